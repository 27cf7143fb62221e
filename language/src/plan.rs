//! The plan: a spec with every name resolved. It is the one serialised form of a deployment.
//!
//! A plan is flat. Groups and leaves are numbered, members of a group are slots, wires run from leaf port to leaf port
//! (through any number of group boundaries), and each group carries its event-action expression with slots for names.
//! Invariants, kept by `check::lower` and re-checked by [`Plan::validate`] when a plan arrives over a wire: every index
//! is in range, `groups[0]` is `main`, every group but `main` is a member of exactly one group, every leaf too. Of a plan that was
//! changed while it ran some are members of none: they were taken away, and nothing of them is started.

mod component;
mod difference;
mod environment;
mod exec;
mod external;
mod nested;
mod on_boot;
mod operand;
mod parameter;
mod policy;
mod state_chart;
mod supervision;
mod timer;
mod validate;

use crate::automaton::{Failure, Trigger};
use ros::logic::route::Route;
use serde::{Deserialize, Serialize};
use std::time::Duration;

pub use component::Failing;
pub use difference::{Difference, PlanChange, difference, difference_with};
pub use environment::{
    Environment, VARIABLE_SIZE_MAX, VARIABLES_MAX, directory_problem, is_matched, pattern_problem, value_problem,
    variable_problem,
};
pub use exec::{ExecError, words};
pub use external::External;
pub use on_boot::OnBoot;
pub use operand::{Arm, CatchArm, GIVEN_MAX, Given};
pub use parameter::{Accepts, Parameter};
pub use policy::{
    BACKOFF_MAX, BACKOFF_MIN, Backoff, LinkLoss, Policy, REALTIME_MAX, Realtime, Replacement, Restart, Usage, Watchdog,
};
pub use state_chart::{DefaultAnswer, Filter, FilterPart, Notice, Question, StateChart, StateRun, text_value};
pub use supervision::{Intensity, RESTARTS_MAX, Strategy, Supervision};
pub use timer::{TIMER_LEAST, TimerKind};
pub use validate::PlanError;

/// The deepest nesting of groups and of expressions that is accepted.
pub const DEPTH_MAX: usize = 64;
/// The largest number of leaves in one plan.
pub const LEAVES_MAX: usize = 10_000;

/// The controller type of the bridge to ROS 2, which is added to a plan with topics.
pub const BRIDGE: &str = "RosBridge";
/// The argument of the bridge that has its routes.
pub(crate) const ROUTES: &str = "routes";
/// The controller type that has the ports of an activity. A plan has one for each activity with connections.
pub const PORTS: &str = "ActivityPorts";
/// The program that offers the type. It is in the folder of the node's program.
pub const PORTS_PROGRAM: &str = "dca-controller";
/// The controller type that runs a program of ROS 2. The bridge offers it.
pub const ROS_NODE: &str = "RosNode";
/// The variables of ROS 2 that say which network is meant.
pub(crate) const ROS_VARIABLES: [&str; 3] = ["ROS_DISTRO", "ROS_DOMAIN_ID", "ZENOH_CONFIG_OVERRIDE"];
/// The program of the bridge. It is in the folder of the node's program. A leaf whose `exec` begins with this word is started by it.
pub const BRIDGE_PROGRAM: &str = "dca-ros";

/// How the reason of a deadline that has passed begins: `the deadline `a within 5 s` in line 3 has passed`.
pub const DEADLINE: &str = "the deadline `";

/// A whole deployment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Name of the deployment: the file's stem unless the user gave another.
    pub name: String,
    /// Host names as written in the spec, each once. A `host` index points here.
    pub hosts: Vec<String>,
    /// Every process group; `groups[0]` is `main`.
    pub groups: Vec<Group>,
    /// Every leaf: a controller module or a plain program.
    pub leaves: Vec<Leaf>,
    /// Every data route, leaf port to leaf port.
    pub wires: Vec<Wire>,
    /// The claims of the leaves on devices of their hosts.
    pub claims: Vec<Claim>,
    /// The home's action with it after a reboot of its machine.
    pub on_boot: OnBoot,
}

/// A device that a leaf claims on its host, against other deployments too.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Claim {
    /// Index into [`Plan::leaves`].
    pub leaf: u32,
    /// The device.
    pub device: String,
    /// Whether it is alone with it; any number may read.
    pub is_write: bool,
}

