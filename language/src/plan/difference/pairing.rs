//! Which process of the plan that is wanted is which of the plan that runs, by their names.

use super::{BTreeMap, BTreeSet, Group, Leaf, Member, MemberKind, Numbers, Plan, PlanChange, TAKEN_AWAY, host, leaf};

/// The pairs of processes of two plans.
pub(super) struct Pairing<'a> {
    pub(super) running: &'a Plan,
    pub(super) wanted: &'a Plan,
    /// The running leaves whose programs are restarted.
    pub(super) again: &'a BTreeSet<u32>,
    /// The running plan, with the new processes, and without those that are no longer wanted.
    pub(super) plan: Plan,
    pub(super) numbers: Numbers,
    pub(super) changes: Vec<PlanChange>,
    pub(super) obstacles: Vec<String>,
    /// The leaves that were taken away before, by their paths.
    pub(super) gone: BTreeMap<&'a str, Vec<u32>>,
}

impl<'a> Pairing<'a> {
    pub(super) fn new(running: &'a Plan, wanted: &'a Plan, again: &'a BTreeSet<u32>) -> Self {
        let numbers = Numbers {
            groups: BTreeMap::new(),
            leaves: BTreeMap::new(),
            added: BTreeSet::new(),
            overlapping: BTreeMap::new(),
            slots: BTreeMap::new(),
        };
        let (changes, obstacles) = (Vec::new(), Vec::new());
        let (live, mut gone) = (running.live_leaves(), BTreeMap::<&str, Vec<u32>>::new());
        for (number, leaf) in (0_u32..).zip(&running.leaves).filter(|(number, _)| !live.contains(number)) {
            gone.entry(&leaf.path).or_default().push(number);
        }
        Self { running, wanted, again, plan: running.clone(), numbers, changes, obstacles, gone }
    }

    /// Pairs the members of two groups, recursively. Plans are validated, so this goes at most `DEPTH_MAX` deep.
    pub(super) fn pair_group(&mut self, wanted: u32, number: u32) {
        self.numbers.groups.insert(wanted, number);
        let Some(after) = self.wanted.groups.get(wanted as usize) else { return };
        let mut slots = Vec::new();
        for member in &after.members {
            // A member that was taken away from the wanted plan was also taken away from the running plan.
            if member.name.is_empty() {
                slots.push(TAKEN_AWAY);
                continue;
            }
            let slot = match self.slot_of(number, &member.name) {
                Some((slot, kind)) => self.pair(member, number, slot, kind),
                None => self.add(member, number),
            };
            slots.push(slot);
        }
        self.numbers.slots.insert(number, slots);
        let is_wanted = |name: &String| after.members.iter().any(|member| member.name == *name);
        let before = self.plan.groups.get(number as usize).map_or(&[][..], |group| &group.members);
        let gone = (0_u32..).zip(before).filter(|(_, member)| !member.name.is_empty() && !is_wanted(&member.name));
        for slot in gone.map(|(slot, _)| slot).collect::<Vec<_>>() {
            self.remove(number, slot);
        }
    }

    fn slot_of(&self, group: u32, name: &str) -> Option<(u32, MemberKind)> {
        let members = (0_u32..).zip(&self.plan.groups.get(group as usize)?.members);
        members.filter(|(_, member)| member.name == name).map(|(slot, member)| (slot, member.kind)).next()
    }

    fn pair(&mut self, member: &Member, group: u32, slot: u32, kind: MemberKind) -> u32 {
        match (member.kind, kind) {
            (MemberKind::Leaf(wanted), MemberKind::Leaf(number)) => {
                let number = self.succeed(wanted, number, group, slot).unwrap_or(number);
                self.numbers.leaves.insert(wanted, number);
            }
            (MemberKind::Group(wanted), MemberKind::Group(number)) => self.pair_group(wanted, number),
            (MemberKind::Leaf(_), MemberKind::Group(_)) | (MemberKind::Group(_), MemberKind::Leaf(_)) => {
                let what = if matches!(member.kind, MemberKind::Leaf(_)) { "a program" } else { "a group" };
                let path = self.path(group, &member.name);
                self.obstacles.push(format!("`{path}` is {what} now; remove it first, then add it"));
            }
        }
        if let Some(own) = self.member(group, slot) {
            own.service = member.service;
        }
        slot
    }

