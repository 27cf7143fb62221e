//! All expressions of a given size.

use super::pair::TAGS;
use super::reference::{Asked, Declared, Term};
use super::spec::{Spec, number};

/// The operators of the enumerated expressions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Operators {
    /// `, ; : # ;;`
    Core,
    /// And `else`, `else match`, `finally`, `&`, `any k of`, `at least 1 of`, `match`, `::`.
    All,
}

/// The leaves of the enumerated expressions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Leaves {
    /// Members only, all different: each a task or a service.
    Distinct,
    /// Members, also the same one several times, and `skip`, `never`, `fail`, `wait`.
    Any,
}

/// How large an expression is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Size {
    /// Its leaves.
    pub(crate) leaves: usize,
    /// How many times `shield`, `shield(1 s)`, `using(r)`, `as`, `with`, `=>`, `repeat` and `match` with one arm occur in it, anywhere.
    pub(crate) unary: usize,
}

/// Calls `visit` with every expression of a size.
pub(crate) fn all(size: Size, operators: Operators, leaves: Leaves, visit: &mut impl FnMut(Spec)) {
    let shapes = shapes(size, operators);
    let labels = labels(size.leaves, leaves);
    for shape in &shapes {
        for (terms, members) in &labels {
            for services in 0..1_u32 << members {
                let declared = |member| match services >> member & 1 {
                    0 => Declared::Task,
                    _ => Declared::Service,
                };
                let mut term = shape.clone();
                fill(&mut term, &mut terms.iter());
                number(&mut term);
                visit(Spec { term, declared: (0..*members).map(declared).collect() });
            }
        }
    }
}

/// Returns all trees with `skip` for every leaf.
fn shapes(size: Size, operators: Operators) -> Vec<Term> {
    let mut all = Vec::new();
    if size == (Size { leaves: 1, unary: 0 }) {
        all.push(Term::Skip);
    }
    for operands in forests(size, operators).into_iter().filter(|operands| operands.len() > 1) {
        if let [e, f] = &operands[..] {
            let pair = || (Box::new(e.clone()), Box::new(f.clone()));
            let binary = [Term::Seq, Term::Cond, Term::Rec];
            all.extend(binary.into_iter().map(|operator| operator(pair().0, pair().1)));
            if operators == Operators::All {
                all.push(Term::Else(pair().0, pair().1));
                all.push(Term::Fin(pair().0, pair().1));
                all.push(Term::Catch(pair().0, vec![(Some(Asked::Busy), *pair().1)]));
            }
        }
        if operators == Operators::All {
            all.push(Term::Ff(operands.clone()));
            all.extend((1..=operands.len()).map(|count| Term::Any(count, operands.clone())));
            all.push(Term::Least(1, operands.clone()));
            all.push(Term::Match(arms(&operands)));
            all.push(Term::Arec(Box::new(operands[0].clone()), operands[1..].to_vec()));
        }
        all.push(Term::Par(operands.clone()));
        all.push(Term::Dis(operands));
    }
    if size.unary > 0 {
        for inner in shapes(Size { unary: size.unary - 1, ..size }, operators) {
            all.push(Term::Match(vec![(Some(TAGS[0].to_owned()), inner.clone())]));
            all.push(Term::Using(0, vec!["r".to_owned()], Box::new(inner.clone())));
            all.push(Term::With(b"u".to_vec(), Box::new(inner.clone())));
            let name = || format!("p{}", size.unary);
            all.push(Term::Named(name(), Box::new(Term::WithName(name(), Box::new(inner.clone())))));
            all.push(Term::Repeat(vec![TAGS[0].to_owned()], Box::new(inner.clone())));
            all.push(Term::Tag(TAGS[1].to_owned(), Box::new(inner.clone())));
            all.push(Term::Shield(Some(0), Box::new(inner.clone())));
            all.push(Term::Shield(None, Box::new(inner)));
        }
    }
    all
}

/// The arms of a `match`: one tag each, `else` for the last.
fn arms(operands: &[Term]) -> Vec<(Option<String>, Term)> {
    let tags = TAGS.iter().take(operands.len() - 1).map(|&tag| Some(tag.to_owned())).chain([None]);
    tags.zip(operands.iter().cloned()).collect()
}

/// Returns all lists of trees that have the size together; the single tree of that size is left out.
fn forests(size: Size, operators: Operators) -> Vec<Vec<Term>> {
    let mut all = Vec::new();
    for leaves in 1..size.leaves {
        for unary in 0..=size.unary {
            let left = Size { leaves: size.leaves - leaves, unary: size.unary - unary };
            let mut rests = forests(left, operators);
            rests.extend(shapes(left, operators).into_iter().map(|tree| vec![tree]));
            for tree in shapes(Size { leaves, unary }, operators) {
                all.extend(rests.iter().map(|rest| [std::slice::from_ref(&tree), &rest[..]].concat()));
            }
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
    if *shape == Term::Skip {
        *shape = leaves.next().expect("a shape has as many leaves as it is filled with").clone();
    } else {
        shape.parts_mut().into_iter().for_each(|part| fill(part, leaves));
    }
}
