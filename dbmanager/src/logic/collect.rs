//! What nobody needs any more, by membership and never by age.
//!
//! *State.* For each member, the last cut it has said to have durably that the own cut dominates.
//!
//! *Rule.* The *stable cut* is the least of these, over all members, the own one, and retired origins before their barrier.
//! A key that is only deleted is dropped when its deletions are stable; frames are dropped when they are stable and the log
//! is longer than it is to be.
//!
//! *T5, nothing comes back.* Let a deletion `T` be stable here. A transaction that has not seen `T` was committed by a
//! member before it had `T`, so within the cut by which that member showed that it has `T`; this cut counted only because
//! the own one dominates it, so the transaction is applied here already and `T` has met it. Whatever comes later has `T` in
//! its context. So dropping `T` is no change to anything that is still to come. Newcomers begin with a state that has `T`
//! (see [`member`](crate::logic::member)), and a transaction that is brought in under a new origin takes away every deletion
//! in its context: whatever was dropped anywhere before the newcomer was known was so with the sponsor's consent, hence is in
//! the state that the newcomer begins with.
//!
//! Counting what members *say* is not enough: one may say that it has `T`, and a concurrent write of it may still be on
//! its way. Then one replica drops `T` and shows the write, and another orders the two. A member that is away holds the
//! stable cut where it is; that costs some bytes, and [`Stable::pinned_by`] says who it is.

use crate::logic::cut::{Cut, Origin};
use crate::logic::member::Members;
use std::collections::BTreeMap;

/// What is stable, and who keeps it from growing.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stable {
    /// The cut that everybody has and nobody can write without.
    pub cut: Cut,
    /// Those whose cut is missing, or has less than the own one.
    pub pinned_by: Vec<Origin>,
}

/// What a replica knows of what others have.
#[derive(Clone, Debug, Default)]
pub struct Acks {
    said: BTreeMap<Origin, Cut>,
    counted: BTreeMap<Origin, Cut>,
    /// Up to where deletions were dropped.
    dropped: Cut,
}

impl Acks {
    /// Takes note of what `origin` says to have durably.
    pub fn note(&mut self, origin: Origin, cut: &Cut) {
        self.said.entry(origin).or_default().join(cut);
    }

    /// Counts what the own cut dominates by now.
    pub fn settle(&mut self, own: &Cut) {
        for (origin, cut) in &self.said {
            if own.dominates(cut) {
                self.counted.insert(*origin, cut.clone());
            }
        }
    }

    /// Takes note of what is stable now; returns whether that has changed, so that deletions can be dropped.
    pub fn drops(&mut self, stable: &Cut) -> bool {
        let changed = self.dropped != *stable;
        if changed {
            self.dropped = stable.clone();
        }
        changed
    }

    /// The state was replaced: nothing was dropped from it.
    pub fn begin_anew(&mut self) {
        self.dropped = Cut::default();
    }

    /// Returns what `origin` has said to have.
    pub fn said(&self, origin: Origin) -> Option<&Cut> {
        self.said.get(&origin)
    }

    /// Returns the stable cut as `me`, who has `own`, knows it.
    pub fn stable(&self, me: Origin, own: &Cut, members: &Members) -> Stable {
        let has = |origin: Origin| if origin == me { Some(own) } else { self.counted.get(&origin) };
        let active = members.active().map(|(origin, _)| origin);
        let retired = members.before_barrier(has);
        let mut stable = Stable { cut: own.clone(), pinned_by: Vec::new() };
        for origin in active.chain(retired) {
            let cut = has(origin).cloned().unwrap_or_default();
            if !cut.dominates(own) {
                stable.pinned_by.push(origin);
            }
            stable.cut.meet(&cut);
        }
        stable
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Stamp;
    use crate::logic::cut::Dot;
    use crate::logic::member;
    use crate::logic::state::{Seen, State};

    fn cut(entries: &[(u64, u64)]) -> Cut {
        entries.iter().map(|(origin, seq)| (Origin::new(*origin), *seq)).collect()
    }

    /// Returns the team of these origins, in which origin 1 has retired the last by its transaction 9 if asked for.
    fn team(origins: &[u64], retire: bool) -> Members {
        let mut state = State::default();
        let me = Origin::new(1);
        let mut apply = |seq, write| {
            let context = Cut::default();
            let stamp = Stamp { epoch: 0, hlc: seq, origin: me };
            state.apply(Dot { origin: me, seq }, stamp, Seen { context: &context, only: None }, &[write]);
        };
        for origin in origins {
            apply(*origin, member::admission(Origin::new(*origin), "r").unwrap());
        }
        if retire {
            apply(9, member::retirement(Origin::new(origins[origins.len() - 1])).unwrap());
        }
        Members::of(&state)
    }

    #[test]
    fn delete_vs_concurrent_put_gc_race() {
        let members = team(&[1, 2], false);
        let (me, own) = (Origin::new(1), cut(&[(1, 5)]));
        let mut acks = Acks::default();
        acks.note(Origin::new(2), &cut(&[(1, 5), (2, 1)]));
        acks.settle(&own);
        let stable = acks.stable(me, &own, &members);
        assert_eq!(
            (stable.cut, stable.pinned_by),
            (Cut::default(), vec![Origin::new(2)]),
            "2:1 may be a put beside it"
        );
        let own = cut(&[(1, 5), (2, 1)]);
        acks.settle(&own);
        assert_eq!(acks.stable(me, &own, &members), Stable { cut: own, pinned_by: vec![] });
    }

    #[test]
    fn a_retired_origin_counts_until_everybody_knows() {
        let members = team(&[1, 2, 3], true);
        let (me, own) = (Origin::new(1), cut(&[(1, 9)]));
        let mut acks = Acks::default();
        acks.note(Origin::new(2), &cut(&[(1, 8)]));
        acks.settle(&own);
        assert_eq!(acks.stable(me, &own, &members).cut, Cut::default());
        acks.note(Origin::new(2), &cut(&[(1, 9)]));
        acks.settle(&own);
        assert_eq!(acks.stable(me, &own, &members).cut, own);
    }

    #[test]
    fn last_member_standing() {
        let own = cut(&[(1, 9)]);
        assert_eq!(Acks::default().stable(Origin::new(1), &own, &team(&[1, 2], true)).cut, own);
    }
}
