//! Several controllers in one process and one loop, with memory between them: an *in-process group*.
//!
//! To a node, a spec and a recorder it is one controller type, with the ports that it exposes. In each turn of its loop
//! every member calculates at most once, in the order in which the members were added: when its period is over, or when
//! a value has come that triggers it. Later members get a value in the same turn, earlier members
//! get it in the next turn. So nothing between them waits for a thread or is copied to another process,
//! and a turn ends with any wires.
//!
//! The members share their fate: one that ends, ends the group, and one that crashes takes the process of all of them along.

mod checks;
mod inner;
mod turns;

use super::arguments::{Arguments, Parameter};
use super::controller::Controller;
use super::interface::Interface;
use super::module::{Instance, Module, interface};
use checks::Layout;
use std::fmt;
use std::sync::Arc;
use thiserror::Error;
use turns::GroupModule;

/// How many members a group has at most.
const MEMBERS_MAX: usize = 64;

/// Makes an idle member from the arguments of the group.
type Make = dyn Fn(&Arguments) -> Result<Box<dyn Module>, String> + Send + Sync;

/// A group before it is checked, see [`super::Registry::add_group`].
///
/// ```
/// # use controllers::sdk::{
/// #     About, Arguments, Controller, InProcessGroup, In, Inputs, MemberPort, Message, Out, Outputs, Progress, Registry, Tick,
/// # };
/// # use controllers::sdk::serde::{Deserialize, Serialize};
/// # #[derive(Clone, Debug, Serialize, Deserialize)]
/// # #[serde(crate = "controllers::sdk::serde")]
/// # struct Distance(f64);
/// # impl Message for Distance {
/// #     const TYPE: &'static str = "Distance";
/// # }
/// # #[derive(Inputs)]
/// # struct Inputs {
/// #     #[port("In")]
/// #     distance: In<Distance>,
/// # }
/// # #[derive(Outputs)]
/// # struct Outputs {
/// #     #[port("Out")]
/// #     twice: Out<Distance>,
/// # }
/// # struct Doubler;
/// # impl Controller for Doubler {
/// #     type Inputs = Inputs;
/// #     type Outputs = Outputs;
/// #     const TYPE: &'static str = "Doubler";
/// #     fn about() -> About {
/// #         About::service("Doubles.").triggered_by("In")
/// #     }
/// #     fn new(_: &Arguments) -> Result<Self, String> {
/// #         Ok(Self)
/// #     }
/// #     fn main_calc(&mut self, _: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
/// #         inputs.distance.fresh().into_iter().for_each(|distance| outputs.twice.send(Distance(2.0 * distance.0)));
/// #         Progress::Continue
/// #     }
/// # }
/// let group = InProcessGroup::new("Quadrupler", "Doubles twice.")
///     .member::<Doubler>("first", |_| Vec::new())
///     .member::<Doubler>("second", |_| Vec::new())
///     .wire(MemberPort::new("first", "Out"), MemberPort::new("second", "In"))
///     .expose(MemberPort::new("first", "In"), "In")
///     .expose(MemberPort::new("second", "Out"), "Out");
/// let mut registry = Registry::default();
/// registry.add_group(group).expect("its wires fit");
/// assert!(registry.interface_text().contains("module Quadrupler(host: Host)"));
/// ```
pub struct InProcessGroup {
    type_name: &'static str,
    doc: &'static str,
    parameters: &'static [Parameter],
    members: Vec<Member>,
    wires: Vec<(MemberPort, MemberPort)>,
    exposed: Vec<(MemberPort, &'static str)>,
}

/// A port of a member of a group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MemberPort {
    member: String,
    port: String,
}

impl MemberPort {
    /// Returns the port of this name of a member.
    pub fn new(member: &str, port: &str) -> Self {
        Self { member: member.to_owned(), port: port.to_owned() }
    }
}

impl fmt::Display for MemberPort {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.member, self.port)
    }
}

struct Member {
    name: String,
    interface: Interface,
    make: Box<Make>,
}

