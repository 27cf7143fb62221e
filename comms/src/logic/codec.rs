//! The envelope around every message: what it is, and which version of it.
//!
//! ```text
//! 'D' 'C' | version: u16 LE | kind: u16 LE | postcard
//! ```
//!
//! A reader refuses a message of another kind or version instead of guessing. Samples on wires go without an envelope:
//! both ends are told the same message type by the same plan.

use crate::logic::control::{self, Notice, Order};
use crate::logic::signals::Signals;
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

const MAGIC: [u8; 2] = *b"DC";
/// The bytes before the message.
pub const HEADER_SIZE: usize = 6;

/// A message that travels in an envelope.
pub trait Enveloped: Serialize + DeserializeOwned {
    /// Its number, unique in DCA: 1..99 belong to this crate, 100.. to nodes, 200.. to others.
    const KIND: u16;
    /// Its version: a change that older readers cannot read needs a new one.
    const VERSION: u16;
    /// The most bytes a message may have, envelope included.
    const SIZE_MAX: usize = 16 << 20;
}

impl Enveloped for Order {
    const KIND: u16 = 1;
    const VERSION: u16 = control::VERSION;
}

impl Enveloped for Notice {
    const KIND: u16 = 2;
    const VERSION: u16 = control::VERSION;
}

impl Enveloped for Signals {
    const KIND: u16 = 3;
    const VERSION: u16 = 1;
    const SIZE_MAX: usize = 64 << 10;
}

/// Why a message was not written or read.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CodecError {
    /// Too many bytes.
    #[error("a message of {size} bytes is longer than the {size_max} allowed for kind {kind}")]
    TooLong {
        /// Expected kind.
        kind: u16,
        /// Its size.
        size: usize,
        /// The limit.
        size_max: usize,
    },
    /// Not DCA's.
    #[error("not a DCA message")]
    Foreign,
    /// Another kind of message than expected.
    #[error("a message of kind {found} instead of kind {expected}")]
    Kind {
        /// Expected kind.
        expected: u16,
        /// Kind of the message.
        found: u16,
    },
    /// Written by another version of DCA.
    #[error("a message of version {found} of kind {kind}; this program speaks version {expected}")]
    Version {
        /// Kind of the message.
        kind: u16,
        /// Expected version.
        expected: u16,
        /// Version of the message.
        found: u16,
    },
    /// The body is not what the envelope says.
    #[error("a message of kind {kind} is malformed: {cause}")]
    Body {
        /// Kind of the message.
        kind: u16,
        /// What the decoder says.
        cause: postcard::Error,
    },
}

/// Returns a message in its envelope.
///
/// # Errors
/// If it is longer than its kind allows.
pub fn encode<T: Enveloped>(message: &T) -> Result<Vec<u8>, CodecError> {
    let mut bytes = Vec::with_capacity(64);
    bytes.extend(MAGIC);
    bytes.extend(T::VERSION.to_le_bytes());
    bytes.extend(T::KIND.to_le_bytes());
    let bytes = postcard::to_extend(message, bytes).map_err(|cause| CodecError::Body { kind: T::KIND, cause })?;
    check_size::<T>(bytes.len())?;
    Ok(bytes)
}

/// Reads a message from its envelope; it must fill `bytes`.
///
/// # Errors
/// If it is too long, of another kind or version, or malformed.
pub fn decode<T: Enveloped>(bytes: &[u8]) -> Result<T, CodecError> {
    check_size::<T>(bytes.len())?;
    let (header, body) = bytes.split_first_chunk::<HEADER_SIZE>().ok_or(CodecError::Foreign)?;
    let [d, c, version @ .., kind_low, kind_high] = *header;
    if [d, c] != MAGIC {
        return Err(CodecError::Foreign);
    }
    let (found, version) = (u16::from_le_bytes([kind_low, kind_high]), u16::from_le_bytes(version));
    if found != T::KIND {
        return Err(CodecError::Kind { expected: T::KIND, found });
    }
    if version != T::VERSION {
        return Err(CodecError::Version { kind: found, expected: T::VERSION, found: version });
    }
    let body_error = |cause| CodecError::Body { kind: T::KIND, cause };
    match postcard::take_from_bytes(body).map_err(body_error)? {
        (message, []) => Ok(message),
        _ => Err(body_error(postcard::Error::DeserializeBadEncoding)),
    }
}

