//! The replica id under which a replica writes, and the id under which it wants to be admitted.
//!
//! *State.* The identity on the disk. Also, since this start: the number up to which other replicas are known to have the same
//! transactions under the replica's own numbers.
//!
//! *One sponsor for one origin.* A sponsor counts a newcomer as a replica that begins with its state. If two sponsors that are
//! cut off from each other admitted the same origin, both would count on it, but the newcomer can take only one state. So a
//! newcomer that gets no answer and asks another sponsor asks for another origin, and reports that it has given up the first. It
//! asks a sponsor again for the same origin as before, unless the sponsor reports that this origin was retired. So a newcomer
//! that no sponsor can answer costs the team one record for each member, not one for each request.

use crate::logic::message::Join;
use crate::logic::record::{Batch, IdentityRecord, OpenError, Past};
use crate::logic::version_vector::ReplicaId;
use comms::logic::random::Random;

/// How many origins of earlier lives are remembered.
const PAST_MAX: usize = 256;

/// The identity of a replica.
#[derive(Debug)]
pub(super) struct Identity {
    record: IdentityRecord,
    /// A random number, drawn at this start.
    boot: u64,
    /// The number up to which others have shown, since this start, that they have the same transactions under the own numbers.
    proven: u64,
    /// Whether the record has changed since it was last written.
    changed: bool,
}

impl Identity {
    /// Continues with the identity in the store, or begins a new one if the store is empty.
    pub(super) fn open(
        robot: &str,
        stored: Option<IdentityRecord>,
        is_empty: bool,
        random: &mut Random,
    ) -> Result<Self, OpenError> {
        let boot = random.next();
        let (record, changed) = match stored {
            Some(record) if record.robot == robot => (record, false),
            Some(record) => return Err(OpenError::Robot { found: record.robot, expected: robot.to_owned() }),
            None if is_empty => {
                let (origin, joining) = (ReplicaId::new(random.next()), ReplicaId::new(random.next()));
                let joining = Some(joining);
                (IdentityRecord { origin, robot: robot.to_owned(), joining, ..IdentityRecord::default() }, true)
            }
            None => return Err(OpenError::Damaged { what: "there is no identity" }),
        };
        Ok(Self { record, boot, proven: 0, changed })
    }

    pub(super) fn origin(&self) -> ReplicaId {
        self.record.origin
    }

    pub(super) fn robot(&self) -> &str {
        &self.record.robot
    }

    pub(super) fn boot(&self) -> u64 {
        self.boot
    }

    /// Returns the origin under which the replica wants to be admitted; `None` once it was admitted.
    pub(super) fn joining(&self) -> Option<ReplicaId> {
        self.record.joining
    }

    /// Returns the sponsor that the replica has asked for admission.
    pub(super) fn asked(&self) -> Option<ReplicaId> {
        self.record.asked
    }

    /// Returns the origins that the replica has given up.
    pub(super) fn past(&self) -> &[Past] {
        &self.record.past
    }

    /// Returns the number up to which others have shown that they have the same transactions under the own numbers.
    pub(super) fn proven(&self) -> u64 {
        self.proven.max(self.record.known_by_peers)
    }

    /// Returns the request for admission; none if the replica does not ask for it.
    pub(super) fn join(&self) -> Option<Join> {
        let replaces = || self.record.past.iter().map(|past| past.origin).collect();
        let join = |origin| Join { origin, robot: self.record.robot.clone(), replaces: replaces(), claim: None };
        self.record.joining.map(join)
    }

    /// Writes the record if it has changed.
    pub(super) fn write(&mut self, batch: &mut Batch) {
        if std::mem::take(&mut self.changed) {
            batch.identity(&self.record);
        }
    }

    /// Gives up the origin, and returns it. `twice`: the origin may have used numbers twice.
    pub(super) fn begin_anew(&mut self, twice: bool, random: &mut Random) -> ReplicaId {
        let record = &mut self.record;
        let from = record.origin;
        record.past.iter_mut().for_each(|past| past.asked = None);
        record.past.push(Past { origin: from, known_by_peers: record.known_by_peers, twice, asked: None });
        let asked_for = record.joining.filter(|_| record.asked.is_some());
        record.past.extend(asked_for.map(|origin| Past { origin, ..Past::default() }));
        record.origin = ReplicaId::new(random.next());
        record.joining = Some(ReplicaId::new(random.next()));
        (record.asked, record.known_by_peers) = (None, 0);
        self.changed = true;
        from
    }

    /// Continues under the admitted origin.
    pub(super) fn admitted(&mut self, joining: ReplicaId) {
        let record = &mut self.record;
        record.origin = joining;
        (record.joining, record.asked, record.known_by_peers) = (None, None, 0);
        self.proven = 0;
        // Every later sponsor gets these origins. Only a team that was also given up may have known them.
        record.past.iter_mut().for_each(|past| (past.known_by_peers, past.twice, past.asked) = (u64::MAX, false, None));
        let surplus = record.past.len().saturating_sub(PAST_MAX);
        record.past.drain(..surplus);
        self.changed = true;
    }

