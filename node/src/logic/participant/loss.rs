//! The hosts that cannot be reached, and which of them matter here. `run` carries the reaction of this part of a deployment out.
//!
//! A host is lost 5 s after the start of its absence, which is 6 s after its last answer. For that host, everything that it
//! supervises here has failed. Then each program follows its `on_link_loss`. By default the program is stopped. `keep` and
//! `hold` let it run, and with `hold` nothing new begins. `safe_stop_after` sets another time from when the host was
//! missed. A group proceeds with its expression as long as any program below it may run. When the lost host returns, the programs that ran without it are stopped: its
//! supervisor has given them up, and may have replaced them.
//!
//! When the home is lost, this part is on its own: programs that are to stop leave. Once nothing runs any more,
//! everything leaves, since no host could end it.

use super::site::Supervisors;
use crate::logic::executer::{group_host, leaf_host};
use crate::logic::protocol::Target;
use comms::logic::time::Time;
use language::plan::{Expression, Notice, Plan};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// The hosts that cannot be reached.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Loss {
    lost: BTreeSet<String>,
    /// The hosts that are missing or lost.
    missing: BTreeSet<String>,
    /// The times at which programs stop because a host is missing.
    stops: BTreeSet<(Time, u32, String)>,
}

impl Loss {
    /// Takes note that a host is missing, and of the programs that stop because of that, each with its time. A program that has a
    /// time for this host keeps it. Returns whether the absence is new.
    pub(super) fn missing(&mut self, host: &str, stops: impl IntoIterator<Item = (Time, u32)>) -> bool {
        let known: BTreeSet<u32> =
            self.stops.iter().filter(|(_, _, missing)| missing == host).map(|(_, leaf, _)| *leaf).collect();
        let new = stops.into_iter().filter(|(_, leaf)| !known.contains(leaf));
        self.stops.extend(new.map(|(due, leaf)| (due, leaf, host.to_owned())));
        self.missing.insert(host.to_owned())
    }

    /// Takes the loss of a host.
    pub(super) fn lost(&mut self, host: &str) {
        self.lost.insert(host.to_owned());
    }

    /// Takes note that a host is there again; returns whether it was lost.
    pub(super) fn back(&mut self, host: &str) -> bool {
        self.stops.retain(|(_, _, missing)| missing != host);
        self.missing.remove(host);
        self.lost.remove(host)
    }

    /// Returns whether a host is lost.
    pub(super) fn is_lost(&self, host: &str) -> bool {
        self.lost.contains(host)
    }

    /// Takes the next program whose time to stop has come, with the host that is missing.
    pub(super) fn next_stop(&mut self, now: Time) -> Option<(u32, String)> {
        self.deadline().filter(|due| *due <= now)?;
        self.stops.pop_first().map(|(_, leaf, host)| (leaf, host))
    }

    /// Returns the next time at which a program stops.
    pub(super) fn deadline(&self) -> Option<Time> {
        self.stops.first().map(|(due, ..)| *due)
    }
}

/// Returns the hosts whose loss matters to something on `host`.
pub(super) fn relevant(plan: &Plan, supervisors: &Supervisors, host: &str) -> BTreeSet<String> {
    let mut relevant: BTreeSet<&str> = plan.home().into_iter().collect();
    for target in supervisors.keys() {
        let place = match target {
            Target::Leaf(leaf) => leaf_host(plan, *leaf),
            Target::Group(group) => group_host(plan, *group),
        };
        let above = |target: &Target| supervisors.get(target).map(|(group, _)| Target::Group(*group));
        for above in std::iter::successors(above(target), above) {
            let Target::Group(group) = above else { continue };
            let from = group_host(plan, group);
            if from == Some(host) {
                relevant.extend(place);
            } else if place == Some(host) {
                relevant.extend(from);
            }
        }
    }
    relevant.extend(awaited(plan, host));
    relevant.into_iter().map(str::to_owned).collect()
}

/// The hosts whose loss the activities on a host wait for.
fn awaited<'a>(plan: &'a Plan, host: &str) -> impl Iterator<Item = &'a str> {
    let here = (0..).zip(&plan.groups).filter(|(number, _)| group_host(plan, *number) == Some(host));
    let charts =
        here.filter_map(|(_, group)| if let Expression::Chart(chart) = &group.expression { Some(chart) } else { None });
    let notices = charts.flat_map(|chart| &chart.notices);
    notices.filter_map(|notice| {
        if let Notice::HostLost(lost) | Notice::LinkLost(lost) = notice { Some(lost.as_str()) } else { None }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(seconds: u64) -> Time {
        Time::from_nanos(seconds * 1_000_000_000)
    }

    /// A program keeps its time to stop, however often the absence is noted, and does not stop after the return of the host.
    #[test]
    fn a_program_keeps_its_time_to_stop() {
        let mut loss = Loss::default();
        assert!(loss.missing("c2", [(at(3), 1)]) && !loss.missing("c2", [(at(4), 1)]));
        assert!(loss.missing("c3", [(at(5), 1), (at(2), 4)]));
        assert_eq!((loss.deadline(), loss.next_stop(at(1))), (Some(at(2)), None));
        assert_eq!(loss.next_stop(at(3)), Some((4, "c3".to_owned())));
        assert_eq!(loss.next_stop(at(3)), Some((1, "c2".to_owned())));
        assert_eq!(loss.next_stop(at(3)), None);
        loss.lost("c3");
        assert!(loss.is_lost("c3") && loss.back("c3") && !loss.is_lost("c3") && !loss.back("c2"));
        assert_eq!((loss.deadline(), loss.next_stop(at(9))), (None, None));
        assert!(loss.missing("c2", []));
    }
}
