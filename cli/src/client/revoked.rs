//! Robots whose keys are revoked: commands do not ask them, and no node of the team links to them.

use super::{ANSWER_WITHIN, Client};
use anyhow::anyhow;
use comms::io::clock;
use node::console::Failure;
use node::logic::protocol::{Answer, Request};
use std::collections::BTreeSet;
use team::visitor::VisitorIdentity;

impl Client {
    /// Returns the hosts that these nodes have met, and whose known keys are all revoked; no hosts outside a team.
    pub(crate) async fn revoked(&self, nodes: impl Iterator<Item = &str>) -> BTreeSet<String> {
        let identity = self.team().and_then(|file| VisitorIdentity::open(&file).ok());
        let Some(identity) = identity else { return BTreeSet::new() };
        // All nodes are asked at once: each may be far away.
        let asked: Vec<_> = nodes.filter_map(|node| self.ask_on(node, &Request::Credentials).ok()).collect();
        let (deadline, mut shown) = (clock::now() + ANSWER_WITHIN, Vec::new());
        for mut answers in asked {
            if let Some(Ok(Answer::Credentials(more))) = answers.next_by(deadline).await {
                shown.extend(more);
            }
        }
        identity.revoked(&shown)
    }

    /// Returns whether the keys of the node that the connection goes through are revoked.
    pub(crate) async fn is_outlawed(&self) -> bool {
        let Some(local) = self.local() else { return false };
        self.revoked(std::iter::once(local)).await.contains(local)
    }

    /// Refuses to work with hosts whose keys are revoked. Their nodes may run, but no other node of the team links to them.
    pub(crate) async fn refuse_revoked(&self, hosts: &[String]) -> Result<(), Failure> {
        let revoked = self.revoked(self.local().into_iter()).await;
        match hosts.iter().find(|host| revoked.contains(*host)) {
            None => Ok(()),
            Some(host) => Err(anyhow!(
                "the keys of the host `{host}` are revoked, so no node of the team works with it; `dca team invite {host}` takes it \
                 into the team again, with new keys"
            )
            .into()),
        }
    }
}
