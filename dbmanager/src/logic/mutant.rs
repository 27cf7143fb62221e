//! Planted bugs, to show that the simulation would find them.
//!
//! Without the feature `mutants` each question below is answered "no" at compile time.

macro_rules! bugs {
    ($($(#[$story:meta])* $bug:ident,)*) => {
        /// A planted bug.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Mutant {
            $($(#[$story])* $bug,)*
        }

        impl Mutant {
            /// Every planted bug.
            pub const ALL: &[Self] = &[$(Self::$bug),*];
        }
    };
}

bugs! {
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
    /// A caller whose time is over is not told so.
    TicketForgotten,
    /// The own disk counts as one of the others.
    SelfCounted,
    /// A log that begins after a snapshot forgets what had been seen.
    HeadsWithoutContext,
    /// After a restart the clock begins at zero.
    ClockForgotten,
    /// Epochs of others are not looked at.
    EpochUnseen,
    /// What is brought in takes nothing away.
    TakesForgotten,
    /// The head of an origin is not written to the disk.
    HeadNotStored,
    /// What a transaction has written is not written to the disk, the transaction is.
    VersionsNotStored,
    /// Of two that have each other's transactions as a state only, nobody gives way.
    StandOff,
    /// A snapshot has no deletions.
    SnapshotWithoutDeletions,
    /// What a snapshot replaces stays on the disk.
    EraseForgotten,
    /// What was sent in answer to a question counts as received.
    SentIsHad,
    /// What was pushed counts as received.
    PushedIsHad,
    /// Two concurrent writes are no conflict yet.
    PairsNoConflict,
    /// Conditions are not checked.
    ConditionsIgnored,
    /// Anybody may write what belongs to a robot.
    OwnersIgnored,
    /// Watchers are shown transactions of others twice.
    ShownTwice,
    /// Watchers are not shown what comes along when a replica comes back.
    NotShown,
    /// Two transactions with one name count as the same.
    ForksUnseen,
    /// Who comes back does not say what came along.
    ArrivalForgotten,
    /// A snapshot whose source is gone is waited for.
    DownloadForEver,
    /// Who has less than it has said to have is not told so.
    SetBackUntold,
    /// Who lacks frames that are gone is given the rest.
    GoneServed,
    /// No frame is ever dropped.
    LogNeverCut,
    /// No deletion is ever dropped.
    DeletionsForEver,
    /// A replica that was set back believes that others have all it wrote.
    ToldForgotten,
    /// After a move stamps carry the old origin.
    ClockNotMoved,
    /// What a transaction has seen is compared by numbers only.
    SeenByNumber,
}

#[cfg(feature = "mutants")]
thread_local! {
    static PLANTED: std::cell::Cell<Option<Mutant>> = const { std::cell::Cell::new(None) };
}

impl Mutant {
    /// Plants this bug in all replicas of the thread.
    #[cfg(feature = "mutants")]
    pub fn plant(bug: Option<Self>) {
        PLANTED.set(bug);
    }

    /// Returns whether this bug is planted.
    #[cfg(feature = "mutants")]
    pub(crate) fn is_planted(self) -> bool {
        PLANTED.get() == Some(self)
    }

    /// Returns whether this bug is planted.
    #[cfg(not(feature = "mutants"))]
    pub(crate) const fn is_planted(self) -> bool {
        false
    }
}
