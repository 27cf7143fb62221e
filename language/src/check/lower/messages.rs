//! Adds the ports of activities. Each activity with connections gets one program, whose ports are the ports of the activity.
//!
//! This program is a member of the activity that no state runs. It is linked and idle for as long as the deployment exists.

use super::tree::Tree;
use super::wires::{End, end};
use crate::check::spec::{Direction, Spec};
use crate::plan::{
    Argument, Constant, Environment, Leaf, LeafKind, LinkLoss, Member, MemberKind, PORTS, Plan, Policy, Restart,
};
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The argument that lists the ports.
const LIST: &str = "ports";
/// The name of the program within the activity.
const NAME: &str = "ports";
/// How long the program may take to stop.
const STOP_WITHIN: Duration = Duration::from_secs(2);

/// The activities of a plan with connected ports.
pub(super) struct Messages {
    /// The leaf with the ports of each of these activities.
    leaves: BTreeMap<usize, u32>,
}

impl Messages {
    /// Finds the activities that are the start or the end of a connection.
    pub(super) fn new(tree: &Tree, spec: &Spec) -> Self {
        let mut found = BTreeSet::new();
        for group in 0..tree.groups.len() {
            let sets = &spec.processes[tree.process_of[group]].sets;
            for connection in sets.iter().flat_map(|set| &set.connections) {
                for endpoint in [&connection.from, &connection.to] {
                    if let Some(End::Activity { group, .. }) = end(tree, spec, group, endpoint) {
                        found.insert(group);
                    }
                }
            }
        }
        let first = number(tree.leaves.len());
        Self { leaves: found.into_iter().zip(first..).collect() }
    }

    /// Returns the leaf with the ports of a group.
    pub(super) fn leaf(&self, group: usize) -> Option<u32> {
        self.leaves.get(&group).copied()
    }

    /// Returns the number of these leaves.
    pub(super) fn count(&self) -> u32 {
        number(self.leaves.len())
    }

    /// Adds the leaves to a plan, after all leaves of the text.
    pub(super) fn add(&self, plan: &mut Plan, spec: &Spec, process_of: &[usize]) {
        for (&group, &leaf) in &self.leaves {
            let own = &mut plan.groups[group];
            let mut name = NAME.to_owned();
            while own.members.iter().any(|member| member.name == name) {
                name.push('_');
            }
            let path = format!("{}/{name}", own.path);
            own.members.push(Member { name, kind: MemberKind::Leaf(leaf), service: true });
            // An activity whose programs continue without the home of the deployment keeps its ports as well.
            let inside = format!("{}/", own.path);
            let keeps = |leaf: &&Leaf| leaf.path.starts_with(&inside) && leaf.policy.link_loss == LinkLoss::Keep;
            let link_loss = if plan.leaves.iter().any(|leaf| keeps(&leaf)) { LinkLoss::Keep } else { LinkLoss::Leave };
            let list = list(spec, process_of[group]);
            let added = ports(path, list, own.host, link_loss);
            plan.leaves.push(added);
        }
    }
}

/// Returns the ports of an activity in the form that its program reads: `in speech 8 Text;out say Text`.
fn list(spec: &Spec, process: usize) -> String {
    let Some(model) = spec.processes[process].chart() else { return String::new() };
    let mut limits = model.chart.chart.ports.iter();
    let ports = model.ports.iter().map(|port| {
        let kind = port.kind.as_ref().map_or("?", |kind| kind.text.as_str());
        match port.direction {
            Direction::In => format!("in {} {} {kind}", port.name.text, limits.next().copied().unwrap_or(1)),
            Direction::Out => format!("out {} {kind}", port.name.text),
        }
    });
    ports.collect::<Vec<_>>().join(";")
}

fn ports(path: String, list: String, host: u32, link_loss: LinkLoss) -> Leaf {
    Leaf {
        path,
        module: PORTS.to_owned(),
        host,
        arguments: vec![Argument { name: Some(LIST.to_owned()), value: Constant::Text(list) }],
        exec: None,
        parameters: Some(Vec::new()),
        environment: Environment::default(),
        kind: LeafKind::Controller,
        stop_within: STOP_WITHIN,
        outcomes: Vec::new(),
        policy: Policy { restart: Restart::Transient, link_loss, ..Policy::default() },
        keys: Vec::new(),
        external: None,
    }
}

fn number(index: usize) -> u32 {
    u32::try_from(index).expect("a plan has fewer than 2^32 leaves")
}
