//! The control channel between a node and one controller on the same host, over a local Unix socket.
//!
//! Frames are postcard, length-prefixed, inside the versioned envelope of [`crate::logic::codec`]. Variants are only
//! ever appended: postcard numbers them.
//!
//! Life of a channel: the program connects and says [`Notice::Hello`]; the node answers [`Order::Connect`] with every
//! link the program takes part in; the program dials them and says [`Notice::Connected`] (or why not). From then on it
//! is idle until [`Order::Activate`].
//!
//! A channel that breaks is not the end of the program. The program dials again and sends [`Notice::Resume`]. The node,
//! which may be a successor of the first node, answers [`Order::Resumed`]. Each side then sends what the other side has
//! not received. For this, both count orders and notices from the program's start, over all its channels, except those
//! that only concern a channel ([`Order::is_counted`], [`Notice::is_counted`]).

use crate::logic::bytes::SecretBytes;
use crate::logic::database::{DatabaseAnswer, DatabaseRequest};
use crate::logic::direct::Place;
use crate::logic::object::{Access, Warrant};
use crate::logic::seal::Refused;
use crate::logic::switch::{Expect, Flip};
use crate::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The most bytes that a process may leave for the next one.
pub const VALUE_MAX: usize = 1 << 20;

/// Returns why a process may not leave a value of so many bytes; none if it may.
pub fn too_large(size: usize) -> Option<String> {
    (size > VALUE_MAX).then(|| format!("it leaves a value of {size} bytes; {VALUE_MAX} are allowed"))
}

/// Where a program's data session can be dialled.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Location {
    /// The zenoh id of the session, as lower-case hex.
    pub session: String,
    /// Dialled by programs on the same host: a Unix socket, and the direct path of wires.
    pub local: Vec<String>,
    /// Dialled by programs on other hosts; empty when the node is not open to the network.
    pub remote: Vec<String>,
    /// The public keys that the program made at its start, for data sealed for it; empty outside of a team.
    pub keys: Vec<u8>,
}

/// A program at the other end of wires, or that shares a device. Data for it is sealed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Partner {
    /// The session of the program.
    pub session: String,
    /// Its public keys, as in its [`Location`].
    pub keys: Vec<u8>,
    /// Whether it runs on the same machine.
    pub is_near: bool,
    /// Numbers of the wires, including those of calls.
    pub wires: Vec<u32>,
    /// Devices that one of the two owns and the other needs.
    pub devices: Vec<String>,
}

/// One end of a data route. The key is `comms::logic::key::wire(..)`; both ends get the same one.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Incoming {
    /// Number of the wire in the plan.
    pub wire: u32,
    /// The consumer's input port.
    pub port: String,
    /// The key the producer publishes (or answers) on.
    pub key: String,
    /// Where the producer is: session id and the locators to dial.
    pub producer: Dial,
    /// Whether the consumer fetches (pull) or receives (push).
    pub pull: bool,
}

/// The producer's end of a data route. It sends only while the wire is open.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Outgoing {
    /// Number of the wire in the plan.
    pub wire: u32,
    /// The producer's output port.
    pub port: String,
    /// The key to publish (or answer) on.
    pub key: String,
    /// Whether the consumer fetches (pull) or receives (push).
    pub pull: bool,
}

/// How data moves on a wire, if the spec gives it. Both ends get this.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shape {
    /// Number of the wire in the plan.
    pub wire: u32,
    /// Whether a consumer gets the last value when the wire is opened.
    pub latch: bool,
    /// How many values wait for the consumer at most.
    pub queue: Option<u32>,
    /// The shortest time between two values.
    pub period_min: Option<Duration>,
}

/// A link to the program that owns a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Device {
    /// The device: `arm`, `base`, `ft`, `gripper`, `laser`, `camera`.
    pub device: String,
    /// The program that owns its keys.
    pub owner: Dial,
    /// The deployment of that program: the device's keys begin with its name.
    pub deployment: String,
}

