//! Puts the table into a Markdown file, between two markers.

use anyhow::{Context, Result};

const BEGIN: &str = "<!-- eval:begin -->";
const END: &str = "<!-- eval:end -->";

/// `text` with `table` in place of what was between the markers.
pub(crate) fn with_table(text: &str, table: &str) -> Result<String> {
    let (before, rest) = text
        .split_once(BEGIN)
        .with_context(|| format!("there is no line {BEGIN}"))?;
    let (_, after) = rest
        .split_once(END)
        .with_context(|| format!("there is no line {END} after {BEGIN}"))?;
    Ok(format!("{before}{BEGIN}\n{}\n{END}{after}", table.trim()))
}

#[cfg(test)]
mod tests {
    use super::with_table;

    #[test]
    fn only_what_is_between_the_markers_changes() {
        let old = "a\n<!-- eval:begin -->\nold\n<!-- eval:end -->\nb\n";
        let new = "a\n<!-- eval:begin -->\nnew\n<!-- eval:end -->\nb\n";
        assert_eq!(with_table(old, "new\n").expect("both markers"), new);
        assert_eq!(with_table(new, "new\n").expect("both markers"), new);
    }

    #[test]
    fn a_file_without_markers_is_refused() {
        assert!(with_table("text", "new").is_err());
        assert!(with_table("<!-- eval:end --> <!-- eval:begin -->", "new").is_err());
    }
}
