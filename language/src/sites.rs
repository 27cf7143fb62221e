//! The information that a verifier needs in addition to the plan: the place of each part in the text, the durations of
//! programs, and the properties that the spec states.

use crate::source::Span;
use std::time::Duration;

/// The places, facts and properties of a spec, for its plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sites {
    /// The places of each group of the plan.
    pub groups: Vec<GroupSites>,
    /// For each leaf of the plan, the facts from its interface.
    pub leaves: Vec<LeafFacts>,
    /// The properties of all `verify` blocks, in the order of the text, for each group that they are about.
    pub properties: Vec<Property>,
}

/// The place of a group in the text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GroupSites {
    /// The name of the group's process, at its definition.
    pub name: Span,
    /// The instances, in the order of their slots.
    pub members: Vec<Span>,
    /// The nodes of the expression, in the order in which `algebra::Program` numbers them.
    pub nodes: Vec<Span>,
    /// The first connection of each connection set.
    pub sets: Vec<Span>,
}

/// The facts from the interface of a leaf.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LeafFacts {
    /// The shortest and the longest time from the start of the leaf to its end: `duration 1 s .. 15 s;`.
    pub takes: Option<(Duration, Duration)>,
    /// The inputs that the leaf needs.
    pub inputs: Vec<String>,
    /// The inputs that the leaf can work without.
    pub optional: Vec<String>,
}

/// One sentence of a `verify` block about one group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// The place of the sentence.
    pub span: Span,
    /// The text of the sentence on one line.
    pub text: String,
    /// The group that the sentence is about, as an index into `Plan::groups`.
    pub group: u32,
    /// The meaning of the sentence.
    pub sentence: Sentence,
}

/// A process that a sentence names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ProcessRef {
    /// The index of the group in `Plan::groups`.
    pub group: u32,
    /// The slot of the member. Without a slot, the process is the group itself.
    pub member: Option<u32>,
}

/// An event of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Occurrence {
    /// The process.
    pub who: ProcessRef,
    /// The kind of event.
    pub kind: EventKind,
}

/// The event after which a sentence requires something.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Moment {
    /// The event.
    pub event: Occurrence,
    /// `the 2nd`: only this occurrence of the event counts, from 1 to [`NTH_MAX`]. Otherwise, each occurrence counts.
    pub nth: Option<u8>,
}

/// The largest number in `after the 2nd start of p`.
pub const NTH_MAX: u8 = 16;

/// The kinds of events of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EventKind {
    /// The process is activated.
    Started,
    /// The process is done. If there is a tag, the outcome has this tag.
    Done(Option<String>),
    /// The process fails.
    Aborted,
    /// The process has ended, in any way.
    Ended,
}

impl EventKind {
    /// Returns the outcome that the event must have, if there is one.
    pub fn outcome(&self) -> Option<&str> {
        match self {
            Self::Done(outcome) => outcome.as_deref(),
            Self::Started | Self::Aborted | Self::Ended => None,
        }
    }
}

/// The consequence that a sentence requires after an event.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Consequence {
    /// `p stopped`, `p stopped within 300 ms`: no part of the process runs any more, at the latest after that time.
    Stopped(ProcessRef, Option<Duration>),
    /// `never p`, `not p.done`: this event never happens after that.
    Never(Occurrence),
    /// `eventually p`, `eventually p.done`: this event happens, at the latest when no other event is possible.
    Eventually(Occurrence),
}

/// The fault that a sentence is about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// `crash of p`, `crash of any`.
    Crash(Option<ProcessRef>),
    /// `hang of p`, `hang of any`: the program never ends by itself.
    Hang(Option<ProcessRef>),
    /// `loss of host(c1)`.
    HostLoss(String),
}

