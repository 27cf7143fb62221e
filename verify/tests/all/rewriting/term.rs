//! The terms of the reference: static expressions, configurations, outcomes. `rules` explains their meaning.

use language::algebra::Value;
use language::automaton::Failure;
use language::plan::{Expression, Given, Group, MemberKind};
use std::rc::Rc;
use std::time::Duration;

/// The value of a process, or the reason that an `else` hands on as text. The reference does not know the content of a
/// reason.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Left {
    Value(Value),
    ReasonText,
}

impl Left {
    pub(crate) const NOTHING: Self = Self::Value(Value::EMPTY);

    /// Joins the values of several processes. The result is unknown if one of them is a reason.
    pub(crate) fn tuple(all: &[Self]) -> Self {
        let mut values = Vec::new();
        for left in all {
            match left {
                Self::Value(value) => values.push(value.clone()),
                Self::ReasonText => return Self::ReasonText,
            }
        }
        Self::Value(Value::tuple(values.iter()))
    }
}

/// The reason for an abort, as far as the rules define it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Why {
    Reported(Option<u32>, Value),
    Given(u32, Failure),
    Busy(u32),
    Unconfirmed(u32),
    ServiceEnded(u32),
    /// An active member reported that it had stopped. So it has failed, for a reason that the rules leave open.
    Left(u32),
    Failed(String),
    NoMatch,
}

/// The way in which a term ended. Only a drain ever consumes `killed`. Otherwise, it is the end of a group that was
/// asked to stop.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Outcome {
    Done(Left),
    Aborted(Why),
    Killed,
}

impl Outcome {
    pub(crate) fn is_unconfirmed(&self) -> bool {
        matches!(self, Self::Aborted(Why::Unconfirmed(_)))
    }
}

/// A static expression. A node with a state between events has a number.
#[derive(Debug)]
pub(crate) struct Expr {
    pub(crate) kind: Kind,
    /// Whether no run of the expression ends without a fault (§2.5).
    pub(crate) is_service: bool,
}

#[derive(Debug)]
pub(crate) enum Kind {
    Run(u32, Vec<u32>),
    Skip,
    Never,
    Fail(String),
    /// The number of the timer, and its duration.
    Wait(u32, Duration),
    Par(Vec<Rc<Expr>>),
    And(Vec<Rc<Expr>>),
    Any(usize, Vec<Rc<Expr>>),
    Least(usize, Vec<Rc<Expr>>),
    Dis(Vec<Rc<Expr>>),
    Seq(Rc<Expr>, Rc<Expr>),
    Cond(Rc<Expr>, Rc<Expr>),
    Rec(Rc<Expr>, Rc<Expr>),
    Else(Rc<Expr>, Rc<Expr>),
    Finally(Rc<Expr>, Rc<Expr>),
    Match(Vec<(Option<String>, Rc<Expr>)>),
    Shield(Option<(u32, Duration)>, Rc<Expr>),
    /// The number of the `using`, its resources, and the expression that runs with them.
    Using(usize, Vec<String>, Rc<Expr>),
    Pool(Rc<Expr>, Vec<Rc<Expr>>),
    As(String, Rc<Expr>),
    With(Value, Rc<Expr>),
    /// The number of the kept value, and the expression that may start with it.
    Named(usize, Rc<Expr>),
    WithKept(usize, Rc<Expr>),
    Repeat(Vec<String>, Rc<Expr>),
    Catch(Rc<Expr>, CatchArms),
}

