//! Snapshots: the whole state in chunks, for a replica that the log cannot serve.
//!
//! A snapshot consists of the versions of all keys at a version vector, including deleted ones, and the head of each
//! origin. It is cut into chunks at keys that their hash selects, and chunks are named by their hashes. So two replicas
//! with nearly the same state have most chunks in common, and a download that was broken off can continue with another
//! peer.

use crate::logic::key::Key;
use crate::logic::log::Head;
use crate::logic::state::{State, Version};
use crate::logic::version_vector::{ReplicaId, VersionVector};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use thiserror::Error;

/// The size in bytes at which a chunk ends at the latest; its last key may exceed it.
const CHUNK_SIZE_MAX: usize = 48 << 10;
/// On average, one key in this many ends a chunk.
const CHUNK_KEYS: u8 = 64;
/// The most chunks.
pub const CHUNKS_MAX: usize = 65_536;

/// The hash of a chunk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ChunkHash(pub [u8; 32]);

impl ChunkHash {
    /// Returns the name of a chunk with these bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }
}

/// The chunks of a snapshot, and the digest of the resulting state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    /// The last transaction of each origin in the snapshot.
    pub heads: Vec<(ReplicaId, Head)>,
    /// Digest of the state.
    pub state: u128,
    /// The chunks, in the order of their keys.
    pub chunks: Vec<ChunkHash>,
}

/// Why chunks do not form a snapshot.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum SnapshotError {
    /// A chunk is missing.
    #[error("a chunk of the snapshot is missing")]
    Missing,
    /// The bytes of a chunk do not match its name, or are not entries.
    #[error("a chunk of the snapshot is malformed")]
    Chunk,
    /// The chunks together differ from the state that the manifest names.
    #[error("the chunks are another state than the manifest says")]
    Digest,
}

impl Manifest {
    /// Returns the version vector of the snapshot.
    pub fn vector(&self) -> VersionVector {
        self.heads.iter().map(|(origin, head)| (*origin, head.seq)).collect()
    }

    /// Assembles the chunks.
    ///
    /// # Errors
    /// If they do not form this snapshot.
    pub fn assemble(&self, chunks: &BTreeMap<ChunkHash, Vec<u8>>) -> Result<State, SnapshotError> {
        let mut state = State::default();
        for name in &self.chunks {
            let bytes = chunks.get(name).ok_or(SnapshotError::Missing)?;
            let Ok(entries) = postcard::from_bytes::<Vec<(Key, Vec<Version>)>>(bytes) else {
                return Err(SnapshotError::Chunk);
            };
            for (key, versions) in entries {
                state.restore(key, versions);
            }
        }
        if state.digest() == self.state { Ok(state) } else { Err(SnapshotError::Digest) }
    }
}

/// Returns the snapshot of a state, with its chunks.
pub fn take(state: &State, heads: &BTreeMap<ReplicaId, Head>) -> (Manifest, BTreeMap<ChunkHash, Vec<u8>>) {
    let (mut chunks, mut names) = (BTreeMap::new(), Vec::new());
    let mut entries: Vec<(&Key, &[Version])> = Vec::new();
    let mut size = 0;
    let mut close = |entries: &mut Vec<(&Key, &[Version])>| {
        // Encoding to memory fails only for lengths that are not known in advance, and slices have known lengths.
        let bytes = postcard::to_stdvec(entries).unwrap_or_default();
        let name = ChunkHash::of(&bytes);
        chunks.insert(name, bytes);
        names.push(name);
        entries.clear();
    };
    for (key, versions) in state.scan("") {
        entries.push((key, versions));
        size += key.as_str().len()
            + versions.iter().map(|v| 32 + v.value.as_ref().map_or(0, |v| v.bytes.len())).sum::<usize>();
        if size >= CHUNK_SIZE_MAX || blake3::hash(key.as_str().as_bytes()).as_bytes()[0].is_multiple_of(CHUNK_KEYS) {
            close(&mut entries);
            size = 0;
        }
    }
    if !entries.is_empty() {
        close(&mut entries);
    }
    let heads = heads.iter().map(|(origin, head)| (*origin, head.clone())).collect();
    (Manifest { heads, state: state.digest(), chunks: names }, chunks)
}
