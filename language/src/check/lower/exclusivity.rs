//! Finds out from the event actions alone which processes may run at the same time. So it finds two writers of one input and two owners of
//! one device. It also finds senders and receivers that never run together.
//!
//! Two processes may run together when the operator that joins them is one of `, & # any`. The same holds for the members of groups:
//! members of one group may run together with members of the other.

use super::tree::Tree;
use super::wires::leaf_port;
use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{Claim, Connection, Expr, ExprKind, Module, Path, Process, Spec, Target, are_parallel};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{MemberKind, Retention, Transfer};
use crate::source::Span;
use std::collections::{BTreeMap, BTreeSet};

/// The largest number of users of one input or device that are compared with each other. If there are more, none of them are compared.
const USERS_MAX: usize = 200;

/// A place in the event actions of a group where an instance is run.
struct Place {
    slot: usize,
    sets: Vec<usize>,
    span: Span,
    /// The resources that the enclosing `using`s take. Two members that take the same resource wait for each other.
    taken: Vec<usize>,
    path: Path,
}

/// A state that holds while certain places of a group run: for example an instance runs, or a set is open.
#[derive(Clone)]
struct Activity<'a> {
    group: usize,
    places: Vec<&'a Place>,
    /// Whether the state holds as long as the group runs.
    is_always: bool,
}

/// A connection to an input.
#[derive(Clone, Copy)]
struct Writer<'a> {
    group: usize,
    set: usize,
    connection: &'a Connection,
}

/// A leaf that claims a device.
#[derive(Clone, Copy)]
struct Owner<'a> {
    group: usize,
    slot: usize,
    module: &'a Module,
    claim: &'a Claim,
}

/// The places of one process.
struct Places {
    all: Vec<Place>,
    of_slot: BTreeMap<usize, Vec<usize>>,
    of_set: BTreeMap<usize, Vec<usize>>,
}

impl Places {
    fn new(actions: Option<&Expr>) -> Self {
        let mut all = Vec::new();
        if let Some(actions) = actions {
            collect(actions, &mut Enclosing::default(), &mut all);
        }
        let (mut of_slot, mut of_set) = (BTreeMap::<_, Vec<_>>::new(), BTreeMap::<_, Vec<_>>::new());
        for (index, place) in all.iter().enumerate() {
            of_slot.entry(place.slot).or_default().push(index);
            place.sets.iter().for_each(|&set| of_set.entry(set).or_default().push(index));
        }
        Self { all, of_slot, of_set }
    }

    fn some(&self, indices: Option<&Vec<usize>>) -> Vec<&Place> {
        indices.into_iter().flatten().map(|&index| &self.all[index]).collect()
    }
}

/// The operators and `using`s around an expression.
#[derive(Default)]
struct Enclosing {
    path: Path,
    /// The resources that these `using`s take.
    taken: Vec<usize>,
}

struct Exclusivity<'a> {
    spec: &'a Spec,
    tree: &'a Tree,
    /// The places of each process, with an index by instance and by set.
    places: Vec<Places>,
    /// The enclosing group of each group, and the slot in it.
    around: Vec<Option<(usize, usize)>>,
}

/// Reports inputs with two writers at once, and devices with two owners at once.
pub(super) fn check(spec: &Spec, tree: &Tree, diagnostics: &mut Diagnostics) {
    let places = spec.processes.iter().map(|process| Places::new(process.actions.as_ref()));
    let mut around = vec![None; tree.groups.len()];
    for (index, group) in tree.groups.iter().enumerate() {
        for (slot, member) in group.members.iter().enumerate() {
            if let MemberKind::Group(inner) = member.kind {
                around[inner as usize] = Some((index, slot));
            }
        }
    }
    let exclusivity = Exclusivity { spec, tree, places: places.collect(), around };
    let writers = exclusivity.writers();
    exclusivity.check_writers(&writers, diagnostics);
    exclusivity.check_meetings(&writers, diagnostics);
    exclusivity.check_claims(diagnostics);
}

fn collect(expr: &Expr, around: &mut Enclosing, places: &mut Vec<Place>) {
    if let ExprKind::Run(slot, sets) = &expr.kind {
        let (taken, path) = (around.taken.clone(), around.path.clone());
        places.push(Place { slot: *slot, sets: sets.clone(), span: expr.span, taken, path });
    }
    let before = around.taken.len();
    if let ExprKind::Using(more, _) = &expr.kind {
        around.taken.extend(more);
    }
    for (index, part) in expr.parts().into_iter().enumerate() {
        let length = around.path.len();
        around.path.extend(expr.way_to(index));
        collect(part, around, places);
        around.path.truncate(length);
    }
    around.taken.truncate(before);
}

/// Returns the instances that the event actions of a group may run at the same time as another instance.
pub(crate) fn concurrent_with(actions: &Expr, slot: usize) -> BTreeSet<usize> {
    let places = Places::new(Some(actions));
    let own = places.some(places.of_slot.get(&slot));
    let others = places.all.iter().filter(|other| other.slot != slot);
    others.filter(|other| own.iter().any(|one| meet(one, other))).map(|other| other.slot).collect()
}