/// Why controllers cannot be one group.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum GroupError {
    /// The group has no members, or too many.
    #[error("`{group}` has {count} members, and may have 1 to {MEMBERS_MAX}")]
    Count {
        /// The group.
        group: &'static str,
        /// How many.
        count: usize,
    },
    /// Two things have one name.
    #[error("`{group}`: there are two `{name}`")]
    Twice {
        /// The group.
        group: &'static str,
        /// The kind of the two: members, ports, exports or calls.
        name: String,
    },
    /// A wire or an exposed port belongs to no member.
    #[error("`{group}` has no {direction} `{member}.{port}` to connect")]
    NoPort {
        /// The group.
        group: &'static str,
        /// `input` or `output`.
        direction: &'static str,
        /// As given.
        member: String,
        /// As given.
        port: String,
    },
    /// Both ends of a wire, or two inputs that are exposed as one, are of different types.
    #[error("`{group}`: `{from}` and `{to}` are of different types")]
    Types {
        /// The group.
        group: &'static str,
        /// `Member.Port` of the one.
        from: String,
        /// `Member.Port` of the other.
        to: String,
    },
    /// An input that its controller needs is connected with nothing.
    #[error("`{group}`: `{member}.{port}` is neither wired nor exposed")]
    Unconnected {
        /// The group.
        group: &'static str,
        /// The member.
        member: String,
        /// The input.
        port: &'static str,
    },
    /// A device is owned and used, or two members write it.
    #[error(
        "`{group}`: two members use the device `{key}`; put the owner of the device and each client into separate programs"
    )]
    Device {
        /// The group.
        group: &'static str,
        /// The key of the device.
        key: &'static str,
    },
    /// There are several tasks, and one of them has several normal ends.
    #[error("`{group}`: `{member}` has several normal ends, so it has to be the only task")]
    Outcomes {
        /// The group.
        group: &'static str,
        /// The member.
        member: String,
    },
}

impl fmt::Debug for InProcessGroup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let names: Vec<&str> = self.members.iter().map(|member| &*member.name).collect();
        f.debug_struct("InProcessGroup")
            .field("type_name", &self.type_name)
            .field("members", &names)
            .finish_non_exhaustive()
    }
}

impl InProcessGroup {
    /// Returns a group without members, with its type name in specs and one sentence.
    pub fn new(type_name: &'static str, doc: &'static str) -> Self {
        let (members, wires, exposed) = Default::default();
        Self { type_name, doc, parameters: &[], members, wires, exposed }
    }

    /// Returns it with parameters after the host.
    #[must_use]
    pub fn with(mut self, parameters: &'static [Parameter]) -> Self {
        self.parameters = parameters;
        self
    }

    /// Returns it with one more member; `given` makes its arguments, each `value` or `name=value`, from those of the group. The first member is
    /// initialised with the value of the process before the group, the others with nothing.
    #[must_use]
    pub fn member<C: Controller>(
        mut self,
        name: impl Into<String>,
        given: impl Fn(&Arguments) -> Vec<String> + Send + Sync + 'static,
    ) -> Self {
        let make = move |of_group: &Arguments| {
            let arguments = Arguments::parse(C::about().parameters, &given(of_group));
            let arguments =
                arguments.map_err(|error| error.to_string())?.of(of_group.deployment(), of_group.instance());
            let controller = C::new(&arguments)?;
            Ok(Box::new(Instance::new(controller)) as Box<dyn Module>)
        };
        self.members.push(Member { name: name.into(), interface: interface::<C>(), make: Box::new(make) });
        self
    }

    /// Returns it with a wire from an output of one member to an input of another one.
    #[must_use]
    pub fn wire(mut self, output: MemberPort, input: MemberPort) -> Self {
        self.wires.push((output, input));
        self
    }

    /// Returns it with a port of a member as a port of its own. Several inputs of one type may be exposed as one.
    #[must_use]
    pub fn expose(mut self, port: MemberPort, name: &'static str) -> Self {
        self.exposed.push((port, name));
        self
    }

    /// Returns its interface, and its constructor.
    ///
    /// # Errors
    /// Its members or wires do not fit.
    pub(super) fn checked(self) -> Result<(Interface, Box<Make>), GroupError> {
        let layout = Arc::new(Layout::of(self)?);
        let interface = layout.interface.clone();
        let make = move |arguments: &Arguments| {
            let module = GroupModule::new(Arc::clone(&layout), arguments)?;
            Ok(Box::new(module) as Box<dyn Module>)
        };
        Ok((interface, Box::new(make)))
    }
}