    /// Makes the replica a member without an admission.
    pub(super) fn founds(&mut self) {
        (self.record.joining, self.record.asked) = (None, None);
        self.record.past.clear();
        self.changed = true;
    }

    /// Asks a peer for admission, unless this replica is a member. Each peer is asked for a different origin.
    pub(super) fn asks(&mut self, peer: ReplicaId, random: &mut Random) {
        let record = &mut self.record;
        let Some(joining) = record.joining.filter(|_| record.asked != Some(peer)) else { return };
        if let Some(before) = record.asked.replace(peer) {
            let known = record.past.iter().position(|past| past.asked == Some(peer));
            let known = known.map(|index| record.past.remove(index).origin);
            record.joining = Some(known.unwrap_or_else(|| ReplicaId::new(random.next())));
            record.past.push(Past { origin: joining, asked: Some(before), ..Past::default() });
        }
        self.changed = true;
    }

    /// Requests another origin if the one requested from `from` has been retired since. Returns whether it was.
    pub(super) fn wants_another(&mut self, from: ReplicaId, random: &mut Random) -> bool {
        let Some(joining) = self.record.joining.filter(|_| self.record.asked == Some(from)) else { return false };
        self.record.past.push(Past { origin: joining, ..Past::default() });
        self.record.joining = Some(ReplicaId::new(random.next()));
        self.changed = true;
        true
    }

    /// Remembers that an origin, under which this replica has not written, has used numbers twice.
    pub(super) fn knows_forked(&mut self, origin: ReplicaId) {
        if !self.is_forked(origin) {
            self.record.past.push(Past { origin, twice: true, ..Past::default() });
            self.changed = true;
        }
    }

    /// Returns whether an origin is known to have used numbers twice.
    pub(super) fn is_forked(&self, origin: ReplicaId) -> bool {
        self.record.past.iter().any(|past| past.origin == origin && past.twice)
    }

    /// Remembers that others have all own transactions up to `head`. A report of the number alone is not enough: if the store
    /// was set back, the other replica may have a different transaction under this number.
    pub(super) fn set_known_by_peers(&mut self, head: u64) {
        if head > self.record.known_by_peers && self.record.joining.is_none() {
            self.record.known_by_peers = head;
            self.changed = true;
        }
    }

    /// Notes that a replica has shown that it has the same transactions under the own numbers up to `seq`.
    pub(super) fn proves(&mut self, seq: u64) {
        self.proven = self.proven.max(seq);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn newcomer() -> (Identity, Random) {
        let mut random = Random::new(1);
        (Identity::open("r", None, true, &mut random).unwrap(), random)
    }

    #[test]
    fn each_sponsor_is_asked_for_an_origin_of_its_own_and_always_for_the_same() {
        let (mut me, mut random) = newcomer();
        let (a, b) = (ReplicaId::new(1), ReplicaId::new(2));
        let mut ask = |me: &mut Identity, peer| {
            me.asks(peer, &mut random);
            me.joining().unwrap()
        };
        let (first, second) = (ask(&mut me, a), ask(&mut me, b));
        assert_ne!(first, second, "two sponsors would both count on one state");
        assert_eq!((ask(&mut me, a), ask(&mut me, b)), (first, second));
        assert_eq!(me.join().unwrap().replaces, [first]);
        assert!(me.wants_another(b, &mut random) && !me.wants_another(a, &mut random));
        assert_ne!(me.joining(), Some(second), "it was retired");
    }

    #[test]
    fn a_life_that_is_given_up_is_told_of_until_it_is_admitted() {
        let (mut me, mut random) = newcomer();
        let before = me.origin();
        me.admitted(me.joining().unwrap());
        me.set_known_by_peers(7);
        let from = me.begin_anew(true, &mut random);
        let past = me.past().last().copied().unwrap();
        assert_eq!((past.origin, past.known_by_peers, past.twice), (from, 7, true));
        assert!(from != before && me.joining().is_some());
        me.set_known_by_peers(9);
        assert_eq!(me.proven(), 0, "nobody knows what it writes until it is admitted");
        me.admitted(me.joining().unwrap());
        assert_eq!(me.past().last().map(|past| (past.origin, past.known_by_peers)), Some((from, u64::MAX)));
    }

    #[test]
    fn a_store_of_another_robot_or_without_identity_is_none() {
        let mut random = Random::new(1);
        let other = IdentityRecord { robot: "x".into(), ..IdentityRecord::default() };
        assert!(matches!(Identity::open("r", Some(other), false, &mut random), Err(OpenError::Robot { .. })));
        assert!(matches!(Identity::open("r", None, false, &mut random), Err(OpenError::Damaged { .. })));
    }

    #[test]
    fn it_is_written_when_it_has_changed() {
        let (mut me, _) = newcomer();
        let written = |me: &mut Identity| {
            let mut batch = Batch::default();
            me.write(&mut batch);
            !batch.is_empty()
        };
        assert_eq!([written(&mut me), written(&mut me)], [true, false]);
        me.founds();
        assert!(written(&mut me));
    }
}
