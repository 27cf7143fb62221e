//! The rules for `Hello`: the content of a replica's own `Hello`, and the consequences of a peer's.

use super::action::Action;
use super::branch::is_set_back;
use super::interface::{Alarm, Effect};
use super::ledger::Ledger;
use crate::logic::clock::Timestamp;
use crate::logic::message::{Chunk, Hello, Message};
use crate::logic::txn::FORMAT;
use crate::logic::version_vector::ReplicaId;

/// The actions that follow from a hello.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Greeting {
    /// The message needs no reaction.
    Ignored,
    /// The disk was copied: the same origin was started twice.
    Copied,
    /// The peer may have more transactions than this replica.
    Ahead,
    /// The peer is unknown, and its sponsor was retired.
    Retired(Timestamp),
    /// The peer belongs to another team of the same name.
    OtherTeam {
        /// Whether this replica gives up its own team for the peer's.
        gives_way: bool,
    },
    /// The peer's own chain is shorter than this replica knows it, or different.
    SetBack,
    /// The peer is a member with other transactions.
    Differs,
    /// The peer is a member with the same version vector.
    Even {
        /// Whether the peer has buffered other transactions.
        buffers: bool,
        /// Whether the same numbers stand for the same transactions.
        same_chains: bool,
        /// Whether both have the same state.
        same_state: bool,
    },
}

/// Returns the hello of a replica.
pub(super) fn of(ledger: &Ledger) -> Hello {
    let (me, log, contents) = (ledger.identity.origin(), ledger.log(), ledger.contents());
    Hello {
        robot: ledger.identity.robot().to_owned(),
        boot: ledger.identity.boot(),
        format: FORMAT,
        member: ledger.is_member(),
        sponsors: contents.members().sponsors(me),
        vector: log.vector().digest(),
        chains: log.chains(),
        pending: ledger.pending().vector().digest(),
        state: contents.state().digest(),
        head: log.tip(me),
        wall: ledger.pipeline.wall(),
    }
}

/// Returns the consequence of a hello of `from`.
fn judge(ledger: &Ledger, from: ReplicaId, hello: &Hello) -> Greeting {
    let (members, log) = (ledger.contents().members(), ledger.log());
    if from == ledger.identity.origin() {
        return if hello.boot == ledger.identity.boot() { Greeting::Ignored } else { Greeting::Copied };
    }
    if !hello.member {
        return Greeting::Ignored;
    }
    if !ledger.is_member() {
        return Greeting::Ahead;
    }
    if !members.is_active(from) {
        let known = |origin: &&ReplicaId| members.is_active(**origin) || members.retired(**origin).is_some();
        let Some(sponsor) = hello.sponsors.iter().find(known) else {
            return Greeting::OtherTeam { gives_way: gives_way(ledger, from, hello) };
        };
        // A member from which nothing was received lately may have admitted the peer. The peer itself can then report this.
        return members.retired(*sponsor).map_or(Greeting::Ahead, Greeting::Retired);
    }
    if is_set_back(hello.head, log.tip(from)) {
        Greeting::SetBack
    } else if hello.vector == log.vector().digest() {
        Greeting::Even {
            buffers: hello.pending != ledger.pending().vector().digest(),
            same_chains: hello.chains == log.chains(),
            same_state: hello.state == ledger.contents().state().digest(),
        }
    } else {
        Greeting::Differs
    }
}

/// Returns whether this replica gives up its own team for the team of `from`, a different team of the same name.
///
/// Only a replica that is alone in its team gives way: between teams with several members an
/// operator decides. A founder joins the team of a replica that was admitted. Otherwise the replica
/// with the larger origin joins the other team. So of two lone replicas exactly one gives way.
fn gives_way(ledger: &Ledger, from: ReplicaId, hello: &Hello) -> bool {
    let (me, members) = (ledger.identity.origin(), ledger.contents().members());
    let rank = |origin: ReplicaId, sponsors: &[ReplicaId]| (sponsors.is_empty(), origin);
    members.active().all(|(origin, _)| origin == me) && rank(from, &hello.sponsors) < rank(me, &members.sponsors(me))
}

/// Returns the actions by which a member leaves its team, and joins the team of a peer. The member first asks the peer.
pub(super) fn join(ledger: &Ledger, peer: ReplicaId) -> Vec<Action> {
    let is_other = ledger.is_member() && !ledger.contents().members().is_active(peer);
    if is_other { vec![Action::Rejoin { twice: false }, Action::Ahead] } else { Vec::new() }
}

