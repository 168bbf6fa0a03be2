use serde_json::Value;

use super::*;

fn description() -> Value {
    serde_json::from_slice(&JSON).unwrap()
}

#[test]
fn the_committed_description_is_the_codes() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/openapi.json");
    if std::fs::read(path).ok().as_deref() != Some(&JSON[..]) {
        std::fs::write(path, &JSON[..]).unwrap();
        panic!("server/openapi.json was stale and has been rewritten: run again and commit it");
    }
}

#[test]
fn what_is_referred_to_is_there() {
    fn check(part: &Value, whole: &Value) {
        match part {
            Value::Object(members) => {
                if let Some(Value::String(name)) = members.get("$ref") {
                    let pointer = name.strip_prefix('#').unwrap();
                    assert!(whole.pointer(pointer).is_some(), "{name} is nowhere");
                }
                members.values().for_each(|member| check(member, whole));
            }
            Value::Array(items) => items.iter().for_each(|item| check(item, whole)),
            _ => {}
        }
    }
    let whole = description();
    assert!(whole["openapi"].as_str().unwrap().starts_with("3.1"));
    check(&whole, &whole);
}

#[test]
fn options_are_described_with_the_ranges_and_names_that_are_checked() {
    let options = &description()["components"]["schemas"]["Options"];
    assert_eq!(options["additionalProperties"], false);
    let disparities = &options["properties"]["num_disparities"];
    assert_eq!(
        (&disparities["minimum"], &disparities["maximum"]),
        (&16.into(), &256.into())
    );
    assert_eq!(disparities["multipleOf"], 16);
    assert_eq!(
        options["properties"]["preset"]["enum"],
        serde_json::json!(["default", "fast", "paper", null])
    );
    assert!(options.get("required").is_none(), "every option may be left out");
}

#[test]
fn the_page_needs_nothing_but_this_server() {
    let config = || Arc::new(Config::from("/openapi.json").validator_url("none"));
    let response = page("index.html", config()).unwrap();
    assert_eq!(response.headers()[CONTENT_TYPE], "text/html");
    let file = utoipa_swagger_ui::serve("index.html", config()).unwrap().unwrap();
    let text = String::from_utf8(file.bytes.into_owned()).unwrap();
    assert!(!text.contains("http://") && !text.contains("https://"), "{text}");
    let file = utoipa_swagger_ui::serve("swagger-initializer.js", config())
        .unwrap()
        .unwrap();
    assert!(String::from_utf8_lossy(&file.bytes).contains("/openapi.json"));
    assert!(page("nothing.js", config()).is_err());
}
