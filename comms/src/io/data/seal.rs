//! Makes and opens the seals of wires: ChaCha20-Poly1305 (RFC 8439). The nonce is the program's counter.

use crate::logic::codec;
use crate::logic::seal::{Content, Refusal, Seal, TAG_SIZE};
use ring::aead::{Aad, CHACHA20_POLY1305, LessSafeKey, NONCE_LEN, Nonce, Tag, UnboundKey};
use std::collections::VecDeque;
use std::fmt;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use zenoh::bytes::ZBytes;
use zeroize::Zeroizing;

/// The part of a message that a seal covers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cover {
    /// Every byte: no third program can read them.
    Bytes,
    /// Only the fact that the sender has sent something now. This is for wires within a machine, whose bytes no
    /// third program can change.
    Sender,
}

/// The key of one direction of a wire.
pub struct SealKey {
    key: LessSafeKey,
    id: u32,
    cover: Cover,
}

/// Counts the messages that a program has sealed.
#[derive(Clone, Debug, Default)]
pub struct SealCounter(Arc<AtomicU64>);

/// Seals the messages in one direction of a wire. Without a key it sends nothing.
#[derive(Debug)]
pub struct Sealer {
    counter: SealCounter,
    key: Mutex<Option<Arc<SealKey>>>,
}

/// Opens the seals of incoming messages. Without a key it accepts nothing.
pub struct Opener {
    state: Mutex<Opening>,
    refused: Box<dyn Fn(Refusal, Option<String>) + Send + Sync>,
}

/// Something sealed.
#[derive(Debug)]
pub(super) struct Sealed {
    pub(super) bytes: ZBytes,
    /// The seal of the bytes.
    pub(super) seal: Vec<u8>,
    /// The number in the seal.
    pub(super) number: u64,
}

#[derive(Debug, Default)]
struct Opening {
    key: Option<Arc<SealKey>>,
    /// The number of the last seal that was opened.
    last: u64,
    /// The id and the last number of each earlier key, the latest first.
    earlier: VecDeque<(u32, u64)>,
}

/// How many earlier keys are remembered. The other end makes a new key at each start.
const EARLIER_MAX: usize = 64;

impl SealKey {
    /// Takes 32 secret bytes, which must not be used for anything else.
    ///
    /// # Panics
    /// Never: 32 bytes are the length of a key of this algorithm.
    pub fn new(secret: &Zeroizing<[u8; 32]>, cover: Cover) -> Self {
        let id = blake3::derive_key("dca seal key id 1", &**secret);
        let key = UnboundKey::new(&CHACHA20_POLY1305, &**secret).expect("the key has the length of the algorithm");
        Self { key: LessSafeKey::new(key), id: u32::from_le_bytes([id[0], id[1], id[2], id[3]]), cover }
    }

    /// Seals `bytes` in place. `about` is not secret, and both ends know it.
    fn seal(&self, content: Content, about: u64, number: u64, bytes: &mut [u8]) -> Option<Seal> {
        let cover = if content == Content::Value { self.cover } else { Cover::Bytes };
        let covered = if cover == Cover::Bytes { bytes } else { &mut [] };
        let aad = Aad::from(associated(content, about));
        let tag = self.key.seal_in_place_separate_tag(nonce(number), aad, covered).ok()?;
        let tag = <[u8; TAG_SIZE]>::try_from(tag.as_ref()).ok()?;
        Some(Seal { content, key: self.id, number, tag })
    }

    /// Returns a seal for bytes that everybody can read, over their hash.
    fn vouch(&self, number: u64, hash: &[u8; 32]) -> Option<Seal> {
        let tag = self.key.seal_in_place_separate_tag(nonce(number), Aad::from(self.vouched(hash)), &mut []).ok()?;
        let tag = <[u8; TAG_SIZE]>::try_from(tag.as_ref()).ok()?;
        Some(Seal { content: Content::Device, key: self.id, number, tag })
    }

