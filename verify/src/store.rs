//! The states that were seen, each once, in the order of their discovery.
//!
//! All states of a system have the same length, so they lie one after the other in one array, and a number names one. The
//! table beside it holds numbers only: four bytes a slot, at most two thirds of them taken.

/// A set of byte strings of one length, numbered from 0.
#[derive(Debug)]
pub(crate) struct Store {
    length: usize,
    bytes: Vec<u8>,
    /// The number of a state plus 1; 0 is a free slot. The number of slots is a power of two.
    slots: Vec<u32>,
    count: u32,
}

impl Store {
    pub(crate) fn new(length: usize) -> Self {
        Self { length, bytes: Vec::new(), slots: vec![0; 1024], count: 0 }
    }

    pub(crate) fn count(&self) -> u32 {
        self.count
    }

    pub(crate) fn get(&self, state: u32) -> &[u8] {
        let start = state as usize * self.length;
        &self.bytes[start..start + self.length]
    }

    /// The memory that it takes, in bytes.
    pub(crate) fn memory(&self) -> usize {
        self.bytes.capacity() + 4 * self.slots.len()
    }

    /// Adds a state unless it is known; returns its number, and whether it is new.
    pub(crate) fn add(&mut self, state: &[u8]) -> (u32, bool) {
        debug_assert_eq!(state.len(), self.length, "all states of a system have one length");
        if (self.count as usize + 1) * 3 > self.slots.len() * 2 {
            self.grow();
        }
        let mask = self.slots.len() - 1;
        let mut slot = hash(state) & mask;
        while self.slots[slot] != 0 {
            let known = self.slots[slot] - 1;
            if self.get(known) == state {
                return (known, false);
            }
            slot = (slot + 1) & mask;
        }
        let number = self.count;
        self.bytes.extend_from_slice(state);
        self.count += 1;
        self.slots[slot] = self.count;
        (number, true)
    }

    fn grow(&mut self) {
        let mask = 2 * self.slots.len() - 1;
        let mut slots = vec![0; mask + 1];
        for state in 0..self.count {
            let mut slot = hash(self.get(state)) & mask;
            while slots[slot] != 0 {
                slot = (slot + 1) & mask;
            }
            slots[slot] = state + 1;
        }
        self.slots = slots;
    }
}

/// Mixes the bytes, eight at a time. Two rounds of multiplication spread states that differ in one bit.
fn hash(bytes: &[u8]) -> usize {
    const FACTOR: u64 = 0x9e37_79b9_7f4a_7c15;
    let mut sum: u64 = bytes.len() as u64;
    for chunk in bytes.chunks(8) {
        let mut word = [0; 8];
        word[..chunk.len()].copy_from_slice(chunk);
        sum = (sum ^ u64::from_le_bytes(word)).wrapping_mul(FACTOR);
        sum ^= sum >> 29;
    }
    usize::try_from(sum.wrapping_mul(FACTOR) >> 20).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_state_is_kept_once() {
        let mut store = Store::new(4);
        for round in 0..2 {
            for number in 0..5000_u32 {
                assert_eq!(store.add(&number.to_le_bytes()), (number, round == 0));
            }
        }
        assert_eq!(store.count(), 5000);
        assert_eq!(store.get(77), 77_u32.to_le_bytes());
    }
}
