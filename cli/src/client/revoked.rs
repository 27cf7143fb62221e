//! Robots that nobody asks any more: their keys are revoked, and no node of the team links to them.

use super::{ANSWER_WITHIN, Client};
use comms::io::clock;
use node::logic::protocol::{Answer, Request};
use std::collections::BTreeSet;
use team::visitor::VisitorIdentity;

impl Client {
    /// Returns the hosts whose keys are all revoked, as far as these nodes have met them; nobody without a team.
    pub(crate) async fn revoked(&self, nodes: impl Iterator<Item = &str>) -> BTreeSet<String> {
        let identity = self.team().and_then(|file| VisitorIdentity::open(&file).ok());
        let Some(identity) = identity else { return BTreeSet::new() };
        // All at once: each may be far away.
        let asked: Vec<_> = nodes.filter_map(|node| self.ask_on(node, &Request::Credentials).ok()).collect();
        let (deadline, mut shown) = (clock::now() + ANSWER_WITHIN, Vec::new());
        for mut answers in asked {
            if let Some(Ok(Answer::Credentials(more))) = answers.next_by(deadline).await {
                shown.extend(more);
            }
        }
        identity.revoked(&shown)
    }
}
