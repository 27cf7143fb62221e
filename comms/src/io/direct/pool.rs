//! The shared buffers of one output. Each value is in one buffer for all consumers on this host,
//! until all consumers have released it.

use super::memory::{Buffer, Filler};
use std::collections::BTreeMap;
use std::io;
use std::os::fd::BorrowedFd;

/// How much one consumer may hold without releasing it: so many bytes, but at least `COUNT_MIN` and at most
/// `COUNT_MAX` values. Further values are lost for that consumer. One held value may wait for the loop of the
/// consumer.
const BYTES_MAX: usize = 32 << 20;
const COUNT_MIN: usize = 3;
const COUNT_MAX: usize = 16;
/// The smallest buffer, in bytes.
const SIZE_MIN: usize = 64 << 10;

/// The buffers of one output.
#[derive(Debug, Default)]
pub(super) struct Pool {
    slots: BTreeMap<u32, Slot>,
    next: u32,
    /// How long the last value was.
    pub(super) size_last: usize,
}

#[derive(Debug)]
struct Slot {
    buffer: Buffer,
    /// How many consumers have not released the buffer.
    leases: usize,
    /// Whether a consumer that is gone may still read the buffer.
    is_abandoned: bool,
}

/// Returns how many values of a size one consumer may keep.
pub(super) fn leases_max(size: usize) -> usize {
    (BYTES_MAX / size.max(1)).clamp(COUNT_MIN, COUNT_MAX)
}

impl Pool {
    /// Puts a value into an unused buffer, and returns its number.
    ///
    /// # Errors
    /// If the system has no memory for another buffer.
    pub(super) fn put(&mut self, bytes: &[u8]) -> io::Result<u32> {
        let filled = self.fill(bytes.len(), |filler| filler.put(bytes))?;
        // A buffer that was chosen by its size has room.
        filled.map(|(number, _)| number).ok_or_else(|| io::ErrorKind::StorageFull.into())
    }

    /// Lets `fill` write a value into an unused buffer of at least `room` bytes. Returns the buffer's number and the
    /// length of the value; none if `fill` finds no room.
    ///
    /// # Errors
    /// If the system has no memory for another buffer.
    pub(super) fn fill(
        &mut self,
        room: usize,
        fill: impl FnOnce(&mut Filler<'_>) -> bool,
    ) -> io::Result<Option<(u32, usize)>> {
        self.slots.retain(|_, slot| !slot.is_abandoned);
        let is_free = |slot: &Slot| slot.leases == 0 && slot.buffer.size() >= room;
        let free = self.slots.iter().find(|(_, slot)| is_free(slot)).map(|(number, _)| *number);
        let number = match free {
            Some(number) => number,
            None => self.add(room)?,
        };
        let Some(slot) = self.slots.get_mut(&number) else { return Ok(None) };
        let mut filler = slot.buffer.filler();
        Ok(fill(&mut filler).then(|| (number, filler.size())))
    }

    /// Returns a copy of a value.
    pub(super) fn read(&self, number: u32, size: usize) -> Option<Vec<u8>> {
        self.slots.get(&number)?.buffer.read(size)
    }

    /// Makes a buffer; unused buffers that are too small for the present values are removed.
    fn add(&mut self, size: usize) -> io::Result<u32> {
        let buffer = Buffer::new(size.next_power_of_two().max(SIZE_MIN))?;
        self.slots.retain(|_, slot| slot.leases > 0 || slot.buffer.size() >= size);
        self.next = self.next.wrapping_add(1);
        self.slots.insert(self.next, Slot { buffer, leases: 0, is_abandoned: false });
        Ok(self.next)
    }

    /// Returns the file of a buffer.
    pub(super) fn file(&self, number: u32) -> Option<BorrowedFd<'_>> {
        self.slots.get(&number).map(|slot| slot.buffer.file())
    }

    /// Returns whether the pool still has this buffer.
    pub(super) fn has(&self, number: u32) -> bool {
        self.slots.contains_key(&number)
    }

    /// Notes that one more consumer has the buffer.
    pub(super) fn lease(&mut self, number: u32) {
        if let Some(slot) = self.slots.get_mut(&number) {
            slot.leases += 1;
        }
    }

    /// Marks a buffer as never usable again: a consumer that is no longer connected may not have read it yet. The
    /// buffer is removed only before the next value is written, because its value may still be sent to others.
    pub(super) fn abandon(&mut self, number: u32) {
        if let Some(slot) = self.slots.get_mut(&number) {
            slot.is_abandoned = true;
        }
    }

    /// Notes that one consumer has released the buffer.
    pub(super) fn release(&mut self, number: u32) {
        if let Some(slot) = self.slots.get_mut(&number) {
            slot.leases = slot.leases.saturating_sub(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_buffer_is_filled_again_once_all_have_released_it() {
        let mut pool = Pool::default();
        let first = pool.put(&[1; 100_000]).unwrap();
        pool.lease(first);
        pool.lease(first);
        let second = pool.put(&[2; 100]).unwrap();
        assert_ne!(first, second);
        pool.lease(second);
        pool.release(first);
        assert!(![first, second].contains(&pool.put(&[3; 100]).unwrap()));
        pool.release(first);
        assert_eq!(pool.put(&[4; 100_000]).unwrap(), first);
        pool.lease(first);
        let larger = pool.put(&[5; 200_000]).unwrap();
        assert!(pool.has(larger) && pool.has(second) && pool.has(first), "what is in use stays");
        pool.abandon(first);
        assert!(pool.has(first), "its value may still be on its way to others");
        let next = pool.put(&[6; 100]).unwrap();
        assert!(next != first && !pool.has(first));
    }

    #[test]
    fn a_consumer_keeps_so_many_values_and_no_more() {
        assert_eq!([1, 1 << 20, 8 << 20, 64 << 20].map(leases_max), [16, 16, 4, 3]);
    }
}