    fn check(&self, seal: &Seal, hash: &[u8; 32]) -> Result<(), Refusal> {
        let (aad, tag) = (Aad::from(self.vouched(hash)), Tag::from(seal.tag));
        let opened = self.key.open_in_place_separate_tag(nonce(seal.number), aad, tag, &mut [], 0..);
        opened.map(drop).map_err(|_unspecified| Refusal::Broken)
    }

    fn vouched(&self, hash: &[u8; 32]) -> [u8; 41] {
        let mut bytes = [0; 41];
        bytes[..9].copy_from_slice(&associated(Content::Device, 0));
        if self.cover == Cover::Bytes {
            bytes[9..].copy_from_slice(hash);
        }
        bytes
    }

    fn open(&self, seal: &Seal, about: u64, bytes: &mut [u8]) -> Result<(), Refusal> {
        let cover = if seal.content == Content::Value { self.cover } else { Cover::Bytes };
        let covered = if cover == Cover::Bytes { bytes } else { &mut [] };
        let aad = Aad::from(associated(seal.content, about));
        let opened = self.key.open_in_place_separate_tag(nonce(seal.number), aad, Tag::from(seal.tag), covered, 0..);
        opened.map(drop).map_err(|_unspecified| Refusal::Broken)
    }
}

fn nonce(number: u64) -> Nonce {
    let mut bytes = [0; NONCE_LEN];
    bytes[..8].copy_from_slice(&number.to_le_bytes());
    Nonce::assume_unique_for_key(bytes)
}

fn associated(content: Content, about: u64) -> [u8; 9] {
    let mut bytes = [0; 9];
    bytes[0] = content as u8;
    bytes[1..].copy_from_slice(&about.to_le_bytes());
    bytes
}

impl fmt::Debug for SealKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SealKey").field("id", &self.id).field("cover", &self.cover).finish_non_exhaustive()
    }
}

impl fmt::Debug for Opener {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Opener").field("state", &self.state).finish_non_exhaustive()
    }
}

impl Sealer {
    /// Returns a sealer without a key. All sealers with the same key need the same counter.
    pub fn new(counter: &SealCounter) -> Self {
        Self { counter: counter.clone(), key: Mutex::default() }
    }

    /// Seals with another key from now on.
    pub fn set(&self, key: Option<SealKey>) {
        *self.key.lock().unwrap_or_else(PoisonError::into_inner) = key.map(Arc::new);
    }

    /// Returns a seal for bytes that everybody can read, over their hash; none without a key.
    pub(super) fn vouch(&self, hash: &[u8; 32]) -> Option<Seal> {
        let key = self.key.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        key.vouch(self.counter.0.fetch_add(1, Ordering::Relaxed) + 1, hash)
    }

    /// Returns these bytes sealed; none without a key.
    pub(super) fn seal(&self, content: Content, about: u64, bytes: &ZBytes) -> Option<Sealed> {
        let key = self.key.lock().unwrap_or_else(PoisonError::into_inner).clone()?;
        let number = self.counter.0.fetch_add(1, Ordering::Relaxed) + 1;
        let (bytes, seal) = if content == Content::Value && key.cover == Cover::Sender {
            (bytes.clone(), key.seal(content, about, number, &mut [])?)
        } else {
            let mut copy = bytes.to_bytes().into_owned();
            let seal = key.seal(content, about, number, &mut copy)?;
            (copy.into(), seal)
        };
        Some(Sealed { bytes, seal: codec::encode(&seal).ok()?, number })
    }
}

impl Opener {
    /// Returns an opener without a key. `refused` gets the reason of each drop, and the session
    /// that the message claims to come from. `refused` may only note these.
    pub fn new(refused: impl Fn(Refusal, Option<String>) + Send + Sync + 'static) -> Self {
        Self { state: Mutex::default(), refused: Box::new(refused) }
    }

