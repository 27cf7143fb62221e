//! Splits `exec "…"` into a program and its arguments. There is no shell in between.
//!
//! Blanks separate words. Text between two `'`, or between two `"`, belongs to one word, blanks included, and joins the
//! adjacent text, as in a shell. Nothing else has a meaning, neither `$` nor `*` nor `\`.

use thiserror::Error;

/// Why nothing can be started.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum ExecError {
    /// No word in it.
    #[error("it names no program")]
    Empty,
    /// A quote without its other half.
    #[error("a quote ({0}) is not closed")]
    Unclosed(char),
}

/// Returns the words of an `exec`: the program first, then its arguments.
///
/// # Errors
/// There is none, or a quote is not closed.
pub fn words(exec: &str) -> Result<Vec<String>, ExecError> {
    let (mut words, mut word, mut open) = (Vec::new(), None::<String>, None);
    for c in exec.chars() {
        if open == Some(c) {
            open = None;
        } else if open.is_none() && c.is_whitespace() {
            words.extend(word.take());
        } else {
            // A quote that opens begins a word, which may stay empty.
            let word = word.get_or_insert_default();
            if open.is_none() && (c == '\'' || c == '"') {
                open = Some(c);
            } else {
                word.push(c);
            }
        }
    }
    words.extend(word);
    match open {
        Some(quote) => Err(ExecError::Unclosed(quote)),
        None if words.first().is_none_or(String::is_empty) => Err(ExecError::Empty),
        None => Ok(words),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blanks_separate_and_quotes_keep_together() {
        let check = |exec: &str, expected: &[&str]| {
            assert_eq!(words(exec), Ok(expected.iter().map(|word| (*word).to_owned()).collect()), "{exec}");
        };
        check("fetch", &["fetch"]);
        check("  espeak-ng\t-s 120  hello ", &["espeak-ng", "-s", "120", "hello"]);
        check("'/opt/my robot/say' 'good morning' \"it's me\"", &["/opt/my robot/say", "good morning", "it's me"]);
        check("tool --name='a b'c '' \"\"", &["tool", "--name=a bc", "", ""]);
        check(r"grep \d+ $HOME *", &["grep", r"\d+", "$HOME", "*"]);
    }

    #[test]
    fn what_cannot_be_started() {
        for exec in ["", " \t", "''", "'' x"] {
            assert_eq!(words(exec), Err(ExecError::Empty), "{exec}");
        }
        assert_eq!(words("say 'good morning"), Err(ExecError::Unclosed('\'')));
        assert_eq!(words("say \"it's"), Err(ExecError::Unclosed('"')));
    }
}