impl Plan {
    /// Returns the host of `main`; none only for a plan that is not sound.
    pub fn home(&self) -> Option<&str> {
        let main = self.groups.first()?;
        self.hosts.get(main.host as usize).map(String::as_str)
    }

    /// Returns whether a leaf never ends by itself.
    pub fn is_service(&self, leaf: u32) -> bool {
        let mut members = self.groups.iter().flat_map(|group| &group.members);
        members.any(|member| member.service && member.kind == MemberKind::Leaf(leaf))
    }

    /// Returns the slot and the leaf that has the ports of a group, if the group is an activity with connections.
    pub fn ports_of(&self, group: u32) -> Option<(u32, u32)> {
        let group = self.groups.get(group as usize)?;
        (0_u32..).zip(&group.members).find_map(|(slot, member)| match member.kind {
            MemberKind::Leaf(leaf) if self.has_ports(leaf) && !member.name.is_empty() => Some((slot, leaf)),
            MemberKind::Leaf(_) | MemberKind::Group(_) => None,
        })
    }

    /// Returns whether a leaf has the ports of an activity.
    pub fn has_ports(&self, leaf: u32) -> bool {
        self.leaves.get(leaf as usize).is_some_and(|leaf| leaf.module == PORTS)
    }

    /// Returns whether any number of processes may send to a port at the same time: the bridge to ROS 2 publishes their transforms.
    pub fn has_many_senders(&self, port: &LeafPort) -> bool {
        self.route(port).is_some_and(|route| route.has_transforms())
    }

    /// Returns the type of the messages of a port of the bridge to ROS 2, as a spec writes it: `ros.sensor.LaserScan`.
    pub fn ros_type(&self, port: &LeafPort) -> Option<String> {
        self.route(port).map(|route| route.of.spec())
    }

    /// Returns the topic or service that a port of the bridge to ROS 2 stands for.
    fn route(&self, port: &LeafPort) -> Option<Route> {
        let bridge = self.leaves.get(port.leaf as usize).filter(|leaf| leaf.module == BRIDGE)?;
        let routes = bridge.arguments.iter().find(|argument| argument.name.as_deref() == Some(ROUTES))?;
        let Constant::Text(text) = &routes.value else { return None };
        Route::list(text)?.into_iter().find(|route| route.port() == port.port)
    }

    /// Returns the ends of a wire: `main/a, Out -> main/b, In`.
    pub fn ends(&self, wire: &Wire) -> String {
        let end = |end: &LeafPort| {
            let path = self.leaves.get(end.leaf as usize).map_or("?", |leaf| leaf.path.as_str());
            format!("{path}, {}", end.port)
        };
        format!("{} -> {}", end(&wire.from), end(&wire.to))
    }
}

/// One instance of a process group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Group {
    /// Absolute path of the instance: `main`, `main/dooropensyst`, `main/dooropensyst/hit`.
    pub path: String,
    /// The process type it was made from.
    pub process: String,
    /// The host of its supervisor: an index into [`Plan::hosts`].
    pub host: u32,
    /// Its instances; a slot number in `expression` and in events points here.
    pub members: Vec<Member>,
    /// Its connection sets; the numbers in `Expression::Run` point here.
    pub sets: Vec<ConnectionSet>,
    /// Sets that stay open for as long as the group runs (declared without an owner).
    pub sets_always: Vec<u32>,
    /// The event actions; `Skip` for an empty section.
    pub expression: Expression,
    /// The strategy for its programs when one of them dies.
    pub supervision: Supervision,
}

/// One instance inside a group.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Member {
    /// The instance name within its group; empty once it was taken away while the group ran.
    pub name: String,
    /// Group or leaf.
    pub kind: MemberKind,
    /// Whether no fault-free run of it ends (declared on leaves, inferred for groups).
    pub service: bool,
}

/// The kind of a member of a group, with its index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MemberKind {
    /// Index into [`Plan::leaves`].
    Leaf(u32),
    /// Index into [`Plan::groups`].
    Group(u32),
}

