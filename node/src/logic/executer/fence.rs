//! Fences: resources of `using` that may still be in use although the algebra has released them.
//!
//! For its supervisor, a member on a lost host has failed, and the group proceeds. But it is unknown whether the member
//! has stopped: it may run for as long as its spec allows. The same is true for a program that could not be ended: its
//! stop is unconfirmed. So its resources stay reserved until the host has reported how the activation ended, the
//! program has ended after all, or its home has received the confirmation that nothing of the deployment is left there. Fences fail closed:
//! a host that never returns releases nothing, and neither does a program that never ends.
//!
//! Whether a member on another host has ended is known to its own supervisor alone. So if resources
//! are taken for a group on any level above, the group tells the group above which hosts may still
//! work for it (`ToParticipant::Loose`). It does this before it reports its own end.
//!
//! The same member may be activated again: one process never runs twice on its host. Inside a group for which something is
//! taken above, nothing else begins beside a program that could not be ended.

use language::plan::{Expression, Group, MemberKind, Plan};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Stands for resources that a group further up has taken for the whole group. No resource has this name.
const ABOVE: &str = "";

/// The resources that are taken for each member, by slot.
type Taken = BTreeMap<u32, BTreeSet<String>>;

/// Something that a member has to wait for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Against<'a> {
    /// The resource; empty if it is taken for the whole group, somewhere above.
    pub(super) resource: &'a str,
    /// The host that may still use it.
    pub(super) host: &'a str,
    /// The member for which the host does this.
    pub(super) user: u32,
    /// Whether the host is lost. Otherwise a program could not be ended there.
    pub(super) is_lost: bool,
}

/// The fences of one group.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(super) struct Fences {
    taken: Taken,
    /// Hosts that are lost now.
    lost: BTreeSet<String>,
    /// Members that were activated last while their host was lost: they have not begun.
    unbegun: BTreeSet<u32>,
    /// Activations that may continue: slot, number, host.
    up: BTreeSet<(u32, u32, String)>,
    /// Activations whose program could not be ended: slot, number, host.
    stuck: BTreeSet<(u32, u32, String)>,
    /// Hosts that may still do something for a member that is a group and has ended.
    loose: BTreeMap<u32, BTreeSet<String>>,
    /// Waiting activations that users have been told about.
    told: BTreeSet<(u32, u32)>,
    /// Whether something is taken for the group, somewhere above.
    is_below: bool,
    /// Hosts that may still do something for the group after its node has left it.
    left: BTreeSet<String>,
    /// The hosts in the last report to the supervisor of the group.
    said: BTreeSet<String>,
}

impl Fences {
    /// Returns the fences of a group; something is taken for it above if it `is_below` a `using`.
    pub(super) fn new(group: &Group, is_below: bool) -> Self {
        let mut taken = taken(group);
        if is_below {
            for (slot, _) in (0..).zip(&group.members) {
                taken.entry(slot).or_default().insert(ABOVE.to_owned());
            }
        }
        Self { taken, is_below, ..Self::default() }
    }

    /// Takes on other event actions of the group.
    pub(super) fn retake(&mut self, group: &Group) {
        self.taken = Self::new(group, self.is_below).taken;
    }

    /// Takes the loss of a host; `active` is which members run there or are supervised from there, with their numbers and all
    /// hosts of theirs.
    pub(super) fn lose(&mut self, host: &str, active: impl Iterator<Item = (u32, u32, BTreeSet<String>)>) {
        for (slot, number, hosts) in active {
            if self.taken.contains_key(&slot) && !self.unbegun.contains(&slot) {
                self.up.extend(hosts.into_iter().map(|host| (slot, number, host)));
            }
        }
        self.lost.insert(host.to_owned());
    }

    /// Notes that a host is back. Its programs may still run.
    pub(super) fn reach(&mut self, host: &str) {
        self.lost.remove(host);
    }

    /// Takes note that a member of a host is activated.
    pub(super) fn began(&mut self, slot: u32, host: &str) {
        if self.lost.contains(host) {
            self.unbegun.insert(slot);
        } else {
            self.unbegun.remove(&slot);
        }
    }

    /// Takes note that an activation has ended, for sure.
    pub(super) fn ended(&mut self, slot: u32, number: u32) {
        self.up.retain(|(other, theirs, _)| (*other, *theirs) != (slot, number));
        self.stuck.retain(|(other, theirs, _)| (*other, *theirs) != (slot, number));
    }

    /// Notes that the end of an activation on a host could not be confirmed. An activation that is
    /// not current is included if it might still have been running.
    pub(super) fn unconfirmed(&mut self, slot: u32, number: u32, host: &str, is_current: bool) {
        let before = self.up.len();
        self.up.retain(|(other, theirs, _)| (*other, *theirs) != (slot, number));
        if self.taken.contains_key(&slot) && (is_current || self.up.len() < before) {
            self.stuck.insert((slot, number, host.to_owned()));
        }
    }

    /// Takes note of the hosts that may still do something for a member that has ended.
    pub(super) fn loosen(&mut self, slot: u32, hosts: BTreeSet<String>) {
        if hosts.is_empty() {
            self.loose.remove(&slot);
        } else {
            self.loose.insert(slot, hosts);
        }
    }

