//! The control channel between a node and one controller on the same host, over a local Unix socket.
//!
//! Frames are length-prefixed and contain postcard, inside the versioned envelope of [`crate::logic::codec`]. New variants
//! are only appended, since postcard numbers them.
//!
//! The life of a channel: the program connects and sends [`Notice::Hello`]. The node answers [`Order::Connect`] with every
//! link of the program. The program dials them and sends [`Notice::Connected`], or the reason why it cannot. Then it is
//! idle until [`Order::Activate`].
//!
//! If a channel breaks, the program continues. It dials again and sends [`Notice::Resume`]. The node, which may be a
//! successor of the first node, answers [`Order::Resumed`]. Then each side sends the messages that the other side has not
//! received. For this, both sides number orders and notices from the program's start, over all its channels. Messages that
//! concern only one channel have no number ([`Order::is_counted`], [`Notice::is_counted`]).

use crate::logic::bytes::SecretBytes;
use crate::logic::database::{DatabaseAnswer, DatabaseRequest};
use crate::logic::direct::Place;
use crate::logic::object::{Access, Warrant};
use crate::logic::seal::Refused;
use crate::logic::switch::{Expect, Flip};
use crate::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// The longest value that a process may pass on to the next process, in bytes.
pub const VALUE_MAX: usize = 1 << 20;

/// Returns why a process may not pass on a value of `size` bytes. None if this is allowed.
pub fn too_large(size: usize) -> Option<String> {
    (size > VALUE_MAX).then(|| format!("it leaves a value of {size} bytes; {VALUE_MAX} are allowed"))
}

/// The addresses at which a program's data session can be dialled.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Location {
    /// The zenoh id of the session, as lower-case hex.
    pub session: String,
    /// Addresses for programs on the same host: a Unix socket, and the direct path of wires.
    pub local: Vec<String>,
    /// Addresses for programs on other hosts; empty if the node is not open to the network.
    pub remote: Vec<String>,
    /// The public keys that the program made at its start; others use them to seal data for it. Empty outside of a team.
    pub keys: Vec<u8>,
}

/// A program at the other end of wires, or that shares a device. Data for this program is sealed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Partner {
    /// The session of the program.
    pub session: String,
    /// Its public keys, as in its [`Location`].
    pub keys: Vec<u8>,
    /// Whether it runs on the same machine.
    pub is_near: bool,
    /// Numbers of the wires, including the wires of calls.
    pub wires: Vec<u32>,
    /// Devices that one of the two programs owns and the other one uses.
    pub devices: Vec<String>,
}

/// The consumer's end of a data route. Both ends get the same key, `comms::logic::key::wire(..)`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Incoming {
    /// Number of the wire in the plan.
    pub wire: u32,
    /// The consumer's input port.
    pub port: String,
    /// The key on which the producer publishes (push) or answers (pull).
    pub key: String,
    /// The producer's session id, and the locators to dial.
    pub producer: Dial,
    /// Whether the consumer fetches values (pull) instead of receiving them (push).
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
    /// Whether the consumer fetches values (pull) instead of receiving them (push).
    pub pull: bool,
}

/// How data moves on a wire, if the spec defines it. Both ends get this.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shape {
    /// Number of the wire in the plan.
    pub wire: u32,
    /// Whether a consumer gets the last value when the wire is opened.
    pub latch: bool,
    /// How many values may wait for the consumer.
    pub queue: Option<u32>,
    /// The shortest time between two values.
    pub period_min: Option<Duration>,
}

/// A link to the program that owns a device.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Device {
    /// The device: `arm`, `base`, `ft`, `gripper`, `laser`, `camera`.
    pub device: String,
    /// The program that publishes the device's keys.
    pub owner: Dial,
    /// The deployment of that program, whose name is the beginning of the device's keys.
    pub deployment: String,
}

/// The route of a call to another program's export.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct CallRoute {
    /// Number of the wire in the plan. It is opened and closed like a wire for data.
    pub wire: u32,
    /// The call of the caller's interface.
    pub call: String,
    /// The called program.
    pub server: Dial,
    /// The instance path of that program.
    pub path: String,
    /// The procedure or state there.
    pub name: String,
    /// The deployment of that program.
    pub deployment: String,
    /// In a team: the number from which both ends derive the seals of the wire.
    pub seal: u32,
}

/// A port that is connected to keys of the database.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct KeyPort {
    /// The port.
    pub port: String,
    /// A key, or a prefix that ends in `/`.
    pub keys: String,
    /// Whether the program writes the keys; otherwise it reads and watches them.
    pub is_write: bool,
}