/// A configuration: the running part of a term.
#[derive(Clone, Debug)]
pub(crate) enum Conf {
    Active(u32, Vec<u32>),
    Stopping(u32, Vec<u32>),
    Never,
    Timer(u32),
    Seq(Box<Self>, Rc<Expr>),
    Cond(Box<Self>, Rc<Expr>),
    Rec1(Box<Self>, Rc<Expr>, Rc<Expr>),
    Rec2(Box<Self>, Rc<Expr>, Rc<Expr>),
    Else(Box<Self>, Rc<Expr>),
    Par(Slots),
    And(Slots),
    Any(usize, Slots),
    Least(usize, Slots),
    Dis(Vec<Self>),
    Drain(Outcome, Vec<Self>),
    Shield(Option<(u32, Duration)>, Box<Self>),
    /// A requested stop waits here. If there is a timer, the stop waits only while the timer with this number runs.
    ShieldK(Option<u32>, Box<Self>),
    Waiting(usize, Rc<Expr>, Left),
    Using(usize, Box<Self>),
    Pool(Box<Pool>),
    Fin1(Box<Self>, Rc<Expr>),
    Fin2(Outcome, Box<Self>),
    As(String, Box<Self>),
    Named(usize, Left, Box<Self>),
    Repeat(Vec<String>, Box<Self>, Rc<Expr>),
    Catch(Box<Self>, CatchArms),
}

/// The arms of an `else match`. The arm `else` has no failure.
pub(crate) type CatchArms = Vec<(Option<Failure>, Rc<Expr>)>;

/// The operands of `,` `&` and `any`.
#[derive(Clone, Debug)]
pub(crate) struct Slots {
    pub(crate) slots: Vec<Result<Conf, Outcome>>,
    pub(crate) services: Vec<bool>,
    /// The aborted operands, in the order of their ends.
    pub(crate) aborts: Vec<usize>,
    /// The operands that are done, in the order of their ends.
    pub(crate) dones: Vec<usize>,
}

/// `P ::[n] Q`
#[derive(Clone, Debug)]
pub(crate) struct Pool {
    pub(crate) source: Rc<Expr>,
    pub(crate) bodies: Vec<Rc<Expr>>,
    /// The running configuration of P. None while P waits for a free place, or after a failure.
    pub(crate) running: Option<Conf>,
    pub(crate) places: Vec<Option<Conf>>,
    /// The value of P that arrived while all places were taken.
    pub(crate) owed: Option<Left>,
    /// The first failure. After it, no new Q starts.
    pub(crate) failed: Option<Why>,
}

/// Numbers the parts of an expression, starting with 0, in the order of the text.
#[derive(Default)]
struct Numbers {
    timers: u32,
    usings: usize,
    kept: usize,
    /// The kept values around, by their names.
    names: Vec<(String, usize)>,
}

/// Returns the expression of a group.
pub(crate) fn expression(group: &Group) -> Rc<Expr> {
    build(&group.expression, group, &mut Numbers::default())
}

fn build(source: &Expression, group: &Group, numbers: &mut Numbers) -> Rc<Expr> {
    let kind = match source {
        Expression::Run { member, sets } => Kind::Run(*member, sets.clone()),
        Expression::Skip => Kind::Skip,
        Expression::Never => Kind::Never,
        Expression::Fail(why) => Kind::Fail(why.clone()),
        Expression::Wait(after) => Kind::Wait(timer(numbers), *after),
        Expression::Concurrent(of) => Kind::Par(all(of, group, numbers)),
        Expression::FailFast(of) => Kind::And(all(of, group, numbers)),
        Expression::AnyOf { count, of } => Kind::Any(*count as usize, all(of, group, numbers)),
        Expression::AtLeast { count, of } => Kind::Least(*count as usize, all(of, group, numbers)),
        Expression::Disable(of) => Kind::Dis(all(of, group, numbers)),
        Expression::Sequence(p, q) => two(Kind::Seq, (p, q), group, numbers),
        Expression::Conditional(p, q) => two(Kind::Cond, (p, q), group, numbers),
        Expression::Recurrent(p, q) => two(Kind::Rec, (p, q), group, numbers),
        Expression::Otherwise(p, q) => two(Kind::Else, (p, q), group, numbers),
        Expression::Finally(p, q) => two(Kind::Finally, (p, q), group, numbers),
        Expression::Match(arms) => {
            Kind::Match(arms.iter().map(|arm| (arm.tag.clone(), build(&arm.body, group, numbers))).collect())
        }
        Expression::Shield { bound, of } => {
            let bound = bound.map(|after| (timer(numbers), after));
            Kind::Shield(bound, build(of, group, numbers))
        }
        Expression::Using { resources, of } => {
            let number = numbers.usings;
            numbers.usings += 1;
            Kind::Using(number, resources.clone(), build(of, group, numbers))
        }
        Expression::Asynchronous { source, pool } => {
            let source = build(source, group, numbers);
            Kind::Pool(source, all(pool, group, numbers))
        }
        Expression::Chart(_) => unreachable!("random expressions have no activities"),
        Expression::Tagged { tag, of } => Kind::As(tag.clone(), build(of, group, numbers)),
        Expression::Catch { of, arms } => {
            let of = build(of, group, numbers);
            let arms = arms.iter().map(|arm| (arm.failure.clone(), build(&arm.body, group, numbers)));
            Kind::Catch(of, arms.collect())
        }
        Expression::Repeat { until, of } => Kind::Repeat(until.clone(), build(of, group, numbers)),
        Expression::With { given: Given::Known { value, .. }, of } => {
            Kind::With(value.clone(), build(of, group, numbers))
        }
        Expression::With { given: Given::Result(name), of } => {
            let (_, number) = numbers.names.iter().find(|(known, _)| known == name).expect("a name around it");
            Kind::WithKept(*number, build(of, group, numbers))
        }
        Expression::Named { name, of } => {
            let number = numbers.kept;
            numbers.kept += 1;
            numbers.names.push((name.clone(), number));
            let of = build(of, group, numbers);
            numbers.names.pop();
            Kind::Named(number, of)
        }
    };
    Rc::new(Expr { is_service: is_service(&kind, group), kind })
}

