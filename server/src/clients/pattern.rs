//! Patterns of camera names.

/// Whether `name` is one of those that `pattern` stands for: `*` is any characters or none, everything else is itself.
pub(super) fn matches(pattern: &str, name: &str) -> bool {
    let (pattern, name) = (pattern.as_bytes(), name.as_bytes());
    let (mut p, mut n) = (0, 0);
    // The last star, and where in the name what follows it was tried last.
    let mut star: Option<(usize, usize)> = None;
    while n < name.len() {
        if p < pattern.len() && pattern[p] == b'*' {
            star = Some((p, n));
            p += 1;
        } else if p < pattern.len() && pattern[p] == name[n] {
            p += 1;
            n += 1;
        } else if let Some((at, tried)) = star {
            star = Some((at, tried + 1));
            p = at + 1;
            n = tried + 1;
        } else {
            return false;
        }
    }
    pattern[p..].iter().all(|&byte| byte == b'*')
}

#[cfg(test)]
mod tests {
    use super::matches;

    #[test]
    fn a_star_is_any_characters_and_all_else_is_itself() {
        for (pattern, name, expected) in [
            ("front", "front", true),
            ("front", "front-2", false),
            ("front", "fron", false),
            ("*", "", true),
            ("*", "anything", true),
            ("arm-*", "arm-", true),
            ("arm-*", "arm-left", true),
            ("arm-*", "harm-left", false),
            ("*-left", "arm-left", true),
            ("*-left", "arm-left-2", false),
            ("a*b*c", "a-b-b-c", true),
            ("a*b*c", "a-c-b", false),
            ("**", "x", true),
            ("", "", true),
            ("", "x", false),
            (".", "x", false),
        ] {
            assert_eq!(matches(pattern, name), expected, "{pattern} {name}");
        }
    }

    #[test]
    fn a_pattern_of_stars_takes_no_time() {
        let (pattern, name) = ("*a".repeat(32), "a".repeat(31) + "b");
        assert!(!matches(&pattern, &name));
    }
}
