//! The operator of a simulated team: merges two teams into one, founds the team again, and gives and revokes the keys
//! of its robots.

use super::World;
use super::keys::{Keys, Revoked};
use dbmanager::logic::replica::{Alarm, Input, Replica};

impl World {
    /// Gives keys to all robots that are added later.
    pub(crate) fn with_keys(mut self) -> Self {
        self.revoked = Some(Revoked::default());
        self
    }

    pub(super) fn keys(&self, node: usize) -> Option<Keys> {
        let super::Node { name, invited, .. } = &self.nodes[node];
        self.revoked.as_ref().map(|revoked| Keys::new(name, *invited, revoked))
    }

    /// Revokes the keys of a robot; the robot makes new ones, and is invited again.
    pub(super) fn revoke(&mut self, node: usize) {
        let Some(keys) = self.keys(node) else { return };
        keys.revoke();
        let name = self.nodes[node].name.clone();
        let invited = 1 + self.nodes.iter().map(|node| node.invited).max().unwrap_or_default();
        for of_name in (0..self.nodes.len()).filter(|other| self.nodes[*other].name == name).collect::<Vec<_>>() {
            self.nodes[of_name].invited = invited;
            if self.nodes[of_name].replica.is_some() {
                self.crash(of_name);
                self.restart(of_name);
            }
        }
    }

    /// Acts like an operator who learns that there are two teams with several robots each: the team of robot 0 stays.
    pub(super) fn make_one_team(&mut self, told: usize) {
        let Some(first) = self.nodes[0].replica.as_ref().filter(|first| first.is_member()) else { return };
        let (origin, members) = (first.origin(), first.members().clone());
        let told = self.alarms[told..].to_vec();
        for (node, alarm) in told {
            let Alarm::OtherTeam(peer, _) = alarm else { continue };
            let is_apart = |replica: &Replica| replica.is_member() && !replica.members().is_active(origin);
            if members.is_active(peer) && self.nodes[node].replica.as_ref().is_some_and(is_apart) {
                self.input(node, |_, wall| Input::Join(peer, wall));
            }
        }
    }

    /// Acts like an operator when the last member has lost its disk: an empty robot founds the team again.
    pub(super) fn found_anew(&mut self) {
        let runs = |node: &super::Node, is: fn(&Replica) -> bool| node.replica.as_ref().is_some_and(is);
        let wanted = self.memberless && !self.nodes.iter().any(|node| runs(node, Replica::is_member));
        let empty = self.nodes.iter().position(|node| runs(node, |replica| replica.log().vector().is_empty()));
        empty.filter(|_| wanted).into_iter().for_each(|node| self.input(node, |_, wall| Input::Found(wall)));
    }
}