/// The statement of a property.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Sentence {
    /// `never a with b`, and each pair of `exclusive a, b, c`: they never run at the same time. A process that is
    /// stopping still runs.
    NeverTogether(Vec<ProcessRef>),
    /// `always a implies b`: b runs at all times at which a runs.
    Implies(ProcessRef, ProcessRef),
    /// `b only after a.done`
    OnlyAfter(ProcessRef, Occurrence),
    /// `after a.done: ...`, `after the 2nd start of a: ...`. `once a runs: never b` is about the first start of a.
    After(Moment, Consequence),
    /// `once a runs: never b with c`, `once a runs: always b implies c`: the sentence holds from the first start of a on.
    Once(ProcessRef, Box<Self>),
    /// `on crash of any: ...`
    On(Fault, Consequence),
    /// `eventually p`: on every run without faults.
    Eventually(Occurrence),
    /// `can finish`: the end can be reached from every reachable state.
    CanFinish,
    /// `finishes within 90 s`
    FinishesWithin(Duration),
    /// `stops within 2 s`
    StopsWithin(Duration),
    /// `p at most once`, `p at most 3 times`
    AtMost(ProcessRef, u32),
    /// `assume p takes 1 s .. 15 s`
    Assume(ProcessRef, Duration, Duration),
    /// `holds ltl "G (a -> F b.done)"`
    Holds(Formula),
}

/// A formula of linear temporal logic over events. It has no word for "next".
///
/// At each position of a run, an event has just happened. There, the atoms about this event are true, and the atoms
/// about the processes that run after it. A run that has ended repeats its last position for ever, without events.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Formula {
    /// `true`, `false`
    Constant(bool),
    /// `p`, `p.done`
    Atom(Atom),
    /// `!p`
    Not(Box<Self>),
    /// `p & q`
    And(Box<Self>, Box<Self>),
    /// `p | q`, and `p -> q` as `!p | q`
    Or(Box<Self>, Box<Self>),
    /// `p <-> q`
    Same(Box<Self>, Box<Self>),
    /// `p U q`: q happens, and p holds until then. `F q` is `true U q`.
    Until(Box<Self>, Box<Self>),
    /// `p W q`: p holds until q happens, or for ever.
    WeakUntil(Box<Self>, Box<Self>),
    /// `p R q`: q holds up to and including the first p, or for ever. `G q` is `false R q`.
    Release(Box<Self>, Box<Self>),
}

/// A statement about one position of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Atom {
    /// `p`: the process is active. A process that is stopping is still active.
    Active(ProcessRef),
    /// `p.running`: the process is active, and neither the process nor a group around it is being stopped.
    Running(ProcessRef),
    /// `p.stopping`: the process is active, and the process or a group around it is being stopped.
    Stopping(ProcessRef),
    /// `p.done`, `p.started`: this event has just happened.
    Happens(Occurrence),
}

impl Sentence {
    /// Returns the events that the sentence names.
    pub fn events(&self) -> Vec<&Occurrence> {
        match self {
            Self::OnlyAfter(_, event) | Self::Eventually(event) => vec![event],
            Self::After(moment, then) => [&moment.event].into_iter().chain(then.event()).collect(),
            Self::Once(_, sentence) => sentence.events(),
            Self::On(_, then) => then.event().into_iter().collect(),
            Self::Holds(formula) => formula.events(),
            Self::NeverTogether(_)
            | Self::Implies(..)
            | Self::CanFinish
            | Self::FinishesWithin(_)
            | Self::StopsWithin(_)
            | Self::AtMost(..)
            | Self::Assume(..) => Vec::new(),
        }
    }
}

impl Consequence {
    fn event(&self) -> Option<&Occurrence> {
        match self {
            Self::Never(event) | Self::Eventually(event) => Some(event),
            Self::Stopped(..) => None,
        }
    }
}

impl Formula {
    fn events(&self) -> Vec<&Occurrence> {
        match self {
            Self::Atom(Atom::Happens(event)) => vec![event],
            Self::Atom(Atom::Active(_) | Atom::Running(_) | Atom::Stopping(_)) | Self::Constant(_) => Vec::new(),
            Self::Not(of) => of.events(),
            Self::And(p, q)
            | Self::Or(p, q)
            | Self::Same(p, q)
            | Self::Until(p, q)
            | Self::WeakUntil(p, q)
            | Self::Release(p, q) => p.events().into_iter().chain(q.events()).collect(),
        }
    }
}
