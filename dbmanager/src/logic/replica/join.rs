//! Beginning anew: admission, the state of another, and what one had written before.
//!
//! *Rule.* A replica that is no member writes under a provisional origin that it shows to nobody, and asks to be admitted as
//! another, fresh one. It then takes the sponsor's state in place of its own, applies what it has of other members besides,
//! and commits what else it had and the sponsor has not, under the admitted origin: see `bring`. All of it is one batch.
//!
//! *One sponsor for one origin.* A sponsor counts a newcomer as one who begins with its state. So whoever gets no answer and
//! asks somebody else asks for another origin, and says that it has given up the first: two sponsors that did not hear of each
//! other would both count on a state of which the newcomer can take only one. Who was asked before is asked for the same
//! origin as before, unless it says that this was retired: so a newcomer that nobody can answer costs the team one record for each
//! member, and not one for each question.
//!
//! A member whose question is answered with a state (the log is gone) keeps its origin and applies what it has beyond that
//! state once more, under the same names. If frames for that are gone here too, the state is dropped: it was long on its way,
//! and the next one is newer. Or it will never do: either has what the other lacks as a state only. Nobody can tell which,
//! so at the second such state of one peer in a row the one with the larger origin of the two begins anew.

use super::bring::Old;
use super::commit::Change;
use super::{Alarm, Effect, Replica};
use crate::logic::clock::Wall;
use crate::logic::cut::{Cut, Dot, Origin};
use crate::logic::log::{Head, Log, Verdict};
use crate::logic::member::{self, Members};
use crate::logic::message::{Chunk, Join, Message};
use crate::logic::mutant::Mutant;
use crate::logic::owner::Owners;
use crate::logic::record::{Past, SHARED};
use crate::logic::snapshot::{self, CHUNKS_MAX, Manifest, Name};
use crate::logic::state::State;
use crate::logic::txn::Link;
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// How long a chunk is waited for at least before it is asked for once more, each time twice as long; and at most, which is
/// twice what it takes on the slowest radio. One that was lost looks as if it took long.
const CHUNK_TIME: [Duration; 2] = [Duration::from_secs(2), Duration::from_secs(20)];
/// How often.
const TRIES_MAX: u32 = 3;
/// If chunks come faster than this after each other, more of them are asked for at a time.
const CHUNK_TIME_FAST: Duration = Duration::from_millis(250);
/// If one alone takes no longer than this, two at a time are tried: it may have been a long way, and not a slow one.
const CHUNK_TIME_TRY: Duration = Duration::from_secs(4);
/// How many states of one peer in a row may turn out to be of no use.
const DROPPED_MAX: u32 = 2;
/// How many bytes a state that is taken over may have: it has to be in memory as a whole.
const DOWNLOAD_SIZE_MAX: usize = 1 << 30;
/// How many origins one admission replaces.
const REPLACED_MAX: usize = 1024;
/// How many chunks are asked for at a time at most.
const CHUNKS_ASKED_MAX: usize = 8;

/// A snapshot that others may take.
#[derive(Debug, Default)]
pub(super) struct Offer {
    latest: Option<(Cut, Manifest)>,
    chunks: BTreeMap<Name, Vec<u8>>,
    before: BTreeMap<Name, Vec<u8>>,
}

/// A snapshot that is being taken over.
#[derive(Debug)]
pub(super) struct Download {
    from: Origin,
    manifest: Manifest,
    chunks: BTreeMap<Name, Vec<u8>>,
    asked: BTreeSet<Name>,
    /// How many are asked for at a time.
    window: usize,
    /// How long one took that was asked for alone.
    alone: Duration,
    /// When the last one came, or the download began.
    since: Time,
    /// How long the next one is waited for, and until when.
    patience: Duration,
    until: Time,
    tries: u32,
}

