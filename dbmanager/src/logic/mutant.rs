//! Planted bugs, to show that the simulation would find them.
//!
//! Without the feature `mutants` each question below is answered "no" at compile time.

/// A planted bug.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mutant {
    /// No bug.
    #[default]
    None,
    /// A write does not replace what it saw.
    ContextIgnored,
    /// A write replaces what it did not see.
    SiblingsDropped,
    /// A deletion leaves nothing behind.
    TombstoneAtOnce,
    /// Garbage is what each member has said it has, whether or not its transactions are all here.
    AckFirst,
    /// Garbage is what those have whom one can reach.
    ReachableOnly,
    /// Stamps come from the wall clock alone.
    WallClock,
    /// Stamps of others are not looked at.
    StampsUnseen,
    /// A transaction is taken before its causes.
    GuardOpen,
    /// A transaction is taken although one before it is missing.
    GapTaken,
    /// Half of the writes of a transaction of others are forgotten.
    HalfApplied,
    /// The answer goes out before the disk has it.
    AckBeforeDisk,
    /// A snapshot replaces transactions that it does not have.
    SnapshotLoses,
    /// A store that has lost its identity goes on under the old one.
    Reuse,
    /// A replica that was moved to a new origin forgets what it had not told.
    RejoinForgets,
    /// Transactions that moved to a new origin keep their old view of deletions.
    FloorForgotten,
    /// A retired origin no longer counts at once.
    RetireAtOnce,
    /// A peer that is retired is answered as before.
    RetiredServed,
    /// Nobody pulls: only what is pushed arrives.
    PushOnly,
    /// A pull that gets no answer is waited for.
    PullForEver,
    /// Only the own transactions are given to others.
    NoRelay,
    /// A new member is not counted until it has written.
    JoinerUncounted,
    /// The log is cut as far as oneself has read.
    LogCutAtOwn,
    /// The winner among siblings is who came last.
    LastArrivalWins,
}

impl Mutant {
    /// Every planted bug.
    pub const ALL: [Self; 23] = [
        Self::ContextIgnored,
        Self::SiblingsDropped,
        Self::TombstoneAtOnce,
        Self::AckFirst,
        Self::ReachableOnly,
        Self::WallClock,
        Self::StampsUnseen,
        Self::GuardOpen,
        Self::GapTaken,
        Self::HalfApplied,
        Self::AckBeforeDisk,
        Self::SnapshotLoses,
        Self::Reuse,
        Self::RejoinForgets,
        Self::FloorForgotten,
        Self::RetireAtOnce,
        Self::RetiredServed,
        Self::PushOnly,
        Self::PullForEver,
        Self::NoRelay,
        Self::JoinerUncounted,
        Self::LogCutAtOwn,
        Self::LastArrivalWins,
    ];

    /// Returns whether `bug` is planted.
    pub(crate) const fn is(self, bug: Self) -> bool {
        cfg!(feature = "mutants") && self as u8 == bug as u8
    }
}
