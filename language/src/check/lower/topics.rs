//! Adds the bridges to ROS 2: one program for each host that has ports which are connected with topics or services.
//!
//! A bridge is a process of `main` that runs beside its event actions. Its ports are the topics and services, and wires that are
//! always open connect them.

use super::tree::Tree;
use super::wires::{Wires, leaf_port};
use crate::check::ports;
use crate::check::ros_name;
use crate::check::spec::{Spec, Target, TopicConnection};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{
    Argument, BRIDGE, ConnectionSet, Constant, Environment, Expression, Leaf, LeafKind, LeafPort, LinkLoss, Member,
    MemberKind, Plan, Policy, Quality, ROS_VARIABLES, ROUTES, Replacement, Restart, Retention, Transfer, Wire,
};
use crate::source::Span;
use ros::logic::frame::FramePrefix;
use ros::logic::key::GraphName;
use ros::logic::name::TypeName;
use ros::logic::qos::{Durability, Qos};
use ros::logic::route::{ROUTES_MAX, Route, Way};
use std::time::Duration;

/// The name of the bridge if a plan has only one bridge. If there are several bridges, the name is followed by the host.
const NAME: &str = "ros";
/// How long a bridge may take to stop.
const STOP_WITHIN: Duration = Duration::from_secs(2);

/// The bridges of a plan, before they have leaves.
pub(super) struct Topics {
    /// How many leaves there are without bridges.
    leaves: u32,
    /// By host, in the order of the first use.
    bridges: Vec<Bridge>,
    /// The wires of all bridges.
    wires: Vec<u32>,
    problems: Vec<Diagnostic>,
}

struct Bridge {
    host: u32,
    routes: Vec<(Route, Span)>,
    link_loss: LinkLoss,
}

impl Topics {
    /// Bridges stand behind the leaves of the tree and `more` leaves.
    pub(super) fn new(tree: &Tree, more: u32) -> Self {
        Self { leaves: number(tree.leaves.len()) + more, bridges: Vec::new(), wires: Vec::new(), problems: Vec::new() }
    }

    /// Makes a wire of each connection of a group with a topic.
    pub(super) fn connect(&mut self, tree: &Tree, spec: &Spec, group: usize, wires: &mut Wires) {
        for connection in &spec.processes[tree.process_of[group]].outside.topics {
            let Some(end) = leaf_port(tree, spec, group, &connection.endpoint) else { continue };
            let Some(of) = type_of(tree, spec, &end) else { continue };
            let leaf = &tree.leaves[end.leaf as usize];
            let policy = &leaf.policy;
            if policy.replacement == Replacement::Overlap {
                let message = format!("`{}` is connected with ROS 2, so two of its programs cannot overlap", leaf.path);
                self.problems.push(Diagnostic::new(Code::E0309, connection.span, message));
            }
            let Some((name, frames)) = self.names(connection, tree.texts(spec, group)) else { continue };
            let TopicConnection { qos, way, span, .. } = *connection;
            let route = Route { name, of, way, qos, frames };
            let port = route.port();
            let Some(bridge) = self.place(leaf.host, route, span) else { continue };
            let own = &mut self.bridges[bridge];
            // A bridge continues after the loss of other hosts while at least one of its partners continues.
            if own.link_loss == LinkLoss::Leave {
                own.link_loss = policy.link_loss;
            }
            let other = LeafPort { leaf: self.leaves + number(bridge), port };
            let (from, to) = if way.is_outward() { (end, other) } else { (other, end) };
            let (transfer, quality) =
                if way.is_service() { (Transfer::Call, Quality::default()) } else { (Transfer::Push, quality(qos)) };
            let wire = wires.add(Wire { from, to, transfer, quality });
            if !self.wires.contains(&wire) {
                self.wires.push(wire);
            }
        }
    }

