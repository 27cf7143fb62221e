//! Processes of one deployment that others use on this host.

use super::Agent;
use crate::logic::effect::Out;
use crate::logic::executer::leaf_host;
use crate::logic::participant::{Participant, Seen, Wanted};
use crate::logic::protocol::Deployment;
use comms::logic::control::Partner;
use language::plan::Plan;
use std::collections::BTreeMap;

/// For each deployment, the programs that other deployments call, with their callers.
type Clients = BTreeMap<Deployment, BTreeMap<u32, Vec<Partner>>>;

impl Agent {
    /// Returns the state of the processes of other deployments that a plan uses on this host, by leaf.
    pub(super) fn externals(&self, plan: &Plan) -> BTreeMap<u32, Result<Seen, String>> {
        let host = self.identity.host.as_str();
        let mine = plan.live_leaves().into_iter().filter(|leaf| leaf_host(plan, *leaf) == Some(host));
        mine.filter_map(|leaf| Some((leaf, self.look_up(&Wanted::of(plan, leaf)?)))).collect()
    }

    /// Tells deployments that use processes of others about their state, and those processes about their callers.
    pub(super) fn look_at_externals(&mut self, out: &mut Out<'_>) {
        let mut clients = Clients::new();
        let mut news: Vec<(Deployment, u32, Result<Seen, String>)> = Vec::new();
        for (deployment, participant) in &self.participants {
            for leaf in participant.externals() {
                let Some(wanted) = Wanted::of(participant.plan(), leaf) else { continue };
                if let Some((other, theirs)) = self.deployment_called(&wanted.external.deployment)
                    && let Some(served) = theirs.served(&wanted.external.path)
                {
                    let callers = participant.callers(leaf);
                    clients.entry(other.clone()).or_default().entry(served).or_default().extend(callers);
                }
                news.push((deployment.clone(), leaf, self.look_up(&wanted)));
            }
        }
        for (deployment, leaf, seen) in news {
            if let Some(participant) = self.participants.get_mut(&deployment) {
                participant.sees(leaf, seen, out);
            }
        }
        for (deployment, participant) in &mut self.participants {
            participant.serve(clients.remove(deployment).unwrap_or_default(), out);
        }
    }

    fn look_up(&self, wanted: &Wanted<'_>) -> Result<Seen, String> {
        let name = &wanted.external.deployment;
        match self.deployment_called(name) {
            Some((_, participant)) => participant.show(wanted, &self.programs),
            None => Err(format!("no deployment `{name}` runs there; deploy it first")),
        }
    }

    fn deployment_called(&self, name: &str) -> Option<(&Deployment, &Participant)> {
        self.participants.iter().find(|(deployment, _)| deployment.name == *name)
    }
}
