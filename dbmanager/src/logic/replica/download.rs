//! Snapshots: the snapshots that are offered to other replicas, and the snapshot that is being downloaded.
//!
//! *Rule.* Chunks are named by their hashes, so the received chunks remain useful after a download was broken off. On a slow link
//! one chunk is requested at a time. If chunks arrive quickly, or the link only has a long delay, more are requested.

use super::contents::Contents;
use super::interface::{Alarm, Effect};
use crate::logic::message::Message;
use crate::logic::snapshot::{self, CHUNKS_MAX, ChunkHash, Manifest};
use crate::logic::state::State;
use crate::logic::timing::{CHUNK_TIME_FAST, CHUNK_TIME_TRY, CHUNK_TRIES_MAX, CHUNK_WAIT_MAX, CHUNK_WAIT_MIN};
use crate::logic::version_vector::{ReplicaId, VersionVector};
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The greatest size in bytes of a state that is taken over, since the whole state has to be in memory.
const DOWNLOAD_SIZE_MAX: usize = 1 << 30;
/// How many chunks may be requested at a time.
const CHUNKS_ASKED_MAX: usize = 8;

/// A snapshot that others may take.
#[derive(Debug, Default)]
pub(super) struct Offer {
    latest: Option<(VersionVector, Manifest)>,
    chunks: BTreeMap<ChunkHash, Vec<u8>>,
    before: BTreeMap<ChunkHash, Vec<u8>>,
}

/// The download in progress, if any, and the chunks of a download that was broken off.
#[derive(Debug, Default)]
pub(super) struct Downloads {
    current: Option<Download>,
    spare: BTreeMap<ChunkHash, Vec<u8>>,
}

/// A snapshot that is being taken over.
#[derive(Debug)]
struct Download {
    from: ReplicaId,
    manifest: Manifest,
    chunks: BTreeMap<ChunkHash, Vec<u8>>,
    asked: BTreeSet<ChunkHash>,
    /// How many chunks may be requested at a time.
    window: usize,
    /// How long a chunk took when it was the only requested one.
    alone: Duration,
    /// When the last chunk came, or the download began.
    since: Time,
    /// How long the download waits for the next chunk, and until when.
    wait: Duration,
    until: Time,
    tries: u32,
}

/// A state that was downloaded completely.
#[derive(Debug)]
pub(super) struct Downloaded {
    pub(super) from: ReplicaId,
    pub(super) manifest: Manifest,
    pub(super) state: State,
}

impl Offer {
    /// Takes a snapshot now. Other replicas can still take over the previous snapshot as well.
    pub(super) fn take(&mut self, contents: &Contents) -> Manifest {
        let log = contents.log();
        match &self.latest {
            Some((vector, manifest)) if vector == log.vector() => manifest.clone(),
            _ => {
                let (manifest, chunks) = snapshot::take(contents.state(), log.heads());
                self.before = std::mem::replace(&mut self.chunks, chunks);
                self.latest = Some((log.vector().clone(), manifest.clone()));
                manifest
            }
        }
    }

    pub(super) fn chunk(&self, name: ChunkHash) -> Option<Vec<u8>> {
        self.chunks.get(&name).or_else(|| self.before.get(&name)).cloned()
    }
}

impl Downloads {
    pub(super) fn deadline(&self) -> Option<Time> {
        self.current.as_ref().map(|download| download.until)
    }

    pub(super) fn is_on(&self) -> bool {
        self.current.is_some()
    }

    /// Begins a download, unless one is in progress.
    pub(super) fn begin(&mut self, now: Time, from: ReplicaId, manifest: Manifest, effects: &mut Vec<Effect>) {
        if self.current.is_some() || manifest.chunks.len() > CHUNKS_MAX {
            return;
        }
        // Chunks of a download that was broken off may also belong to this one.
        let wanted: BTreeSet<ChunkHash> = manifest.chunks.iter().copied().collect();
        let mut chunks = std::mem::take(&mut self.spare);
        chunks.retain(|name, _| wanted.contains(name));
        let mut download = Download::new(now, from, manifest, chunks);
        effects.extend(download.ask());
        self.current = Some(download);
    }