    /// Takes note that nothing of the deployment is left on a host.
    pub(super) fn clear(&mut self, host: &str) {
        self.up.retain(|(_, _, other)| other != host);
        self.stuck.retain(|(_, _, other)| other != host);
        for hosts in self.loose.values_mut() {
            hosts.remove(host);
        }
        self.left.remove(host);
    }

    /// Takes note that the node of the group leaves it, while these hosts do something for it.
    pub(super) fn abandon(&mut self, hosts: BTreeSet<String>) {
        self.left.extend(hosts);
    }

    /// Returns the hosts that may still do something for the group, if its supervisor has to be told again.
    pub(super) fn news(&mut self) -> Option<BTreeSet<String>> {
        let is_above = |slot: u32| self.taken.get(&slot).is_some_and(|taken| taken.contains(ABOVE));
        let mut now: BTreeSet<String> =
            self.all().filter(|(slot, _)| is_above(*slot)).map(|(_, host)| host.to_owned()).collect();
        now.extend(self.left.iter().filter(|_| self.is_below).cloned());
        (now != self.said).then(|| {
            self.said.clone_from(&now);
            now
        })
    }

    /// Returns the fence that a member has to wait for, if there is one.
    pub(super) fn against(&self, slot: u32) -> Option<Against<'_>> {
        let wanted = self.taken.get(&slot)?;
        let shared = |other: u32, counts: &dyn Fn(&str) -> bool| {
            self.taken.get(&other)?.intersection(wanted).map(String::as_str).find(|name| counts(name))
        };
        let stuck = self.stuck.iter().filter(|(other, ..)| *other != slot).find_map(|(other, _, host)| {
            let resource = shared(*other, &|_| true)?;
            Some(Against { resource, host, user: *other, is_lost: false })
        });
        stuck.or_else(|| {
            self.all().filter(|(other, _)| *other != slot).find_map(|(user, host)| {
                let resource = shared(user, &|name| name != ABOVE)?;
                Some(Against { resource, host, user, is_lost: self.lost.contains(host) })
            })
        })
    }

    /// Returns whether the fence of a member is still to be reported for this activation: it is reported once.
    pub(super) fn is_news(&mut self, slot: u32, number: u32) -> bool {
        self.against(slot).is_some() && self.told.insert((slot, number))
    }

    /// Returns every host that may still do something, with the member for which it does.
    fn all(&self) -> impl Iterator<Item = (u32, &str)> {
        let loose = self.loose.iter().flat_map(|(slot, hosts)| hosts.iter().map(|host| (*slot, host.as_str())));
        self.up.iter().chain(&self.stuck).map(|(slot, _, host)| (*slot, host.as_str())).chain(loose)
    }
}

/// Returns the groups for which something is taken somewhere above.
pub(super) fn below(plan: &Plan) -> BTreeSet<u32> {
    let mut found = BTreeSet::new();
    let mut groups: Vec<u32> = (0..).zip(&plan.groups).map(|(number, _)| number).collect();
    groups.retain(|number| !taken(&plan.groups[*number as usize]).is_empty());
    let member =
        |number: u32, slot: u32| plan.groups.get(number as usize)?.members.get(slot as usize).map(|it| it.kind);
    let handed =
        |number: u32| taken(&plan.groups[number as usize]).into_keys().filter_map(move |slot| member(number, slot));
    let mut kinds: Vec<MemberKind> = groups.into_iter().flat_map(handed).collect();
    while let Some(kind) = kinds.pop() {
        if let MemberKind::Group(number) = kind
            && found.insert(number)
        {
            let members = plan.groups.get(number as usize).map_or(&[][..], |group| &group.members);
            kinds.extend(members.iter().map(|member| member.kind));
        }
    }
    found
}

/// Returns the hosts of a process and of all that is below it.
pub(super) fn hosts(plan: &Plan, process: MemberKind) -> BTreeSet<String> {
    let name = |host: u32| plan.hosts.get(host as usize).cloned();
    let (mut found, mut kinds, mut seen) = (BTreeSet::new(), vec![process], BTreeSet::new());
    while let Some(kind) = kinds.pop() {
        match kind {
            MemberKind::Leaf(leaf) => found.extend(plan.leaves.get(leaf as usize).and_then(|leaf| name(leaf.host))),
            // A plan from elsewhere may be wrong: a circle of groups would never end.
            MemberKind::Group(number) if seen.insert(number) => {
                let Some(group) = plan.groups.get(number as usize) else { continue };
                found.extend(name(group.host));
                kinds.extend(group.members.iter().map(|member| member.kind));
            }
            MemberKind::Group(_) => {}
        }
    }
    found
}

fn taken(group: &Group) -> Taken {
    let mut taken = Taken::new();
    collect(&group.expression, &mut BTreeSet::new(), &mut taken);
    taken
}

/// Finds the resources taken around each run of a member.
fn collect(expression: &Expression, around: &mut BTreeSet<String>, taken: &mut Taken) {
    if let Expression::Run { member, .. } = expression
        && !around.is_empty()
    {
        taken.entry(*member).or_default().extend(around.iter().cloned());
    }
    let taken_here = if let Expression::Using { resources, .. } = expression { &resources[..] } else { &[] };
    let added: Vec<&String> = taken_here.iter().filter(|name| around.insert((*name).clone())).collect();
    expression.operands().into_iter().for_each(|operand| collect(operand, around, taken));
    for name in added {
        around.remove(name);
    }
}