/// The route of a call to another program's export.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CallRoute {
    /// Number of the wire in the plan; it is opened and closed like a wire for data.
    pub wire: u32,
    /// The call of the caller's interface.
    pub call: String,
    /// The program that is called.
    pub server: Dial,
    /// The instance path of that program.
    pub path: String,
    /// The procedure or state there.
    pub name: String,
    /// The deployment of that program.
    pub deployment: String,
    /// The number under which both ends make the seals of the wire, in a team.
    pub seal: u32,
}

/// A port that is connected with keys of the database.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct KeyPort {
    /// The port.
    pub port: String,
    /// A key, or a prefix that ends in `/`.
    pub keys: String,
    /// Whether the program writes the keys; otherwise it watches them.
    pub is_write: bool,
}

impl KeyPort {
    /// Returns whether a key is among its keys.
    pub fn covers(&self, key: &str) -> bool {
        if self.keys.ends_with('/') { key.starts_with(&self.keys) } else { key == self.keys }
    }
}

/// A session to dial.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dial {
    /// The zenoh id of the session.
    pub session: String,
    /// Locators, to be tried in order. For a program on the same host, the locator of its direct path may be among
    /// them.
    pub locators: Vec<String>,
}

impl Dial {
    /// Returns the locators of the session itself.
    pub fn of_session(&self) -> Vec<String> {
        self.locators.iter().filter(|locator| !Place::is_meant(locator)).cloned().collect()
    }

    /// Returns the direct path, if it has one.
    pub fn direct(&self) -> Option<Place> {
        self.locators.iter().find_map(|locator| Place::of(locator))
    }
}

