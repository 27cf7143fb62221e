//! An expression with the kinds of its members, and its translation into a plan's group.

use super::reference::{Asked, Declared, Term};
use language::algebra::Value;
use language::automaton::Failure;
use language::plan::{Arm, CatchArm, ConnectionSet, Expression, Given, Group, Member, MemberKind, Supervision};
use std::time::Duration;

/// The set that is open for as long as the group runs; member `i` opens set `i`.
pub(crate) const SET_ALWAYS: u32 = 50;

/// The spec that both interpreters are made from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Spec {
    pub(crate) term: Term,
    pub(crate) declared: Vec<Declared>,
}

impl Spec {
    /// Returns the group for `Program::compile`.
    pub(crate) fn group(&self) -> Group {
        let member = |(index, declared): (u32, &Declared)| Member {
            name: format!("m{index}"),
            kind: match declared {
                Declared::Task | Declared::Service => MemberKind::Leaf(index),
                Declared::ServiceGroup => MemberKind::Group(index),
            },
            service: *declared != Declared::Task,
        };
        Group {
            path: "main".into(),
            process: "main".into(),
            host: 0,
            members: (0..).zip(&self.declared).map(member).collect(),
            sets: vec![ConnectionSet { owner: None, label: None, wires: vec![] }],
            sets_always: vec![SET_ALWAYS],
            expression: expression(&self.term),
            supervision: Supervision::default(),
        }
    }
}

fn expression(term: &Term) -> Expression {
    let all = |terms: &[Term]| terms.iter().map(expression).collect();
    let boxed = |term: &Term| Box::new(expression(term));
    match term {
        Term::Leaf(member, sets) => Expression::Run { member: *member, sets: sets.clone() },
        Term::Skip => Expression::Skip,
        Term::Never => Expression::Never,
        Term::Fail(why) => Expression::Fail(why.clone()),
        Term::Wait(_) => Expression::Wait(Duration::from_secs(1)),
        Term::Seq(e, f) => Expression::Sequence(boxed(e), boxed(f)),
        Term::Cond(e, f) => Expression::Conditional(boxed(e), boxed(f)),
        Term::Rec(e, f) => Expression::Recurrent(boxed(e), boxed(f)),
        Term::Else(e, f) => Expression::Otherwise(boxed(e), boxed(f)),
        Term::Par(es) => Expression::Concurrent(all(es)),
        Term::Ff(es) => Expression::FailFast(all(es)),
        Term::Least(k, es) => {
            Expression::AtLeast { count: u32::try_from(*k).expect("`at least` of a test is small"), of: all(es) }
        }
        Term::Any(k, es) => {
            Expression::AnyOf { count: u32::try_from(*k).expect("`any` of a test is small"), of: all(es) }
        }
        Term::Dis(es) => Expression::Disable(all(es)),
        Term::Match(arms) => {
            Expression::Match(arms.iter().map(|(tag, e)| Arm { tag: tag.clone(), body: expression(e) }).collect())
        }
        Term::Shield(bound, e) => Expression::Shield { bound: bound.map(|_| Duration::from_secs(1)), of: boxed(e) },
        Term::Using(_, resources, e) => Expression::Using { resources: resources.clone(), of: boxed(e) },
        Term::Fin(e, f) => Expression::Finally(boxed(e), boxed(f)),
        Term::Tag(tag, e) => Expression::Tagged { tag: tag.clone(), of: boxed(e) },
        Term::With(value, e) => {
            let given = Given::Known { text: "?".to_owned(), value: Value::new(value) };
            Expression::With { given, of: boxed(e) }
        }
        Term::Named(name, e) => Expression::Named { name: name.clone(), of: boxed(e) },
        Term::WithName(name, e) => Expression::With { given: Given::Result(name.clone()), of: boxed(e) },
        Term::Catch(e, arms) => {
            let failure = |asked: &Asked| match asked {
                Asked::Reported => Failure::Reported,
                Asked::Busy => Failure::Busy,
                Asked::Unconfirmed => Failure::StopUnconfirmed,
                Asked::ServiceEnded => Failure::ServiceEnded,
                Asked::NoMatch => Failure::NoMatch,
                Asked::Timeout => Failure::Timeout,
                Asked::Crash => Failure::Crash,
                Asked::HostLost => Failure::HostLost,
                Asked::Text(why) => Failure::Failed(why.clone()),
            };
            let arm = |(asked, e): &(Option<Asked>, Term)| CatchArm {
                failure: asked.as_ref().map(failure),
                body: expression(e),
            };
            Expression::Catch { of: boxed(e), arms: arms.iter().map(arm).collect() }
        }
        Term::Repeat(tags, e) => Expression::Repeat { until: tags.clone(), of: boxed(e) },
        Term::Arec(e, fs) => Expression::Asynchronous { source: boxed(e), pool: all(fs) },
    }
}

/// Numbers the timers and the `using`s of a term in textual order, as the compiler does.
pub(crate) fn number(term: &mut Term) {
    fn visit(term: &mut Term, timers: &mut u32, usings: &mut u32) {
        if let Term::Wait(timer) | Term::Shield(Some(timer), _) = term {
            *timer = *timers;
            *timers += 1;
        }
        if let Term::Using(using, ..) = term {
            *using = *usings;
            *usings += 1;
        }
        term.parts_mut().into_iter().for_each(|part| visit(part, timers, usings));
    }
    visit(term, &mut 0, &mut 0);
}

/// Returns whether something in a term is so.
pub(crate) fn any(term: &Term, is_so: &impl Fn(&Term) -> bool) -> bool {
    is_so(term) || term.parts().into_iter().any(|part| any(part, is_so))
}
