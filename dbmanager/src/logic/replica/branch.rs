//! The rules for branches: a peer has a different transaction under a number, knows more transactions of this replica than the replica
//! itself, or has retired it.
//!
//! *Numbers used twice.* If a store was set back, and writes before it has contact with other replicas, it reuses numbers that these
//! already know. The two transactions are never mixed up. A transaction that does not follow, or that has seen the other one, is refused.
//! The two replicas that disagree exchange the hashes by which they know each number ([`Chunk::Known`]). So an acknowledged write is never
//! overwritten by a writer that never saw it, and each branch is rebased.
//!
//! *Branches that cannot be compared.* A log that is cut does not have the hash of an old number. If two replicas are known to
//! disagree, the replica with the larger origin starts again, and treats every number that it cannot compare as used twice. A state
//! has only the hashes of its last numbers. So a replica that has seen an origin use a number twice remembers it, and takes over no
//! state that has more transactions of this origin.
//!
//! *Set back.* If a store was set back without a witness, this shows in two ways. Other replicas know more of its own transactions than
//! the replica itself ([`Chunk::Fork`]), or the replica reports less than before ([`Chunk::Behind`]). In both cases it starts again. The
//! second sign is lost if all replicas that had received the report were restarted since. It also does not help a replica that has since
//! applied a write made without the lost deletions. Then digests differ, and there is an alarm.

use super::action::Action;
use super::interface::{Alarm, Effect};
use super::ledger::Ledger;
use crate::logic::clock::Timestamp;
use crate::logic::log::Head;
#[cfg(doc)]
use crate::logic::message::Chunk;
use crate::logic::snapshot::Manifest;
use crate::logic::txn::ChainHash;
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use std::collections::BTreeSet;

/// Handles the hashes by which a member knows transactions. If one differs here, a store was set
/// back, and both branches have spread. Then the replica with the larger origin starts again with
/// the state of the other replica, and rebases its transactions. Returns no actions if all hashes
/// agree, or the replica is already starting again.
pub(super) fn known(ledger: &Ledger, from: ReplicaId, hashes: &[(Dot, ChainHash)]) -> Vec<Action> {
    let contents = ledger.contents();
    if !may_rejoin(ledger) {
        return Vec::new();
    }
    let Some((dot, hash)) = contents.other_than(hashes) else { return untold(ledger, from, hashes) };
    let me = ledger.identity.origin();
    if dot.origin == me {
        fork(ledger, dot.seq, hash).into_iter().collect()
    } else if dot.origin == from {
        tell_fork(ledger, from)
    } else if from < me {
        let alarm = Action::Emit(Effect::Alarm(Alarm::Fork(dot.origin)));
        vec![alarm, Action::KnowForked(dot.origin), Action::Rejoin { twice: false }]
    } else {
        let mut actions = tell_fork(ledger, dot.origin);
        actions.push(Action::send(from, contents.links_of([(dot.origin, dot.seq)])));
        actions
    }
}

/// Handles the case that a peer knows different transactions, but too little of the log is kept
/// here to tell which of `hashes` differ. Each transaction that cannot be compared may be such a
/// transaction. The replica with the smaller origin sends how far it has those chains.
fn untold(ledger: &Ledger, from: ReplicaId, hashes: &[(Dot, ChainHash)]) -> Vec<Action> {
    let (log, me) = (ledger.log(), ledger.identity.origin());
    let untold = hashes.iter().map(|(dot, _)| *dot).filter(|dot| dot.origin != me && log.hash(*dot).is_none());
    let origins: BTreeSet<ReplicaId> = untold.map(|dot| dot.origin).filter(|origin| log.tip(*origin).0 > 0).collect();
    gives_up(ledger, from, &origins)
}

/// Resolves different branches of these origins: of the two replicas, the replica with the larger origin starts again.
fn gives_up(ledger: &Ledger, from: ReplicaId, origins: &BTreeSet<ReplicaId>) -> Vec<Action> {
    if origins.is_empty() {
        return Vec::new();
    }
    if from > ledger.identity.origin() {
        let tips = origins.iter().map(|origin| (*origin, ledger.log().tip(*origin).0));
        return vec![Action::send(from, ledger.contents().links_of(tips))];
    }
    let alarms = origins.iter().map(|origin| Action::Emit(Effect::Alarm(Alarm::Fork(*origin))));
    let forked = origins.iter().map(|origin| Action::KnowForked(*origin));
    alarms.chain(forked).chain([Action::Rejoin { twice: false }]).collect()
}

/// Handles the hash by which a peer knows the own transaction `seq`.
pub(super) fn fork(ledger: &Ledger, seq: u64, hash: ChainHash) -> Option<Action> {
    let origin = ledger.identity.origin();
    let known = ledger.log().hash(Dot { origin, seq });
    let other = is_set_back(ledger.log().tip(origin), (seq, hash)) || known.is_some_and(|known| known != hash);
    (other && may_rejoin(ledger)).then_some(Action::Rejoin { twice: true })
}

/// Returns the actions for a state that has other transactions under the same numbers, and so would hide some; none if it hides nothing.
pub(super) fn hidden(ledger: &Ledger, from: ReplicaId, manifest: &Manifest) -> Vec<Action> {
    let head = |(origin, head): &(ReplicaId, Head)| (Dot { origin: *origin, seq: head.seq }, head.hash);
    let heads: Vec<(Dot, ChainHash)> = manifest.heads.iter().map(head).collect();
    let own = heads.iter().find(|(dot, _)| dot.origin == ledger.identity.origin());
    match own.and_then(|(own, hash)| fork(ledger, own.seq, *hash)) {
        Some(rejoin) => vec![rejoin],
        None if ledger.contents().other_than(&heads).is_none() => {
            gives_up(ledger, from, &beyond_a_fork(ledger, &heads))
        }
        None => known(ledger, from, &heads),
    }
}