    /// Adds a process to a group. Returns its slot.
    fn add(&mut self, member: &Member, group: u32) -> u32 {
        let path = self.path(group, &member.name);
        let kind = match member.kind {
            MemberKind::Leaf(wanted) => self.add_leaf(wanted, &path).map(MemberKind::Leaf),
            MemberKind::Group(wanted) => self.add_group(wanted, &path).map(MemberKind::Group),
        };
        let Some(kind) = kind else { return u32::MAX };
        let Some(own) = self.plan.groups.get_mut(group as usize) else { return u32::MAX };
        // A process that returns has the slot that it had.
        let slot = own.members.iter().position(|member| member.name.is_empty() && member.kind == kind);
        let slot = slot.unwrap_or(own.members.len());
        let next = Member { name: member.name.clone(), kind, service: member.service };
        match own.members.get_mut(slot) {
            Some(member) => *member = next,
            None => own.members.push(next),
        }
        u32::try_from(slot).unwrap_or(u32::MAX)
    }

    fn add_leaf(&mut self, wanted: u32, path: &str) -> Option<u32> {
        let after = self.wanted.leaves.get(wanted as usize)?;
        let host = self.host(after.host, path)?;
        let next = Leaf { host, path: path.to_owned(), ..after.clone() };
        let what = format!("{} on `{}`", next.module, super::host(&self.plan, host));
        let number = self.number(next)?;
        self.numbers.leaves.insert(wanted, number);
        self.numbers.added.insert(number);
        self.changes.push(PlanChange::Add { leaf: number, path: path.to_owned(), what });
        Some(number)
    }

    /// Returns the number of a leaf that no member has. If the leaf has not changed, this is its earlier number.
    pub(super) fn number(&mut self, next: Leaf) -> Option<u32> {
        let is_it = |number: &u32| {
            let leaf = self.plan.leaves.get(*number as usize);
            leaf.is_some_and(|leaf| leaf.host == next.host && leaf::change_of_leaf(0, leaf, &next, false).is_none())
        };
        let known = self.gone.get(next.path.as_str()).and_then(|gone| gone.iter().copied().find(is_it));
        let number = known.unwrap_or(u32::try_from(self.plan.leaves.len()).ok()?);
        if known.is_none() {
            self.plan.leaves.push(next);
        }
        Some(number)
    }

    fn add_group(&mut self, wanted: u32, path: &str) -> Option<u32> {
        let after = self.wanted.groups.get(wanted as usize)?;
        let host = self.host(after.host, path)?;
        let number = u32::try_from(self.plan.groups.len()).ok()?;
        self.plan.groups.push(Group {
            path: path.to_owned(),
            host,
            members: Vec::new(),
            sets: Vec::new(),
            sets_always: Vec::new(),
            expression: super::Expression::Skip,
            ..after.clone()
        });
        self.pair_group(wanted, number);
        Some(number)
    }

    /// Returns the number of a host that takes part already.
    fn host(&mut self, wanted: u32, path: &str) -> Option<u32> {
        let name = host(self.wanted, wanted);
        let known = (0_u32..).zip(&self.running.hosts).find(|(_, host)| *host == name).map(|(number, _)| number);
        if known.is_none() {
            let part = format!("`{path}` is on the host `{name}`, which has no part in the running deployment");
            self.obstacles.push(format!("{part}; choose one of `{}`", self.running.hosts.join("`, `")));
        }
        known
    }

    /// Takes a process away, with all that is below it.
    fn remove(&mut self, group: u32, slot: u32) {
        let Some(member) = self.member(group, slot) else { return };
        member.name.clear();
        let kind = member.kind;
        match kind {
            MemberKind::Leaf(leaf) => {
                let path = self.plan.leaves.get(leaf as usize).map(|leaf| leaf.path.clone()).unwrap_or_default();
                self.changes.push(PlanChange::Remove { leaf, path });
            }
            MemberKind::Group(inner) => {
                let count = self.plan.groups.get(inner as usize).map_or(0, |group| group.members.len());
                let named = |slot: &u32| self.plan.groups[inner as usize].members[*slot as usize].name.is_empty();
                let slots = 0..u32::try_from(count).unwrap_or(u32::MAX);
                for slot in slots.filter(|slot| !named(slot)).collect::<Vec<_>>() {
                    self.remove(inner, slot);
                }
            }
        }
    }

    pub(super) fn member(&mut self, group: u32, slot: u32) -> Option<&mut Member> {
        self.plan.groups.get_mut(group as usize)?.members.get_mut(slot as usize)
    }

    fn path(&self, group: u32, name: &str) -> String {
        let above = self.plan.groups.get(group as usize).map_or("", |group| group.path.as_str());
        format!("{above}/{name}")
    }
}
