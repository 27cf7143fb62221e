//! All expressions of a given size.

use crate::reference::{Declared, Term};
use crate::spec::{Spec, number_timers};

/// Which operators.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Operators {
    /// `, ; : # ;;`
    Core,
    /// And `else`, `&`, `any k of`.
    All,
}

/// Which leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Leaves {
    /// Members only, all different: each a task or a service.
    Distinct,
    /// Members, also the same one several times, and `skip`, `never`, `fail`, `wait`.
    Any,
}

/// Calls `visit` with every expression of `leaves` leaves.
pub(crate) fn all(size: usize, operators: Operators, leaves: Leaves, visit: &mut impl FnMut(Spec)) {
    let shapes = shapes(size, operators);
    let labels = labels(size, leaves);
    for shape in &shapes {
        for (terms, members) in &labels {
            for services in 0..1_u32 << members {
                let declared = |member| match services >> member & 1 {
                    0 => Declared::Task,
                    _ => Declared::Service,
                };
                let mut term = shape.clone();
                fill(&mut term, &mut terms.iter());
                number_timers(&mut term);
                visit(Spec { term, declared: (0..*members).map(declared).collect() });
            }
        }
    }
}

/// Returns all trees with `skip` for every leaf.
fn shapes(size: usize, operators: Operators) -> Vec<Term> {
    if size == 1 {
        return vec![Term::Skip];
    }
    let mut all = Vec::new();
    for operands in forests(size, operators) {
        if operands.len() == 1 {
            continue;
        }
        if let [e, f] = &operands[..] {
            let pair = || (Box::new(e.clone()), Box::new(f.clone()));
            let binary = [Term::Seq, Term::Cond, Term::Rec];
            all.extend(binary.into_iter().map(|operator| operator(pair().0, pair().1)));
            if operators == Operators::All {
                all.push(Term::Else(pair().0, pair().1));
            }
        }
        if operators == Operators::All {
            all.push(Term::Ff(operands.clone()));
            all.extend((1..=operands.len()).map(|count| Term::Any(count, operands.clone())));
        }
        all.push(Term::Par(operands.clone()));
        all.push(Term::Dis(operands));
    }
    all
}

/// Returns all lists of trees that have `size` leaves together; the single tree of that size is left out.
fn forests(size: usize, operators: Operators) -> Vec<Vec<Term>> {
    let mut all = Vec::new();
    for first in 1..size {
        let mut rests = forests(size - first, operators);
        rests.extend(shapes(size - first, operators).into_iter().map(|tree| vec![tree]));
        for tree in shapes(first, operators) {
            all.extend(rests.iter().map(|rest| [std::slice::from_ref(&tree), &rest[..]].concat()));
        }
    }
    all
}

/// Returns all ways to fill the leaves, each with its number of members. Which member is which does not matter, so they
/// are numbered in the order of their first appearance.
fn labels(size: usize, leaves: Leaves) -> Vec<(Vec<Term>, u32)> {
    let mut all = vec![(Vec::new(), 0)];
    for _ in 0..size {
        let mut longer = Vec::new();
        for (terms, members) in all {
            let from = if leaves == Leaves::Distinct { members } else { 0 };
            let runs = (from..=members).map(|member| (Term::Leaf(member, vec![member]), members.max(member + 1)));
            let constants =
                [Term::Skip, Term::Never, Term::Fail("f".into()), Term::Wait(0)].map(|term| (term, members));
            let constants = constants.into_iter().filter(|_| leaves == Leaves::Any);
            for (term, members) in runs.chain(constants) {
                longer.push(([&terms[..], &[term]].concat(), members));
            }
        }
        all = longer;
    }
    all
}

fn fill(shape: &mut Term, leaves: &mut std::slice::Iter<'_, Term>) {
    match shape {
        Term::Skip => *shape = leaves.next().expect("a shape has as many leaves as it is filled with").clone(),
        Term::Seq(e, f) | Term::Cond(e, f) | Term::Rec(e, f) | Term::Else(e, f) => {
            fill(e, leaves);
            fill(f, leaves);
        }
        Term::Par(es) | Term::Ff(es) | Term::Any(_, es) | Term::Dis(es) => es.iter_mut().for_each(|e| fill(e, leaves)),
        Term::Leaf(..) | Term::Never | Term::Fail(_) | Term::Wait(_) => unreachable!("a shape's leaves are `skip`"),
    }
}
