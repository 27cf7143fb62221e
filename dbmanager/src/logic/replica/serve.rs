//! The rules for requests: a pull of transactions, a request for admission, and the founding of a team.

use super::action::Action;
use super::commit::Change;
use super::interface::{Alarm, Effect};
use super::ledger::Ledger;
use crate::logic::member;
use crate::logic::message::{CHUNK_SIZE_MAX, Chunk, Join, Message, Pull};
use crate::logic::notary::{self, Claim, Notary};
use crate::logic::txn::EncodedTxn;
use crate::logic::version_vector::{ReplicaId, VersionVector};

/// How many given-up origins one admission retires at most.
const REPLACED_MAX: usize = 1024;

/// Answers a question for transactions.
pub(super) fn pull(ledger: &Ledger, from: ReplicaId, pull: &Pull) -> Vec<Action> {
    if !ledger.is_member() {
        return Vec::new();
    }
    if let Some(join) = &pull.join {
        return admission(ledger, from, join);
    }
    if pull.vector.get(from) < ledger.log().vector().get(from) {
        return vec![Action::send(from, ledger.contents().tip_of(from))];
    }
    if let Some(behind) = ledger.behind(from, &pull.vector) {
        return vec![Action::send(from, behind)];
    }
    let mut actions = Vec::new();
    // If two members were admitted by sponsors that have vanished, neither knows the other. Such a peer is answered, but is not
    // counted.
    if ledger.contents().members().is_active(from) {
        actions.push(Action::Has(pull.vector.clone()));
    }
    if !ledger.have().dominates(&pull.vector) {
        actions.push(Action::Ahead);
    }
    let size_max = usize::try_from(pull.size_max).unwrap_or(CHUNK_SIZE_MAX).min(CHUNK_SIZE_MAX);
    let txns = beyond(ledger, pull, size_max);
    if let Some(Chunk::Txns { txns, more: true, .. }) = &txns {
        actions.push(Action::send(from, Message::Coming { number: pull.number, last: last_of(txns) }));
    }
    actions.push(txns.map_or(Action::Offer, |txns| Action::send(from, Message::Chunk(txns))));
    actions
}

fn admission(ledger: &Ledger, from: ReplicaId, join: &Join) -> Vec<Action> {
    let (origin, members) = (join.origin, ledger.contents().members());
    if from != origin {
        return vec![Action::Emit(Effect::Alarm(Alarm::Malformed(from)))];
    }
    if let Some(stamp) = members.retired(origin) {
        return vec![Action::send(from, Message::Chunk(Chunk::Retired(stamp)))];
    }
    if members.is_active(origin) {
        return vec![Action::Offer];
    }
    let claim = join.claim.as_deref().unwrap_or_default();
    if let Some(notary) = ledger.authors.notary()
        && let Err(why) = claimed(notary, join, claim)
    {
        return vec![Action::Emit(Effect::Alarm(Alarm::Forged { from, why }))];
    }
    // This replica may not know some of them yet. A retirement is valid even if the admission comes later.
    let is_theirs = |past: &&ReplicaId| {
        let holder = ledger.authors.holder(**past, ledger.contents());
        holder.is_none_or(|holder| holder.robot == join.robot)
    };
    let replaced = join.replaces.iter().filter(|past| ledger.may_retire(**past)).filter(is_theirs).take(REPLACED_MAX);
    let mut writes: Vec<_> = replaced.filter_map(|past| member::retirement(*past)).collect();
    writes.extend(member::admission(origin, &join.robot));
    writes.extend(ledger.authors.notary().and_then(|_| notary::record(origin, claim)));
    writes.sort_by(|a, b| a.key.cmp(&b.key));
    writes.dedup_by(|a, b| a.key == b.key);
    vec![Action::Commit(Change::system("admit", writes)), Action::Offer]
}

/// Checks that the joining replica has claimed the origin under its own name.
fn claimed(notary: &dyn Notary, join: &Join, claim: &[u8]) -> Result<(), String> {
    let claim = Claim::from_bytes(claim).ok_or_else(|| format!("`{}` joins without a claim", join.robot))?;
    let holder = claim.check(notary, join.origin)?;
    if holder.robot == join.robot { Ok(()) } else { Err(format!("`{}` joins as `{}`", holder.robot, join.robot)) }
}

