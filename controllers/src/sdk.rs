//! What it takes to write a controller: typed ports, the [`Controller`] trait, and what runs it.
//!
//! A controller is a struct of inputs, a struct of outputs and one function. It reads no clock, does no I/O and draws no
//! random number, so the same code runs in its own process on the real clock, and beside all others in one thread on
//! virtual time ([`harness`]).
//!
//! ```
//! use controllers::sdk::{About, Arguments, Controller, Message, Progress, Tick};
//! use serde::{Deserialize, Serialize};
//! use std::time::Duration;
//!
//! /// In metres.
//! #[derive(Clone, Debug, Serialize, Deserialize)]
//! struct Distance {
//!     length: f64,
//! }
//! impl Message for Distance {
//!     const TYPE: &'static str = "Distance";
//!     const FIELDS: &'static str = "length: Length";
//! }
//! controllers::inputs! {
//!     /// What it hears.
//!     struct Inputs {
//!         /// The length to double.
//!         distance: Distance = wire("In"),
//!     }
//! }
//! controllers::outputs! {
//!     /// What it says.
//!     struct Outputs {
//!         /// Twice the length.
//!         twice: Distance = wire("Out"),
//!     }
//! }
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
//! assert!(text.contains("module Doubler(host: Host)"));
//! ```

mod arguments;
mod controller;
pub mod harness;
mod interface;
mod module;
mod port;
pub mod process;
mod random;
mod registry;

pub use arguments::{ArgumentError, Arguments, Kind, Parameter};
pub use controller::{About, Configured, Controller, Outcome, Progress, Schedule, Stopping, TAG_MAX, Tick};
pub use interface::{Binding, Device, Direction, Interface, PortInterface};
pub use module::{Delivery, DeliveryError, Module};
pub use port::{AnyIn, AnyOut, In, InputSet, Message, Out, OutputSet};
pub use random::Random;
pub use registry::{CreateError, Registry};
