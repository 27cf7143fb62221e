//! The whole comparison of the algebra with its reference, of which the test suite runs a slice:
//!
//! ```text
//! cargo run --release -p language --example algebra_full                 everything: hours, mostly for `most`
//! cargo run --release -p language --example algebra_full -- random 9     1,000,000 random cases from seed 9: a minute
//! ```
//!
//! Parts: `small` (1 to 3 leaves, all operators), `core` (4 leaves, the five operators of the paper), `all` (4 leaves,
//! all operators, different members), `most` (4 leaves, all operators, any leaves), `random` (up to 12 leaves). By
//! default, leaves are constants and members that may occur twice.
#![expect(clippy::print_stdout, reason = "its output is its result")]

#[path = "../tests/all/algebra/enumerate.rs"]
mod enumerate;
#[path = "../tests/all/algebra/exhaustive.rs"]
mod exhaustive;
#[path = "../tests/all/algebra/pair.rs"]
mod pair;
#[path = "../tests/all/algebra/random.rs"]
mod random;
#[path = "../tests/all/algebra/reference/rewrite.rs"]
mod reference;
#[path = "../tests/all/algebra/spec.rs"]
mod spec;

use enumerate::{Leaves, Operators, Size};

fn main() {
    let mut arguments = std::env::args().skip(1);
    let part = arguments.next();
    let seed = arguments.next().and_then(|seed| seed.parse().ok()).unwrap_or(1);
    let wanted = |name: &str| part.as_deref().is_none_or(|part| part == name);
    if wanted("small") {
        for (leaves, unary) in [(1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2), (3, 0), (3, 1)] {
            exhaustive(Size { leaves, unary }, Operators::All, Leaves::Any);
        }
    }
    if wanted("core") {
        exhaustive(Size { leaves: 4, unary: 0 }, Operators::Core, Leaves::Any);
    }
    if wanted("all") {
        exhaustive(Size { leaves: 4, unary: 0 }, Operators::All, Leaves::Distinct);
    }
    if wanted("most") {
        exhaustive(Size { leaves: 4, unary: 0 }, Operators::All, Leaves::Any);
    }
    if wanted("unary") {
        exhaustive(Size { leaves: 3, unary: 2 }, Operators::All, Leaves::Distinct);
        exhaustive(Size { leaves: 4, unary: 1 }, Operators::All, Leaves::Distinct);
    }
    if wanted("random") {
        let (events, outcomes) = random::run(1_000_000, seed);
        println!("random, seed {seed}: 1000000 expressions, {events} events, {outcomes} outcomes, no difference");
    }
}

fn exhaustive(size: Size, operators: Operators, leaves: Leaves) {
    let (expressions, figures) = exhaustive::check(size, operators, leaves);
    println!("{size:?}, {operators:?}, {leaves:?}: {expressions} expressions, {figures:?}, no difference");
}