/// A labelled set of internal connections.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConnectionSet {
    /// Slot of the owner, if one was named.
    pub owner: Option<u32>,
    /// The label, if one was given.
    pub label: Option<String>,
    /// Indices into [`Plan::wires`].
    pub wires: Vec<u32>,
}

/// Returns the labelled connection sets of which a member is the owner: number and label.
pub fn owned_sets(group: &Group, slot: u32) -> Vec<(u32, &str)> {
    let owned = (0..).zip(&group.sets).filter(|(_, set)| set.owner == Some(slot));
    owned.filter_map(|(number, set)| Some((number, set.label.as_deref()?))).collect()
}

/// A controller module or a plain program.
// Wide: its fields are the statements of the instance and of its `module` block.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Leaf {
    /// Absolute path of the instance: `main/dooropensyst/hit/force`.
    pub path: String,
    /// The module type: `ForceTorque`.
    pub module: String,
    /// The host of its program: an index into [`Plan::hosts`].
    pub host: u32,
    /// Arguments after the host, in order.
    pub arguments: Vec<Argument>,
    /// How to start it, as [`words`] reads it, when the module's interface says so; else the node looks the type up among
    /// its controllers.
    pub exec: Option<String>,
    /// The parameters of its program, when the module declares them beside its `exec`; else the node knows them from its
    /// controllers.
    pub parameters: Option<Vec<Parameter>>,
    /// The variables and the folder of its program.
    pub environment: Environment,
    /// Whether it speaks the control protocol.
    pub kind: LeafKind,
    /// The longest time to stop; then the program is killed.
    pub stop_within: Duration,
    /// Its normal ends, when it has declared several.
    pub outcomes: Vec<String>,
    /// The limits of its program, and the reaction to losses.
    pub policy: Policy,
    /// The keys of the database that its ports are connected with.
    pub keys: Vec<KeyBinding>,
    /// The process of another deployment that this leaf refers to. Then no program is started for the leaf.
    pub external: Option<External>,
}

/// A port that is connected with keys of the database for as long as its process runs.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct KeyBinding {
    /// The port; [`DATABASE`] for the program's use without a port.
    pub port: String,
    /// A key, or a prefix that ends in `/`.
    pub keys: String,
    /// Whether the process writes the keys. Otherwise it receives their changes.
    pub is_write: bool,
}

/// Stands for a program that uses the database without a port.
pub const DATABASE: &str = "database";
/// The most keys and prefixes that one process is connected with.
pub const KEYS_MAX: usize = 64;

/// How a leaf is controlled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LeafKind {
    /// A program made with the controller SDK.
    Controller,
    /// Any program: exit code 0 is DONE, anything else ABORTED.
    Plain,
}

/// A constant argument of a leaf.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Argument {
    /// Its name; none if the parameters of its module are unknown.
    pub name: Option<String>,
    /// Its value.
    pub value: Constant,
}

/// A constant of the language. Quantities are in SI units.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum Constant {
    /// A string, or an identifier that names nothing else.
    Text(String),
    /// A number or a quantity, in SI units.
    Number(f64),
    /// `true` or `false`.
    Truth(bool),
    /// `secret("team/camera/password")`: the secret that the database has at this key, for its program alone.
    Secret(String),
}

impl Constant {
    /// Returns the value as a spec spells it, a text without quotes.
    pub fn bare(&self) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Number(number) => number.to_string(),
            Self::Truth(truth) => truth.to_string(),
            Self::Secret(key) => format!("secret(\"{key}\")"),
        }
    }
}

/// A data route from one leaf's output to another leaf's input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wire {
    /// The output.
    pub from: LeafPort,
    /// The input.
    pub to: LeafPort,
    /// Push or pull.
    pub transfer: Transfer,
    /// The quality of the connection.
    pub quality: Quality,
}

/// How data moves on a wire; the default is as the ports themselves do it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Quality {
    /// Whether the last value is kept for consumers that connect later.
    pub retention: Retention,
    /// The most values that wait. The input decides if this is absent.
    pub queue: Option<u32>,
    /// The shortest time between two values.
    pub period_min: Option<Duration>,
}

/// Whether a wire keeps its last value.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Retention {
    /// A consumer that is connected later waits for the next value.
    #[default]
    Drop,
    /// A consumer that is connected later gets the last value at once.
    Latch,
}