impl KeyPort {
    /// Returns whether `key` is one of the keys of this port.
    pub fn covers(&self, key: &str) -> bool {
        if self.keys.ends_with('/') { key.starts_with(&self.keys) } else { key == self.keys }
    }
}

/// A session to dial.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Dial {
    /// The zenoh id of the session.
    pub session: String,
    /// Locators, to be tried in order. For a program on the same host, they may include the locator of its direct path.
    pub locators: Vec<String>,
}

impl Dial {
    /// Returns the locators of the zenoh session, without the direct path.
    pub fn of_session(&self) -> Vec<String> {
        self.locators.iter().filter(|locator| !Place::is_meant(locator)).cloned().collect()
    }

    /// Returns the direct path, if the program has one.
    pub fn direct(&self) -> Option<Place> {
        self.locators.iter().find_map(|locator| Place::of(locator))
    }
}

/// From the node to the program.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Order {
    /// Make every link; the wires stay closed.
    Connect {
        /// Prefix of device keys: the robot's name.
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
        /// The generation of the order.
        generation: u64,
    },
    /// Close these outgoing wires, then answer [`Notice::Switched`].
    Close {
        /// Wire numbers.
        wires: Vec<u32>,
        /// The generation of the order.
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
    /// Call `Stop()`, then report [`Notice::Stopped`], or the outcome already reached.
    Stop {
        /// The activation to stop; the order is ignored if it names an older one.
        activation: u32,
    },
    /// End the program: stop if running, close the session, exit with code 0.
    Exit,
    /// Parameter values from the database, which have precedence over the arguments of the spec. They replace the values of
    /// the previous `Configure`.
    Configure {
        /// Parameter names, each with its value as a spec spells it.
        parameters: Vec<(String, String)>,
    },
    /// How data moves on some wires, where the spec differs from the ports. Comes before [`Order::Connect`].
    Shape {
        /// The shapes, one for each wire.
        wires: Vec<Shape>,
    },
    /// The deployment already runs, and this program was restarted. Comes before [`Order::Connect`], which then does not
    /// wait long: absent programs are linked later, when they can be reached.
    Rejoin,
    /// A program that this program dials was restarted, and has another address now.
    Relink {
        /// The previous session of that program.
        lost: String,
        /// The present session and locators of that program.
        found: Dial,
    },
    /// The answer to [`Notice::Resume`], and the first order after it: the node knows the program. The program sends again
    /// all notices after the number `notices`.
    Resumed {
        /// How many counted notices the node has received since the program's start.
        notices: u64,
    },
    /// The complete set of the program's calls to others. Comes before [`Order::Connect`].
    Calls {
        /// The routes. A route that was open before stays open; all others are closed.
        calls: Vec<CallRoute>,
    },
    /// Flip these outgoing wires between two values, then answer [`Notice::Switched`].
    Flip {
        /// Echoed in the answer.
        ticket: u64,
        /// The wires.
        flip: Flip,
    },
    /// Expect a switch of inputs: answer [`Notice::Expecting`] at once, and [`Notice::Taken`] when the switch has arrived.
    Expect {
        /// Echoed in the answers.
        ticket: u64,
        /// The inputs.
        expect: Expect,
        /// Outgoing wires to flip once the program has processed everything that came before the switch.
        then: Option<Flip>,
    },
    /// The database answers.
    Database {
        /// The number of the request.
        number: u64,
        /// The answer, or the next part of the answer.
        answer: DatabaseAnswer,
    },
    /// The ports that are connected to keys of the database. If there are such ports, this is the first order of a
    /// program's life.
    Keys {
        /// Each port with its keys.
        ports: Vec<KeyPort>,
    },
    /// In a team: the complete set of programs at the other ends of wires and calls. Comes before [`Order::Connect`], and
    /// again when one of these programs was restarted.
    Partners {
        /// Each program with the wires to it.
        partners: Vec<Partner>,
    },
    /// The present value of a secret parameter. It replaces the value with which the program was started.
    Secret {
        /// The parameter.
        parameter: String,
        /// The value.
        value: SecretBytes,
    },
    /// In a team: the signed proof for programs of other hosts that the node has started this program. It covers the keys
    /// of the program's [`Location`].
    Vouch {
        /// A delegation, in the form of the room `trust`.
        delegation: Vec<u8>,
    },
    /// The answer to [`Notice::Judge`]: whether a user may make a call.
    Judged {
        /// The number of the question.
        number: u64,
        /// The reason, for people, why the user may not do this. None if the user may do it.
        refusal: Option<String>,
    },
    /// The fate of a [`Notice::Message`].
    Received {
        /// The number of the message.
        number: u64,
        /// The fate of the message.
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

/// A message for a port of an activity. It comes from the program that has the ports of this activity.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortMessage {
    /// The number of the message, which the program uses only once. The answer repeats it.
    pub number: u64,
    /// The port.
    pub port: String,
    /// The value, encoded.
    pub value: Vec<u8>,
    /// Messages of greater priority go first.
    pub priority: u8,
    /// Whether the sender of the message waits for a receipt.
    pub has_receipt: bool,
    /// How many values of this port were lost for lack of room since the last message.
    pub lost: u64,
}

/// The fate of a message for an activity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum MessageFate {
    /// The activity has accepted the message.
    Taken,
    /// Too many messages wait already.
    Full,
    /// The activity is not running.
    Idle,
}

