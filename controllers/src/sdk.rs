//! The kit to write a controller: typed ports, the [`Controller`] trait, and the harnesses that run it.
//!
//! A controller is a struct of inputs, a struct of outputs and one function. It reads no clock, does no I/O and draws
//! no random number. So the same code runs in its own process on the real clock, and together with all others in one
//! thread on virtual time ([`harness`]).
//!
//! ```
//! use controllers::sdk::serde::{Deserialize, Serialize};
//! use controllers::sdk::{About, Arguments, Controller, In, Inputs, Message, Out, Outputs, Progress, Tick};
//! use std::time::Duration;
//!
//! /// In metres.
//! #[derive(Clone, Debug, Serialize, Deserialize)]
//! #[serde(crate = "controllers::sdk::serde")] // Not needed where `serde` is a dependency of one's own.
//! struct Distance {
//!     length: f64,
//! }
//! impl Message for Distance {
//!     const TYPE: &'static str = "Distance";
//!     const FIELDS: &'static str = "length: Length";
//! }
//!
//! #[derive(Inputs)]
//! struct Inputs {
//!     /// The length to double.
//!     #[port("In")]
//!     distance: In<Distance>,
//! }
//!
//! #[derive(Outputs)]
//! struct Outputs {
//!     #[port("Out")]
//!     twice: Out<Distance>,
//! }
//!
//! struct Doubler;
//! impl Controller for Doubler {
//!     type Inputs = Inputs;
//!     type Outputs = Outputs;
//!     const TYPE: &'static str = "Doubler";
//!     fn about() -> About {
//!         About::service("Doubles a length.").every(Duration::from_millis(10)).triggered_by("In")
//!     }
//!     fn new(_: &Arguments) -> Result<Self, String> {
//!         Ok(Self)
//!     }
//!     fn main_calc(&mut self, _: Tick, inputs: &Inputs, outputs: &mut Outputs) -> Progress {
//!         if let Some(distance) = inputs.distance.fresh() {
//!             outputs.twice.send(Distance { length: 2.0 * distance.length });
//!         }
//!         Progress::Continue
//!     }
//! }
//! let mut registry = controllers::sdk::Registry::default();
//! registry.add::<Doubler>();
//! let text = registry.interface_text();
//! assert!(text.contains("type Distance = { length: Length };"));
//! assert!(text.contains("module Doubler(host: Host)") && text.contains("/// The length to double."));
//! ```
//!
//! A mistake in a port is an error at the port:
//!
//! ```compile_fail
//! #[derive(controllers::sdk::Inputs)]
//! struct Inputs {
//!     #[port("In")]
//!     distance: f64, // `f64` is no input port: expected `In<T>`
//! }
//! ```
//!
//! ```compile_fail
//! #[derive(controllers::sdk::Inputs)]
//! struct Inputs {
//!     distance: controllers::sdk::In<f64>, // say which port `distance` is: `#[port("In")]`
//! }
//! ```

mod arguments;
mod arrivals;
mod calls;
mod controller;
mod database;
mod export;
mod finite;
mod group;
pub mod harness;
mod interface;
mod key_ports;
pub mod messaging;
mod module;
mod port;
mod port_interface;
pub mod process;
mod quantity;
mod random;
mod registry;
mod ros;

pub use comms::logic::signals::Signal;
pub use comms::logic::time::Time;
pub use controllers_derive::{Inputs, Outputs};
pub use serde;

pub use comms::logic::bytes::Bytes;
pub use comms::logic::object::{Access, ExportKind, ObjectError};

pub use self::ros::allows_nan;
pub use arguments::{ArgumentError, Arguments, Kind, Parameter};
pub use arrivals::Arrivals;
pub use calls::{Answered, AnyCalls, CallOrder, CallPort, Calls, RawCalls};
pub use comms::logic::control::KeyPort;
pub use controller::{About, Configured, Controller, Outcome, Progress, Schedule, StartValue, Stopping, TAG_MAX, Tick};
pub use database::{
    Change, Database, DatabaseError, DatabaseOrder, DatabasePort, DatabaseRefusal, Entry, Expected, Transaction, TxnId,
    Unknown, Value, ValueError, WatchEvent,
};
pub use export::{Activity, CallInterface, ExportInterface, Exports, RawReply, Reply};
pub use group::{GroupError, InProcessGroup, MemberPort};
pub use interface::{Binding, Device, Direction, InnerOutput, Interface, PortInterface};
pub use key_ports::{KeyAnswer, KeyNews, KeyPorts, KeyPut, KeyResult};
pub use module::{Delivery, DeliveryError, InnerValue, Module, Outlets, Waker};
pub use port::{AnyIn, AnyOut, EVERY_MAX, Every, In, InputPort, InputSet, Message, Out, OutputPort, OutputSet, Unfit};
pub use quantity::Quantity;
pub use random::Random;
pub use registry::{CreateError, Registry};
