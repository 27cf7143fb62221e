//! Version vectors and names of transactions as text. People copy them from one command to the next, and a watcher resumes from
//! one.
//!
//! A version vector is `origin:number` for each origin, separated by commas: `4f2a…:12,9b01…:7`. The empty version vector, before
//! everything, is `0`.

use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};

/// Returns a version vector as text without blanks.
pub fn token(vector: &VersionVector) -> String {
    if vector.is_empty() { "0".to_owned() } else { vector.to_string().replace(' ', ",") }
}

/// Reads the text that [`token`] returns.
pub fn vector(text: &str) -> Option<VersionVector> {
    if text == "0" {
        return Some(VersionVector::default());
    }
    text.split(',').map(|entry| dot(entry).map(|dot| (dot.origin, dot.seq))).collect()
}

/// Reads the name of a transaction.
pub fn dot(text: &str) -> Option<Dot> {
    let (origin, seq) = text.split_once(':')?;
    let plain = !seq.is_empty() && seq.bytes().all(|byte| byte.is_ascii_digit()) && !seq.starts_with('0');
    let seq = plain.then(|| seq.parse().ok())??;
    Some(Dot { origin: ReplicaId::parse(origin)?, seq })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_was_written_is_read(entries in proptest::collection::btree_map(any::<u64>(), 1_u64.., 0..5)) {
            let whole: VersionVector = entries.into_iter().map(|(origin, seq)| (ReplicaId::new(origin), seq)).collect();
            let text = token(&whole);
            prop_assert!(!text.contains(char::is_whitespace));
            prop_assert_eq!(vector(&text), Some(whole));
        }

        #[test]
        fn anything_else_is_refused(text in "[0-9a-f:, ]{0,40}") {
            prop_assert!(vector(&text).is_none_or(|vector| token(&vector).len() <= text.len()));
        }
    }

    #[test]
    fn what_is_none() {
        for text in ["", ":", "ab:1", "00000000000000ab:0", "00000000000000ab:01", "00000000000000ab:+1", "0,0"] {
            assert_eq!(vector(text), None, "{text}");
        }
    }
}