/// From the node to the program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Order {
    /// Make every link; the wires stay closed.
    Connect {
        /// Prefix for hardware keys: the robot's name.
        robot: String,
        /// Inputs.
        incoming: Vec<Incoming>,
        /// Outputs.
        outgoing: Vec<Outgoing>,
        /// Devices that other programs own.
        devices: Vec<Device>,
    },
    /// Open these outgoing wires, then answer [`Notice::Switched`] with the same generation.
    Open {
        /// Wire numbers.
        wires: Vec<u32>,
        /// The generation that the order had.
        generation: u64,
    },
    /// Close these outgoing wires, then answer [`Notice::Switched`].
    Close {
        /// Wire numbers.
        wires: Vec<u32>,
        /// The generation that the order had.
        generation: u64,
    },
    /// `Init(value)`, then `Run()`.
    Activate {
        /// Echoed in the outcome.
        activation: u32,
        /// The argument of `Init`.
        value: Vec<u8>,
        /// When the supervisor decided it, on the clock of this host: values that come later are for this activation.
        since: Time,
    },
    /// `Stop()`, then report [`Notice::Stopped`], or the outcome already reached.
    Stop {
        /// The activation meant; an older one is ignored.
        activation: u32,
    },
    /// End: stop if running, close the session, exit with code 0.
    Exit,
    /// Parameter values from the database, which have precedence over the arguments of the spec. The values of the
    /// previous `Configure` no longer count.
    Configure {
        /// Parameter names, and values as a spec spells them.
        parameters: Vec<(String, String)>,
    },
    /// How data moves on some wires, other than as the ports do it; comes before [`Order::Connect`].
    Shape {
        /// The shapes, one for each wire.
        wires: Vec<Shape>,
    },
    /// The deployment runs already, and this program was restarted. Comes before [`Order::Connect`], which then does
    /// not wait long: absent programs are linked when they come.
    Rejoin,
    /// A program that this one dials was started again and is elsewhere now.
    Relink {
        /// The session that the program had.
        lost: String,
        /// Where the program is now.
        found: Dial,
    },
    /// The answer to [`Notice::Resume`], and the first order after it: the program is known. It sends the notices after
    /// this number again.
    Resumed {
        /// How many counted notices of this program the node has, since the program's start.
        notices: u64,
    },
    /// The complete set of the program's calls to others; comes before [`Order::Connect`].
    Calls {
        /// The routes, all closed unless they were open before.
        calls: Vec<CallRoute>,
    },
    /// Flip these outgoing wires between two values, then answer [`Notice::Switched`].
    Flip {
        /// Echoed in the answer.
        ticket: u64,
        /// The wires.
        flip: Flip,
    },
    /// Expect a switch of inputs: answer [`Notice::Expecting`] at once, and [`Notice::Taken`] when it has come.
    Expect {
        /// Echoed in the answers.
        ticket: u64,
        /// The inputs.
        expect: Expect,
        /// Outgoing wires to flip once all that came before the switch has had its calculation.
        then: Option<Flip>,
    },
    /// The database answers.
    Database {
        /// The number of the request.
        number: u64,
        /// The answer, or the next part of it.
        answer: DatabaseAnswer,
    },
    /// The ports that are connected with keys of the database; the first order of a program's life, if there are some.
    Keys {
        /// Each with its keys.
        ports: Vec<KeyPort>,
    },
    /// The complete set of programs at the other ends of wires and calls, in a team; comes before [`Order::Connect`],
    /// and again when one of them was restarted.
    Partners {
        /// Each with the wires to it.
        partners: Vec<Partner>,
    },
    /// The present value of a secret parameter. It replaces the value with which the program was started.
    Secret {
        /// The parameter.
        parameter: String,
        /// The value.
        value: SecretBytes,
    },
    /// The proof for programs of other hosts that the node has started this one, in a team: signed, for the keys of its
    /// [`Location`].
    Vouch {
        /// A delegation, in the form of the room `trust`.
        delegation: Vec<u8>,
    },
    /// Whether a user may make a call that the program has asked about.
    Judged {
        /// The number of the question.
        number: u64,
        /// Why not, for a person; none if the user may.
        refusal: Option<String>,
    },
    /// The fate of a [`Notice::Message`].
    Received {
        /// The number of the message.
        number: u64,
        /// Its fate.
        fate: MessageFate,
    },
    /// Send a value through an output, then answer [`Notice::Sent`].
    Send {
        /// Echoed in the answer.
        number: u64,
        /// The output.
        port: String,
        /// The value, encoded.
        value: Vec<u8>,
    },
}

/// A message for a port of an activity, from the program that has its ports.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortMessage {
    /// The program gives each number once; the answer bears it.
    pub number: u64,
    /// The port.
    pub port: String,
    /// The value, encoded.
    pub value: Vec<u8>,
    /// A message with a greater priority goes first.
    pub priority: u8,
    /// Whether its sender waits for a receipt.
    pub has_receipt: bool,
    /// How many values of this port have found no room since the last message.
    pub lost: u64,
}

/// The fate of a message for an activity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MessageFate {
    /// The activity has it.
    Taken,
    /// Too many messages wait already.
    Full,
    /// The activity does not run.
    Idle,
}

impl Order {
    /// Returns whether the order has a number: 1 is the first of the program's life. The others concern one
    /// channel.
    pub const fn is_counted(&self) -> bool {
        !matches!(
            self,
            Self::Configure { .. }
                | Self::Resumed { .. }
                | Self::Database { .. }
                | Self::Keys { .. }
                | Self::Secret { .. }
                | Self::Vouch { .. }
                | Self::Judged { .. }
        )
    }
}

