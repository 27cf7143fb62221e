//! Processes of one deployment that others use on this host.

use crate::logic::effect::Out;
use crate::logic::executer::leaf_host;
use crate::logic::participant::{Participant, Seen, Wanted};
use crate::logic::programs::Programs;
use crate::logic::protocol::Deployment;
use comms::logic::control::Partner;
use language::plan::Plan;
use std::collections::BTreeMap;

/// The deployments on this host.
type Participants = BTreeMap<Deployment, Participant>;
/// For each deployment, the programs that other deployments call, with their callers.
type Clients = BTreeMap<Deployment, BTreeMap<u32, Vec<Partner>>>;

/// Returns the state of the processes of other deployments that a plan uses on a host, by leaf.
pub(super) fn used_by(
    plan: &Plan,
    host: &str,
    participants: &Participants,
    programs: &Programs,
) -> BTreeMap<u32, Result<Seen, String>> {
    let mine = plan.live_leaves().into_iter().filter(|leaf| leaf_host(plan, *leaf) == Some(host));
    mine.filter_map(|leaf| Some((leaf, look_up(&Wanted::of(plan, leaf)?, participants, programs)))).collect()
}

/// Tells deployments that use processes of others about their state, and those processes about their callers.
pub(super) fn look_at(participants: &mut Participants, programs: &Programs, out: &mut Out<'_>) {
    let mut clients = Clients::new();
    let mut news: Vec<(Deployment, u32, Result<Seen, String>)> = Vec::new();
    for (deployment, participant) in &*participants {
        for leaf in participant.externals() {
            let Some(wanted) = Wanted::of(participant.plan(), leaf) else { continue };
            if let Some((other, theirs)) = called(&wanted.external.deployment, participants)
                && let Some(served) = theirs.served(&wanted.external.path)
            {
                let callers = participant.callers(leaf);
                clients.entry(other.clone()).or_default().entry(served).or_default().extend(callers);
            }
            news.push((deployment.clone(), leaf, look_up(&wanted, participants, programs)));
        }
    }
    for (deployment, leaf, seen) in news {
        if let Some(participant) = participants.get_mut(&deployment) {
            participant.sees(leaf, seen, out);
        }
    }
    for (deployment, participant) in participants {
        participant.serve(clients.remove(deployment).unwrap_or_default(), out);
    }
}

fn look_up(wanted: &Wanted<'_>, participants: &Participants, programs: &Programs) -> Result<Seen, String> {
    let name = &wanted.external.deployment;
    match called(name, participants) {
        Some((_, participant)) => participant.show(wanted, programs),
        None => Err(format!("no deployment `{name}` runs there; deploy it first")),
    }
}

fn called<'a>(name: &str, participants: &'a Participants) -> Option<(&'a Deployment, &'a Participant)> {
    participants.iter().find(|(deployment, _)| deployment.name == *name)
}
