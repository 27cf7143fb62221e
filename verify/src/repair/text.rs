//! Expressions as text.

use std::time::Duration;

/// Returns a text as one operand: in parentheses, unless it is one word or already in parentheses.
pub(super) fn operand(text: &str) -> String {
    let is_word = text.chars().all(|c| c.is_alphanumeric() || matches!(c, '_' | '[' | ']' | '.'));
    let is_prefixed =
        ["retry", "using"].iter().any(|word| head(text, word).is_some_and(|(_, _, body)| inside(body).is_some()));
    if is_word || is_prefixed || inside(text).is_some() { text.to_owned() } else { format!("({text})") }
}

/// Returns the text inside the parentheses around a whole text.
pub(super) fn inside(text: &str) -> Option<&str> {
    let body = text.strip_prefix('(')?.strip_suffix(')')?;
    let mut depth = 0_i32;
    let is_open = |c: char| {
        depth += i32::from(c == '(') - i32::from(c == ')');
        depth >= 0
    };
    body.chars().all(is_open).then(|| body.trim())
}

/// Returns the operands of the outermost `;` of a text. The result is the text itself if there is none, or another
/// operator of the same rank.
pub(super) fn steps(text: &str) -> Vec<&str> {
    let body = inside(text).unwrap_or(text);
    let (mut depth, mut begin, mut steps) = (0_i32, 0, Vec::new());
    let bytes = body.as_bytes();
    for (at, byte) in bytes.iter().enumerate() {
        match byte {
            b'(' | b'{' | b'[' => depth += 1,
            b')' | b'}' | b']' => depth -= 1,
            b',' | b'#' | b'&' | b':' if depth == 0 => return vec![text],
            b';' if depth == 0 => {
                if bytes.get(at + 1) == Some(&b';') || at > 0 && bytes[at - 1] == b';' {
                    return vec![text];
                }
                steps.push(body[begin..at].trim());
                begin = at + 1;
            }
            _ => {}
        }
    }
    steps.push(body[begin..].trim());
    steps
}

/// Returns the three parts of `using(a, b) P` or `retry(3) P`: the head up to its `)`, the text between the
/// parentheses, and P.
pub(super) fn head<'t>(text: &'t str, word: &str) -> Option<(&'t str, &'t str, &'t str)> {
    let rest = text.strip_prefix(word)?;
    let open = rest.find(|c: char| !c.is_whitespace()).filter(|at| rest[*at..].starts_with('('))?;
    let close = rest.find(')')?;
    let end = word.len() + close + 1;
    Some((&text[..end], rest[open + 1..close].trim(), text[end..].trim_start()))
}

/// Returns whether a text contains a word.
pub(super) fn has_word(text: &str, word: &str) -> bool {
    text.split(|c: char| !(c.is_alphanumeric() || c == '_')).any(|other| other == word)
}

/// Returns a time as a spec writes it.
pub(super) fn time(time: Duration) -> String {
    crate::story::seconds(time)
}

/// Returns the time at the end of a sentence: `2 s`, `300 ms`.
pub(super) fn last_time(text: &str) -> Option<Duration> {
    let mut words = text.rsplit(' ');
    let (unit, number) = (words.next()?, words.next()?);
    let number: f64 = number.parse().ok()?;
    let factor = match unit {
        "s" => 1.0,
        "ms" => 1e-3,
        _ => return None,
    };
    Duration::try_from_secs_f64(number * factor).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_taken_apart() {
        assert_eq!(steps("(pick ; (a, b) ; place)"), ["pick", "(a, b)", "place"]);
        assert_eq!(steps("a ;; b"), ["a ;; b"]);
        assert_eq!(steps("a , b ; c"), ["a , b ; c"]);
        assert_eq!(inside("(a) ; (b)"), None);
        assert_eq!(head("using(a, b) (c ; d)", "using"), Some(("using(a, b)", "a, b", "(c ; d)")));
        assert_eq!(operand("a ; b"), "(a ; b)");
        assert_eq!(operand("retry(2) (a ; b)"), "retry(2) (a ; b)");
        assert_eq!(operand("force[lbl1]"), "force[lbl1]");
        assert_eq!(last_time("give it more than 300 ms"), Some(Duration::from_millis(300)));
    }
}
