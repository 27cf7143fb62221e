//! A value that arrived over a wire: bytes of this program, or bytes in the memory of their producer. The producer
//! does not write there until the bytes are taken.

use super::memory::{Mapping, Reading};
use super::packet::send;
use crate::logic::decode::Source;
use crate::logic::direct::release;
use std::os::fd::OwnedFd;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// A value of a wire.
#[derive(Debug)]
pub enum Value {
    /// Bytes of this program.
    Own(Vec<u8>),
    /// Bytes in the memory of their producer.
    Loaned(Arc<Loan>),
}

/// A value in memory of its producer. Dropping it gives the memory back.
///
/// Each wire has at most one loan at a time: when the next value arrives, this one is copied.
#[derive(Debug)]
pub struct Loan {
    state: Mutex<State>,
}

#[derive(Debug)]
enum State {
    There { mapping: Arc<Mapping>, size: usize, _return: Return },
    Copied(Vec<u8>),
}

/// Gives a buffer back when it is dropped.
#[derive(Debug)]
pub(super) struct Return {
    pub(super) stream: Arc<OwnedFd>,
    pub(super) buffer: u32,
}

impl Drop for Return {
    fn drop(&mut self) {
        // The socket has room: the producer limits how many buffers this consumer has.
        send(&self.stream, &[&release(self.buffer)], None);
    }
}

impl Value {
    /// Returns its bytes.
    pub fn into_vec(self) -> Vec<u8> {
        match self {
            Self::Own(bytes) => bytes,
            Self::Loaned(loan) => loan.read(|source| {
                let mut bytes = Vec::new();
                source.append(source.left(), &mut bytes);
                bytes
            }),
        }
    }
}

impl From<Vec<u8>> for Value {
    fn from(bytes: Vec<u8>) -> Self {
        Self::Own(bytes)
    }
}

impl Loan {
    /// Returns the first `size` bytes of a buffer; none if the buffer is shorter.
    pub(super) fn new(mapping: &Arc<Mapping>, size: usize, back: Return) -> Option<Self> {
        let state = State::There { mapping: Arc::clone(mapping), size, _return: back };
        (size <= mapping.size()).then(|| Self { state: Mutex::new(state) })
    }

    /// Lets `read` read the bytes, from their beginning.
    pub fn read<R>(&self, read: impl FnOnce(&mut dyn Source) -> R) -> R {
        match &*self.state() {
            State::There { mapping, size, .. } => read(&mut Reading::new(mapping, *size)),
            State::Copied(bytes) => read(&mut &**bytes),
        }
    }

    /// Copies the bytes, and gives the memory back.
    pub(super) fn copy(&self) {
        let mut state = self.state();
        if let State::There { mapping, size, .. } = &*state {
            let bytes = mapping.read(*size).unwrap_or_default();
            *state = State::Copied(bytes);
        }
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
