//! All small expressions: the product of both interpreters over all events.

use crate::enumerate::{Leaves, Operators, all};
use crate::pair::{Figures, explore};

/// Explores every expression. Returns how many there are and what was seen.
pub(crate) fn check(size: usize, operators: Operators, leaves: Leaves) -> (u64, Figures) {
    let (mut expressions, mut sum) = (0, Figures::default());
    all(size, operators, leaves, &mut |spec| {
        let figures = explore(&spec).unwrap_or_else(|difference| panic!("{spec:?}\n{difference}"));
        expressions += 1;
        sum.states += figures.states;
        sum.events += figures.events;
    });
    (expressions, sum)
}

#[test]
fn all_expressions_of_one_and_two_leaves() {
    assert_eq!(check(1, Operators::All, Leaves::Any).0, 6);
    assert_eq!(check(2, Operators::All, Leaves::Any).0, 342);
}

#[test]
fn all_expressions_of_three_leaves() {
    assert_eq!(check(3, Operators::All, Leaves::Any).0, 42_672);
}

#[test]
fn core_expressions_of_four_leaves() {
    assert_eq!(check(4, Operators::Core, Leaves::Distinct).0, 10_832);
}
