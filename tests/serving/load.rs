//! The load generator against the real server, for as long as it takes to see that it works.

use std::process::{Command, Output};

use crate::conversation::Server;

/// One second of load by the program that `cargo load` runs.
fn load(url: &str, flags: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_load"))
        .args([
            "--server",
            url,
            "--size",
            "128x96",
            "--seconds",
            "1",
            "--max-seconds",
            "1",
        ])
        .args(flags)
        .output()
        .expect("a program that cargo has built")
}

fn text(output: &Output) -> String {
    let (stdout, stderr) = (&output.stdout, &output.stderr);
    format!(
        "{}{}",
        String::from_utf8_lossy(stdout),
        String::from_utf8_lossy(stderr)
    )
}

#[test]
fn a_fleet_that_the_server_carries_gets_a_verdict_that_says_so() {
    let server = Server::start(&[]);
    let flags = [
        "--cameras",
        "2",
        "--rate",
        "5",
        "--budget",
        "60000",
        "--codec",
        "png",
    ];
    let output = load(server.process.url(), &flags);
    let text = text(&output);
    assert_eq!(output.status.code(), Some(0), "{text}");
    for words in [
        "2 cameras at 5 Hz, 128 x 96 px png pairs, budget 60000 ms: 10 frames",
        "100.00 % in budget, wanted 99.00 %",
        "rungs run                  100 %",
    ] {
        assert!(text.contains(words), "{words}: {text}");
    }
}

#[test]
fn a_fleet_that_the_server_does_not_carry_ends_with_exit_code_2() {
    let server = Server::start(&[]);
    let output = load(server.process.url(), &["--rate", "10", "--budget", "0.001"]);
    let text = text(&output);
    assert_eq!(output.status.code(), Some(2), "{text}");
    assert!(text.contains("NOT KEPT: 0.00 % in budget"), "{text}");
    assert!(text.contains("refused ") || text.contains("expired "), "{text}");
}

#[test]
fn a_mistake_on_the_command_line_is_named_before_anything_is_sent() {
    let output = load("http://127.0.0.1:1", &["--rate", "0"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(
        text(&output).contains("--rate must be above 0"),
        "{}",
        text(&output)
    );
}
