//! What may go wrong in a system.

use super::Loss;

/// What may happen beside what programs do when all is well.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Mode {
    /// Any program may abort at any time.
    pub(crate) aborts: bool,
    /// Programs that are started again when they die may die at any time.
    pub(crate) crashes: bool,
    /// The whole may be stopped at any time.
    pub(crate) stops: bool,
    /// One fault of this kind may happen to this member.
    pub(crate) fault: Option<Injection>,
    /// A second one, before or after it.
    pub(crate) second: Option<Injection>,
    /// This host may be lost.
    pub(crate) lost: Option<Loss>,
    /// What a program on the lost host has come to before may be heard after the loss, until that is noted.
    pub(crate) hears_late: bool,
}

/// A fault, and whom it strikes: a member of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Injection {
    pub(crate) unit: usize,
    pub(crate) member: u32,
    pub(crate) kind: FaultKind,
}

/// What goes wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FaultKind {
    /// The program dies; by its policy it is started again.
    Crash,
    /// The program goes on for ever, but still answers a stop, at the latest by being killed.
    Hang,
    /// Nobody can confirm that the program has stopped.
    Unanswered,
    /// A host is lost, with every program and supervisor there.
    HostLost,
    /// A host reaches no other, and goes on by itself.
    CutOff,
    /// Two hosts do not reach each other.
    LinkLost,
    /// The program dies, and has died too often: it is not started again.
    GivenUp,
    /// The program dies, and the programs of its group have died more often than it bears: the group has failed.
    TooMany,
}