/// Returns the origins that are known to have used numbers twice and of which a state has more than this replica. The state does not show
/// whether these are on the same branch.
fn beyond_a_fork(ledger: &Ledger, heads: &[(Dot, ChainHash)]) -> BTreeSet<ReplicaId> {
    let here = |dot: &Dot| ledger.log().tip(dot.origin).0;
    let beyond = heads.iter().map(|(dot, _)| dot).filter(|dot| here(dot) > 0 && dot.seq > here(dot));
    beyond.map(|dot| dot.origin).filter(|origin| ledger.identity.is_forked(*origin)).collect()
}

/// Handles a peer's report that this replica once had all of `vector`.
pub(super) fn behind(ledger: &Ledger, vector: &VersionVector) -> Action {
    let set_back = ledger.identity.joining().is_none() && !ledger.log().vector().dominates(vector);
    // If this is false, the report is stale: the transactions in it have arrived by now.
    if set_back { Action::Rejoin { twice: false } } else { Action::Ahead }
}

/// Handles a peer's report that this replica was retired, by a transaction with this timestamp. If each has retired the other, the earlier
/// retirement is valid.
pub(super) fn retired(ledger: &Ledger, from: ReplicaId, stamp: Timestamp) -> Option<Action> {
    let mine = ledger.contents().members().retired(from);
    let stands = ledger.identity.joining().is_none() && mine.is_none_or(|mine| stamp < mine);
    stands.then_some(Action::Rejoin { twice: false })
}

/// Returns whether a replica's own chain, which ends at `own`, is shorter than another replica knows it, or different. `known` is the end
/// that the other one knows.
pub(super) fn is_set_back(own: (u64, ChainHash), known: (u64, ChainHash)) -> bool {
    own.0 < known.0 || own.0 == known.0 && own.1 != known.1
}

fn may_rejoin(ledger: &Ledger) -> bool {
    ledger.identity.joining().is_none()
}

fn tell_fork(ledger: &Ledger, origin: ReplicaId) -> Vec<Action> {
    let mut effects = Vec::new();
    ledger.tell_fork(origin, &mut effects);
    effects.into_iter().map(Action::Emit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::message::{Chunk, Message};
    use crate::logic::replica::Answer;
    use crate::logic::replica::tests::{Team, put};

    fn rejoins(actions: &[Action]) -> bool {
        actions.iter().any(|action| matches!(action, Action::Rejoin { .. }))
    }

    #[test]
    fn of_two_on_different_branches_one_begins_anew() {
        let mut team = Team::of(3);
        let Answer::Committed(dot) = team.commit(2, put("team/a", b"1")) else { panic!("nothing forbids it") };
        team.run(20);
        let [a, b] = [0, 1].map(|node: usize| team.replicas[node].origin());
        let said = |at: usize, from, hash| known(&team.replicas[at].ledger, from, &[(dot, hash)]);
        let hash = team.replicas[0].log().hash(dot).unwrap();
        assert!(said(0, b, hash).is_empty(), "they mean the same");
        let other = ChainHash([9; 8]);
        assert_eq!([rejoins(&said(0, b, other)), rejoins(&said(1, a, other))], [b < a, a < b]);
        assert!(!rejoins(&said(0, dot.origin, other)), "it was that one's own");
        assert!(rejoins(&said(2, a, other)), "it was the own one");
    }

    #[test]
    fn of_two_whose_hashes_cannot_be_compared_one_begins_anew_and_the_other_says_what_it_has() {
        let mut team = Team::of(3);
        team.commit(2, put("team/a", b"1"));
        team.run(20);
        let [a, b, origin] = [0, 1, 2].map(|node: usize| team.replicas[node].origin());
        let longer = [(Dot { origin, seq: 99 }, ChainHash([9; 8]))];
        let said = |at: usize, from| known(&team.replicas[at].ledger, from, &longer);
        let (to_a, to_b) = (said(0, b), said(1, a));
        assert_eq!([rejoins(&to_a), rejoins(&to_b)], [b < a, a < b]);
        let (gives_up, stays) = if b < a { (to_a, to_b) } else { (to_b, to_a) };
        assert!(gives_up.iter().any(|action| matches!(action, Action::KnowForked(of) if *of == origin)));
        assert!(matches!(stays[..], [Action::Emit(Effect::Send(_, Message::Chunk(Chunk::Known(_))))]), "{stays:?}");
    }

    #[test]
    fn who_has_less_than_it_had_begins_anew() {
        let mut team = Team::of(2);
        team.commit(0, put("team/a", b"1"));
        let ledger = &team.replicas[0].ledger;
        let (seq, hash) = ledger.log().tip(ledger.identity.origin());
        let rejoins = |action: Option<Action>| action.is_some_and(|action| rejoins(&[action]));
        assert!(
            !rejoins(fork(ledger, seq, hash))
                && !rejoins(fork(
                    ledger,
                    seq - 1,
                    ledger.log().hash(Dot { origin: ledger.identity.origin(), seq: seq - 1 }).unwrap()
                ))
        );
        assert!(rejoins(fork(ledger, seq + 1, hash)) && rejoins(fork(ledger, seq, ChainHash([9; 8]))));
        let mut more = ledger.log().vector().clone();
        assert!(!rejoins(Some(behind(ledger, &more))), "stale");
        more.include(Dot { origin: ReplicaId::new(77), seq: 1 });
        assert!(rejoins(Some(behind(ledger, &more))));
    }
}