fn check_size<T: Enveloped>(size: usize) -> Result<(), CodecError> {
    if size > T::SIZE_MAX {
        return Err(CodecError::TooLong { kind: T::KIND, size, size_max: T::SIZE_MAX });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::control::{Device, Dial, Incoming, Location, Outgoing, Shape};
    use crate::logic::signals::Signal;
    use crate::logic::time::Time;
    use proptest::prelude::*;
    use std::time::Duration;

    fn check<T: Enveloped + PartialEq + std::fmt::Debug>(message: &T, golden: &str) {
        let bytes = encode(message).unwrap();
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, golden, "{message:?}");
        assert_eq!(decode::<T>(&bytes).as_ref(), Ok(message));
    }

    /// Bytes that other versions rely on: if this fails, the version has to go up.
    #[test]
    fn golden_orders() {
        let dial = || Dial { session: "a1".into(), locators: vec!["l".into()] };
        let incoming = Incoming { wire: 1, port: "In".into(), key: "k".into(), producer: dial(), pull: false };
        let outgoing = Outgoing { wire: 300, port: "Out".into(), key: "j".into(), pull: true };
        let devices = vec![Device { device: "arm".into(), owner: dial() }];
        check(
            &Order::Connect { robot: "r".into(), incoming: vec![incoming], outgoing: vec![outgoing], devices },
            "444301000100000172010102496e016b02613101016c0001ac02034f7574016a01010361726d02613101016c",
        );
        check(&Order::Open { wires: vec![1, 2], generation: 3 }, "4443010001000102010203");
        check(&Order::Close { wires: vec![], generation: 1 }, "444301000100020001");
        check(&Order::Activate { activation: 9, value: vec![1] }, "44430100010003090101");
        check(&Order::Stop { activation: 9 }, "4443010001000409");
        check(&Order::Exit, "44430100010005");
        let parameters = vec![("a".to_owned(), "1".to_owned())];
        check(&Order::Configure { parameters }, "444301000100060101610131");
        let shape = Shape { wire: 1, latch: true, queue: Some(5), period_min: Some(Duration::from_millis(100)) };
        check(&Order::Shape { wires: vec![shape] }, "444301000100070101010105010080c2d72f");
    }

    #[test]
    fn golden_notices() {
        let location = Location { session: "a".into(), local: vec!["u".into()], remote: vec![] };
        let hello = Notice::Hello {
            version: 1,
            instance: "m".into(),
            location: Some(location),
            owns: vec![],
            needs: vec!["ft".into()],
            signals: true,
        };
        check(&hello, "4443010002000001016d01016101017500000102667401");
        check(&Notice::Connected, "44430100020001");
        check(&Notice::ConnectFailed { reason: "x".into() }, "444301000200020178");
        check(&Notice::Switched { generation: 7 }, "4443010002000307");
        check(&Notice::Running { activation: 1 }, "4443010002000401");
        check(&Notice::Done { activation: 1, value: vec![] }, "444301000200050100");
        check(&Notice::Aborted { activation: 1, reason: "x".into() }, "44430100020006010178");
        check(&Notice::Stopped { activation: 1 }, "4443010002000701");
    }

    #[test]
    fn golden_signals() {
        let value = Signal { name: "a".into(), unit: "N".into(), value: 1.0, headline: true };
        check(
            &Signals { stamp: Time::from_nanos(5), values: vec![value] },
            "44430100030005010161014e000000000000f03f01",
        );
    }

    #[test]
    fn refusals() {
        let refused = |bytes: &[u8]| decode::<Order>(bytes).unwrap_err().to_string();
        assert_eq!(refused(b""), "not a DCA message");
        assert_eq!(refused(b"GET / HTTP/1.1"), "not a DCA message");
        let notice = encode(&Notice::Connected).unwrap();
        assert_eq!(refused(&notice), "a message of kind 2 instead of kind 1");
        let mut order = encode(&Order::Exit).unwrap();
        order.push(0);
        assert!(refused(&order).starts_with("a message of kind 1 is malformed"));
        order[2] = 9;
        assert_eq!(refused(&order), "a message of version 9 of kind 1; this program speaks version 1");
        let long = vec![0; Order::SIZE_MAX + 1];
        assert!(matches!(decode::<Order>(&long), Err(CodecError::TooLong { .. })));
        assert!(encode(&Order::Activate { activation: 0, value: long }).is_err());
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_or_refused(bytes: Vec<u8>) {
            drop(decode::<Order>(&bytes));
            let mut framed = encode(&Order::Exit).unwrap();
            framed.truncate(HEADER_SIZE);
            framed.extend(&bytes);
            if let Ok(order) = decode::<Order>(&framed) {
                prop_assert_eq!(decode::<Order>(&encode(&order).unwrap()), Ok(order));
            }
        }

        #[test]
        fn values_round_trip(activation: u32, value: Vec<u8>) {
            let order = Order::Activate { activation, value };
            prop_assert_eq!(decode::<Order>(&encode(&order).unwrap()), Ok(order));
        }
    }
}
