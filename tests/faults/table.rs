//! A row for each fault.

use std::fmt::Write as _;
use std::time::Duration;

/// How long it took until pairs were answered again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Recovery {
    /// Until the first result of a pair that was sent after the fault, or after its end.
    Took(Duration),
    /// Pairs were answered all the time.
    NotNeeded,
    /// Until the process was gone.
    Ended(Duration),
}

/// What came of a fault.
#[derive(Debug, Clone)]
pub(crate) struct Row {
    /// What was done.
    pub(crate) fault: String,
    /// What the clients saw of it.
    pub(crate) saw: String,
    pub(crate) recovery: Recovery,
    /// Requests that were taken and got neither a result nor a refusal.
    pub(crate) lost: u64,
    /// How many of them there may be.
    pub(crate) promised: u64,
    /// What the first of them got to know.
    pub(crate) why_lost: String,
}

impl Row {
    pub(crate) fn markdown(&self) -> String {
        let Self {
            fault,
            saw,
            recovery,
            lost,
            promised,
            ..
        } = self;
        let recovery = match recovery {
            Recovery::Took(time) => seconds(*time),
            Recovery::NotNeeded => "not interrupted".to_owned(),
            Recovery::Ended(time) => format!("ended after {}", seconds(*time)),
        };
        let promised = match promised {
            0 => "0".to_owned(),
            most => format!("at most {most}"),
        };
        format!("| {fault} | {saw} | {recovery} | {lost} | {promised} |")
    }

    /// What is promised and was not kept.
    pub(crate) fn broken_promise(&self) -> Option<String> {
        let Self {
            fault,
            saw,
            lost,
            promised,
            why_lost,
            ..
        } = self;
        (lost > promised).then(|| {
            format!("{fault}: {lost} requests were lost, at most {promised} may be ({saw}; {why_lost})")
        })
    }
}

fn seconds(time: Duration) -> String {
    format!("{:.2} s", time.as_secs_f64())
}

/// The whole table, with where it comes from.
pub(crate) fn markdown(rows: &[Row], machine: &str) -> String {
    let mut text =
        "| fault | what the clients saw | recovered | lost | promised |\n|---|---|---|---|---|".to_owned();
    for row in rows {
        write!(text, "\n{}", row.markdown()).expect("a String takes everything");
    }
    write!(text, "\n\n{machine}.").expect("a String takes everything");
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(lost: u64) -> Row {
        Row {
            fault: "a fault".to_owned(),
            saw: "12 results".to_owned(),
            recovery: Recovery::Took(Duration::from_millis(120)),
            lost,
            promised: 0,
            why_lost: String::new(),
        }
    }

    #[test]
    fn a_row_has_as_many_cells_as_the_table() {
        let text = markdown(&[row(0)], "here");
        let mut lines = text.lines().take(3);
        let columns = lines.next().expect("a head").matches('|').count();
        assert!(lines.all(|line| line.matches('|').count() == columns), "{text}");
        assert!(text.contains("| a fault | 12 results | 0.12 s | 0 | 0 |") && text.ends_with("here."));
    }

    #[test]
    fn what_was_lost_and_must_not_be_is_told() {
        assert_eq!(row(0).broken_promise(), None);
        assert!(
            row(1)
                .broken_promise()
                .is_some_and(|why| why.contains("1 requests were lost"))
        );
    }
}
