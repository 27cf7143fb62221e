//! The words of a command line.

use crate::name::is_hidden;

/// Splits a command line as a shell does, without its expansions.
///
/// # Errors
/// A quote is not closed.
pub(super) fn split(line: &str) -> Result<Vec<String>, String> {
    let (mut words, mut word, mut quote) = (Vec::new(), None::<String>, None);
    let mut characters = line.chars();
    while let Some(found) = characters.next() {
        match (found, quote) {
            (_, Some(open)) if found == open => quote = None,
            ('\\', None | Some('"')) => word.get_or_insert_default().extend(characters.next()),
            ('\'' | '"', None) => {
                word.get_or_insert_default();
                quote = Some(found);
            }
            (_, None) if found.is_whitespace() => words.extend(word.take()),
            (_, None | Some(_)) => word.get_or_insert_default().push(found),
        }
    }
    words.extend(word);
    quote.map_or(Ok(words), |quote| Err(format!("the quote {quote} is not closed")))
}

/// Returns a word as the spec writes it in a command line.
///
/// # Errors
/// A spec cannot have it.
pub(super) fn written(word: &str) -> Result<String, String> {
    let is_bare = |c: char| c.is_ascii_alphanumeric() || "_-./=:+@%,~".contains(c);
    if word.chars().any(is_hidden) {
        return Err(format!("`{}` has hidden characters", crate::name::plain(word)));
    }
    if !word.is_empty() && word.chars().all(is_bare) {
        return Ok(word.to_owned());
    }
    let quote = ['\'', '"'].into_iter().find(|quote| !word.contains(*quote));
    quote.map(|quote| format!("{quote}{word}{quote}")).ok_or_else(|| format!("`{word}` has both kinds of quotes"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_split_as_a_shell_does() {
        let expected = ["a", "b c", "d'e", "", "f\\g", "h i"].map(str::to_owned);
        assert_eq!(split("a 'b c'  \"d'e\" '' f\\\\g h\\ i"), Ok(expected.to_vec()));
        assert!(split("a 'b").is_err());
        assert_eq!(split("  "), Ok(Vec::new()));
    }

    #[test]
    fn a_word_is_quoted_if_it_has_to_be() {
        assert_eq!(written("--a=b"), Ok("--a=b".to_owned()));
        assert_eq!(written("a b"), Ok("'a b'".to_owned()));
        assert_eq!(written("it's"), Ok("\"it's\"".to_owned()));
        assert_eq!(written(""), Ok("''".to_owned()));
        assert!(written("'\"").is_err() && written("a\nb").is_err());
    }
}
