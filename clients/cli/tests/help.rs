//! What needs no server.

use std::process::{Command, Output};

fn stereo(args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_stereo"));
    command
        .args(args)
        .output()
        .expect("a program that cargo has built")
}

#[test]
fn help_tells_the_exit_codes_and_the_variable() {
    let output = stereo(&["--help"]);
    let text = String::from_utf8_lossy(&output.stdout);
    for word in [
        "Exit codes:",
        "4  refused",
        "STEREO_SERVER",
        "doctor",
        "completions",
    ] {
        assert!(text.contains(word), "{word}: {text}");
    }
    assert!(output.status.success());
    assert_eq!(stereo(&[]).status.code(), Some(2));
}

#[test]
fn every_shell_gets_completions() {
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        let output = stereo(&["completions", shell]);
        let script = String::from_utf8_lossy(&output.stdout);
        assert!(
            output.status.success() && script.contains("doctor"),
            "{shell}: {script}"
        );
        let json = stereo(&["completions", shell, "--json"]).stdout;
        let object: serde_json::Value = serde_json::from_slice(&json).expect("one object");
        let same = object["script"].as_str().map(str::trim_end);
        assert_eq!(same, Some(script.trim_end()), "{shell}");
    }
}

#[test]
fn text_that_is_not_for_a_terminal_has_no_colours() {
    let output = stereo(&["match", "nothing-here"]);
    assert_eq!(output.status.code(), Some(1));
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(text.starts_with("error: nothing-here can't be read"), "{text}");
}