impl Order {
    /// Returns whether the order is counted; the first counted order of a program's life is number 1. The other orders
    /// concern one channel only.
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
    /// The first frame on the first channel of a program. In every version this is the first variant, and begins with the
    /// fields `version` and `instance`.
    Hello {
        /// [`WIRE_VERSION`](crate::logic::codec::WIRE_VERSION) of the program.
        version: u16,
        /// The instance path with which the program was started (`DCA_INSTANCE`).
        instance: String,
        /// The address of its data session; none if the program has no ports.
        location: Option<Location>,
        /// Devices whose keys this program owns.
        owns: Vec<String>,
        /// Devices of other programs that this program uses.
        needs: Vec<String>,
        /// Whether the program publishes [`crate::logic::signals::Signals`].
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
        /// The value for the next process.
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
    /// The first frame on each later channel: the program has lost its node and connects again. In every version it begins
    /// with the fields `version` and `instance`. A node that does not know the program closes the channel.
    Resume {
        /// [`WIRE_VERSION`](crate::logic::codec::WIRE_VERSION) of the program.
        version: u16,
        /// The instance path with which the program was started.
        instance: String,
        /// How many counted orders the program has received since its start.
        orders: u64,
        /// How many counted notices the program has made since its start.
        notices: u64,
    },
    /// The answer to [`Order::Expect`]: the program expects a switch.
    Expecting {
        /// As ordered.
        ticket: u64,
    },
    /// An expected switch has arrived, or the program does not wait for it any longer.
    Taken {
        /// As ordered.
        ticket: u64,
        /// How many values of closed wires were sent but did not arrive, or were lost for lack of room while they were held
        /// back.
        lost: u64,
        /// How many values arrived after they were counted as lost, and were dropped.
        late: u64,
        /// Wires on which nothing arrived in time.
        missing: Vec<u32>,
    },
    /// A request to the database of the node.
    Database {
        /// The number of the request, which the program uses only once on a channel. The answers repeat it.
        number: u64,
        /// The request, or a message about the watch with this number.
        request: DatabaseRequest,
    },
    /// The losses since the program began: values of wires that did not arrive, and values that inputs have refused.
    Losses {
        /// The wires that have lost values, each with the number of lost values.
        wires: Vec<(u32, u64)>,
        /// The inputs that have refused values because a number in them was not finite, each with the number of refused
        /// values.
        refused: Vec<(String, u64)>,
        /// The wires of outputs whose consumer is not connected, each with the number of values that were sent without
        /// it. A consumer that is connected again counts these values itself.
        undelivered: Vec<(u32, u64)>,
    },
    /// Messages over wires that were dropped because they were not sealed by the other end.
    Refused {
        /// Each wire at most once a minute.
        wires: Vec<Refused>,
    },
    /// In a team: asks whether a user may call a procedure of this program. Answered by [`Order::Judged`].
    Judge {
        /// The number of the question, which the program uses only once. The answer repeats it.
        number: u64,
        /// The call.
        call: UserCall,
    },
    /// Stopped as ordered, after `Stop()`. But work outside of the program may continue.
    StopUnconfirmed {
        /// As ordered.
        activation: u32,
        /// The work that may continue, for people.
        reason: String,
    },
    /// A message for the activity whose ports belong to this program. Answered by [`Order::Received`].
    Message(PortMessage),
    /// A value of [`Order::Send`] was sent.
    Sent {
        /// As ordered.
        number: u64,
    },
    /// The controller has ended this activation by itself, and its `Stop()` begins. The node limits the time of the stop.
    Stopping {
        /// As ordered.
        activation: u32,
    },
}

/// A call of a user, as the called program has received it.
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
    /// Returns whether the notice is counted; [`Notice::Hello`] is number 1.
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
