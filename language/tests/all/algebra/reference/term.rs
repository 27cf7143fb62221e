//! Terms, configurations, events, commands: the vocabulary of the reference.

/// Bytes that one process leaves for the next.
pub(crate) type Value = Vec<u8>;

/// `E`: an expression.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Term {
    /// `i[L]`
    Leaf(u32, Vec<u32>),
    /// `skip`
    Skip,
    /// `never`
    Never,
    /// `fail(r)`
    Fail(String),
    /// `wait(d)`: the number of the timer; every timer runs 1 s.
    Wait(u32),
    /// `E ; F`
    Seq(Box<Self>, Box<Self>),
    /// `E : F`
    Cond(Box<Self>, Box<Self>),
    /// `E ;; F`
    Rec(Box<Self>, Box<Self>),
    /// `E else F`
    Else(Box<Self>, Box<Self>),
    /// `E , F , ..`
    Par(Vec<Self>),
    /// `E & F & ..`
    Ff(Vec<Self>),
    /// `any k of (E, F, ..)`
    Any(usize, Vec<Self>),
    /// `at least k of {E..}`
    Least(usize, Vec<Self>),
    /// `E # F # ..`
    Dis(Vec<Self>),
    /// `match { t => E, .. }`; `else` has no tag.
    Match(Vec<(Option<String>, Self)>),
    /// `shield E`, or for at most 1 s with the number of the timer.
    Shield(Option<u32>, Box<Self>),
    /// `using(res) E`: the number of the `using`, and its resources.
    Using(u32, Vec<String>, Box<Self>),
    /// `E ::[n] F`, with F written out n times.
    Arec(Box<Self>, Vec<Self>),
    /// `E finally F`
    Fin(Box<Self>, Box<Self>),
    /// `E as t`
    Tag(String, Box<Self>),
    /// `E with u`
    With(Value, Box<Self>),
    /// `p => E`
    Named(String, Box<Self>),
    /// `E with p`
    WithName(String, Box<Self>),
    /// `repeat E until t | ..`
    Repeat(Vec<String>, Box<Self>),
    /// `E else match { r => F, .. }`; `else` asks for no reason.
    Catch(Box<Self>, Vec<(Option<Asked>, Self)>),
}

/// The failures that an arm takes.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Asked {
    Reported,
    Busy,
    Unconfirmed,
    ServiceEnded,
    NoMatch,
    Timeout,
    Crash,
    HostLost,
    Text(String),
}

/// `r`: why something aborted.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Reason {
    /// A member reported it.
    Reported(u32, Value),
    /// A member was active already.
    Busy(u32),
    /// A member could not confirm its stop.
    Unconfirmed(u32),
    /// A service ended.
    ServiceEnded(u32),
    /// `fail(r)`
    Failed(String),
    /// A loop whose round takes no time.
    Instant,
    /// No arm for the outcome.
    NoMatch,
}

/// `o`: an outcome.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Outcome {
    /// Normal.
    Done(Value),
    /// A failure.
    Aborted(Reason),
    /// Stopped from outside.
    Killed,
}

/// `C`: a configuration.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Config {
    /// `a.i<n>` with its connection sets.
    Active(u32, u32, Vec<u32>),
    /// `s.i<n>`
    Stopping(u32, u32, Vec<u32>),
    /// `w(d)`, armed for the n-th time.
    Armed(u32, u32),
    /// `never`
    Never,
    /// `C;F`
    Seq(Box<Self>, Term),
    /// `C:F`
    Cond(Box<Self>, Term),
    /// `C else F`
    Else(Box<Self>, Term),
    /// `rec1(C,E,F)`
    Rec1(Box<Self>, Term, Term),
    /// `rec2(C,E,F)`
    Rec2(Box<Self>, Term, Term),
    /// `par[k1..km]`
    Par(Vec<Slot>),
    /// `ff[k1..km]`
    Ff(Vec<Slot>),
    /// `anyk[k1..km]`
    Any(usize, Vec<Slot>),
    Least(usize, Vec<Slot>),
    /// `dis[C1..Cm]`
    Dis(Vec<Self>),
    /// `drain(o,{C..})`
    Drain(Outcome, Vec<Self>),
    /// `shield(C)`
    Shield(Option<u32>, Box<Self>),
    /// `shieldK(C)`, with its timer and which of its arms if it has a bound.
    ShieldK(Option<(u32, u32)>, Box<Self>),
    /// `acq(res,E,v)`
    Acquiring(u32, Vec<String>, Term, Value),
    /// E of `using(res) E` runs.
    Holding(Vec<String>, Box<Self>),
    /// `arec(k,{C or nothing ..},E,F..)`
    Arec(Box<Held>, Vec<Option<Self>>, Term, Vec<Term>),
    /// `fin1(C,F)`
    Fin1(Box<Self>, Term),
    /// `fin2(o,C)`
    Fin2(Outcome, Box<Self>),
    /// `C as t`
    Tag(String, Box<Self>),
    /// `catch(C,{r => F ..})`
    Catch(Box<Self>, Vec<(Option<Asked>, Term)>),
    /// `repeat(C,E,t..)`
    Repeat(Box<Self>, Term, Vec<String>),
    /// An `arec` that comes to its end or is stopped: `o` once all have ended.
    Ending(Outcome, Vec<Self>),
}

/// `k`: an operand of a join, and whether it is a service.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Slot {
    pub(super) service: bool,
    pub(super) held: Held,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Held {
    Runs(Config),
    Done(Value),
    /// With the number of aborts that the join had seen before.
    Aborted(usize, Reason),
}

/// `R`: a configuration or an outcome.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum R {
    C(Config),
    O(Outcome),
}

/// `e`: an event.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Event {
    /// The group is started.
    Start(Value),
    /// The group is asked to stop.
    Stop,
    /// `done(i,n,v)`
    Done(u32, u32, Value),
    /// `aborted(i,n,r)`
    Aborted(u32, u32, Value),
    /// `stopped(i,n)`
    Stopped(u32, u32),
    /// `stop_unconfirmed(i,n)`
    Unconfirmed(u32, u32),
    /// `elapsed(w,n)`
    Elapsed(u32, u32),
    /// `granted(u)`: the resources that the `using` of that number wants are free. Comes from the group itself alone.
    Granted(u32),
}

/// One order of the reference interpreter.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Command {
    /// Open a set.
    Connect(u32),
    /// Close a set.
    Disconnect(u32),
    /// `activate(i,n,v)`
    Activate(u32, u32, Value),
    /// `stop(i,n)`
    Stop(u32, u32),
    /// Start a timer.
    Arm(u32, u32),
    /// Forget a timer.
    Cancel(u32, u32),
}

/// The declared properties of a member.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Declared {
    /// A leaf that ends.
    Task,
    /// A leaf declared `service`.
    Service,
    /// A group that is inferred to be a service.
    ServiceGroup,
}
