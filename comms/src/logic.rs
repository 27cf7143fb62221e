//! Messages, keys, frames and queue policies, without I/O.

pub mod bytes;
pub mod codec;
pub mod control;
pub mod database;
pub mod decode;
pub mod direct;
pub mod frame;
pub mod human;
pub mod key;
pub mod layout;
pub mod messaging;
pub mod object;
pub mod pace;
pub mod port;
pub mod proof;
pub mod random;
pub mod replay;
pub mod seal;
pub mod signals;
pub mod switch;
pub mod tap;
pub mod time;
pub mod tunnel;