/// From the program to the node.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Notice {
    /// First frame on the first channel of a program. It is the first variant in every version, and begins with
    /// these two fields.
    Hello {
        /// [`WIRE_VERSION`](crate::logic::codec::WIRE_VERSION) of the program.
        version: u16,
        /// The instance path the program was started as (`DCA_INSTANCE`).
        instance: String,
        /// Where its data session is; none if it has no ports.
        location: Option<Location>,
        /// Devices whose keys this program owns.
        owns: Vec<String>,
        /// Devices of others that it needs.
        needs: Vec<String>,
        /// Whether it publishes [`crate::logic::signals::Signals`].
        signals: bool,
    },
    /// Every link is up.
    Connected,
    /// A link could not be made.
    ConnectFailed {
        /// The reason, for a person.
        reason: String,
    },
    /// The wires of this generation are switched.
    Switched {
        /// As ordered.
        generation: u64,
    },
    /// Initialised and running.
    Running {
        /// As ordered.
        activation: u32,
    },
    /// Ended normally, after `Stop()`.
    Done {
        /// As ordered.
        activation: u32,
        /// The value that it leaves.
        value: Vec<u8>,
    },
    /// Failed, after `Stop()`.
    Aborted {
        /// As ordered.
        activation: u32,
        /// Why, for a person.
        reason: String,
    },
    /// Stopped as ordered, after `Stop()`.
    Stopped {
        /// As ordered.
        activation: u32,
    },
    /// First frame on each later channel: the program had lost its node. In every version it begins with these two
    /// fields. A node that does not know the program closes the channel.
    Resume {
        /// [`WIRE_VERSION`](crate::logic::codec::WIRE_VERSION) of the program.
        version: u16,
        /// The instance path the program was started as.
        instance: String,
        /// How many counted orders the program has taken since its start.
        orders: u64,
        /// How many counted notices it has made since then.
        notices: u64,
    },
    /// A switch is expected.
    Expecting {
        /// As ordered.
        ticket: u64,
    },
    /// A switch that was expected has come, or is not waited for any longer.
    Taken {
        /// As ordered.
        ticket: u64,
        /// How many values of closed wires were sent and have not arrived, or found no room while they were held back.
        lost: u64,
        /// How many values came after they had been given up, and were dropped.
        late: u64,
        /// Wires that nothing was heard of in time.
        missing: Vec<u32>,
    },
    /// A request to the database of the node.
    Database {
        /// The answers bear it; the program gives each number once on a channel.
        number: u64,
        /// The request, or a word about a watch that has this number.
        request: DatabaseRequest,
    },
    /// How many values of wires have not come, and how many values inputs have refused, since the program began.
    Losses {
        /// The wires that have lost values, each with the number of all values that it has lost.
        wires: Vec<(u32, u64)>,
        /// The inputs that have refused values, because a number in them was not finite, each with the number of all values
        /// that it has refused.
        refused: Vec<(String, u64)>,
    },
    /// Messages over wires that were dropped, because the other end has not sealed them.
    Refused {
        /// Each wire at most once a minute.
        wires: Vec<Refused>,
    },
    /// A user wants to call a procedure of this program, in a team: may the user? Answered by [`Order::Judged`].
    Judge {
        /// The answer bears it; the program gives each number once.
        number: u64,
        /// The call.
        call: UserCall,
    },
    /// Stopped as ordered, after `Stop()`, but work outside of the program may go on.
    StopUnconfirmed {
        /// As ordered.
        activation: u32,
        /// The work that may go on, for a person.
        reason: String,
    },
    /// A message for the activity whose ports this program has. Answered by [`Order::Received`].
    Message(PortMessage),
    /// A value of [`Order::Send`] was sent.
    Sent {
        /// As ordered.
        number: u64,
    },
}

/// A call of a user, as the called program has it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UserCall {
    /// The procedure.
    pub name: String,
    /// The right that the user needs.
    pub access: Access,
    /// The digest of the call, which the user has signed.
    pub digest: [u8; 32],
    /// The signature of the user.
    pub warrant: Warrant,
}

impl Notice {
    /// Returns whether the notice has a number: [`Notice::Hello`] is 1.
    pub const fn is_counted(&self) -> bool {
        !matches!(
            self,
            Self::Resume { .. }
                | Self::Database { .. }
                | Self::Losses { .. }
                | Self::Refused { .. }
                | Self::Judge { .. }
        )
    }
}
