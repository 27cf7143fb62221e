//! Unpredictable random numbers from the system. Reproducible numbers from a seed are in `logic/random`.

use std::io;

/// Returns unpredictable bytes. Right after the start of the machine it waits until the system has collected
/// randomness.
///
/// # Errors
/// If the system has no such call.
pub fn bytes<const N: usize>() -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    getrandom::fill(&mut bytes).map_err(|error| io::Error::other(error.to_string()))?;
    Ok(bytes)
}

/// Returns a unique number: 64 random bits.
///
/// # Errors
/// If the system has no such call.
pub fn number() -> io::Result<u64> {
    bytes().map(u64::from_le_bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn no_number_comes_twice() {
        let numbers: BTreeSet<u64> = (0..1000).map(|_| number().unwrap()).collect();
        assert_eq!(numbers.len(), 1000);
    }
}
