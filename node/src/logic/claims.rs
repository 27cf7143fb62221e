//! The devices of this host that deployments hold. Two deployments must not move the same arm.
//!
//! A program that `claims` a device in the spec holds the device from `Prepare` on. A controller holds a device if it
//! names the device's keys as its own in its `Hello`. Any number of programs may hold a device as `(read)`. A device is
//! held until nothing of the deployment is left.

use crate::logic::executer::leaf_host;
use crate::logic::protocol::{Deployment, DeviceName};
use language::plan::Plan;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The devices that one deployment holds on this host.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Claims {
    held: BTreeMap<String, Holder>,
}

/// The holder of a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Holder {
    path: String,
    is_write: bool,
}

impl Claims {
    /// Returns the claims that the spec makes on `host`.
    pub fn of(plan: &Plan, host: &str) -> Self {
        let mut claims = Self::default();
        for claim in plan.claims.iter().filter(|claim| leaf_host(plan, claim.leaf) == Some(host)) {
            if let Some(leaf) = plan.leaves.get(claim.leaf as usize) {
                claims.hold(&claim.device, &leaf.path, claim.is_write);
            }
        }
        claims
    }

    /// Returns the claims that the spec makes for a leaf.
    pub fn of_leaf(plan: &Plan, leaf: u32) -> Self {
        let mut claims = Self::default();
        let path = plan.leaves.get(leaf as usize).map_or("", |leaf| leaf.path.as_str());
        plan.claims.iter().filter(|claim| claim.leaf == leaf).for_each(|claim| {
            claims.hold(&claim.device, path, claim.is_write);
        });
        claims
    }

    /// Returns the claims of a controller at `path` that owns these devices.
    pub fn of_owner(path: &str, devices: &[String]) -> Self {
        let mut claims = Self::default();
        devices.iter().for_each(|device| claims.hold(device, path, true));
        claims
    }

    /// Adds the devices that other programs of the same deployment hold.
    pub fn extend(&mut self, others: Self) {
        for (device, holder) in others.held {
            self.hold(&device, &holder.path, holder.is_write);
        }
    }

    /// Returns each device with its holder.
    pub fn names(&self, deployment: &Deployment) -> impl Iterator<Item = DeviceName> {
        self.held.iter().map(|(device, holder)| DeviceName {
            device: device.clone(),
            deployment: deployment.clone(),
            path: holder.path.clone(),
            is_exclusive: holder.is_write,
        })
    }

    /// Returns why these devices cannot be held at the same time as the devices of `holder`: one sentence for each such device.
    pub fn conflicts(&self, holder: &Deployment, theirs: &Self) -> Vec<String> {
        self.both(theirs).map(|(device, path)| held(device, holder, path)).collect()
    }

    /// Returns the same sentences for a `holder` whose programs could not be ended.
    pub fn conflicts_with_unended(&self, holder: &Deployment, theirs: &Self) -> Vec<String> {
        let unended = unended(holder);
        let conflict = |(device, path)| format!("`{device}` is held by `{path}` of `{holder}`, which {unended}");
        self.both(theirs).map(conflict).collect()
    }

    /// Returns the first device that only one of the two deployments can hold, with its holder's path in the other.
    pub fn first_conflict<'a>(&'a self, theirs: &'a Self) -> Option<(&'a str, &'a str)> {
        self.both(theirs).next()
    }

    /// Returns each device that only one of the two deployments can hold, with its holder's path in the other.
    fn both<'a>(&'a self, theirs: &'a Self) -> impl Iterator<Item = (&'a str, &'a str)> {
        let both = self.held.iter().filter_map(|(device, own)| Some((device, own, theirs.held.get(device)?)));
        let conflicts = both.filter(|(_, own, other)| own.is_write || other.is_write);
        conflicts.map(|(device, _, other)| (device.as_str(), other.path.as_str()))
    }

    fn hold(&mut self, device: &str, path: &str, is_write: bool) {
        let holder = Holder { path: path.to_owned(), is_write };
        let held = self.held.entry(device.to_owned()).or_insert_with(|| holder.clone());
        if is_write && !held.is_write {
            *held = holder;
        }
    }
}

/// Returns the end of a sentence, which says that programs of a deployment could not be ended.
pub fn unended(deployment: &Deployment) -> String {
    format!("could not be ended and may still run; once you know better, `dca stop {} --forget`", deployment.name)
}

fn held(device: &str, holder: &Deployment, path: &str) -> String {
    format!("`{device}` is held by `{path}` of `{holder}`; `dca stop {}` ends that", holder.name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn readers_share_and_a_writer_is_alone() {
        let door = Deployment { name: "door".into(), epoch: 3 };
        let hold = |is_write| {
            let mut claims = Claims::default();
            claims.hold("arm", "main/a", false);
            claims.hold("arm", "main/b", is_write);
            claims
        };
        let refused = ["`arm` is held by `main/b` of `door@3`; `dca stop door` ends that"];
        assert_eq!(hold(false).conflicts(&door, &hold(false)), Vec::<String>::new());
        assert_eq!(hold(false).conflicts(&door, &hold(true)), refused);
        assert_eq!(Claims::of_owner("main/w", &["arm".into()]).conflicts(&door, &hold(true)), refused);
        assert_eq!(hold(true).conflicts(&door, &Claims::of_owner("main/w", &["leg".into()])), Vec::<String>::new());
    }
}
