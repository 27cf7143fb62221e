//! The object level: a program exports procedures and state, and other programs call and read them.
//!
//! A call is one message to the program (`key::object`), and has one answer. Both ends send the types of argument and
//! result. So two programs that were built from different definitions refuse each other instead of misreading bytes. A
//! caller that does not wait any longer sends [`ObjectCancel`]. A call that has not begun is then never carried out.
//!
//! An unknown result is shown as such: after [`ObjectError::Deadline`] and [`ObjectError::Gone`] the call may have
//! been carried out.

mod table;

pub use table::{Admission, BEGIN_WITHIN, CallTable, Next, PER_CALLER_MAX, WAITING_MAX, begins_by};

use crate::logic::bytes::Bytes;
use crate::logic::codec::{Enveloped, Kind};
use crate::logic::human::span;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::time::Duration;
use thiserror::Error;

/// The most bytes of an argument or a result.
pub const PAYLOAD_SIZE_MAX: usize = 8 << 20;

/// Identifies a call: the session of its caller, and its number in that session.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct CallId {
    /// The data session of the caller, as in a `Dial`.
    pub session: String,
    /// The number of the call in that session.
    pub number: u64,
}

/// A call of a procedure, or a request to read a state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ObjectCall {
    /// The name of the call.
    pub id: CallId,
    /// The caller, for people: `main/task`, or `dca`.
    pub caller: String,
    /// The procedure or state.
    pub name: String,
    /// The types as the caller knows them.
    pub signature: Signature,
    /// How long the caller waits.
    pub within: Duration,
    /// The encoded argument; none for a state.
    pub argument: Bytes,
    /// In a team: the signature of a user. Programs that the spec connects need none, and neither does a call that
    /// only looks.
    pub warrant: Option<Warrant>,
}

/// A request with the signature of a user, in the form of the room `trust`. Only a node checks it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warrant {
    /// The request, its time and its user, with the signature.
    pub head: Bytes,
    /// The bytes that the signature covers.
    pub body: Bytes,
}

/// The right that a user of a team needs to call a procedure. Programs do not need it: the spec connects them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Access {
    /// To look: the procedure changes nothing.
    Look,
    /// To operate running programs.
    #[default]
    Operate,
    /// To start and stop deployments.
    Deploy,
}

/// The answer to an [`ObjectCall`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ObjectAnswer {
    /// The encoded result.
    Done(Bytes),
    /// The call has no result.
    Failed(ObjectError),
}

/// A caller waits no more.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ObjectCancel {
    /// The call.
    pub id: CallId,
}

/// The types of a procedure: `Force { newton: Force } -> Width { metre: Length }`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Signature {
    /// The type of the argument.
    pub argument: TypeForm,
    /// The type of the result.
    pub result: TypeForm,
}

/// A type, with its fields if they are declared.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct TypeForm {
    /// The name of the type; empty for a procedure without such a value.
    pub name: String,
    /// Its fields, as a spec spells them; empty if they are not declared.
    pub fields: String,
}

/// The exports of a program.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exports {
    /// In order of declaration.
    pub exports: Vec<Exported>,
}

/// A procedure or a state.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exported {
    /// The name of the export.
    pub name: String,
    /// The kind of the export.
    pub kind: ExportKind,
    /// The types of the export.
    pub signature: Signature,
    /// A description in one sentence; may be empty.
    pub doc: String,
    /// Whether a call is answered while the process is idle.
    pub is_answered_idle: bool,
    /// The right that a user needs. For a state it is `Look`.
    pub access: Access,
}

/// The kinds of exports.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ExportKind {
    /// Something to call.
    Procedure,
    /// Something to read.
    State,
}