impl Offer {
    /// Returns the snapshot of now; the one before it can still be taken over too.
    pub(super) fn take(&mut self, state: &State, log: &Log) -> Manifest {
        match &self.latest {
            Some((cut, manifest)) if cut == log.cut() => manifest.clone(),
            _ => {
                let (manifest, chunks) = snapshot::take(state, log.heads());
                self.before = std::mem::replace(&mut self.chunks, chunks);
                self.latest = Some((log.cut().clone(), manifest.clone()));
                manifest
            }
        }
    }

    pub(super) fn chunk(&self, name: Name) -> Option<Vec<u8>> {
        self.chunks.get(&name).or_else(|| self.before.get(&name)).cloned()
    }
}

impl Download {
    fn new(now: Time, from: Origin, manifest: Manifest, chunks: BTreeMap<Name, Vec<u8>>) -> Self {
        let (asked, patience) = (BTreeSet::new(), CHUNK_TIME[0]);
        let (since, until, alone) = (now, now + patience, Duration::ZERO);
        Self { from, manifest, chunks, asked, window: 1, alone, since, patience, until, tries: 0 }
    }

    /// A chunk has come: what it took is what the next one may take. On a slow radio there is one on its way at a time.
    fn arrived(&mut self, now: Time, name: Name, bytes: Vec<u8>) {
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
        self.patience = (2 * took).clamp(CHUNK_TIME[0], CHUNK_TIME[1]);
        (self.since, self.until, self.tries) = (now, now + self.patience, 0);
    }

    /// No chunk has come: what was asked for is asked for once more, one at a time.
    fn again(&mut self, now: Time) {
        self.tries += 1;
        self.until = now + (self.patience * (1 << self.tries.min(TRIES_MAX))).min(CHUNK_TIME[1]);
        self.asked.clear();
        self.window = 1;
    }

    /// Returns the chunks to ask for now.
    fn ask(&mut self) -> Vec<Effect> {
        let missing = self.manifest.chunks.iter().filter(|name| !self.chunks.contains_key(name));
        let new: Vec<Name> = missing.filter(|name| !self.asked.contains(name)).copied().collect();
        let new = new.into_iter().take(self.window.saturating_sub(self.asked.len()));
        let from = self.from;
        let asked = &mut self.asked;
        new.filter(|name| asked.insert(*name)).map(|name| Effect::Send(from, Message::Snap(name))).collect()
    }
}

impl Replica {
    pub(super) fn download_deadline(&self) -> Option<Time> {
        self.download.as_ref().map(|download| download.until)
    }

    pub(super) fn is_downloading(&self) -> bool {
        self.download.is_some()
    }

    /// Gives up the origin. It may be known to have used numbers `twice`.
    pub(super) fn rejoin(&mut self, now: Time, twice: bool, effects: &mut Vec<Effect>) {
        let from = self.identity.origin;
        self.identity.past.iter_mut().for_each(|past| past.asked = None);
        self.identity.past.push(Past { origin: from, told: self.identity.told, twice, asked: None });
        let asked_for = self.identity.joining.filter(|_| self.identity.asked.is_some());
        self.identity.past.extend(asked_for.map(|origin| Past { origin, ..Past::default() }));
        self.identity.origin = Origin::new(self.random.next());
        self.identity.joining = Some(Origin::new(self.random.next()));
        (self.identity.asked, self.identity.told) = (None, 0);
        if !self.config.mutant.is(Mutant::ClockNotMoved) {
            self.clock.move_to(self.identity.origin);
        }
        self.batch.identity(&self.identity);
        self.sync.reset(now);
        self.download = None;
        effects.push(Effect::Alarm(Alarm::Rejoining { from }));
    }

