//! Length-prefixed frames for stream sockets: `length: u32 LE`, then that many bytes.

use std::collections::VecDeque;
use thiserror::Error;

/// The bytes before a frame's body.
pub const PREFIX_SIZE: usize = 4;

/// Why a frame cannot travel.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum FrameError {
    /// Longer than agreed.
    #[error("a frame of {size} bytes is longer than the {size_max} allowed")]
    TooLong {
        /// The size of the frame.
        size: usize,
        /// The limit.
        size_max: usize,
    },
}

/// Returns `body` as a frame.
///
/// # Errors
/// If `body` is longer than `size_max`.
pub fn encode(body: &[u8], size_max: usize) -> Result<Vec<u8>, FrameError> {
    let size = body.len();
    let prefix = u32::try_from(size).ok().filter(|_| size <= size_max);
    let prefix = prefix.ok_or(FrameError::TooLong { size, size_max })?;
    let mut frame = Vec::with_capacity(PREFIX_SIZE + size);
    frame.extend(prefix.to_le_bytes());
    frame.extend(body);
    Ok(frame)
}

/// Assembles frames from the pieces that a stream delivers.
#[derive(Clone, Debug)]
pub struct Decoder {
    bytes: VecDeque<u8>,
    size_max: usize,
}

impl Decoder {
    /// Returns a decoder that refuses frames longer than `size_max`.
    pub fn new(size_max: usize) -> Self {
        Self { bytes: VecDeque::new(), size_max }
    }

    /// Takes the next bytes of the stream.
    pub fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend(bytes);
    }

    /// Returns the body of the next complete frame.
    ///
    /// # Errors
    /// If a frame announces too many bytes. The stream cannot be used afterwards.
    pub fn next_frame(&mut self) -> Result<Option<Vec<u8>>, FrameError> {
        let mut prefix = [0; PREFIX_SIZE];
        if self.bytes.len() < PREFIX_SIZE {
            return Ok(None);
        }
        for (to, from) in prefix.iter_mut().zip(&self.bytes) {
            *to = *from;
        }
        let size = u32::from_le_bytes(prefix) as usize;
        if size > self.size_max {
            return Err(FrameError::TooLong { size, size_max: self.size_max });
        }
        if self.bytes.len() < PREFIX_SIZE + size {
            return Ok(None);
        }
        self.bytes.drain(..PREFIX_SIZE);
        Ok(Some(self.bytes.drain(..size).collect()))
    }

    /// Returns whether the stream may end here: no frame is incomplete.
    pub fn is_between_frames(&self) -> bool {
        self.bytes.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn frames_survive_any_cutting(
            bodies in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..50), 0..8),
            cut in 1_usize..20,
        ) {
            let stream: Vec<u8> = bodies.iter().flat_map(|body| encode(body, 50).unwrap()).collect();
            let (mut decoder, mut got) = (Decoder::new(50), Vec::new());
            for piece in stream.chunks(cut) {
                decoder.push(piece);
                while let Some(body) = decoder.next_frame().unwrap() {
                    got.push(body);
                }
            }
            prop_assert_eq!(got, bodies);
            prop_assert!(decoder.is_between_frames());
        }
    }

    #[test]
    fn too_long_is_refused_before_it_arrives() {
        let error = FrameError::TooLong { size: 51, size_max: 50 };
        assert_eq!(encode(&[0; 51], 50), Err(error.clone()));
        let mut decoder = Decoder::new(50);
        decoder.push(&[51, 0, 0]);
        assert_eq!(decoder.next_frame(), Ok(None));
        assert!(!decoder.is_between_frames());
        decoder.push(&[0]);
        assert_eq!(decoder.next_frame(), Err(error));
    }
}