/// Why a call has no result.
#[derive(Clone, Debug, Error, PartialEq, Eq, Serialize, Deserialize)]
pub enum ObjectError {
    /// No running program has this name.
    #[error("no running process is called `{name}`")]
    NoSuchName {
        /// As asked for.
        name: String,
    },
    /// The program has no export of this name.
    #[error("it exports no `{name}`; {}", known_words(.known))]
    NoSuchProcedure {
        /// As asked for.
        name: String,
        /// The names of its exports.
        known: Vec<String>,
    },
    /// The two ends have different types.
    #[error(
        "`{name}` is `{theirs}` there, and `{ours}` here: one of the two programs was built with another definition"
    )]
    WrongType {
        /// The procedure.
        name: String,
        /// The types of the program that exports it.
        theirs: Box<Signature>,
        /// The types of the caller.
        ours: Box<Signature>,
    },
    /// The program's reason.
    #[error("{reason}")]
    Refused {
        /// For a person.
        reason: String,
    },
    /// No answer in time.
    #[error("no answer within {}; the call may have been carried out", span(*.within))]
    Deadline {
        /// The time given.
        within: Duration,
    },
    /// The program has ended, or the way to it is lost.
    #[error("the program has ended, or was cut off, without an answer; the call may have been carried out")]
    Gone,
    /// Too many bytes.
    #[error("{size} bytes are more than the {size_max} that a call can have")]
    TooLarge {
        /// Their number.
        size: u64,
        /// The limit.
        size_max: u64,
    },
    /// Too many calls wait.
    #[error("{waiting} calls are already waiting at this program")]
    Busy {
        /// Their number.
        waiting: u32,
    },
    /// The spec does not connect this call, or the connection is closed now.
    #[error("`{name}` is not connected to anything at this time")]
    NotConnected {
        /// The name of the called export.
        name: String,
    },
    /// The program has passed the call on, and has got no answer.
    #[error("{reason}; the call may have been carried out")]
    Unanswered {
        /// For a person.
        reason: String,
    },
}

impl ObjectError {
    /// Checks a size of `size` bytes.
    ///
    /// # Errors
    /// [`ObjectError::TooLarge`] if the size exceeds the limit.
    pub fn check_size(size: usize) -> Result<(), Self> {
        if size <= PAYLOAD_SIZE_MAX {
            return Ok(());
        }
        let count = |size| u64::try_from(size).unwrap_or(u64::MAX);
        Err(Self::TooLarge { size: count(size), size_max: count(PAYLOAD_SIZE_MAX) })
    }

    /// Returns whether the call may have been carried out despite the error.
    pub fn may_have_happened(&self) -> bool {
        matches!(self, Self::Deadline { .. } | Self::Gone | Self::Unanswered { .. })
    }

    /// Returns advice for people; empty if the error itself contains it.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::NoSuchName { .. } => "`dca list` shows what runs",
            Self::NoSuchProcedure { .. } | Self::WrongType { .. } => {
                "`dca list` shows what is exported, with its types"
            }
            Self::Refused { .. } | Self::Unanswered { .. } => "",
            Self::Deadline { .. } => "`--within` gives the program more time; `dca status` shows whether it runs",
            Self::Gone => "`dca status` shows whether the program runs",
            Self::TooLarge { .. } => "send large data over a connection",
            Self::Busy { .. } => "try again later, or call less often",
            Self::NotConnected { .. } => "`internal_connections` connects it",
        }
    }
}

fn known_words(known: &[String]) -> String {
    if known.is_empty() { "it exports nothing".to_owned() } else { format!("its exports are `{}`", known.join("`, `")) }
}

impl Signature {
    /// Returns whether each end can read the values of the other end: the names are equal, and if
    /// both ends declare fields, the fields are equal.
    pub fn fits(&self, other: &Self) -> bool {
        self.argument.fits(&other.argument) && self.result.fits(&other.result)
    }
}

impl TypeForm {
    /// Returns a type with its fields, which are brought into their standard form.
    pub fn new(name: &str, fields: &str) -> Self {
        Self { name: name.to_owned(), fields: fields.trim().trim_end_matches(',').trim_end().to_owned() }
    }

    /// Returns whether both may be the same type: the names are equal, and if both declare fields,
    /// the fields are equal.
    pub fn fits(&self, other: &Self) -> bool {
        let bare = |fields: &str| fields.chars().filter(|c| !c.is_whitespace()).collect::<String>();
        let is_open = self.fields.is_empty() || other.fields.is_empty();
        self.name == other.name && (is_open || bare(&self.fields) == bare(&other.fields))
    }
}