/// Returns whether two places may run at the same time. The innermost operator that joins them decides, unless both take the same resource.
fn meet(one: &Place, other: &Place) -> bool {
    let takes_the_same = || one.taken.iter().any(|it| other.taken.contains(it));
    are_parallel(&one.path, &other.path).is_none_or(|is_parallel| is_parallel && !takes_the_same())
}

impl<'a> Exclusivity<'a> {
    fn process(&self, group: usize) -> &'a Process {
        &self.spec.processes[self.tree.process_of[group]]
    }

    fn of_slot(&'a self, group: usize, slot: usize) -> Activity<'a> {
        let places = &self.places[self.tree.process_of[group]];
        Activity { group, places: places.some(places.of_slot.get(&slot)), is_always: false }
    }

    fn of_set(&'a self, group: usize, set: usize) -> Activity<'a> {
        let places = &self.places[self.tree.process_of[group]];
        let is_always = self.process(group).sets[set].owner.is_none();
        Activity { group, places: places.some(places.of_set.get(&set)), is_always }
    }

    /// Returns the groups around a group, the outermost first, and the group itself.
    fn chain(&self, group: usize) -> Vec<usize> {
        let outwards = std::iter::successors(Some(group), |&group| self.around[group].map(|(outer, _)| outer));
        let mut chain: Vec<usize> = outwards.collect();
        chain.reverse();
        chain
    }

    /// Returns the activity in the view of an enclosing group.
    fn lift(&'a self, mut activity: Activity<'a>, until: usize) -> Activity<'a> {
        while activity.group != until {
            let Some((outer, slot)) = self.around[activity.group] else { break };
            activity = self.of_slot(outer, slot);
        }
        activity
    }

    /// Returns the places where both run at the same time, if that is possible. The list is empty when one of them lasts as long as its
    /// group.
    fn meeting(&'a self, one: &Activity<'a>, other: &Activity<'a>) -> Option<Vec<Span>> {
        let (outer, inner) = (self.chain(one.group), self.chain(other.group));
        let common = std::iter::zip(&outer, &inner).take_while(|(a, b)| a == b).last().map(|(&group, _)| group)?;
        let (one, other) = (self.lift(one.clone(), common), self.lift(other.clone(), common));
        if one.is_always && (other.is_always || !other.places.is_empty()) || other.is_always && !one.places.is_empty() {
            return Some(Vec::new());
        }
        let pairs = one.places.iter().flat_map(|a| other.places.iter().map(move |b| (a, b)));
        let (a, b) = pairs.into_iter().find(|(a, b)| meet(a, b))?;
        Some(if a.span == b.span { vec![a.span] } else { vec![a.span, b.span] })
    }

    /// Returns all connections to each input. Calls are left out, because any number of processes may call the same port.
    fn writers(&'a self) -> BTreeMap<(u32, String), Vec<Writer<'a>>> {
        let mut writers: BTreeMap<(u32, String), Vec<Writer<'_>>> = BTreeMap::new();
        for group in 0..self.tree.groups.len() {
            for (set, source) in self.process(group).sets.iter().enumerate() {
                for connection in source.connections.iter().filter(|one| one.transfer != Transfer::Call) {
                    if let Some(to) = leaf_port(self.tree, self.spec, group, &connection.to) {
                        writers.entry((to.leaf, to.port)).or_default().push(Writer { group, set, connection });
                    }
                }
            }
        }
        writers
    }

    fn check_writers(&'a self, writers: &BTreeMap<(u32, String), Vec<Writer<'a>>>, diagnostics: &mut Diagnostics) {
        let mut reported = BTreeSet::new();
        for ((leaf, port), writers) in writers.iter().filter(|(_, writers)| writers.len() <= USERS_MAX) {
            for (index, &one) in writers.iter().enumerate() {
                for &other in &writers[index + 1..] {
                    let Some(places) = self.write_together(one, other) else { continue };
                    if reported.insert(other.connection.span) {
                        let path = &self.tree.leaves[*leaf as usize].path;
                        let message = format!("two processes write to `{path}`, `{port}` at the same time");
                        let diagnostic = Diagnostic::new(Code::W0306, other.connection.span, message);
                        let diagnostic = diagnostic.reason(one.connection.span, "the other connection");
                        let help = "open the connections in turn, or merge the values in a process of its own";
                        diagnostics.push(at(diagnostic, &places).help(help));
                    }
                }
            }
        }
    }

    /// Returns the places where two connections are open at the same time, unless both have the same source.
    fn write_together(&'a self, one: Writer<'_>, other: Writer<'_>) -> Option<Vec<Span>> {
        let source = |writer: Writer<'_>| leaf_port(self.tree, self.spec, writer.group, &writer.connection.from);
        if source(one) == source(other) {
            return None;
        }
        self.meeting(&self.of_set(one.group, one.set), &self.of_set(other.group, other.set))
    }

    /// Reports inputs whose senders never run together with the receiver, so that no value ever arrives.
    fn check_meetings(&'a self, writers: &BTreeMap<(u32, String), Vec<Writer<'a>>>, diagnostics: &mut Diagnostics) {
        let mut reported = BTreeSet::new();
        for ((leaf, port), writers) in writers.iter().filter(|(_, writers)| writers.len() <= USERS_MAX) {
            let (group, slot) = self.tree.place_of[*leaf as usize];
            let receiver = self.of_slot(group, slot);
            if !writers.iter().all(|&writer| self.never_meets(writer, &receiver)) {
                continue;
            }
            for writer in writers.iter().filter(|writer| reported.insert(writer.connection.span)) {
                let path = &self.tree.leaves[*leaf as usize].path;
                let message = format!(
                    "values sent here never reach `{path}`, `{port}`: the sender and the receiver never run at the same time"
                );
                let diagnostic = Diagnostic::new(Code::W0311, writer.connection.span, message);
                let help = "run both in parallel, hand the value on with `:`, or keep the last value with `latch`";
                diagnostics.push(diagnostic.help(help));
            }
        }
    }

    /// Returns whether the receiver of a connection never runs at the same time as its sender or its set. The result is `false`
    /// if the value waits or is fetched. It is also `false` if one of them never runs at all, which is reported elsewhere.
    fn never_meets(&'a self, writer: Writer<'_>, receiver: &Activity<'a>) -> bool {
        let connection = writer.connection;
        if connection.transfer == Transfer::Pull || connection.quality.retention == Retention::Latch {
            return false;
        }
        let Some(from) = leaf_port(self.tree, self.spec, writer.group, &connection.from) else { return false };
        let (group, slot) = self.tree.place_of[from.leaf as usize];
        let (sender, set) = (self.of_slot(group, slot), self.of_set(writer.group, writer.set));
        let ever_runs = |activity: &Activity<'a>| activity.is_always || self.ever_runs(activity);
        let never = |one: &Activity<'a>, other: &Activity<'a>| {
            ever_runs(one) && ever_runs(other) && self.meeting(one, other).is_none()
        };
        never(&sender, receiver) || never(&set, receiver)
    }

    /// Returns whether an event action runs this activity and all groups around it.
    fn ever_runs(&'a self, activity: &Activity<'a>) -> bool {
        let outwards = std::iter::successors(Some(activity.clone()), |activity| {
            self.around[activity.group].map(|(outer, slot)| self.of_slot(outer, slot))
        });
        outwards.into_iter().all(|activity| activity.is_always || !activity.places.is_empty())
    }

    fn check_claims(&'a self, diagnostics: &mut Diagnostics) {
        let mut owners: BTreeMap<(u32, &str), Vec<Owner<'_>>> = BTreeMap::new();
        for (leaf, &(group, slot)) in self.tree.leaves.iter().zip(&self.tree.place_of) {
            let instance = &self.process(group).instances[slot];
            let Target::Module(module) = instance.target else { continue };
            if instance.policies.runs_in.is_some() {
                continue;
            }
            let module = &self.spec.modules[module];
            for claim in &module.claims {
                let owner = Owner { group, slot, module, claim };
                owners.entry((leaf.host, &claim.name.text)).or_default().push(owner);
            }
        }
        let mut reported = BTreeSet::new();
        for ((host, device), owners) in owners.iter().filter(|(_, owners)| owners.len() <= USERS_MAX) {
            for (index, &one) in owners.iter().enumerate() {
                for &other in &owners[index + 1..] {
                    let Some(places) = self.own_together(one, other) else { continue };
                    let (first, second) = (self.name(one), self.name(other));
                    if reported.insert((first, second)) {
                        let host = &self.tree.hosts[*host as usize];
                        let message =
                            format!("`{device}` on `{host}` can be claimed by two processes at the same time");
                        let diagnostic = Diagnostic::new(Code::E0501, second, message).label(access(other));
                        let diagnostic = at(diagnostic.reason(first, access(one)), &places);
                        diagnostics.push(diagnostic.help("run the processes in turn, or claim the device `(read)`"));
                    }
                }
            }
        }
    }

    /// Returns the places where two owners run at the same time, unless both only read.
    fn own_together(&'a self, one: Owner<'_>, other: Owner<'_>) -> Option<Vec<Span>> {
        if !one.claim.is_write && !other.claim.is_write {
            return None;
        }
        self.meeting(&self.of_slot(one.group, one.slot), &self.of_slot(other.group, other.slot))
    }

    fn name(&self, owner: Owner<'_>) -> Span {
        self.process(owner.group).instances[owner.slot].name.span
    }
}

fn access(owner: Owner<'_>) -> String {
    format!("{} {} it", owner.module.name.text, if owner.claim.is_write { "writes" } else { "reads" })
}

fn at(diagnostic: Diagnostic, places: &[Span]) -> Diagnostic {
    let texts: &[&str] = if places.len() > 1 { &["runs here", "and here at the same time"] } else { &["runs here"] };
    std::iter::zip(places, texts).fold(diagnostic, |diagnostic, (&place, &text)| diagnostic.reason(place, text))
}
