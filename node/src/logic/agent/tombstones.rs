//! The deployments of other homes that were stopped while those homes did not answer.
//!
//! A home is told as soon as it returns. Once its disk no longer has the deployment, it asks this node to drop the
//! tombstone. A tombstone of a later epoch covers the earlier epochs.

use crate::logic::effect::{Effect, Out};
use crate::logic::protocol::{Body, Deployment, Message, Tombstone};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// How many tombstones are kept; if there are more, the oldest epochs are dropped.
const TOMBSTONES_MAX: usize = 1024;

/// The tombstones of this node.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Tombstones {
    all: BTreeSet<Tombstone>,
}

impl FromIterator<Tombstone> for Tombstones {
    fn from_iter<I: IntoIterator<Item = Tombstone>>(all: I) -> Self {
        Self { all: all.into_iter().collect() }
    }
}

impl Tombstones {
    /// Keeps a tombstone for a home that does not answer.
    pub(super) fn add(&mut self, tombstone: Tombstone, out: &mut Out<'_>) {
        if !self.all.iter().any(|other| is_covered_by(&tombstone, other)) {
            self.all.retain(|other| !is_covered_by(other, &tombstone));
            self.all.insert(tombstone);
            while self.all.len() > TOMBSTONES_MAX {
                let first = self.all.iter().min_by_key(|one| one.deployment.epoch).cloned();
                self.all.retain(|one| Some(one) != first.as_ref());
            }
        }
        self.keep(out);
    }

    /// Has these tombstones on the disk, and no others.
    pub(super) fn keep(&self, out: &mut Out<'_>) {
        out.effects.push(Effect::KeepTombstones(self.all.iter().cloned().collect()));
    }

    /// Tells a reachable home which of its deployments were stopped while it was away.
    pub(super) fn tell(&self, home: &str, out: &mut Out<'_>) {
        for tombstone in self.all.iter().filter(|tombstone| tombstone.home == home) {
            out.send(home, Message { deployment: tombstone.deployment.clone(), body: Body::Stopped });
        }
    }

    /// Forgets a tombstone that its home has received.
    pub(super) fn mourned(&mut self, deployment: &Deployment, home: &str, out: &mut Out<'_>) {
        let count = self.all.len();
        self.all.retain(|tombstone| tombstone.home != home || tombstone.deployment != *deployment);
        if self.all.len() != count {
            self.keep(out);
        }
    }
}

/// Returns whether another tombstone covers everything that this one covers.
fn is_covered_by(one: &Tombstone, other: &Tombstone) -> bool {
    let (own, its) = (&one.deployment, &other.deployment);
    one.home == other.home && own.name == its.name && own.epoch <= its.epoch
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn tombstone(home: &str, epoch: u64) -> Tombstone {
        Tombstone { home: home.into(), deployment: Deployment { name: "door".into(), epoch } }
    }

    /// Runs an action, and returns the tombstones that it has on the disk, and how many messages it sends.
    fn run(act: impl FnOnce(&mut Out<'_>)) -> (Option<Vec<Tombstone>>, usize) {
        let (mut effects, mut messages) = (Vec::new(), Vec::new());
        let now = comms::logic::time::Time::ZERO;
        act(&mut Out { now, since_1970: Duration::ZERO, effects: &mut effects, messages: &mut messages });
        let kept = effects.pop().map(|effect| {
            let Effect::KeepTombstones(all) = effect else { panic!("{effect:?}") };
            all
        });
        (kept, messages.len())
    }

    #[test]
    fn a_later_tombstone_covers_earlier_ones() {
        let mut all = Tombstones::default();
        assert_eq!(run(|out| all.add(tombstone("c1", 2), out)).0, Some(vec![tombstone("c1", 2)]));
        assert_eq!(run(|out| all.add(tombstone("c1", 1), out)).0, Some(vec![tombstone("c1", 2)]));
        run(|out| all.add(tombstone("c2", 1), out));
        let kept = run(|out| all.add(tombstone("c1", 3), out)).0;
        assert_eq!(kept, Some(vec![tombstone("c1", 3), tombstone("c2", 1)]));
        assert_eq!(run(|out| all.tell("c1", out)), (None, 1));
        let door = Deployment { name: "door".into(), epoch: 3 };
        assert_eq!(run(|out| all.mourned(&door, "c2", out)).0, None);
        assert_eq!(run(|out| all.mourned(&door, "c1", out)).0, Some(vec![tombstone("c2", 1)]));
    }

    #[test]
    fn the_earliest_epochs_go_first() {
        let mut all: Tombstones =
            (0..=TOMBSTONES_MAX as u64).map(|epoch| tombstone(&format!("c{epoch}"), epoch)).collect();
        let kept = run(|out| all.add(tombstone("late", 9999), out)).0.unwrap();
        assert_eq!(kept.len(), TOMBSTONES_MAX);
        assert!(kept.iter().all(|one| one.deployment.epoch > 1));
    }
}
