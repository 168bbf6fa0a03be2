use super::*;

#[test]
fn the_documented_table_is_the_registry() {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/METRICS.md");
    let fresh = table::markdown();
    if std::fs::read_to_string(path).ok().as_ref() != Some(&fresh) {
        std::fs::write(path, fresh).unwrap();
        panic!("server/METRICS.md was stale and has been rewritten: run again and commit it");
    }
}

#[test]
fn recording_never_adds_a_series() {
    let metrics = Metrics::new();
    let series = |metrics: &Metrics| {
        metrics
            .text()
            .lines()
            .filter(|line| !line.starts_with('#'))
            .count()
    };
    let before = series(&metrics);
    for class in [
        None,
        Some(PriorityClass::Deadline),
        Some(PriorityClass::Background),
    ] {
        for outcome in OUTCOMES {
            metrics.ended(class, outcome);
        }
    }
    for rungs in [RungsCut::Budget, RungsCut::Load, RungsCut::Superseded] {
        let degradation = Degradation {
            rungs: Some(rungs),
            is_half: true,
            has_no_mesh: true,
        };
        let report = Report {
            degradation,
            ..Report::default()
        };
        metrics.answered(PriorityClass::BestEffort, &report, None);
    }
    for reason in &OUTCOMES[1..] {
        metrics.dropped(reason);
    }
    assert_eq!(series(&metrics), before);
}

#[test]
fn every_reason_of_a_refusal_is_an_outcome() {
    use stereo_proto::v1::Reason;
    for number in 0..64 {
        let Ok(reason) = Reason::try_from(number) else {
            continue;
        };
        let name = reason.as_str_name().trim_start_matches("REASON_");
        assert_eq!(OUTCOMES.contains(&name), reason != Reason::Unspecified, "{name}");
    }
}

#[test]
fn an_answered_frame_is_counted_by_its_report() {
    let metrics = Metrics::new();
    let report = Report {
        total: Duration::from_millis(30),
        matched: Duration::from_millis(20),
        deadline_met: true,
        iterations_run: 3,
        steps: 40,
        ..Report::default()
    };
    let costs = Some((Duration::from_millis(22), Duration::from_millis(20)));
    metrics.answered(PriorityClass::Deadline, &report, costs);
    let text = metrics.text();
    for line in [
        "stereod_latency_seconds_bucket{le=\"0.033\",class=\"deadline\"} 1",
        "stereod_deadlines_total{outcome=\"kept\"} 1",
        "stereod_steps_total 40",
        "stereod_rungs_sum 3.0",
        "stereod_prediction_error_ratios_bucket{le=\"0.15\"} 1",
    ] {
        assert!(text.contains(line), "{line} isn't in\n{text}");
    }
    assert!(text.ends_with("# EOF\n"));
}
