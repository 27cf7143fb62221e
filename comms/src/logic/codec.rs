//! The envelope around every message: the kind of the message and its version.
//!
//! ```text
//! 'D' 'C' | version: u16 LE | kind: u16 LE | postcard
//! ```
//!
//! A reader refuses a message of another kind or version; it does not guess. Samples on wires have no envelope: both ends know
//! the message type from the same plan.

use crate::logic::control::{Notice, Order};
use crate::logic::signals::{Peaks, Signals};
use crate::logic::tap::{Outputs, Tapped};
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

/// The version of all messages between programs, nodes and the command line. Any change of a message increases it. A reader
/// refuses every other version. From another version it reads only the beginning of [`Notice::Hello`] and [`Notice::Resume`],
/// to name the sender.
pub const WIRE_VERSION: u16 = 1;
const MAGIC: [u8; 2] = *b"DC";
/// The bytes before the message.
pub const HEADER_SIZE: usize = 6;
/// The variant number of [`Notice::Hello`].
const HELLO: u32 = 0;
/// The variant number of [`Notice::Resume`].
const RESUME: u32 = 8;

/// Every kind of message, with its number on the wire. The compiler refuses a number that is already used. Append only: 1..99
/// are messages of this crate, 100.. of nodes, 200.. of other programs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u16)]
pub enum Kind {
    /// [`Order`].
    Order = 1,
    /// [`Notice`].
    Notice = 2,
    /// [`Signals`].
    Signals = 3,
    /// [`Peaks`].
    Peaks = 4,
    /// A request of a stream's caller for the next piece.
    Pull = 6,
    /// A part of a stream of answers.
    Piece = 7,
    /// [`Tapped`].
    Tapped = 8,
    /// [`Outputs`].
    Outputs = 9,
    /// [`Introduction`](crate::logic::tunnel::Introduction): the identity of an end of a tunnel.
    Introduction = 10,
    /// [`Revocations`](crate::logic::tunnel::Revocations): the revoked keys that an end of a tunnel knows.
    Revocations = 11,
    /// [`ObjectCall`](crate::logic::object::ObjectCall): a call of a procedure, or the request to read a state.
    ObjectCall = 12,
    /// [`ObjectAnswer`](crate::logic::object::ObjectAnswer): the answer to an [`ObjectCall`](Self::ObjectCall).
    ObjectAnswer = 13,
    /// [`ObjectCancel`](crate::logic::object::ObjectCancel): a caller does not wait any longer.
    ObjectCancel = 14,
    /// [`Exports`](crate::logic::object::Exports): the exports of a program.
    Exports = 15,
    /// [`TypeForm`](crate::logic::object::TypeForm): the type that the consumer of a wire accepts.
    TypeForm = 16,
    /// [`Boundary`](crate::logic::switch::Boundary): a control message between the values of a wire.
    Boundary = 17,
    /// [`Proof`](crate::logic::proof::Proof): the sender of a message in a team.
    Proof = 19,
    /// [`QueueRequest`](crate::logic::messaging::wire::QueueRequest): a message for a queue.
    QueueRequest = 20,
    /// [`QueueAnswer`](crate::logic::messaging::wire::QueueAnswer): the result for a message.
    QueueAnswer = 21,
    /// [`RouterRequest`](crate::logic::messaging::wire::RouterRequest): a queue subscribes to a router.
    RouterRequest = 22,
    /// [`RouterAnswer`](crate::logic::messaging::wire::RouterAnswer): the answer to a [`RouterRequest`](Self::RouterRequest).
    RouterAnswer = 23,
    /// [`LockRequest`](crate::logic::messaging::wire::LockRequest): a client wants a lock.
    LockRequest = 24,
    /// [`LockAnswer`](crate::logic::messaging::wire::LockAnswer): the answer to a [`LockRequest`](Self::LockRequest).
    LockAnswer = 25,
    /// [`Seal`](crate::logic::seal::Seal): the attachment of a sealed message in a team.
    Seal = 26,
    /// [`Seals`](crate::logic::seal::Seals): the attachment of a sample for several programs in a team.
    Seals = 27,
    /// [`Hello`](crate::logic::direct::Hello): the consumer of a wire connects to its producer on the same host.
    DirectHello = 28,
    /// [`Welcome`](crate::logic::direct::Welcome): the producer's answer to the consumer's `Hello`.
    DirectWelcome = 29,
    /// [`Challenge`](crate::logic::direct::Challenge): in a team, the producer asks the consumer to prove that it is the other
    /// end of the wire.
    DirectChallenge = 30,
    /// [`Claim`](crate::logic::direct::Claim): the consumer's proof that it is the other end.
    DirectClaim = 31,
    /// [`Confirmation`](crate::logic::direct::Confirmation): the producer's proof that it is the other end.
    DirectConfirmation = 32,
    /// A frame of the ordered link between two nodes.
    Frame = 100,
    /// A request to a node.
    Request = 101,
    /// An element of the answer to a request.
    Answer = 102,
    /// A message between two replicas of the database.
    Envelope = 103,
    /// The answer to a ping.
    Pong = 104,
    /// The question whether a node is running.
    Ping = 105,
    /// A message between two nodes of the same name.
    Namesake = 106,
    /// A node's message to another node, whose message it has refused.
    Refusal = 107,
    /// The signed position of a node's audit log.
    AuditHead = 108,
    /// The certificate of a node, to be renewed or renewed.
    Renewing = 109,
}

