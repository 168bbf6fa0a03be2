use axum::http::HeaderName;

use super::*;

const PAGE: File = File {
    path: "/assets/page-1234.js",
    content_type: "text/javascript; charset=utf-8",
    plain: Body {
        tag: "\"plain\"",
        bytes: b"let a = 1;",
    },
    gzip: Some(Body {
        tag: "\"zipped\"",
        bytes: b"\x1f\x8b",
    }),
};

fn headers(pairs: &[(HeaderName, &'static str)]) -> HeaderMap {
    pairs
        .iter()
        .map(|(name, value)| (name.clone(), HeaderValue::from_static(value)))
        .collect()
}

fn header(response: &Response, name: HeaderName) -> &str {
    response
        .headers()
        .get(name)
        .map_or("", |value| value.to_str().unwrap())
}

#[test]
fn a_browser_that_takes_gzip_gets_it_and_others_don_t() {
    for (accepted, tag, encoding) in [
        ("gzip, deflate, br", "\"zipped\"", "gzip"),
        ("br;q=1.0, GZIP;q=0.5", "\"zipped\"", "gzip"),
        ("gzip;q=0, identity", "\"plain\"", ""),
        ("br", "\"plain\"", ""),
    ] {
        let response = serve(&PAGE, &headers(&[(ACCEPT_ENCODING, accepted)]));
        assert_eq!(header(&response, ETAG), tag, "{accepted}");
        assert_eq!(header(&response, CONTENT_ENCODING), encoding, "{accepted}");
        assert_eq!(header(&response, VARY), "Accept-Encoding");
    }
    assert_eq!(header(&serve(&PAGE, &HeaderMap::new()), ETAG), "\"plain\"");
}

#[test]
fn what_the_browser_has_is_not_sent_again() {
    for (tags, code) in [
        ("\"plain\"", StatusCode::NOT_MODIFIED),
        ("\"other\", W/\"plain\"", StatusCode::NOT_MODIFIED),
        ("*", StatusCode::NOT_MODIFIED),
        ("\"other\"", StatusCode::OK),
        ("\"zipped\"", StatusCode::OK),
    ] {
        let response = serve(&PAGE, &headers(&[(IF_NONE_MATCH, tags)]));
        assert_eq!(response.status(), code, "{tags}");
        assert_eq!(header(&response, ETAG), "\"plain\"");
    }
}

#[test]
fn names_with_a_hash_are_kept_for_ever_and_the_page_is_asked_for_again() {
    let script = serve(&PAGE, &HeaderMap::new());
    assert!(header(&script, CACHE_CONTROL).ends_with("immutable"));
    let page = serve(&ABSENT, &HeaderMap::new());
    assert_eq!(header(&page, CACHE_CONTROL), "no-cache");
}

#[test]
fn the_page_may_load_nothing_from_elsewhere() {
    let page = serve(&ABSENT, &HeaderMap::new());
    let policy = header(&page, CONTENT_SECURITY_POLICY);
    assert!(policy.starts_with("default-src 'none'") && !policy.contains("unsafe"));
}

#[test]
fn the_files_are_all_there_and_refer_to_each_other() {
    let Some(index) = FILES.iter().find(|file| file.path == INDEX) else {
        eprintln!("skipped: the server was built without its console (make console)");
        return;
    };
    let page = std::str::from_utf8(index.plain.bytes).unwrap();
    let named: Vec<&str> = page
        .split('"')
        .filter(|text| text.starts_with("./assets/") || text.starts_with("/assets/"))
        .map(|text| text.trim_start_matches('.'))
        .collect();
    assert!(named.len() >= 2, "a script and a style sheet: {named:?}");
    for path in named {
        assert!(FILES.iter().any(|file| file.path == path), "{path} is not there");
    }
}
