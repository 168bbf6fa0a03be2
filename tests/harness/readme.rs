//! Puts measured tables into a Markdown file, between two markers.

use std::path::Path;

use anyhow::{Context, Result};

/// Replaces what is between `<!-- name:begin -->` and `<!-- name:end -->` in the file at `path` with `table`.
///
/// # Errors
/// If the file can't be read or written, or doesn't have both markers in that order.
pub fn write_table(path: &Path, name: &str, table: &str) -> Result<()> {
    let old = std::fs::read_to_string(path).with_context(|| format!("can't read {}", path.display()))?;
    let new =
        with_table(&old, name, table).with_context(|| format!("{} can't take the table", path.display()))?;
    std::fs::write(path, new).with_context(|| format!("can't write {}", path.display()))
}

/// `text` with `table` in place of what was between the markers.
fn with_table(text: &str, name: &str, table: &str) -> Result<String> {
    let (begin, end) = (format!("<!-- {name}:begin -->"), format!("<!-- {name}:end -->"));
    let (before, rest) = text
        .split_once(&begin)
        .with_context(|| format!("there is no line {begin}"))?;
    let (_, after) = rest
        .split_once(&end)
        .with_context(|| format!("there is no line {end} after {begin}"))?;
    Ok(format!("{before}{begin}\n{}\n{end}{after}", table.trim()))
}

#[cfg(test)]
mod tests {
    use super::with_table;

    #[test]
    fn only_what_is_between_the_markers_changes() {
        let old =
            "a\n<!-- eval:begin -->\nold\n<!-- eval:end -->\nb\n<!-- load:begin -->\n<!-- load:end -->\n";
        let new =
            "a\n<!-- eval:begin -->\nnew\n<!-- eval:end -->\nb\n<!-- load:begin -->\n<!-- load:end -->\n";
        assert_eq!(with_table(old, "eval", "new\n").expect("both markers"), new);
        assert_eq!(with_table(new, "eval", "new\n").expect("both markers"), new);
    }

    #[test]
    fn a_file_without_markers_is_refused() {
        assert!(with_table("text", "eval", "new").is_err());
        assert!(with_table("<!-- eval:end --> <!-- eval:begin -->", "eval", "new").is_err());
        assert!(with_table("<!-- eval:begin --> <!-- eval:end -->", "load", "new").is_err());
    }
}
