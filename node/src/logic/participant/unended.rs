//! Programs that could not be ended while their deployment goes on: what they hold is not used by others of it.

use super::Participant;
use crate::logic::claims::Claims;
use crate::logic::effect::Out;
use crate::logic::protocol::{Change, Ending, Failure, FailureCause, Target};
use language::plan::Plan;
use std::collections::BTreeSet;

impl Participant {
    /// Returns the programs that may still be there although everything was done to end them.
    pub fn unconfirmed(&self) -> BTreeSet<u32> {
        self.instances.iter().filter(|(_, instance)| instance.is_unconfirmed()).map(|(leaf, _)| leaf).collect()
    }

    /// Returns why a plan cannot be taken on that has no program any more which could not be ended: what that has taken would be
    /// free with it.
    pub(super) fn unended_without(&self, plan: &Plan) -> Vec<String> {
        let live = plan.live_leaves();
        let gone = self.unconfirmed().into_iter().filter(|leaf| !live.contains(leaf));
        let paths = gone.filter_map(|leaf| self.path(leaf));
        paths
            .map(|path| format!("`{path}` could not be ended and may still use what it has; end it, then take it away"))
            .collect()
    }

    /// Refuses to begin a program that would use a device beside one that could not be ended; says whether it was.
    pub(super) fn refuse_held(&self, leaf: u32, activation: u32, out: &mut Out<'_>) -> bool {
        let wanted = self.devices(leaf);
        let holder = |other: u32| {
            let theirs = self.devices(other);
            let (device, by) = wanted.first_conflict(&theirs)?;
            Some(FailureCause::DeviceHeld { device: device.to_owned(), by: by.to_owned() })
        };
        // Its own program is refused by itself.
        let others = self.unconfirmed().into_iter().filter(|other| *other != leaf);
        let Some(cause) = others.into_iter().find_map(holder) else { return false };
        let origin = self.path(leaf).unwrap_or_default().to_owned();
        let ending = Ending::Aborted(Failure { origin, cause, at: self.since_go(out.now) });
        self.happened(Target::Leaf(leaf), Change::Ended(ending.clone()), out);
        self.tell_supervisor(Target::Leaf(leaf), activation, ending, out);
        true
    }

    /// Returns the devices of a program: what it claims in the spec, and what is its own by its own word.
    fn devices(&self, leaf: u32) -> Claims {
        let mut claims = Claims::of_leaf(&self.plan, leaf);
        let path = self.path(leaf).unwrap_or_default();
        let facts = self.registrations.facts.get(&leaf);
        facts.into_iter().for_each(|facts| claims.extend(Claims::of_owner(path, &facts.owns)));
        claims
    }
}