    /// Admits somebody.
    pub(super) fn sponsor(&mut self, now: Time, (from, join): (Origin, &Join), effects: &mut Vec<Effect>) {
        let origin = join.origin;
        if from != origin {
            effects.push(Effect::Alarm(Alarm::Malformed(from)));
            return;
        }
        if let Some(stamp) = self.members.retired(origin) {
            effects.push(Effect::Send(from, Message::Chunk(Chunk::Retired(stamp))));
            return;
        }
        if !self.members.is_active(origin) {
            let me = self.identity.origin;
            // Of some it may not have heard yet: a retirement counts whenever the admission comes.
            let known = |past: &Origin| *past == me || self.members.retired(*past).is_some() || self.held.has(*past);
            let replaced = join.replaces.iter().filter(|past| !known(past)).take(REPLACED_MAX);
            let mut writes: Vec<_> = replaced.filter_map(|past| member::retirement(*past)).collect();
            writes.extend(member::admission(origin, &join.robot));
            writes.sort_by(|a, b| a.key.cmp(&b.key));
            writes.dedup_by(|a, b| a.key == b.key);
            self.system(now, Change { reason: "admit".into(), writes, ..Change::default() }, effects);
        }
        let manifest = self.offer.take(&self.state, &self.log);
        effects.push(Effect::Send(from, Message::Chunk(Chunk::Snapshot(manifest))));
    }

    pub(super) fn begin_download(
        &mut self,
        now: Time,
        (from, manifest): (Origin, Manifest),
        effects: &mut Vec<Effect>,
    ) {
        let useless = self.is_member() && self.log.cut().dominates(&manifest.cut());
        if self.download.is_some() || useless || manifest.chunks.len() > CHUNKS_MAX {
            return;
        }
        // Chunks of a download that was broken off may be in this one too.
        let wanted: BTreeSet<Name> = manifest.chunks.iter().copied().collect();
        let mut chunks = std::mem::take(&mut self.spare);
        chunks.retain(|name, _| wanted.contains(name));
        let mut download = Download::new(now, from, manifest, chunks);
        effects.extend(download.ask());
        self.download = Some(download);
        self.try_install(now, effects);
    }

    pub(super) fn tick_download(&mut self, now: Time, effects: &mut Vec<Effect>) {
        let Some(download) = self.download.as_mut().filter(|download| download.until <= now) else { return };
        if download.tries >= TRIES_MAX && !self.config.mutant.is(Mutant::DownloadForEver) {
            return self.break_off();
        }
        download.again(now);
        effects.extend(download.ask());
    }

    pub(super) fn take_snap_chunk(
        &mut self,
        now: Time,
        (from, name, bytes): (Origin, Name, Option<Vec<u8>>),
        effects: &mut Vec<Effect>,
    ) {
        let Some(download) = self.download.as_mut() else { return };
        if !download.asked.remove(&name) {
            return;
        }
        let size: usize = download.chunks.values().map(Vec::len).sum();
        match bytes {
            Some(bytes) if Name::of(&bytes) == name && size + bytes.len() <= DOWNLOAD_SIZE_MAX => {
                download.arrived(now, name, bytes);
                effects.extend(download.ask());
                self.try_install(now, effects);
            }
            Some(_) => {
                self.download = None;
                effects.push(Effect::Alarm(Alarm::Malformed(from)));
            }
            // The peer has gone on, or was started anew: the next pull brings its new manifest.
            None => self.break_off(),
        }
    }

    /// Gives a download up, but not what has come of it.
    fn break_off(&mut self) {
        self.spare = self.download.take().map(|download| download.chunks).unwrap_or_default();
    }