impl fmt::Display for TypeForm {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.name.as_str(), self.fields.as_str()) {
            ("", _) => f.write_str("()"),
            (name, "") => f.write_str(name),
            (name, fields) => write!(f, "{name} {{ {fields} }}"),
        }
    }
}

impl fmt::Display for Signature {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.argument.name.is_empty() {
            write!(f, "{}", self.result)
        } else {
            write!(f, "{} -> {}", self.argument, self.result)
        }
    }
}

impl fmt::Display for Access {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Look => "look",
            Self::Operate => "operate",
            Self::Deploy => "deploy",
        })
    }
}

impl From<Result<Vec<u8>, ObjectError>> for ObjectAnswer {
    fn from(result: Result<Vec<u8>, ObjectError>) -> Self {
        match result.and_then(|bytes| ObjectError::check_size(bytes.len()).map(|()| bytes)) {
            Ok(bytes) => Self::Done(Bytes(bytes)),
            Err(error) => Self::Failed(error),
        }
    }
}

impl From<ObjectAnswer> for Result<Vec<u8>, ObjectError> {
    fn from(answer: ObjectAnswer) -> Self {
        match answer {
            ObjectAnswer::Done(Bytes(bytes)) => Ok(bytes),
            ObjectAnswer::Failed(error) => Err(error),
        }
    }
}

impl Enveloped for ObjectCall {
    const KIND: Kind = Kind::ObjectCall;
}

impl Enveloped for ObjectAnswer {
    const KIND: Kind = Kind::ObjectAnswer;
}

impl Enveloped for ObjectCancel {
    const KIND: Kind = Kind::ObjectCancel;
    const SIZE_MAX: usize = 1 << 10;
}

impl Enveloped for TypeForm {
    const KIND: Kind = Kind::TypeForm;
    const SIZE_MAX: usize = 1 << 20;
}

impl Enveloped for Exports {
    const KIND: Kind = Kind::Exports;
    const SIZE_MAX: usize = 1 << 20;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::codec::{decode, encode};

    fn signature(fields: &str) -> Signature {
        Signature { argument: TypeForm::new("Force", fields), result: TypeForm::new("Width", "") }
    }

    fn check<T: Enveloped + PartialEq + fmt::Debug>(message: &T, golden: &[u8]) {
        let bytes = encode(message).unwrap();
        assert_eq!(bytes, golden, "{message:?}");
        assert_eq!(decode::<T>(&bytes).as_ref(), Ok(message));
    }

    /// The exact bytes of each message. If this test fails, the version has to be increased.
    #[test]
    fn golden_messages() {
        let id = || CallId { session: "a1".into(), number: 300 };
        let warrant = Some(Warrant { head: Bytes(vec![1]), body: Bytes(vec![2, 3]) });
        let call = ObjectCall {
            id: id(),
            caller: "m".into(),
            name: "Grip".into(),
            signature: signature("n: N"),
            within: Duration::new(1, 5),
            argument: Bytes(vec![7, 8]),
            warrant,
        };
        check(
            &call,
            b"DC\x01\x00\x0c\x00\x02a1\xac\x02\x01m\x04Grip\x05Force\x04n: N\x05Width\x00\x01\x05\x02\x07\x08\x01\x01\x01\x02\x02\x03",
        );
        check(&ObjectAnswer::Done(Bytes(vec![9])), b"DC\x01\x00\x0d\x00\x00\x01\x09");
        check(&TypeForm::new("W", "x: N"), b"DC\x01\x00\x10\x00\x01W\x04x: N");
        check(&ObjectCancel { id: id() }, b"DC\x01\x00\x0e\x00\x02a1\xac\x02");
        let export = |kind, is_answered_idle| Exported {
            name: "x".into(),
            kind,
            signature: Signature::default(),
            doc: "d".into(),
            is_answered_idle,
            access: if kind == ExportKind::State { Access::Look } else { Access::Deploy },
        };
        let exports = Exports { exports: vec![export(ExportKind::Procedure, false), export(ExportKind::State, true)] };
        let golden =
            b"DC\x01\x00\x0f\x00\x02\x01x\x00\x00\x00\x00\x00\x01d\x00\x02\x01x\x01\x00\x00\x00\x00\x01d\x01\x00";
        check(&exports, golden);
    }