fn timer(numbers: &mut Numbers) -> u32 {
    numbers.timers += 1;
    numbers.timers - 1
}

fn all(of: &[Expression], group: &Group, numbers: &mut Numbers) -> Vec<Rc<Expr>> {
    of.iter().map(|operand| build(operand, group, numbers)).collect()
}

fn two(
    kind: fn(Rc<Expr>, Rc<Expr>) -> Kind,
    (p, q): (&Expression, &Expression),
    group: &Group,
    numbers: &mut Numbers,
) -> Kind {
    let p = build(p, group, numbers);
    kind(p, build(q, group, numbers))
}

/// The rule of §2.5, and that of the manual for the operators that §2.5 omits. `,` and `#` are services if all
/// operands are, `;` `:` `&` if one is, `;;` and `::` always, `else` and `finally` if P is, `any k of` if fewer than k
/// operands are tasks.
fn is_service(kind: &Kind, group: &Group) -> bool {
    let tasks = |of: &[Rc<Expr>]| of.iter().filter(|operand| !operand.is_service).count();
    match kind {
        Kind::Run(member, _) => group.members[*member as usize].service,
        Kind::Never | Kind::Rec(..) | Kind::Pool(..) => true,
        Kind::Skip | Kind::Fail(_) | Kind::Wait(..) => false,
        Kind::Par(of) | Kind::Dis(of) => tasks(of) == 0,
        Kind::And(of) => tasks(of) < of.len(),
        Kind::Any(count, of) => tasks(of) < *count,
        Kind::Least(_, of) => tasks(of) < of.len(),
        Kind::Seq(p, q) | Kind::Cond(p, q) => p.is_service || q.is_service,
        Kind::Else(p, _) | Kind::Catch(p, _) => p.is_service,
        Kind::Finally(p, q) => p.is_service || q.is_service,
        Kind::Match(arms) => arms.iter().all(|(_, body)| body.is_service),
        Kind::Shield(_, of)
        | Kind::Using(_, _, of)
        | Kind::As(_, of)
        | Kind::With(_, of)
        | Kind::Named(_, of)
        | Kind::WithKept(_, of)
        | Kind::Repeat(_, of) => of.is_service,
    }
}

/// Returns whether the normal end of a member breaks its contract (L7): its module has `service`.
pub(crate) fn is_endless(group: &Group, member: u32) -> bool {
    let member = &group.members[member as usize];
    member.service && matches!(member.kind, MemberKind::Leaf(_))
}
