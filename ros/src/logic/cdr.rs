//! Values as bytes: CDR, the encoding of ROS 2.
//!
//! The form is XCDR version 1 in little endian. Four bytes declare this form. The fields follow in their order, and each number is at a
//! multiple of its size from there. No bytes can make the reader use more memory than their length justifies. Source: OMG
//! DDS-XTypes 1.3, section 7.4.3.

mod check;
mod reader;
mod value;
mod writer;

pub use check::{are_finite, check, is_finite};
pub use reader::Reader;
pub use value::{Value, read, write};
pub use writer::Writer;

use thiserror::Error;

/// The first bytes of each value: XCDR version 1, little endian, no options.
const HEADER: [u8; 4] = [0, 1, 0, 0];
/// The largest number of bytes that may follow a value, to make its length a multiple of four.
const PADDING_MAX: usize = 3;

/// The reason why bytes cannot be read as a type, or a value cannot be written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum CdrError {
    /// The bytes do not begin with the header of CDR in little endian.
    #[error("the bytes do not begin as CDR in little endian does")]
    Header,
    /// The bytes end within the value.
    #[error("the value ends too early")]
    End,
    /// More bytes follow the value.
    #[error("{0} bytes follow the value")]
    Rest(usize),
    /// A text is not UTF-8, or it contains a zero byte.
    #[error("a text is not UTF-8, or has a zero byte in it")]
    Text,
    /// A truth value is neither 0 nor 1.
    #[error("a truth value is neither 0 nor 1")]
    Truth,
    /// A text or a list is longer than its type allows.
    #[error("a text or a list has {0} elements, more than its type allows")]
    Long(usize),
    /// A value is not of the type with which it is written.
    #[error("the value is not of this type")]
    Type,
}