/// Returns the actions in response to a hello of `from`.
pub(super) fn react(ledger: &Ledger, from: ReplicaId, hello: &Hello) -> Vec<Action> {
    let alarm = || Action::Emit(Effect::Alarm(Alarm::Diverged(from)));
    let mut actions = Vec::new();
    let greeting = judge(ledger, from, hello);
    if let Greeting::SetBack | Greeting::Even { .. } | Greeting::Differs = greeting {
        actions.push(Action::Reads(hello.format));
    }
    match greeting {
        Greeting::Ignored => {}
        Greeting::Copied => actions.push(Action::Rejoin { twice: true }),
        Greeting::OtherTeam { gives_way } => {
            actions.push(Action::Emit(Effect::Alarm(Alarm::OtherTeam(from, hello.robot.clone()))));
            if gives_way {
                actions.extend(join(ledger, from));
            }
        }
        Greeting::Retired(stamp) => actions.push(Action::send(from, Message::Chunk(Chunk::Retired(stamp)))),
        // The transactions that an old hello announces may have arrived before it. The receiver of this message can tell.
        Greeting::SetBack => actions.push(Action::send(from, ledger.contents().tip_of(from))),
        Greeting::Ahead | Greeting::Differs => actions.push(Action::Ahead),
        Greeting::Even { buffers, same_chains, same_state } => {
            let vector = ledger.log().vector();
            actions.extend(ledger.behind(from, vector).map(|behind| Action::send(from, behind)));
            actions.push(Action::Has(vector.clone()));
            if buffers {
                actions.push(Action::Ahead);
            }
            actions.push(if same_chains && same_state { Action::KnowsOwn } else { alarm() });
            if !same_chains {
                actions.push(Action::send(from, ledger.contents().links_of(vector.iter())));
            }
        }
    }
    actions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::replica::tests::{Team, put};
    use crate::logic::txn::ChainHash;

    /// Returns the consequence, for robot 0, of the hello of robot 1 after `change`.
    fn judged(team: &Team, change: impl FnOnce(&mut Hello)) -> Greeting {
        let mut hello = of(&team.replicas[1].ledger);
        change(&mut hello);
        judge(&team.replicas[0].ledger, team.replicas[1].origin(), &hello)
    }

    #[test]
    fn what_a_member_says_is_compared_with_what_is_here() {
        let mut team = Team::of(2);
        let even = Greeting::Even { buffers: false, same_chains: true, same_state: true };
        assert_eq!(judged(&team, |_| {}), even);
        assert_eq!(
            judged(&team, |hello| hello.state += 1),
            Greeting::Even { buffers: false, same_chains: true, same_state: false }
        );
        assert_eq!(judged(&team, |hello| hello.member = false), Greeting::Ignored);
        team.away.insert(1);
        team.commit(1, put("team/a", b"1"));
        assert_eq!(judged(&team, |_| {}), Greeting::Differs);
        team.away.clear();
        team.run(20);
        assert_eq!(judged(&team, |hello| hello.head.0 -= 1), Greeting::SetBack);
        assert_eq!(judged(&team, |hello| hello.head.1 = ChainHash([9; 8])), Greeting::SetBack);
    }

    #[test]
    fn a_second_start_of_the_own_origin_is_a_copy() {
        let team = Team::of(1);
        let ledger = &team.replicas[0].ledger;
        let mut hello = of(ledger);
        assert_eq!(judge(ledger, team.replicas[0].origin(), &hello), Greeting::Ignored);
        hello.boot += 1;
        assert_eq!(judge(ledger, team.replicas[0].origin(), &hello), Greeting::Copied);
    }

    #[test]
    fn of_a_stranger_its_sponsors_decide() {
        let team = Team::of(2);
        let (ledger, sponsor) = (&team.replicas[0].ledger, team.replicas[1].origin());
        let mut hello = of(&team.replicas[1].ledger);
        let mut judge = |sponsors: &[ReplicaId]| {
            hello.sponsors = sponsors.to_vec();
            judge(ledger, ReplicaId::new(77), &hello)
        };
        let other = Greeting::OtherTeam { gives_way: false };
        assert_eq!((judge(&[]), judge(&[ReplicaId::new(78)])), (other, other));
        assert_eq!(judge(&[ReplicaId::new(78), sponsor]), Greeting::Ahead);
    }

    #[test]
    fn of_two_replicas_that_are_each_alone_in_a_team_exactly_one_gives_way() {
        let team = Team::of(1);
        let ledger = &team.replicas[0].ledger;
        let (mut hello, smallest, largest) = (of(ledger), ReplicaId::new(0), ReplicaId::new(u64::MAX));
        let mut yields = |origin, sponsors: &[ReplicaId]| {
            hello.sponsors = sponsors.to_vec();
            judge(ledger, origin, &hello) == Greeting::OtherTeam { gives_way: true }
        };
        assert!(yields(smallest, &[]) && !yields(largest, &[]), "of two founders the larger origin");
        assert!(yields(largest, &[ReplicaId::new(78)]), "a founder gives way to a replica that was admitted");
    }
}
