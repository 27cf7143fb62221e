//! Texts of others, made safe and short before the model keeps them.

use node::logic::printable::one_line;

/// The longest text that is kept, in characters.
pub(crate) const TEXT_MAX: usize = 400;
/// The longest name of a host, a deployment or a process, in characters.
const NAME_MAX: usize = 400;

/// Returns a text on one line that moves no cursor and hides no other text, cut after [`TEXT_MAX`] characters.
pub(crate) fn clean(text: &str) -> String {
    // Most of a text that is far too long is not even looked at: one character has at most four bytes.
    let near: String = text.chars().take(TEXT_MAX + 1).collect();
    let shown = one_line(&near);
    if shown.chars().count() <= TEXT_MAX {
        return shown;
    }
    shown.chars().take(TEXT_MAX - 1).chain(['…']).collect()
}

/// Returns whether a name can be shown and used without a change. Every name in a spec can have this form.
pub(crate) fn is_name(name: &str) -> bool {
    !name.is_empty() && name.len() <= NAME_MAX && one_line(name) == name
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_is_safe_and_short() {
        assert_eq!(clean("a\x1b[2Jb\nc"), "a\\x1b[2Jb\\nc");
        assert_eq!(clean("é"), "é");
        let long = clean(&"x".repeat(1_000_000));
        assert_eq!((long.chars().count(), long.ends_with('…')), (TEXT_MAX, true));
    }

    #[test]
    fn a_name_with_a_control_character_is_not_one() {
        assert!(is_name("main/hit/force") && is_name("r1"));
        assert!(!is_name("") && !is_name("a\x1b[2J") && !is_name("a\nb") && !is_name(&"a".repeat(401)));
    }
}
