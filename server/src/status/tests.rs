use super::*;

#[expect(clippy::too_many_lines, reason = "a table: one entry an error")]
fn every_error() -> Vec<(ServiceError, u16, &'static str)> {
    let budget = Duration::from_millis(5);
    let earliest_feasible = Some(Duration::from_micros(12_500));
    vec![
        (ServiceError::Invalid("x".into()), 400, "INVALID"),
        (
            ServiceError::Unauthenticated { is_wrong: false },
            401,
            "UNAUTHENTICATED",
        ),
        (
            ServiceError::Unauthenticated { is_wrong: true },
            401,
            "UNAUTHENTICATED",
        ),
        (
            ServiceError::Forbidden {
                client: "a".into(),
                camera: "b".into(),
            },
            403,
            "FORBIDDEN",
        ),
        (
            ServiceError::Rate {
                client: "a".into(),
                limit: 5,
                wait: budget,
            },
            429,
            "QUOTA",
        ),
        (
            ServiceError::ClientBytes {
                client: "a".into(),
                limit: 1 << 20,
            },
            429,
            "QUOTA",
        ),
        (
            ServiceError::NoSuchResource { path: "/v2".into() },
            404,
            "INVALID",
        ),
        (ServiceError::NoSuchStream { camera: "x".into() }, 404, "INVALID"),
        (
            ServiceError::NoFrames {
                camera: "x".into(),
                waited: budget,
            },
            404,
            "INVALID",
        ),
        (
            ServiceError::MethodNotAllowed {
                path: "/".into(),
                expected: "GET",
                got: "PUT".into(),
            },
            405,
            "INVALID",
        ),
        (
            ServiceError::NotAcceptable {
                expected: "image/png",
                got: "text/html".into(),
            },
            406,
            "INVALID",
        ),
        (
            ServiceError::ReadTimeout {
                limit: Duration::from_secs(10),
            },
            408,
            "EXPIRED",
        ),
        (
            ServiceError::UnsupportedMediaType {
                expected: "a",
                got: "b".into(),
            },
            415,
            "INVALID",
        ),
        (ServiceError::Unmatchable("x".into()), 422, "INVALID"),
        (ServiceError::TooLarge("x".into()), 413, "TOO_LARGE"),
        (ServiceError::Internal("x".into()), 500, "INTERNAL"),
        (
            ServiceError::QueueFull {
                limit: 8,
                earliest_feasible: None,
            },
            503,
            "QUEUE_FULL",
        ),
        (ServiceError::BytesInFlight { limit: 1 << 20 }, 503, "QUEUE_FULL"),
        (ServiceError::Draining, 503, "DRAINING"),
        (ServiceError::Superseded, 409, "SUPERSEDED"),
        (ServiceError::Displaced, 503, "QUEUE_FULL"),
        (ServiceError::TooManyConnections { limit: 4 }, 503, "QUEUE_FULL"),
        (ServiceError::Quota { earliest_feasible }, 429, "QUOTA"),
        (ServiceError::SlowReader { limit: budget }, 408, "SLOW_READER"),
        (
            ServiceError::DeadlineInfeasible {
                budget,
                earliest_feasible,
            },
            504,
            "DEADLINE_INFEASIBLE",
        ),
        (
            ServiceError::Expired {
                budget,
                earliest_feasible: None,
            },
            504,
            "EXPIRED",
        ),
    ]
}

#[test]
fn every_error_has_one_code_and_reason_on_both_encodings() {
    for (error, code, reason) in every_error() {
        let status = error.to_status("id-7");
        assert_eq!(status.code, u32::from(code), "{error}");
        assert_eq!(
            status.reason().as_str_name(),
            format!("REASON_{reason}"),
            "{error}"
        );
        assert_eq!(status.request_id, "id-7");
        let problem: serde_json::Value = serde_json::from_slice(&error.to_problem_json("id-7")).unwrap();
        assert_eq!(problem["status"], code);
        assert_eq!(problem["reason"], reason);
        assert_eq!(problem["detail"], status.message);
        assert_eq!(problem["type"], "about:blank");
        assert_eq!(problem["request_id"], "id-7");
    }
}

#[test]
fn retry_after_is_rounded_up_and_the_body_is_exact() {
    let error = ServiceError::DeadlineInfeasible {
        budget: Duration::from_millis(5),
        earliest_feasible: Some(Duration::from_micros(12_500)),
    };
    assert_eq!(error.retry_after_s(), Some(1));
    let problem: serde_json::Value = serde_json::from_slice(&error.to_problem_json("")).unwrap();
    assert_eq!(problem["earliest_feasible_ms"], 12.5);
    assert!(problem.get("request_id").is_none());
    let wait = |wait_ms| {
        let earliest_feasible = Some(Duration::from_millis(wait_ms));
        ServiceError::QueueFull {
            limit: 1,
            earliest_feasible,
        }
        .retry_after_s()
    };
    assert_eq!((wait(0), wait(1000), wait(1001)), (Some(1), Some(1), Some(2)));
}

#[test]
fn only_what_can_pass_is_worth_trying_again() {
    for (error, code, _) in every_error() {
        let known = error.earliest_feasible().is_some();
        assert_eq!(
            error.retry_after_s().is_some(),
            matches!(code, 429 | 503) || known,
            "{error}"
        );
    }
}

#[test]
fn every_code_is_listed() {
    let codes: std::collections::BTreeSet<u16> = every_error()
        .iter()
        .map(|(error, ..)| error.http_code())
        .collect();
    assert_eq!(codes, ServiceError::HTTP_CODES.into());
}

#[test]
fn nothing_that_was_sent_comes_back_at_length() {
    for long in ["x".repeat(100_000), "\u{e4}\u{1f600}".repeat(10_000)] {
        let error = ServiceError::NoSuchResource { path: long };
        let text = error.text();
        assert!(
            text.len() <= LONGEST_TEXT && text.len() > LONGEST_TEXT - 10,
            "{}",
            text.len()
        );
        assert!(
            text.starts_with("there is nothing at") && text.ends_with("GET /v1/info"),
            "{text}"
        );
        assert_eq!(error.to_status("").message, text);
    }
    let short = ServiceError::Draining;
    assert_eq!(short.text(), short.to_string());
}