    #[test]
    fn golden_errors() {
        let failed = |error: ObjectError, golden: &[u8]| {
            check(&ObjectAnswer::Failed(error), &[b"DC\x01\x00\x0d\x00\x01", golden].concat());
        };
        failed(ObjectError::NoSuchName { name: "a".into() }, b"\x00\x01a");
        failed(ObjectError::NoSuchProcedure { name: "a".into(), known: vec!["b".into()] }, b"\x01\x01a\x01\x01b");
        let (theirs, ours) = (Box::new(signature("")), Box::new(Signature::default()));
        failed(
            ObjectError::WrongType { name: "a".into(), theirs, ours },
            b"\x02\x01a\x05Force\x00\x05Width\x00\x00\x00\x00\x00",
        );
        failed(ObjectError::Refused { reason: "no".into() }, b"\x03\x02no");
        failed(ObjectError::Deadline { within: Duration::new(2, 0) }, b"\x04\x02\x00");
        failed(ObjectError::Gone, b"\x05");
        failed(ObjectError::TooLarge { size: 300, size_max: 1 }, b"\x06\xac\x02\x01");
        failed(ObjectError::Busy { waiting: 3 }, b"\x07\x03");
        failed(ObjectError::NotConnected { name: "a".into() }, b"\x08\x01a");
        failed(ObjectError::Unanswered { reason: "no".into() }, b"\x09\x02no");
    }

    #[test]
    fn types_fit_where_nothing_says_otherwise() {
        let fits = |one: &str, other: &str| signature(one).fits(&signature(other));
        assert!(fits("a: Force, b: Length", " a:Force,b: Length, ") && fits("", "a: Force") && fits("a: Force", ""));
        assert!(!fits("a: Force", "a: Torque") && !signature("").fits(&Signature::default()));
        assert_eq!(signature("a: Force, ").to_string(), "Force { a: Force } -> Width");
        let state = Signature { argument: TypeForm::default(), result: TypeForm::new("Width", "") };
        assert_eq!((state.to_string(), Signature::default().to_string()), ("Width".to_owned(), "()".to_owned()));
    }

    #[test]
    fn an_error_says_what_is_known_and_no_more() {
        let deadline = ObjectError::Deadline { within: Duration::from_millis(1500) };
        assert_eq!(deadline.to_string(), "no answer within 1.5 s; the call may have been carried out");
        assert!(deadline.may_have_happened() && ObjectError::Gone.may_have_happened());
        let wrong = ObjectError::WrongType {
            name: "Grip".into(),
            theirs: Box::new(signature("a: Force")),
            ours: Box::new(signature("a: Torque")),
        };
        assert!(
            wrong
                .to_string()
                .starts_with("`Grip` is `Force { a: Force } -> Width` there, and `Force { a: Torque } -> Width` here")
        );
        let missing = |known: &[&str]| ObjectError::NoSuchProcedure {
            name: "Grab".into(),
            known: known.iter().map(|&name| name.to_owned()).collect(),
        };
        assert_eq!(
            missing(&["Grip", "opening"]).to_string(),
            "it exports no `Grab`; its exports are `Grip`, `opening`"
        );
        assert_eq!(missing(&[]).to_string(), "it exports no `Grab`; it exports nothing");
        assert!(!wrong.may_have_happened() && !missing(&[]).may_have_happened());
        let large = ObjectAnswer::from(Ok(vec![0; PAYLOAD_SIZE_MAX + 1]));
        assert!(matches!(large, ObjectAnswer::Failed(ObjectError::TooLarge { .. })));
    }
}