    /// Requests missing chunks again when they are late, and finally breaks the download off.
    pub(super) fn tick(&mut self, now: Time, effects: &mut Vec<Effect>) {
        let Some(download) = self.current.as_mut().filter(|download| download.until <= now) else { return };
        if download.tries >= CHUNK_TRIES_MAX {
            return self.break_off();
        }
        download.again(now);
        effects.extend(download.ask());
    }

    /// Takes a requested chunk.
    pub(super) fn receive(
        &mut self,
        now: Time,
        from: ReplicaId,
        name: ChunkHash,
        bytes: Option<Vec<u8>>,
        effects: &mut Vec<Effect>,
    ) {
        let Some(download) = self.current.as_mut() else { return };
        if !download.asked.remove(&name) {
            return;
        }
        let size: usize = download.chunks.values().map(Vec::len).sum();
        match bytes {
            Some(bytes) if ChunkHash::of(&bytes) == name && size + bytes.len() <= DOWNLOAD_SIZE_MAX => {
                download.arrived(now, name, bytes);
                effects.extend(download.ask());
            }
            Some(_) => {
                self.current = None;
                effects.push(Effect::Alarm(Alarm::Malformed(from)));
            }
            // The peer has a newer snapshot, or was restarted. The next pull brings its new manifest.
            None => self.break_off(),
        }
    }

    /// Returns the state once it is complete.
    pub(super) fn whole(&mut self, effects: &mut Vec<Effect>) -> Option<Downloaded> {
        let whole = |d: &Download| d.manifest.chunks.iter().all(|name| d.chunks.contains_key(name));
        let Download { from, manifest, chunks, .. } = self.current.take_if(|download| whole(download))?;
        match manifest.assemble(&chunks) {
            Ok(state) => Some(Downloaded { from, manifest, state }),
            Err(_other) => {
                effects.push(Effect::Alarm(Alarm::Malformed(from)));
                None
            }
        }
    }

    /// Cancels the download, and discards its chunks.
    pub(super) fn cancel(&mut self) {
        self.current = None;
    }

    /// Breaks a download off, and keeps the received chunks.
    fn break_off(&mut self) {
        self.spare = self.current.take().map(|download| download.chunks).unwrap_or_default();
    }
}

impl Download {
    fn new(now: Time, from: ReplicaId, manifest: Manifest, chunks: BTreeMap<ChunkHash, Vec<u8>>) -> Self {
        let (asked, wait) = (BTreeSet::new(), CHUNK_WAIT_MIN);
        let (since, until, alone) = (now, now + wait, Duration::ZERO);
        Self { from, manifest, chunks, asked, window: 1, alone, since, wait, until, tries: 0 }
    }

    /// Takes a chunk. Twice its time is the limit for the next one. The times also decide how many chunks are requested at once:
    /// one on a slow radio.
    fn arrived(&mut self, now: Time, name: ChunkHash, bytes: Vec<u8>) {
        self.chunks.insert(name, bytes);
        let took = now.since(self.since);
        self.alone = if self.window == 1 { took } else { self.alone };
        let fast = took <= CHUNK_TIME_FAST.max(self.alone / 2);
        self.window = match (fast, self.window) {
            (true, window) => (2 * window).min(CHUNKS_ASKED_MAX),
            (false, 1) if took <= CHUNK_TIME_TRY => 2,
            (false, window) if took <= self.alone => window,
            (false, _) => 1,
        };
        self.wait = (2 * took).clamp(CHUNK_WAIT_MIN, CHUNK_WAIT_MAX);
        (self.since, self.until, self.tries) = (now, now + self.wait, 0);
    }

    /// Prepares to request the missing chunks again, one at a time, because no chunk has arrived.
    fn again(&mut self, now: Time) {
        self.tries += 1;
        self.until = now + (self.wait * (1 << self.tries.min(CHUNK_TRIES_MAX))).min(CHUNK_WAIT_MAX);
        self.asked.clear();
        self.window = 1;
    }