    /// Sets the expected key; returns whether it differs from the previous one.
    pub fn set(&self, key: Option<SealKey>) -> bool {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let id = |key: Option<&SealKey>| key.map(|key| key.id);
        if id(key.as_ref()) == id(state.key.as_deref()) {
            state.key = key.map(Arc::new);
            return false;
        }
        // A key that is set again continues with its last number, so its earlier messages are not accepted twice.
        if let Some(before) = id(state.key.as_deref()) {
            let last = state.last;
            state.earlier.retain(|(other, _)| *other != before);
            state.earlier.push_front((before, last));
            state.earlier.truncate(EARLIER_MAX);
        }
        let found = id(key.as_ref()).and_then(|id| state.earlier.iter().find(|(other, _)| *other == id));
        state.last = found.map_or(0, |(_, last)| *last);
        state.key = key.map(Arc::new);
        true
    }

    /// Returns the id of the key that it expects.
    pub fn key_id(&self) -> Option<u32> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).key.as_ref().map(|key| key.id)
    }

    /// Returns the content of a message and its unsealed bytes; none if the message is to be dropped. All messages
    /// except answers have to come in the order in which they were sealed.
    pub(super) fn open(
        &self,
        seal: Option<&ZBytes>,
        about: u64,
        bytes: &ZBytes,
        from: impl FnOnce() -> Option<String>,
    ) -> Option<(Content, Vec<u8>)> {
        self.try_open(seal, about, bytes).map_err(|why| (self.refused)(why, from())).ok()
    }

    /// Checks a seal for bytes that everybody can read.
    pub(super) fn check(&self, seal: &Seal, hash: &[u8; 32]) -> Result<(), Refusal> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        let key = state.key.as_ref().filter(|key| key.id == seal.key).ok_or(Refusal::OtherKey)?;
        if seal.number <= state.last {
            return Err(Refusal::Repeated);
        }
        key.check(seal, hash)?;
        state.last = seal.number;
        Ok(())
    }

    fn try_open(&self, seal: Option<&ZBytes>, about: u64, bytes: &ZBytes) -> Result<(Content, Vec<u8>), Refusal> {
        let seal = seal.and_then(|seal| codec::decode::<Seal>(&seal.to_bytes()).ok()).ok_or(Refusal::Unsealed)?;
        let (key, last) = {
            let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
            (state.key.clone(), state.last)
        };
        let key = key.filter(|key| key.id == seal.key).ok_or(Refusal::OtherKey)?;
        let is_answer = seal.content == Content::Answer;
        if !is_answer && seal.number <= last {
            return Err(Refusal::Repeated);
        }
        let mut bytes = bytes.to_bytes().into_owned();
        key.open(&seal, about, &mut bytes)?;
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if !is_answer && state.key.as_ref().is_some_and(|now| now.id == key.id) {
            // In the meantime another thread may have opened a later message.
            if seal.number <= state.last {
                return Err(Refusal::Repeated);
            }
            state.last = seal.number;
        }
        Ok((seal.content, bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc::sync_channel;

    fn key(secret: u8, cover: Cover) -> SealKey {
        SealKey::new(&Zeroizing::new([secret; 32]), cover)
    }

    fn pair(cover: Cover) -> (Sealer, Opener, std::sync::mpsc::Receiver<Refusal>) {
        let (refused_tx, refused) = sync_channel(64);
        let (sealer, opener) = (
            Sealer::new(&SealCounter::default()),
            Opener::new(move |why, _| refused_tx.send(why).expect("the test hears it")),
        );
        sealer.set(Some(key(1, cover)));
        opener.set(Some(key(1, cover)));
        (sealer, opener, refused)
    }

    fn open(opener: &Opener, about: u64, sealed: &Sealed) -> Option<(Content, Vec<u8>)> {
        opener.open(Some(&sealed.seal.clone().into()), about, &sealed.bytes, || None)
    }

    #[test]
    fn what_is_sealed_comes_once_and_in_order() {
        for cover in [Cover::Bytes, Cover::Sender] {
            let (sealer, opener, refused) = pair(cover);
            let seal = |content, about| sealer.seal(content, about, &b"value"[..].into()).unwrap();
            let (first, second) = (seal(Content::Value, 7), seal(Content::Boundary, 7));
            assert_eq!(&*first.bytes.to_bytes() == b"value", cover == Cover::Sender, "others see the bytes");
            assert_ne!(&*second.bytes.to_bytes(), b"value");
            assert_eq!(open(&opener, 7, &first), Some((Content::Value, b"value".to_vec())));
            assert_eq!(open(&opener, 7, &first), None);
            assert_eq!(open(&opener, 7, &second), Some((Content::Boundary, b"value".to_vec())));
            assert_eq!(open(&opener, 7, &first), None);
            assert_eq!(refused.try_iter().collect::<Vec<_>>(), [Refusal::Repeated, Refusal::Repeated]);
            // Setting the same key again discards nothing.
            opener.set(Some(key(1, cover)));
            assert_eq!(open(&opener, 7, &second), None);
            opener.set(Some(key(2, cover)));
            assert_eq!(open(&opener, 7, &seal(Content::Value, 7)), None);
            opener.set(None);
            assert_eq!(open(&opener, 7, &seal(Content::Value, 7)), None);
            // The same key is set again after another key, and after none.
            opener.set(Some(key(1, cover)));
            assert_eq!(open(&opener, 7, &second), None);
            let why = [Refusal::Repeated, Refusal::OtherKey, Refusal::OtherKey, Refusal::Repeated];
            assert_eq!(refused.try_iter().collect::<Vec<_>>(), why);
            sealer.set(None);
            assert!(sealer.seal(Content::Value, 7, &b"value"[..].into()).is_none());
        }
    }

    #[test]
    fn what_was_changed_is_dropped() {
        let (sealer, opener, refused) = pair(Cover::Bytes);
        let sealed = sealer.seal(Content::Value, 7, &b"value"[..].into()).unwrap();
        assert_eq!(open(&opener, 8, &sealed), None, "another number of the wire");
        for place in 0..5 {
            let mut bytes = sealed.bytes.to_bytes().into_owned();
            bytes[place] ^= 1;
            assert_eq!(opener.open(Some(&sealed.seal.clone().into()), 7, &bytes.into(), || None), None);
        }
        let seal: Seal = codec::decode(&sealed.seal).unwrap();
        let with = |seal: Vec<u8>| opener.open(Some(&seal.into()), 7, &sealed.bytes, || None);
        for changed in [Seal { content: Content::Boundary, ..seal }, Seal { number: seal.number + 1, ..seal }] {
            assert_eq!(with(codec::encode(&changed).unwrap()), None);
        }
        assert_eq!(refused.try_iter().collect::<Vec<_>>(), [Refusal::Broken; 8]);
        assert_eq!(with(b"no seal".to_vec()), None);
        assert_eq!(opener.open(None, 7, &sealed.bytes, || None), None);
        assert_eq!(refused.try_iter().collect::<Vec<_>>(), [Refusal::Unsealed; 2]);
        assert_eq!(open(&opener, 7, &sealed), Some((Content::Value, b"value".to_vec())), "nothing of it has counted");
    }

    #[test]
    fn an_answer_is_for_its_question_alone() {
        let (sealer, opener, refused) = pair(Cover::Sender);
        let [first, second] =
            [1, 2].map(|question| sealer.seal(Content::Answer, question, &b"value"[..].into()).unwrap());
        assert_ne!(&*first.bytes.to_bytes(), b"value", "answers are covered as a whole");
        assert_eq!(open(&opener, 2, &second), Some((Content::Answer, b"value".to_vec())));
        assert_eq!(open(&opener, 1, &first), Some((Content::Answer, b"value".to_vec())), "they come in any order");
        assert_eq!(open(&opener, 3, &first), None);
        assert_eq!(refused.try_iter().collect::<Vec<_>>(), [Refusal::Broken]);
    }

    #[test]
    fn no_key_is_shown() {
        let (sealer, opener, _refused) = pair(Cover::Bytes);
        let shown = format!("{sealer:?} {opener:?}");
        assert!(!shown.contains("[1, 1") && shown.contains("SealKey { id: "), "{shown}");
    }
}