impl Kind {
    /// Returns the number of the kind on the wire.
    pub const fn number(self) -> u16 {
        self as u16
    }
}

/// A message that travels in an envelope.
pub trait Enveloped: Serialize + DeserializeOwned {
    /// The kind of the message. No other type has the same kind.
    const KIND: Kind;
    /// The most bytes of a message, including the envelope.
    const SIZE_MAX: usize = 16 << 20;
}

impl Enveloped for Order {
    const KIND: Kind = Kind::Order;
}

impl Enveloped for Notice {
    const KIND: Kind = Kind::Notice;
}

impl Enveloped for Signals {
    const KIND: Kind = Kind::Signals;
    const SIZE_MAX: usize = 64 << 10;
}

impl Enveloped for Peaks {
    const KIND: Kind = Kind::Peaks;
    const SIZE_MAX: usize = 64 << 10;
}

impl Enveloped for Tapped {
    const KIND: Kind = Kind::Tapped;
}

impl Enveloped for Outputs {
    const KIND: Kind = Kind::Outputs;
    const SIZE_MAX: usize = 1 << 20;
}

/// Why a message could not be written or read.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum CodecError {
    /// Too many bytes.
    #[error("a message of {size} bytes is longer than the {size_max} allowed for kind {kind}")]
    TooLong {
        /// Expected kind.
        kind: u16,
        /// The size of the message in bytes.
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
    /// The body does not match the envelope.
    #[error("a message of kind {kind} is malformed: {cause}")]
    Body {
        /// Kind of the message.
        kind: u16,
        /// The error of the decoder.
        cause: postcard::Error,
    },
}

/// Returns a message in its envelope.
///
/// # Errors
/// If the message is longer than its kind allows.
pub fn encode<T: Enveloped>(message: &T) -> Result<Vec<u8>, CodecError> {
    encode_in(message, Vec::with_capacity(64))
}

/// Puts a message into its envelope, in an empty buffer.
///
/// # Errors
/// The errors of [`encode`].
pub fn encode_in<T: Enveloped>(message: &T, mut bytes: Vec<u8>) -> Result<Vec<u8>, CodecError> {
    bytes.extend(MAGIC);
    bytes.extend(WIRE_VERSION.to_le_bytes());
    bytes.extend(T::KIND.number().to_le_bytes());
    let bytes =
        postcard::to_extend(message, bytes).map_err(|cause| CodecError::Body { kind: T::KIND.number(), cause })?;
    check_size::<T>(bytes.len())?;
    Ok(bytes)
}

/// Reads a message from its envelope. Both must fill `bytes` exactly.
///
/// # Errors
/// If `bytes` is too long, of another kind or version, or malformed.
pub fn decode<T: Enveloped>(bytes: &[u8]) -> Result<T, CodecError> {
    let (version, body) = open::<T>(bytes)?;
    if version != WIRE_VERSION {
        return Err(CodecError::Version { kind: T::KIND.number(), expected: WIRE_VERSION, found: version });
    }
    let body_error = |cause| CodecError::Body { kind: T::KIND.number(), cause };
    match postcard::take_from_bytes(body).map_err(body_error)? {
        (message, []) => Ok(message),
        _ => Err(body_error(postcard::Error::DeserializeBadEncoding)),
    }
}

/// Reads a notice like [`decode`]. From a [`Notice::Hello`] or [`Notice::Resume`] of another version it reads the version and
/// the sender, which are at the beginning in all versions.
///
/// # Errors
/// The errors of [`decode`].
pub fn decode_notice(bytes: &[u8]) -> Result<Notice, CodecError> {
    let refused = match decode(bytes) {
        Err(error @ CodecError::Version { .. }) => error,
        decoded => return decoded,
    };
    let (version, body) = open::<Notice>(bytes)?;
    match postcard::take_from_bytes::<(u32, u16, String)>(body) {
        Ok(((HELLO, _, instance), _)) => {
            let (location, owns, needs) = (None, Vec::new(), Vec::new());
            Ok(Notice::Hello { version, instance, location, owns, needs, signals: false })
        }
        Ok(((RESUME, _, instance), _)) => Ok(Notice::Resume { version, instance, orders: 0, notices: 0 }),
        Ok(_) | Err(_) => Err(refused),
    }
}

