//! The reaction of this part of a deployment to hosts that cannot be reached.
//!
//! A host is lost 5 s after the start of its absence, which is 6 s after its last answer. For that host, everything that it
//! supervises here has failed. Then each program follows its `on_link_loss`. By default the program is stopped. `keep` and
//! `hold` let it run, and with `hold` nothing new begins. `safe_stop_after` sets another time from when the host was
//! missed. A group proceeds with its expression as long
//! as any program below it may run. When the lost host returns, the programs that ran without it are stopped: its
//! supervisor has given them up, and may have replaced them.
//!
//! When the home is lost, this part is on its own: programs that are to stop leave. Once nothing runs any more,
//! everything leaves, since no host could end it.

use super::change::supervisors;
use super::{Participant, Phase};
use crate::logic::effect::{Out, earliest};
use crate::logic::executer::{group_host, leaf_host};
use crate::logic::instance::Instance;
use crate::logic::protocol::{ActivityInput, Target, unreached};
use comms::logic::time::Time;
use language::plan::{Expression, Group, LinkLoss, Notice, Plan};
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::time::Duration;

/// The hosts that cannot be reached.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Loss {
    lost: BTreeSet<String>,
    /// The hosts that are missing or lost.
    missing: BTreeSet<String>,
    /// The times at which programs stop because a host is missing.
    stops: BTreeSet<(Time, u32, String)>,
}

impl Participant {
    /// Returns the hosts whose loss matters here: the home, the hosts of everything supervised from here, on any level,
    /// and the hosts that supervise something here. The loss of any other host is left to its supervisors.
    pub fn relevant_hosts(&self) -> &BTreeSet<String> {
        &self.site.relevant
    }

    /// Takes note of more relevant hosts, with another plan.
    pub(super) fn extend_relevant(&mut self) {
        self.site.relevant.extend(relevant(&self.site.plan, &self.site.host));
    }

    /// Takes note that its host takes part again, for the time `number`; GO was `since_go` ago.
    pub fn rejoins(&mut self, number: u32, now: Time, since_go: Duration) {
        self.together.rejoining = true;
        let since_go = u64::try_from(since_go.as_nanos()).unwrap_or(u64::MAX);
        self.together.go_at = Some(Time::from_nanos(now.nanos().saturating_sub(since_go)));
        self.executers.each(|_, executer| executer.rejoins(number));
    }

    /// Returns whether its host takes part again, and its programs are not all up.
    pub fn is_rejoining(&self) -> bool {
        self.together.rejoining
    }

    /// Takes note that a host is missing.
    pub fn host_missing(&mut self, host: &str, now: Time, out: &mut Out<'_>) {
        let is_noted = |leaf| self.loss.stops.iter().any(|(_, other, missing)| *other == leaf && missing == host);
        let stop = |(leaf, instance): (u32, &Instance)| match instance.link_loss() {
            LinkLoss::SafeStopAfter(time) if self.is_below(Target::Leaf(leaf), host) && !is_noted(leaf) => {
                Some((now + time, leaf, host.to_owned()))
            }
            LinkLoss::SafeStopAfter(_) | LinkLoss::Leave | LinkLoss::Keep | LinkLoss::Hold => None,
        };
        let stops: Vec<_> = self.instances.iter().filter_map(stop).collect();
        self.loss.stops.extend(stops);
        if self.loss.missing.insert(host.to_owned()) {
            let news = ActivityInput::Notice(Notice::LinkLost(host.to_owned()));
            for group in self.executers.numbers() {
                self.with_executer(group, out, |executer, at, out| executer.tell(&news, at, out));
            }
        }
    }

    /// Takes the loss of a host.
    pub fn host_lost(&mut self, host: &str, out: &mut Out<'_>) {
        // The host may be lost without having been missing: another boot has its name, or it no longer takes messages.
        self.host_missing(host, out.now, out);
        self.loss.lost.insert(host.to_owned());
        if host == self.site.home {
            if self.phase != Phase::Running || !self.goes_on() {
                return self.give_up(&unreached(host), out);
            }
            self.go_on_alone(out);
        } else {
            self.cut(self.supervised_from(host), host, out);
        }
        for group in self.executers.numbers() {
            self.with_executer(group, out, |executer, at, out| executer.host_lost(host, at, out));
        }
        if host == self.site.home {
            // No answer is to be expected any more.
            self.checked_in(out);
        }
    }

    /// Takes note that a host is there again.
    pub fn host_back(&mut self, host: &str, out: &mut Out<'_>) {
        self.loss.stops.retain(|(_, _, missing)| missing != host);
        self.loss.missing.remove(host);
        self.executers.each(|_, executer| executer.host_back(host));
        if self.loss.lost.remove(host) {
            if host == self.site.home {
                return self.leave(out);
            }
            for target in self.supervised_from(host) {
                self.stop_for(target, host, out);
            }
        }
        self.instances.each(|_, instance| instance.reach(host));
    }

    pub(super) fn tick_loss(&mut self, out: &mut Out<'_>) {
        while let Some((due, leaf, host)) = self.loss.stops.first().cloned().filter(|(due, ..)| *due <= out.now) {
            self.loss.stops.remove(&(due, leaf, host.clone()));
            self.with_instance(leaf, out, |instance, moment| instance.cut(&host, moment));
        }
        if self.is_done_alone() {
            self.leave(out);
        }
    }