    /// Returns the name and the prefix of frames of a connection in a group with these values. Reports names that ROS 2 refuses.
    fn names(
        &mut self,
        connection: &TopicConnection,
        value: impl Fn(&str) -> Option<String>,
    ) -> Option<(GraphName, Option<FramePrefix>)> {
        let of = if connection.way.is_service() { "the name of a service" } else { "the name of a topic" };
        let name = connection.name.resolved(&value, ros_name::is_topic, of);
        let is_prefix = |text: &str| FramePrefix::parse(text).is_some();
        let frames = connection.frames.as_ref().map(|frames| frames.resolved(&value, is_prefix, "a prefix of frames"));
        match (name, frames.transpose()) {
            (Ok(name), Ok(frames)) => {
                Some((GraphName::parse(&name)?, frames.and_then(|frames| FramePrefix::parse(&frames))))
            }
            (name, frames) => {
                self.problems.extend([name.err(), frames.err()].into_iter().flatten().map(|why| *why));
                None
            }
        }
    }

    /// Returns the bridge of a host, with this route; none if the route does not go with another one.
    fn place(&mut self, host: u32, route: Route, span: Span) -> Option<usize> {
        let all = self.bridges.iter().flat_map(|bridge| bridge.routes.iter().map(move |one| (bridge.host, one)));
        let mut same = all.filter(|(_, (other, _))| other.name == route.name);
        if let Some((why, first)) =
            same.find_map(|(at, (other, first))| Some((conflict(at, other, host, &route)?, *first)))
        {
            let message =
                format!("{} `{}` {why}", if route.way.is_service() { "service" } else { "topic" }, route.name);
            self.problems.push(Diagnostic::new(Code::E0309, span, message).reason(first, "the other connection"));
            return None;
        }
        let bridge = self.bridges.iter().position(|bridge| bridge.host == host).unwrap_or_else(|| {
            self.bridges.push(Bridge { host, routes: Vec::new(), link_loss: LinkLoss::Leave });
            self.bridges.len() - 1
        });
        let routes = &mut self.bridges[bridge].routes;
        if routes.iter().all(|(other, _)| *other != route) {
            if routes.len() == ROUTES_MAX {
                let message = format!("the connections of one host can have at most {ROUTES_MAX} topics and services");
                self.problems.push(Diagnostic::new(Code::E0309, span, message));
                return None;
            }
            routes.push((route, span));
        }
        Some(bridge)
    }

    /// Adds the bridges to a plan. Returns the mistakes in their topics.
    pub(super) fn bridge(mut self, plan: &mut Plan) -> Vec<Diagnostic> {
        let Some((_, first)) = self.bridges.first().and_then(|bridge| bridge.routes.first()) else {
            return self.problems;
        };
        if matches!(plan.groups[0].expression, Expression::Chart(_)) {
            let message = "an activity cannot be `main` and have topics of ROS 2";
            let help = "instantiate the activity in a `process main`";
            self.problems.push(Diagnostic::new(Code::E0309, *first, message).help(help));
            return self.problems;
        }
        let (mut runs, is_only) = (Vec::new(), self.bridges.len() == 1);
        for bridge in self.bridges {
            let (main, host) = (&mut plan.groups[0], &plan.hosts[bridge.host as usize]);
            let name = free_name(main.members.iter().map(|member| &member.name), (!is_only).then_some(host));
            runs.push(Expression::Run { member: number(main.members.len()), sets: Vec::new() });
            let path = format!("{}/{name}", main.path);
            let kind = MemberKind::Leaf(number(plan.leaves.len()));
            main.members.push(Member { name, kind, service: true });
            plan.leaves.push(leaf(path, &bridge));
        }
        let main = &mut plan.groups[0];
        main.sets_always.push(number(main.sets.len()));
        main.sets.push(ConnectionSet { owner: None, label: None, wires: self.wires });
        if let Expression::Concurrent(of) = &mut main.expression {
            of.extend(runs);
        } else {
            runs.insert(0, std::mem::replace(&mut main.expression, Expression::Skip));
            main.expression = Expression::Concurrent(runs);
        }
        self.problems
    }
}

