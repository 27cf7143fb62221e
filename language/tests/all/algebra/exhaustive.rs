//! All small expressions: the product of both interpreters over all events.

use super::enumerate::{Leaves, Operators, Size, all};
use super::pair::{Figures, explore};

/// Explores every expression. Returns their number and the figures.
pub(crate) fn check(size: Size, operators: Operators, leaves: Leaves) -> (u64, Figures) {
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
    let count = |leaves, unary| check(Size { leaves, unary }, Operators::All, Leaves::Any).0;
    assert_eq!([count(1, 0), count(1, 1), count(1, 2)], [6, 48, 384]);
    assert_eq!([count(2, 0), count(2, 1)], [532, 12_768]);
}

#[test]
fn all_expressions_of_three_leaves() {
    assert_eq!(check(Size { leaves: 3, unary: 0 }, Operators::All, Leaves::Any).0, 101_854);
}

#[test]
#[ignore = "long: 16,512 expressions"]
fn core_expressions_of_three_leaves_with_one_scope() {
    assert_eq!(check(Size { leaves: 3, unary: 1 }, Operators::Core, Leaves::Distinct).0, 16_512);
}

#[test]
#[ignore = "long: 10,832 expressions"]
fn core_expressions_of_four_leaves() {
    assert_eq!(check(Size { leaves: 4, unary: 0 }, Operators::Core, Leaves::Distinct).0, 10_832);
}
