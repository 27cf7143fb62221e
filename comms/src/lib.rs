//! The messages between DCA's programs, and how they travel.
//!
//! [`logic`] is the vocabulary, without I/O: points in time, keys, the envelope around every message, frames for stream
//! sockets, queue policies, and the messages of the control channel. [`io`] has the clock and the sockets:
//!
//! - a *node* opens [`io::session::Session`]: calls, streams, presence of other nodes, node-to-node messages;
//! - a *controller* opens [`io::data::DataSession`]: data goes from controller to controller over links dialled from
//!   consumer to producer, never through a node;
//! - a node and a controller communicate over [`io::control`], a Unix socket between the node and this controller.
//!
//! ```
//! use comms::logic::codec;
//! use comms::logic::control::Order;
//!
//! let bytes = codec::encode(&Order::Exit)?;
//! assert_eq!(codec::decode::<Order>(&bytes)?, Order::Exit);
//! assert_eq!(comms::logic::key::wire("door", 3, 7), "dca/d/door/3/w/7");
//! # Ok::<(), codec::CodecError>(())
//! ```

pub mod io;
pub mod logic;