    pub(super) fn loss_deadline(&self) -> Option<Time> {
        let stop = self.loss.stops.first().map(|(due, ..)| *due);
        earliest(stop, self.is_done_alone().then_some(Time::ZERO))
    }

    fn is_done_alone(&self) -> bool {
        self.phase == Phase::Running && self.is_home_lost() && !self.goes_on()
    }

    pub(super) fn is_home_lost(&self) -> bool {
        self.loss.lost.contains(&self.site.home)
    }

    /// Whether something here goes on without the home.
    fn goes_on(&self) -> bool {
        let keeps = |instance: &Instance| instance.is_active() && instance.link_loss() != LinkLoss::Leave;
        let mut groups = self.executers.iter().filter(|(_, executer)| executer.is_running()).map(|(group, _)| group);
        self.instances.iter().any(|(_, instance)| keeps(instance)) || groups.any(|group| self.endures(group))
    }

    fn go_on_alone(&mut self, out: &mut Out<'_>) {
        let home = self.site.home.clone();
        for group in self.executers.numbers().into_iter().filter(|group| !self.endures(*group)).collect::<Vec<_>>() {
            self.stop_for(Target::Group(group), &home, out);
        }
        for leaf in self.instances.numbers() {
            self.with_instance(leaf, out, |instance, moment| match instance.link_loss() {
                LinkLoss::Leave => instance.leave(moment),
                LinkLoss::Hold => instance.hold(&home),
                LinkLoss::Keep | LinkLoss::SafeStopAfter(_) => {}
            });
        }
    }

    /// Follows the policies of everything below these processes.
    fn cut(&mut self, mut targets: Vec<Target>, host: &str, out: &mut Out<'_>) {
        while let Some(target) = targets.pop() {
            match target {
                Target::Leaf(leaf) => {
                    self.with_instance(leaf, out, |instance, moment| match instance.link_loss() {
                        LinkLoss::Leave => instance.cut(host, moment),
                        LinkLoss::Hold => instance.hold(host),
                        LinkLoss::Keep | LinkLoss::SafeStopAfter(_) => {}
                    });
                }
                Target::Group(group) if self.endures(group) && self.executers.contains(group) => {
                    targets.extend(self.members(group));
                }
                Target::Group(_) => self.stop_for(target, host, out),
            }
        }
    }

    /// Stops the programs and groups here of a supervisor that cannot be reached, or has given them up.
    fn stop_for(&mut self, target: Target, host: &str, out: &mut Out<'_>) {
        match target {
            Target::Leaf(leaf) => self.with_instance(leaf, out, |instance, moment| instance.cut(host, moment)),
            Target::Group(group) => {
                self.with_executer(group, out, |executer, at, out| executer.stop(executer.activation(), at, out));
            }
        }
    }

    /// Returns the processes of this host whose supervisors are on another.
    fn supervised_from(&self, host: &str) -> Vec<Target> {
        let is_theirs = |(_, (group, _)): &(&Target, &(u32, u32))| group_host(&self.site.plan, *group) == Some(host);
        let is_here = |target: &Target| match target {
            Target::Leaf(leaf) => self.instances.contains(*leaf),
            Target::Group(group) => self.executers.contains(*group),
        };
        self.site.supervisors.iter().filter(is_theirs).map(|(target, _)| *target).filter(is_here).collect()
    }

    /// Whether some group above a process is supervised on `host`.
    fn is_below(&self, target: Target, host: &str) -> bool {
        let above = |target: &Target| self.site.supervisors.get(target).map(|(group, _)| Target::Group(*group));
        let is_there =
            |target: Target| matches!(target, Target::Group(group) if group_host(&self.site.plan, group) == Some(host));
        std::iter::successors(above(&target), above).any(is_there)
    }

    /// Whether some program below a group may continue when hosts are lost.
    fn endures(&self, group: u32) -> bool {
        let mut targets = vec![Target::Group(group)];
        while let Some(target) = targets.pop() {
            match target {
                Target::Group(group) => targets.extend(self.members(group)),
                Target::Leaf(leaf) => {
                    let leaf = self.site.plan.leaves.get(leaf as usize);
                    if leaf.is_some_and(|leaf| leaf.policy.link_loss != LinkLoss::Leave) {
                        return true;
                    }
                }
            }
        }
        false
    }

    /// Returns the members that a group supervises.
    fn members(&self, group: u32) -> impl Iterator<Item = Target> {
        let members = self.site.plan.groups.get(group as usize).map_or(&[][..], |group| &group.members);
        members.iter().map(|member| member.kind.into())
    }
}

/// Returns the hosts whose loss matters to something on `host`.
pub(super) fn relevant(plan: &Plan, host: &str) -> BTreeSet<String> {
    let supervisors = supervisors(plan);
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
    let here = |group: &&'a Group| plan.hosts.get(group.host as usize).is_some_and(|own| own == host);
    let here: Vec<&Group> = plan.groups.iter().filter(here).collect();
    let notices = here.into_iter().flat_map(|group| {
        if let Expression::Chart(chart) = &group.expression { chart.notices.as_slice() } else { &[] }
    });
    notices.filter_map(|notice| {
        if let Notice::HostLost(lost) | Notice::LinkLost(lost) = notice { Some(lost.as_str()) } else { None }
    })
}
