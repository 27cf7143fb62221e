//! The faults that a system may have.

use super::Loss;

/// The events that may happen in addition to the behaviour of programs without faults.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Mode {
    /// Any program may abort at any time.
    pub(crate) aborts: bool,
    /// Programs that are restarted after a death may die at any time.
    pub(crate) crashes: bool,
    /// The whole may be stopped at any time.
    pub(crate) stops: bool,
    /// One fault of this kind may happen to this member.
    pub(crate) fault: Option<Injection>,
    /// A second fault, before or after the first one.
    pub(crate) second: Option<Injection>,
    /// This host may be lost.
    pub(crate) lost: Option<Loss>,
    /// Ends of programs on the lost host may still be reported after the loss, until the loss is noticed.
    pub(crate) hears_late: bool,
}

/// A fault, and the member of a unit that it strikes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Injection {
    pub(crate) unit: usize,
    pub(crate) member: u32,
    pub(crate) kind: FaultKind,
}

/// The kinds of fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FaultKind {
    /// The program dies, and is restarted according to its policy.
    Crash,
    /// The program runs for ever without progress, but still answers a stop, at the latest when it is killed.
    Hang,
    /// The stop of the program is not confirmed.
    Unanswered,
    /// A host is lost, with every program and supervisor there.
    HostLost,
    /// A host cannot reach any other host, and continues by itself.
    CutOff,
    /// Two hosts cannot reach each other.
    LinkLost,
    /// The program dies once too often, and is not restarted.
    GivenUp,
    /// The program dies, and the programs of its group have died more often than the group tolerates. So the group
    /// has failed.
    TooMany,
}