/// A named port of a leaf.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LeafPort {
    /// Index into [`Plan::leaves`].
    pub leaf: u32,
    /// The port's name.
    pub port: String,
}

/// The side that makes data move.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Transfer {
    /// The producer sends each new value.
    Push,
    /// The consumer fetches the latest value before each calculation.
    Pull,
    /// No data: the process at its beginning calls the export of the one at its end.
    Call,
}

/// An event-action expression with slots for names. Meaning: `algebra::step`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(remote = "Self")] // `nested` defines its bytes.
pub enum Expression {
    /// `name[labels]`: runs a member with these connection sets open.
    Run {
        /// Slot in [`Group::members`].
        member: u32,
        /// Indices into [`Group::sets`].
        sets: Vec<u32>,
    },
    /// `skip`: done at once.
    Skip,
    /// `never`: runs until it is stopped.
    Never,
    /// `fail("why")`: aborted at once.
    Fail(String),
    /// `wait(5 s)`: done when the time has passed.
    Wait(Duration),
    /// `P , Q`: concurrent composition, n-ary.
    Concurrent(Vec<Self>),
    /// `P & Q`: concurrent, the first abort stops the others; n-ary.
    FailFast(Vec<Self>),
    /// `any k of (P, Q, ...)`.
    AnyOf {
        /// How many have to be done.
        count: u32,
        /// The candidates.
        of: Vec<Self>,
    },
    /// `P # Q`: disabling composition, n-ary.
    Disable(Vec<Self>),
    /// `P ; Q`.
    Sequence(Box<Self>, Box<Self>),
    /// `P : Q`, the value of P initialises Q.
    Conditional(Box<Self>, Box<Self>),
    /// `P ;; Q`.
    Recurrent(Box<Self>, Box<Self>),
    /// `P else Q`; `P?` is `P else skip`.
    Otherwise(Box<Self>, Box<Self>),
    /// `match { found => P, else => Q }`: the tag of its start value chooses the arm.
    Match(Vec<Arm>),
    /// `shield P`, `shield(10 s) P`: a stop waits until P has ended.
    Shield {
        /// How long it waits at most.
        bound: Option<Duration>,
        /// The operand.
        of: Box<Self>,
    },
    /// `using(arm) P`: P runs once no other process of the group uses one of these resources; first come, first served.
    Using {
        /// The resources, each once.
        resources: Vec<String>,
        /// The operand.
        of: Box<Self>,
    },
    /// `P ::[n] Q`: each time P is done, P is restarted, and a Q starts with the value of P. At
    /// most `n` copies of Q run at the same time.
    Asynchronous {
        /// The source.
        source: Box<Self>,
        /// Q, written out for each that may run at the same time.
        pool: Vec<Self>,
    },
    /// `P finally Q`: Q once P has ended, in any way, even by a stop, which waits for Q.
    Finally(Box<Self>, Box<Self>),
    /// `P as tag`: the value of P gets a tag, for a `match`.
    Tagged {
        /// The tag.
        tag: String,
        /// The operand.
        of: Box<Self>,
    },
    /// The states of an activity. They are the whole event actions of their group.
    Chart(Box<StateChart>),
    /// `P with { x = 2 m }`, `P with p`: P starts with this value.
    With {
        /// The value.
        given: Given,
        /// The operand.
        of: Box<Self>,
    },
    /// `repeat P until found | gone`: P again and again, until it is done with one of these tags.
    Repeat {
        /// The tags, each once.
        until: Vec<String>,
        /// The operand.
        of: Box<Self>,
    },
    /// `P else match { timeout => Q, else => R }`: the reason of a failure of P chooses the arm.
    Catch {
        /// The operand.
        of: Box<Self>,
        /// The arms; `else` is the last one.
        arms: Vec<CatchArm>,
    },
    /// `at least k of (P, Q, ...)`.
    AtLeast {
        /// How many operands have to be done when all operands have ended.
        count: u32,
        /// The operands.
        of: Vec<Self>,
    },
    /// `p => P`: keeps its start value under a name, as long as P runs. P starts with nothing.
    Named {
        /// The name.
        name: String,
        /// The operand.
        of: Box<Self>,
    },
}