/// Checks the envelope of a message; returns its version, and the bytes behind the envelope.
fn open<T: Enveloped>(bytes: &[u8]) -> Result<(u16, &[u8]), CodecError> {
    check_size::<T>(bytes.len())?;
    let (header, body) = bytes.split_first_chunk::<HEADER_SIZE>().ok_or(CodecError::Foreign)?;
    let [d, c, version @ .., kind_low, kind_high] = *header;
    if [d, c] != MAGIC {
        return Err(CodecError::Foreign);
    }
    let found = u16::from_le_bytes([kind_low, kind_high]);
    if found != T::KIND.number() {
        return Err(CodecError::Kind { expected: T::KIND.number(), found });
    }
    Ok((u16::from_le_bytes(version), body))
}

fn check_size<T: Enveloped>(size: usize) -> Result<(), CodecError> {
    if size > T::SIZE_MAX {
        return Err(CodecError::TooLong { kind: T::KIND.number(), size, size_max: T::SIZE_MAX });
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::bytes::{Bytes, SecretBytes};
    use crate::logic::control::{
        CallRoute, Device, Dial, Incoming, KeyPort, Location, MessageFate, Outgoing, Partner, PortMessage, Shape,
        UserCall,
    };
    use crate::logic::direct::{Challenge, Claim, Confirmation, Hello, Welcome};
    use crate::logic::object::{Access, TypeForm, Warrant};
    use crate::logic::seal::{Refusal, Refused};
    use crate::logic::signals::{Peak, Signal};
    use crate::logic::switch::{Boundary, Expect, Flip, Opening};
    use crate::logic::tap::{InnerOutput, OutputType};
    use crate::logic::time::Time;
    use proptest::prelude::*;
    use std::time::Duration;

    fn check<T: Enveloped + PartialEq + std::fmt::Debug>(message: &T, golden: &str) {
        let bytes = encode(message).unwrap();
        let hex: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, golden, "{message:?}");
        assert_eq!(decode::<T>(&bytes).as_ref(), Ok(message));
    }

    /// These bytes are read by other programs of the same version. If this test fails, the version has to be increased.
    #[test]
    fn golden_orders() {
        let dial = || Dial { session: "a1".into(), locators: vec!["l".into()] };
        let incoming = Incoming { wire: 1, port: "In".into(), key: "k".into(), producer: dial(), pull: false };
        let outgoing = Outgoing { wire: 300, port: "Out".into(), key: "j".into(), pull: true };
        let devices = vec![Device { device: "arm".into(), owner: dial(), deployment: "d".into() }];
        check(
            &Order::Connect { robot: "r".into(), incoming: vec![incoming], outgoing: vec![outgoing], devices },
            "444301000100000172010102496e016b02613101016c0001ac02034f7574016a01010361726d02613101016c0164",
        );
        check(&Order::Open { wires: vec![1, 2], generation: 3 }, "4443010001000102010203");
        check(&Order::Close { wires: vec![], generation: 1 }, "444301000100020001");
        check(&Order::Activate { activation: 9, value: vec![1], since: Time::from_nanos(5) }, "4443010001000309010105");
        check(&Order::Stop { activation: 9 }, "4443010001000409");
        check(&Order::Exit, "44430100010005");
        let parameters = vec![("a".to_owned(), "1".to_owned())];
        check(&Order::Configure { parameters }, "444301000100060101610131");
        let shape = Shape { wire: 1, latch: true, queue: Some(5), period_min: Some(Duration::from_millis(100)) };
        check(&Order::Shape { wires: vec![shape] }, "444301000100070101010105010080c2d72f");
        check(&Order::Rejoin, "44430100010008");
        check(&Order::Relink { lost: "b".into(), found: dial() }, "44430100010009016202613101016c");
        check(&Order::Resumed { notices: 300 }, "4443010001000aac02");
        let (call, path, name) = ("Grip".into(), "m".into(), "G".into());
        let route = CallRoute { wire: 300, call, server: dial(), path, name, deployment: "d".into(), seal: 300 };
        let calls = vec![route];
        check(&Order::Calls { calls }, "4443010001000b01ac02044772697002613101016c016d01470164ac02");
        let open = vec![Opening { wire: 4, after: vec![3] }];
        let flip = Flip { generation: 300, close: vec![3], open };
        check(&Order::Flip { ticket: 2, flip: flip.clone() }, "4443010001000c02ac02010301040103");
        let expect = Expect { generation: 300, close: vec![3], open: vec![4] };
        let port = KeyPort { port: "In".into(), keys: "k/".into(), is_write: true };
        check(&Order::Keys { ports: vec![port] }, "4443010001000f0102496e026b2f01");
        let partner = Partner {
            session: "a1".into(),
            keys: vec![7],
            is_near: true,
            wires: vec![300],
            devices: vec!["arm".into()],
        };
        check(&Order::Partners { partners: vec![partner] }, "444301000100100102613101070101ac02010361726d");
        let secret = Order::Secret { parameter: "p".into(), value: SecretBytes::new(vec![1, 2]) };
        check(&secret, "444301000100110170020102");
        check(&Order::Vouch { delegation: vec![7] }, "444301000100120107");
        check(&Order::Judged { number: 300, refusal: Some("x".into()) }, "44430100010013ac02010178");
        check(&Order::Expect { ticket: 2, expect, then: Some(flip) }, "4443010001000d02ac020103010401ac02010301040103");
    }

    #[test]
    fn golden_notices() {
        let location = Location { session: "a".into(), local: vec!["u".into()], remote: vec![], keys: vec![7] };
        let hello = Notice::Hello {
            version: WIRE_VERSION,
            instance: "m".into(),
            location: Some(location),
            owns: vec![],
            needs: vec!["ft".into()],
            signals: true,
        };
        check(&hello, "4443010002000001016d010161010175000107000102667401");
        check(&Notice::Connected, "44430100020001");
        check(&Notice::ConnectFailed { reason: "x".into() }, "444301000200020178");
        check(&Notice::Switched { generation: 7 }, "4443010002000307");
        check(&Notice::Running { activation: 1 }, "4443010002000401");
        check(&Notice::Done { activation: 1, value: vec![] }, "444301000200050100");
        check(&Notice::Aborted { activation: 1, reason: "x".into() }, "44430100020006010178");
        check(&Notice::Stopped { activation: 1 }, "4443010002000701");
        let resume = Notice::Resume { version: WIRE_VERSION, instance: "m".into(), orders: 300, notices: 7 };
        check(&resume, "4443010002000801016dac0207");
        check(&Notice::Expecting { ticket: 2 }, "4443010002000902");
        let taken = Notice::Taken { ticket: 2, lost: 300, late: 1, missing: vec![4] };
        check(&taken, "4443010002000a02ac02010104");
        let (wires, refused, undelivered) = (vec![(300, 2)], vec![("i".into(), 300)], vec![(3, 300)]);
        let losses = Notice::Losses { wires, refused, undelivered };
        check(&losses, "4443010002000c01ac0202010169ac020103ac02");
        let refused = Refused { wire: 300, count: 2, why: Refusal::Repeated, from: Some("a1".into()) };
        let refused = Notice::Refused { wires: vec![refused] };
        check(&refused, "4443010002000d01ac02020201026131");
        let warrant = Warrant { head: Bytes(vec![1]), body: Bytes(vec![2]) };
        let call = UserCall { name: "G".into(), access: Access::Operate, digest: [7; 32], warrant };
        let judge = Notice::Judge { number: 300, call };
        let bytes = "4443010002000eac02014701";
        check(&judge, &format!("{bytes}{}01010102", "07".repeat(32)));
        let unconfirmed = Notice::StopUnconfirmed { activation: 1, reason: "x".into() };
        check(&unconfirmed, "4443010002000f010178");
        let stopping = Notice::Stopping { activation: 300 };
        check(&stopping, "44430100020012ac02");
        assert!(unconfirmed.is_counted() && stopping.is_counted());
        assert!(!losses.is_counted() && !refused.is_counted() && !judge.is_counted());
        assert!(hello.is_counted() && !resume.is_counted());
        assert!(Order::Exit.is_counted() && !Order::Resumed { notices: 0 }.is_counted());
        assert!(!Order::Configure { parameters: vec![] }.is_counted());
        assert!(!Order::Vouch { delegation: vec![] }.is_counted());
    }

    #[test]
    fn golden_messages_of_activities() {
        check(&Order::Received { number: 300, fate: MessageFate::Full }, "44430100010014ac0201");
        let send = Order::Send { number: 300, port: "p".into(), value: vec![7] };
        check(&send, "44430100010015ac0201700107");
        let (number, port, value) = (300, "p".to_owned(), vec![7]);
        let message = PortMessage { number, port, value, priority: 9, has_receipt: true, lost: 300 };
        let message = Notice::Message(message);
        check(&message, "44430100020010ac02017001070901ac02");
        let sent = Notice::Sent { number: 300 };
        check(&sent, "44430100020011ac02");
        assert!(send.is_counted() && message.is_counted() && sent.is_counted());
    }

    #[test]
    fn golden_boundaries() {
        check(&Boundary::Opened { generation: 300, after: vec![3] }, "44430100110000ac020103");
        check(&Boundary::Closed { generation: 1, sent: 300 }, "4443010011000101ac02");
    }

    #[test]
    fn golden_signals() {
        let value = Signal { name: "a".into(), unit: "N".into(), value: 1.0, headline: true };
        check(
            &Signals { stamp: Time::from_nanos(5), values: vec![value] },
            "44430100030005010161014e000000000000f03f01",
        );
        let signal = Signal { name: "a".into(), unit: "N".into(), value: 1.0, headline: true };
        let values = vec![Peak { signal, age: Duration::from_nanos(3) }];
        let peaks = Peaks { stamp: Time::from_nanos(5), values };
        check(&peaks, "44430100040005010161014e000000000000f03f010003");
    }

    #[test]
    fn golden_direct_paths() {
        let form = TypeForm { name: "W".into(), fields: "x: N".into() };
        check(&Hello { token: "t".into(), key: "k".into(), form }, "444301001c000174016b015704783a204e");
        check(&Welcome { process: 300 }, "444301001d00ac02");
        let of = |byte: &str| byte.repeat(32);
        check(&Challenge { nonce: [1; 32] }, &format!("444301001e00{}", of("01")));
        check(&Claim { nonce: [1; 32], tag: [2; 32] }, &format!("444301001f00{}{}", of("01"), of("02")));
        check(&Confirmation { process: 300, tag: [2; 32] }, &format!("444301002000ac02{}", of("02")));
    }

    #[test]
    fn golden_taps() {
        let tapped = Tapped { number: 300, stamp: Time::from_nanos(5), bytes: vec![7, 8] };
        check(&tapped, "444301000800ac0205020708");
        let output = OutputType { name: "Out".into(), type_name: "W".into(), fields: "x: N".into() };
        let inner = InnerOutput { output: output.clone(), inputs: vec!["b.In".into()] };
        let outputs = Outputs { outputs: vec![output], inner: vec![inner] };
        check(&outputs, "44430100090001034f7574015704783a204e01034f7574015704783a204e0104622e496e");
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
        order[2] = 2;
        assert_eq!(refused(&order), "a message of version 2 of kind 1; this program speaks version 1");
        let long = vec![0; Order::SIZE_MAX + 1];
        assert!(matches!(decode::<Order>(&long), Err(CodecError::TooLong { .. })));
        assert!(encode(&Order::Activate { activation: 0, value: long, since: Time::ZERO }).is_err());
    }

    /// A hello of another version with the same fields, or with further ones, still shows the version of its sender.
    #[test]
    fn a_hello_of_another_version_says_whose_it_is() {
        for (version, hello) in [
            (2, &b"DC\x02\x00\x02\x00\x00\x02\x01m\x00\x00\x00\x00"[..]),
            (300, b"DC\x2c\x01\x02\x00\x00\xac\x02\x01m\x05and more"),
        ] {
            let refused = CodecError::Version { kind: 2, expected: WIRE_VERSION, found: version };
            assert_eq!(decode::<Notice>(hello), Err(refused.clone()));
            let (location, owns, needs) = (None, vec![], vec![]);
            let read = Notice::Hello { version, instance: "m".into(), location, owns, needs, signals: false };
            assert_eq!(decode_notice(hello), Ok(read));
            // Other messages of another version are refused.
            let mut other = hello.to_vec();
            other[HEADER_SIZE] = 1;
            assert_eq!(decode_notice(&other), Err(refused));
        }
        let resume = Notice::Resume { version: 300, instance: "m".into(), orders: 0, notices: 0 };
        assert_eq!(decode_notice(b"DC\x2c\x01\x02\x00\x08\xac\x02\x01m\x05and more"), Ok(resume));
        assert_eq!(decode_notice(&encode(&Notice::Connected).unwrap()), Ok(Notice::Connected));
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
        fn values_round_trip(activation: u32, value: Vec<u8>, since: u64) {
            let order = Order::Activate { activation, value, since: Time::from_nanos(since) };
            prop_assert_eq!(decode::<Order>(&encode(&order).unwrap()), Ok(order));
        }
    }
}
