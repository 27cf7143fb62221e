//! The algebra against its reference, its laws, and its promises.

#[path = "reference/rewrite.rs"]
mod reference;

#[path = "algebra/carry.rs"]
mod carry;
#[path = "algebra/edges.rs"]
mod edges;
#[path = "algebra/enumerate.rs"]
mod enumerate;
#[path = "algebra/exhaustive.rs"]
mod exhaustive;
#[path = "algebra/laws.rs"]
mod laws;
#[path = "algebra/pair.rs"]
mod pair;
#[path = "algebra/paper.rs"]
mod paper;
#[path = "algebra/random.rs"]
mod random;
#[path = "algebra/scopes.rs"]
mod scopes;
#[path = "algebra/spec.rs"]
mod spec;
