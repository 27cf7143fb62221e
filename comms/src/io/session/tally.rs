//! A count and a digest of a stream of answers. Each end computes them, so the caller can check that it has all
//! answers.

/// How many bytes of the digest travel.
const DIGEST_SIZE: usize = 16;
/// How many bytes a mark has: the number of answers, and the digest.
const MARK_SIZE: usize = 8 + DIGEST_SIZE;

/// How many answers there were, and a digest of all of them in their order.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Tally {
    count: u64,
    digest: [u8; 32],
}

impl Tally {
    /// Adds an answer.
    pub(super) fn add(&mut self, answer: &[u8]) {
        self.count += 1;
        let mut hasher = blake3::Hasher::new();
        hasher.update(&self.digest).update(answer);
        self.digest = hasher.finalize().into();
    }

    /// Returns how many answers there were.
    pub(super) fn count(&self) -> u64 {
        self.count
    }

    /// Returns the mark that ends a stream: the number of answers (`u64`, little-endian), then the digest.
    pub(super) fn mark(&self) -> [u8; MARK_SIZE] {
        let mut mark = [0; MARK_SIZE];
        mark[..8].copy_from_slice(&self.count.to_le_bytes());
        mark[8..].copy_from_slice(&self.digest[..DIGEST_SIZE]);
        mark
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stream_that_lacks_something_has_another_mark() {
        let mark = |answers: &[&[u8]]| {
            let mut tally = Tally::default();
            answers.iter().for_each(|answer| tally.add(answer));
            tally.mark()
        };
        let whole = mark(&[b"a", b"b", b"c"]);
        assert_eq!(mark(&[b"a", b"b", b"c"]), whole);
        let others: [&[&[u8]]; 5] =
            [&[], &[b"a", b"b"], &[b"b", b"a", b"c"], &[b"ab", b"c", b""], &[b"a", b"b", b"c", b""]];
        for other in others {
            assert_ne!(mark(other), whole, "{other:?}");
        }
    }
}
