//! `dca view --foxglove` and `dca replay --foxglove`: the protocol of Foxglove, as pure functions and machines.
//!
//! The topics and schemas are the same as in a record. Nothing is fetched from a robot before a client has subscribed to it.

mod catalog;
mod events;
mod handshake;
mod hub;
mod lasting;
mod layout;
mod mission;
mod order;
mod outbox;
mod parameters;
mod peer;
mod player;
mod protocol;
mod recording;
mod socket;
mod viewer;

pub(crate) use catalog::{ProgramName, Source};
pub(crate) use handshake::{Entrance, Peer, Refusal, origin};
pub(crate) use hub::Hub;
pub(crate) use layout::of_record as layout_of_record;
pub(crate) use order::{Answer, Given, Order, ProcedureCall, Ticket};
pub(crate) use parameters::Parameters;
pub(crate) use peer::{Endpoint, user};
pub(crate) use protocol::{GivenValue, ParameterValue};
pub(crate) use socket::{Ended, Socket};
pub(crate) use viewer::Arrival;

use crate::logic::record::Form;

/// The form of messages that DCA describes itself.
const JSON: Form = Form::Json;