    /// Returns the chunks to ask for now.
    fn ask(&mut self) -> Vec<Effect> {
        let missing = self.manifest.chunks.iter().filter(|name| !self.chunks.contains_key(name));
        let new: Vec<ChunkHash> = missing.filter(|name| !self.asked.contains(name)).copied().collect();
        let new = new.into_iter().take(self.window.saturating_sub(self.asked.len()));
        let from = self.from;
        let asked = &mut self.asked;
        new.filter(|name| asked.insert(*name)).map(|name| Effect::Send(from, Message::ChunkRequest(name))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PEER: ReplicaId = ReplicaId::new(1);

    /// Returns the manifest of a peer, with two chunks that do not contain a state.
    fn manifest() -> Manifest {
        Manifest { heads: Vec::new(), state: 0, chunks: vec![ChunkHash::of(b"a"), ChunkHash::of(b"b")] }
    }

    fn asked_for(effects: &[Effect]) -> Vec<ChunkHash> {
        let name = |effect: &Effect| {
            let Effect::Send(PEER, Message::ChunkRequest(name)) = effect else { return None };
            Some(*name)
        };
        effects.iter().filter_map(name).collect()
    }

    #[test]
    fn losses_are_not_taken_for_a_link_that_becomes_slower_and_slower() {
        let mut download = Download::new(Time::ZERO, PEER, manifest(), BTreeMap::new());
        let hour = Time::ZERO + Duration::from_secs(3600);
        download.arrived(hour, ChunkHash::of(b"a"), b"a".to_vec());
        let mut now = hour;
        for _ in 0..CHUNK_TRIES_MAX {
            now = download.until;
            download.again(now);
        }
        assert!(now.since(hour) <= CHUNK_WAIT_MAX * CHUNK_TRIES_MAX, "it waits for {:?}", now.since(hour));
    }

    #[test]
    fn what_has_come_is_not_asked_for_again_after_a_break() {
        let (mut downloads, mut effects) = (Downloads::default(), Vec::new());
        downloads.begin(Time::ZERO, PEER, manifest(), &mut effects);
        let first = asked_for(&effects)[0];
        downloads.receive(Time::ZERO, PEER, first, Some(b"a".to_vec()), &mut effects);
        while let Some(deadline) = downloads.deadline() {
            downloads.tick(deadline, &mut effects);
        }
        effects.clear();
        downloads.begin(Time::ZERO, PEER, manifest(), &mut effects);
        assert_eq!(asked_for(&effects), [ChunkHash::of(b"b")]);
    }

    #[test]
    fn nothing_is_taken_that_was_not_asked_for_or_is_not_what_its_name_says() {
        let (mut downloads, mut effects) = (Downloads::default(), Vec::new());
        downloads.begin(Time::ZERO, PEER, manifest(), &mut effects);
        downloads.receive(Time::ZERO, PEER, ChunkHash::of(b"x"), Some(b"x".to_vec()), &mut effects);
        assert!(downloads.is_on() && effects.len() == 1);
        downloads.receive(Time::ZERO, PEER, ChunkHash::of(b"a"), Some(b"x".to_vec()), &mut effects);
        assert!(!downloads.is_on());
        assert!(matches!(effects.last(), Some(Effect::Alarm(Alarm::Malformed(PEER)))), "{effects:?}");
    }

    #[test]
    fn chunks_that_are_no_state_are_refused_as_a_whole() {
        let (mut downloads, mut effects) = (Downloads::default(), Vec::new());
        downloads.begin(Time::ZERO, PEER, manifest(), &mut effects);
        for bytes in [b"a", b"b"] {
            assert!(downloads.whole(&mut effects).is_none() && downloads.is_on());
            downloads.receive(Time::ZERO, PEER, ChunkHash::of(bytes), Some(bytes.to_vec()), &mut effects);
        }
        assert!(downloads.whole(&mut effects).is_none() && !downloads.is_on());
        assert!(matches!(effects.last(), Some(Effect::Alarm(Alarm::Malformed(PEER)))), "{effects:?}");
    }
}
