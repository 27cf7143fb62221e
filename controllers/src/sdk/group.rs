//! Several controllers in one process and one loop, which exchange values in memory: an *in-process group*.
//!
//! For a node, a spec and a recorder, the group is one controller type with the ports that it exposes. In each turn of
//! the loop every member calculates at most once, in the order in which the members were added. A member calculates
//! when its period is over, or when a value has arrived that triggers it. A value reaches later members in the same
//! turn, and earlier members in the next turn. So no value between members waits for a thread or is copied to another
//! process, and a turn ends with any wires.
//!
//! The members share their fate. If one of them ends, the group ends. If one of them crashes, the process of all of
//! them crashes.

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

/// The largest number of members of a group.
const MEMBERS_MAX: usize = 64;

/// Makes a member that is not active, from the arguments of the group.
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
    /// Returns the port with this name of a member.
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
        /// The number of members.
        count: usize,
    },
    /// Two members, ports, exports or calls have the same name.
    #[error("`{group}`: there are two `{name}`")]
    Twice {
        /// The group.
        group: &'static str,
        /// The name that occurs twice.
        name: String,
    },
    /// A wire or an exposed port names a port that no member has.
    #[error("`{group}` has no {direction} `{member}.{port}` to connect")]
    NoPort {
        /// The group.
        group: &'static str,
        /// `input` or `output`.
        direction: &'static str,
        /// The given member.
        member: String,
        /// The given port.
        port: String,
    },
    /// The two ends of a wire, or two inputs that are exposed as one, have different types.
    #[error("`{group}`: `{from}` and `{to}` are of different types")]
    Types {
        /// The group.
        group: &'static str,
        /// `Member.Port` of one end.
        from: String,
        /// `Member.Port` of the other end.
        to: String,
    },
    /// An input that its controller needs is not connected.
    #[error("`{group}`: `{member}.{port}` is neither wired nor exposed")]
    Unconnected {
        /// The group.
        group: &'static str,
        /// The member.
        member: String,
        /// The input.
        port: &'static str,
    },
    /// One member owns a device that another member uses, or two members write to one device.
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
    /// Returns a group without members. `type_name` is its type in specs, and `doc` describes it in one sentence.
    pub fn new(type_name: &'static str, doc: &'static str) -> Self {
        let (members, wires, exposed) = Default::default();
        Self { type_name, doc, parameters: &[], members, wires, exposed }
    }

    /// Sets the parameters after the host.
    #[must_use]
    pub fn with(mut self, parameters: &'static [Parameter]) -> Self {
        self.parameters = parameters;
        self
    }

    /// Adds a member. `given` makes its arguments, each `value` or `name=value`, from the arguments of the group. The
    /// first member is initialised with the value of the process before the group, the others with an empty value.
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

    /// Adds a wire from an output of one member to an input of another member.
    #[must_use]
    pub fn wire(mut self, output: MemberPort, input: MemberPort) -> Self {
        self.wires.push((output, input));
        self
    }

    /// Exposes a port of a member as a port of the group. Several inputs of one type may be exposed as one.
    #[must_use]
    pub fn expose(mut self, port: MemberPort, name: &'static str) -> Self {
        self.exposed.push((port, name));
        self
    }

    /// Returns the interface and the constructor of the group.
    ///
    /// # Errors
    /// If its members or wires do not fit.
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