/// Returns the change that makes this replica the first member of a team. It may keep the data of a team in which it was the only
/// member.
pub(super) fn founding(ledger: &Ledger) -> Option<Change> {
    let given_up = |origin: &ReplicaId| ledger.identity.past().iter().any(|past| past.origin == *origin);
    let before: Vec<ReplicaId> = ledger.contents().members().active().map(|(origin, _)| origin).collect();
    // Origins from before the robots had keys cannot write any more.
    let is_over = |origin: &ReplicaId| given_up(origin) || !ledger.authors.is_claimed(*origin, ledger.contents());
    ledger.identity.joining().filter(|_| before.iter().all(is_over))?;
    let origin = ledger.identity.origin();
    let admission = member::admission(origin, ledger.identity.robot());
    let claim = ledger.authors.claim(origin, &[]).and_then(|claim| notary::record(origin, &claim));
    let retired = before.into_iter().filter_map(member::retirement);
    let mut writes: Vec<_> = admission.into_iter().chain(claim).chain(retired).collect();
    writes.sort_by(|a, b| a.key.cmp(&b.key));
    Some(Change::system("found the team", writes))
}

/// Returns transactions that a peer lacks, about `size_max` bytes of them; `None` if some of them were dropped.
fn beyond(ledger: &Ledger, pull: &Pull, size_max: usize) -> Option<Chunk> {
    let mut theirs = pull.vector.clone();
    theirs.join(&pull.pending);
    let (mut txns, mut more) = ledger.log().beyond(&theirs, size_max)?;
    if !more {
        let (pending, rest) = ledger.pending().beyond(&theirs, size_max);
        txns.extend(pending);
        more = rest;
    }
    Some(Chunk::Txns { number: pull.number, vector: ledger.log().vector().clone(), txns, more })
}

/// Returns the last transaction of each origin.
fn last_of(txns: &[EncodedTxn]) -> VersionVector {
    let mut last = VersionVector::default();
    for (header, _) in txns.iter().filter_map(|txn| txn.split().ok()) {
        last.join(&[(header.stamp.origin, header.seq)].into_iter().collect());
    }
    last
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::replica::tests::{Team, put};

    fn question(vector: VersionVector, join: Option<Join>) -> Pull {
        Pull { number: 1, vector, pending: VersionVector::default(), size_max: 1 << 20, join }
    }

    #[test]
    fn a_newcomer_is_admitted_under_its_own_name_once_and_what_it_was_is_retired() {
        let team = Team::of(2);
        let ledger = &team.replicas[0].ledger;
        let (new, before, me) = (ReplicaId::new(77), ReplicaId::new(78), ledger.identity.origin());
        let join = |origin| Some(Join { origin, robot: "r7".into(), replaces: vec![before, me], claim: None });
        let admit = |from, origin| pull(ledger, from, &question(VersionVector::default(), join(origin)));
        let [Action::Commit(change), Action::Offer] = &admit(new, new)[..] else { panic!("it is admitted") };
        let keys: Vec<_> = change.writes.iter().map(|write| write.key.clone()).collect();
        assert_eq!(keys, [member::admission(new, "").unwrap().key, member::retirement(before).unwrap().key]);
        assert!(matches!(admit(ReplicaId::new(79), new)[..], [Action::Emit(Effect::Alarm(_))]));
        let known = team.replicas[1].origin();
        assert!(matches!(admit(known, known)[..], [Action::Offer]));
    }

    #[test]
    fn a_member_gets_what_it_lacks_and_is_asked_for_what_it_has() {
        let mut team = Team::of(2);
        team.away.insert(1);
        team.commit(0, put("team/a", b"1"));
        let (ledger, from) = (&team.replicas[0].ledger, team.replicas[1].origin());
        let vector = team.replicas[1].log().vector().clone();
        let served = pull(ledger, from, &question(vector.clone(), None));
        let [Action::Has(_), Action::Emit(Effect::Send(_, Message::Chunk(Chunk::Txns { txns, .. })))] = &served[..]
        else {
            panic!("{served:?}")
        };
        assert_eq!(txns.len(), 1);
        let mut more = vector;
        more.join(&[(ReplicaId::new(77), 1)].into_iter().collect());
        assert!(pull(ledger, from, &question(more, None)).iter().any(|action| matches!(action, Action::Ahead)));
        let less = pull(ledger, from, &question(VersionVector::default(), None));
        assert!(matches!(
            less[..],
            [Action::Emit(Effect::Send(_, Message::Chunk(Chunk::Behind(_) | Chunk::Fork { .. })))]
        ));
    }
}