impl Expression {
    /// Returns the direct operands, in the order of the text.
    pub fn operands(&self) -> Vec<&Self> {
        match self {
            Self::Run { .. } | Self::Skip | Self::Never | Self::Fail(_) | Self::Wait(_) => Vec::new(),
            Self::Concurrent(of)
            | Self::FailFast(of)
            | Self::Disable(of)
            | Self::AnyOf { of, .. }
            | Self::AtLeast { of, .. } => of.iter().collect(),
            Self::Sequence(p, q)
            | Self::Conditional(p, q)
            | Self::Recurrent(p, q)
            | Self::Otherwise(p, q)
            | Self::Finally(p, q) => vec![p, q],
            Self::Match(arms) => arms.iter().map(|arm| &arm.body).collect(),
            Self::Shield { of, .. }
            | Self::Using { of, .. }
            | Self::Tagged { of, .. }
            | Self::With { of, .. }
            | Self::Named { of, .. }
            | Self::Repeat { of, .. } => vec![of],
            Self::Asynchronous { source, pool } => std::iter::once(&**source).chain(pool).collect(),
            Self::Catch { of, arms } => std::iter::once(&**of).chain(arms.iter().map(|arm| &arm.body)).collect(),
            Self::Chart(chart) => chart.runs.iter().map(|run| &run.expression).collect(),
        }
    }

    /// Returns the direct operands, to change them.
    pub fn operands_mut(&mut self) -> Vec<&mut Self> {
        match self {
            Self::Run { .. } | Self::Skip | Self::Never | Self::Fail(_) | Self::Wait(_) => Vec::new(),
            Self::Concurrent(of)
            | Self::FailFast(of)
            | Self::Disable(of)
            | Self::AnyOf { of, .. }
            | Self::AtLeast { of, .. } => of.iter_mut().collect(),
            Self::Sequence(p, q)
            | Self::Conditional(p, q)
            | Self::Recurrent(p, q)
            | Self::Otherwise(p, q)
            | Self::Finally(p, q) => vec![p, q],
            Self::Match(arms) => arms.iter_mut().map(|arm| &mut arm.body).collect(),
            Self::Shield { of, .. }
            | Self::Using { of, .. }
            | Self::Tagged { of, .. }
            | Self::With { of, .. }
            | Self::Named { of, .. }
            | Self::Repeat { of, .. } => vec![of],
            Self::Asynchronous { source, pool } => std::iter::once(&mut **source).chain(pool).collect(),
            Self::Catch { of, arms } => {
                std::iter::once(&mut **of).chain(arms.iter_mut().map(|arm| &mut arm.body)).collect()
            }
            Self::Chart(chart) => chart.runs.iter_mut().map(|run| &mut run.expression).collect(),
        }
    }

    /// Returns the reasons of failures that transitions of an activity and arms of `else match` ask for, in the order of the text.
    pub fn failures(&self) -> Vec<&Failure> {
        let mut all = Vec::new();
        if let Self::Chart(chart) = self {
            let triggers = chart.chart.transitions.iter().map(|transition| &transition.trigger);
            all.extend(
                triggers
                    .filter_map(|trigger| if let Trigger::Aborted(asked) = trigger { asked.as_ref() } else { None }),
            );
        } else if let Self::Catch { arms, .. } = self {
            all.extend(arms.iter().filter_map(|arm| arm.failure.as_ref()));
        }
        all.extend(self.operands().into_iter().flat_map(Self::failures));
        all
    }

    /// Returns the tags that it gives itself, `P as found` or `-> done(found)`, in the order of the text.
    pub fn tags(&self) -> Vec<&str> {
        let own = if let Self::Tagged { tag, .. } = self { Some(tag.as_str()) } else { None };
        let ends = if let Self::Chart(chart) = self { Some(chart.outcomes()) } else { None };
        own.into_iter()
            .chain(ends.into_iter().flatten())
            .chain(self.operands().into_iter().flat_map(Self::tags))
            .collect()
    }

    /// Returns the slots of the members that it runs, each as often as it occurs, in the order of the text.
    pub fn members(&self) -> Vec<u32> {
        let own = if let Self::Run { member, .. } = self { Some(*member) } else { None };
        own.into_iter().chain(self.operands().into_iter().flat_map(Self::members)).collect()
    }
}
