//! The information that a verifier needs besides the plan: the place of everything in the text, the durations of
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
    /// The name of its process, where that is defined.
    pub name: Span,
    /// Its instances, in the order of their slots.
    pub members: Vec<Span>,
    /// The nodes of its expression, in the order in which `algebra::Program` numbers them.
    pub nodes: Vec<Span>,
    /// The first line of each connection set.
    pub sets: Vec<Span>,
}

/// The facts from the interface of a leaf.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LeafFacts {
    /// The shortest and the longest time from its start to its end, `duration 1 s .. 15 s;`.
    pub takes: Option<(Duration, Duration)>,
    /// The inputs that it does not work without.
    pub inputs: Vec<String>,
    /// The inputs that it also works without.
    pub optional: Vec<String>,
}

/// One sentence of a `verify` block about one group.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Property {
    /// Its place.
    pub span: Span,
    /// Its text on one line.
    pub text: String,
    /// The group that it is about: an index into `Plan::groups`.
    pub group: u32,
    /// The sentence itself.
    pub sentence: Sentence,
}

/// A process that a sentence names.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ProcessRef {
    /// Index into `Plan::groups`.
    pub group: u32,
    /// The slot of the member; without one the group itself.
    pub member: Option<u32>,
}

/// Something that happens to a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Occurrence {
    /// The process.
    pub who: ProcessRef,
    /// The kind of event.
    pub kind: EventKind,
}

/// The kinds of events of a process.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EventKind {
    /// It is activated.
    Started,
    /// It is done; with this tag, if one is given.
    Done(Option<String>),
    /// It fails.
    Aborted,
    /// It has ended, in any way.
    Ended,
}

impl EventKind {
    /// The outcome that is asked for, if one is.
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
    /// `p stopped`, `p stopped within 300 ms`: nothing of it runs any more, at the latest after that time.
    Stopped(ProcessRef, Option<Duration>),
    /// `never p`, `not p.done`: this event does not happen any more.
    Never(Occurrence),
    /// `eventually p`, `eventually p.done`: this happens, at the latest when nothing else can.
    Eventually(Occurrence),
}

/// Which fault a sentence is about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Fault {
    /// `crash of p`, `crash of any`.
    Crash(Option<ProcessRef>),
    /// `hang of p`, `hang of any`: it never ends by itself.
    Hang(Option<ProcessRef>),
    /// `loss of host(c1)`.
    HostLoss(String),
}

/// The statement of a property.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Sentence {
    /// `never a with b`, and each two of `exclusive a, b, c`: they never run at the same time, also while they stop.
    NeverTogether(Vec<ProcessRef>),
    /// `always a implies b`: b runs at all times at which a runs.
    Implies(ProcessRef, ProcessRef),
    /// `b only after a.done`
    OnlyAfter(ProcessRef, Occurrence),
    /// `after a.done: ...`
    After(Occurrence, Consequence),
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

/// A formula of linear temporal logic over events, without a word for "next".
///
/// At each position of a run an event has just happened: the atoms about this event are true there, and those about the
/// processes that run after it. A run that has come to its end repeats its last position for ever without events.
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
    /// `p U q`: q comes, and p until then. `F q` is `true U q`.
    Until(Box<Self>, Box<Self>),
    /// `p W q`: p until q, or for ever.
    WeakUntil(Box<Self>, Box<Self>),
    /// `p R q`: q up to and with the first p, or for ever. `G q` is `false R q`.
    Release(Box<Self>, Box<Self>),
}

/// A statement about one position of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Atom {
    /// `p`: it is active, also while it stops.
    Active(ProcessRef),
    /// `p.running`: it is active, and neither it nor anything around it is being stopped.
    Running(ProcessRef),
    /// `p.stopping`: it is active, and it or something around it is being stopped.
    Stopping(ProcessRef),
    /// `p.done`, `p.started`: this has just happened.
    Happens(Occurrence),
}

impl Sentence {
    /// The events that it names.
    pub fn events(&self) -> Vec<&Occurrence> {
        match self {
            Self::OnlyAfter(_, event) | Self::Eventually(event) => vec![event],
            Self::After(event, then) => [event].into_iter().chain(then.event()).collect(),
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