/// Returns the places in the text of the bridges of `main`: the first connection with a topic.
pub(in crate::check) fn place(spec: &Spec) -> Option<Span> {
    spec.processes.iter().flat_map(|process| &process.outside.topics).map(|topic| topic.span).min()
}

/// Returns how the values of a topic go over a wire.
fn quality(qos: Qos) -> Quality {
    let is_kept = qos.durability == Durability::TransientLocal;
    let retention = if is_kept { Retention::Latch } else { Retention::Drop };
    Quality { retention, queue: u32::try_from(qos.depth).ok(), period_min: None }
}

/// Returns why two routes of one name cannot be in one plan, each with its host.
fn conflict(host: u32, one: &Route, other_host: u32, other: &Route) -> Option<String> {
    if one.way.is_service() != other.way.is_service() {
        return Some("has the name of a topic and of a service in one deployment".to_owned());
    }
    if one.of != other.of {
        let has = if one.way.is_service() { "is" } else { "has messages" };
        return Some(format!("{has} of two types, `{}` and `{}`", one.of.spec(), other.of.spec()));
    }
    if one.way != other.way && !one.has_transforms() {
        let does = if one.way.is_service() { "called and answered" } else { "published and subscribed to" };
        return Some(format!("is {does} in one deployment"));
    }
    if one.way == Way::Serve {
        return Some("is answered by two processes".to_owned());
    }
    if host != other_host && one.way == Way::ToRos && !one.has_transforms() {
        return Some("is published on two hosts".to_owned());
    }
    if host == other_host && one.frames != other.frames {
        return Some("has two prefixes of frames on one host".to_owned());
    }
    (one.qos != other.qos).then(|| "has two qualities of service".to_owned())
}

fn type_of(tree: &Tree, spec: &Spec, end: &LeafPort) -> Option<TypeName> {
    let (group, slot) = *tree.place_of.get(end.leaf as usize)?;
    let instance = &spec.processes[tree.process_of[group]].instances[slot];
    let Target::Module(module) = instance.target else { return None };
    let port = spec.modules[module].ports.iter().find(|port| port.name.text == end.port)?;
    ports::type_of(port)
}

fn free_name<'a>(taken: impl Iterator<Item = &'a String> + Clone, host: Option<&String>) -> String {
    let mut name = NAME.to_owned();
    if let Some(host) = host {
        let word = |c: char| if c.is_ascii_alphanumeric() { c } else { '_' };
        name.extend(std::iter::once('_').chain(host.chars().map(word)));
    }
    while taken.clone().any(|other| *other == name) {
        name.push('_');
    }
    name
}

fn leaf(path: String, bridge: &Bridge) -> Leaf {
    let routes: Vec<Route> = bridge.routes.iter().map(|(route, _)| route.clone()).collect();
    let value = Constant::Text(Route::text(&routes));
    Leaf {
        path,
        module: BRIDGE.to_owned(),
        host: bridge.host,
        arguments: vec![Argument { name: Some(ROUTES.to_owned()), value }],
        exec: None,
        parameters: Some(Vec::new()),
        environment: Environment { inherited: ROS_VARIABLES.map(str::to_owned).into(), ..Environment::default() },
        kind: LeafKind::Controller,
        stop_within: STOP_WITHIN,
        outcomes: Vec::new(),
        policy: Policy { restart: Restart::Transient, link_loss: bridge.link_loss, ..Policy::default() },
        keys: Vec::new(),
        external: None,
    }
}

fn number(index: usize) -> u32 {
    u32::try_from(index).expect("a plan has fewer than 2^32 leaves")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bridge_has_a_name_of_its_own() {
        let taken = ["ros", "ros_c_2"].map(str::to_owned);
        let name = |host: Option<&str>| free_name(taken.iter(), host.map(str::to_owned).as_ref());
        assert_eq!(
            (name(None), name(Some("c1")), name(Some("c-2"))),
            ("ros_".into(), "ros_c1".into(), "ros_c_2_".into())
        );
    }
}
