//! An expression with the kinds of its members, and its translation into a plan's group.

use crate::reference::{Declared, Term};
use language::plan::{ConnectionSet, Expression, Group, Member, MemberKind};
use std::time::Duration;

/// The set that is open for as long as the group runs; member `i` opens set `i`.
pub(crate) const SET_ALWAYS: u32 = 50;

/// What both interpreters are made from.
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
        Term::Any(k, es) => {
            Expression::AnyOf { count: u32::try_from(*k).expect("`any` of a test is small"), of: all(es) }
        }
        Term::Dis(es) => Expression::Disable(all(es)),
    }
}

/// Numbers the timers of a term in textual order, as the compiler does.
pub(crate) fn number_timers(term: &mut Term) {
    fn visit(term: &mut Term, next: &mut u32) {
        match term {
            Term::Wait(timer) => {
                *timer = *next;
                *next += 1;
            }
            Term::Leaf(..) | Term::Skip | Term::Never | Term::Fail(_) => {}
            Term::Seq(e, f) | Term::Cond(e, f) | Term::Rec(e, f) | Term::Else(e, f) => {
                visit(e, next);
                visit(f, next);
            }
            Term::Par(es) | Term::Ff(es) | Term::Any(_, es) | Term::Dis(es) => {
                es.iter_mut().for_each(|e| visit(e, next));
            }
        }
    }
    visit(term, &mut 0);
}