    /// Takes over a state as soon as it is whole.
    fn try_install(&mut self, now: Time, effects: &mut Vec<Effect>) {
        let whole = |d: &Download| d.manifest.chunks.iter().all(|name| d.chunks.contains_key(name));
        let Some(download) = self.download.take_if(|download| whole(download)) else { return };
        let Ok(mut state) = download.manifest.assemble(&download.chunks, self.config.mutant) else {
            effects.push(Effect::Alarm(Alarm::Malformed(download.from)));
            return;
        };
        let members = Members::of(&state);
        if self.identity.joining.is_some_and(|joining| !members.is_active(joining)) {
            return;
        }
        let cut = download.manifest.cut();
        if self.config.mutant.is(Mutant::SnapshotWithoutDeletions) {
            drop(state.drop_deleted(&cut));
        }
        if self.identity.joining.is_none() && !cut.dominates(&self.log.low()) {
            // What would have to be applied to it again is not all here any more.
            let dropped = self.sync.dropped(download.from);
            let gives_way = download.from < self.identity.origin && !self.config.mutant.is(Mutant::StandOff);
            if dropped >= DROPPED_MAX && gives_way {
                self.rejoin(now, false, effects);
            }
            return;
        }
        // A state that knows other transactions by the same numbers would hide some.
        if self.identity.joining.is_none() {
            let head = |(origin, head): &(Origin, Head)| (Dot { origin: *origin, seq: head.seq }, head.link);
            let heads: Vec<(Dot, Link)> = download.manifest.heads.iter().map(head).collect();
            if let Some((own, link)) = heads.iter().find(|(dot, _)| dot.origin == self.identity.origin) {
                self.take_fork(now, (own.seq, *link), effects);
            }
            if self.take_known(now, (download.from, &heads), effects) || self.identity.joining.is_some() {
                return;
            }
        }
        let log = Log::new(download.manifest.heads.into_iter().collect(), self.config.mutant);
        if !self.config.mutant.is(Mutant::EraseForgotten) {
            self.erase();
        }
        let old = Old {
            log: std::mem::replace(&mut self.log, log),
            state: std::mem::replace(&mut self.state, state),
            members: std::mem::replace(&mut self.members, members),
        };
        self.owners = Owners::of(&self.state);
        self.restate();
        self.clock.observe(now, self.log.last_stamp(), Wall::default());
        effects.push(Effect::Replaced);
        self.apply_again(now, &old.log, effects);
        if let Some(joining) = self.identity.joining {
            self.bring_in(now, (joining, &old), effects);
        }
        self.collected = Cut::default();
        self.acks.note(download.from, &cut);
        self.sync.reset(now);
    }

    /// Applies what a log has beyond the state that was taken over: all of it, or for who is admitted, what others wrote.
    fn apply_again(&mut self, now: Time, old: &Log, effects: &mut Vec<Effect>) {
        let (loses, joins) = (self.config.mutant.is(Mutant::SnapshotLoses), self.identity.joining.is_some());
        for (dot, frame) in old.in_order() {
            if self.log.cut().contains(dot) || loses || joins && !self.members.is_active(dot.origin) {
                continue;
            }
            if !matches!(self.apply(now, frame.clone(), effects), Ok(Verdict::Next)) && !joins {
                effects.push(Effect::Alarm(Alarm::Fork(dot.origin)));
            }
        }
    }

    /// Removes the records of log and state.
    fn erase(&mut self) {
        for (dot, _) in self.log.in_order() {
            self.batch.no_frame(dot);
        }
        for origin in self.log.heads().keys() {
            self.batch.no_head(*origin);
        }
        for (key, _) in self.state.scan("") {
            self.batch.versions((SHARED, key), &[]);
        }
    }

    /// Writes the records of log and state.
    fn restate(&mut self) {
        for (origin, head) in self.log.heads() {
            self.batch.head(*origin, head);
        }
        for (key, versions) in self.state.scan("") {
            self.batch.versions((SHARED, key), versions);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_are_not_taken_for_a_link_that_becomes_slower_and_slower() {
        let manifest = Manifest { heads: Vec::new(), state: 0, chunks: vec![Name::of(b"a"), Name::of(b"b")] };
        let mut download = Download::new(Time::ZERO, Origin::new(1), manifest, BTreeMap::new());
        let hour = Time::ZERO + Duration::from_secs(3600);
        download.arrived(hour, Name::of(b"a"), b"a".to_vec());
        let mut now = hour;
        for _ in 0..TRIES_MAX {
            now = download.until;
            download.again(now);
        }
        assert!(now.since(hour) <= CHUNK_TIME[1] * TRIES_MAX, "it waits for {:?}", now.since(hour));
    }
}
