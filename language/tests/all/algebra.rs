//! The algebra against its reference, its laws, and its promises.

#[path = "algebra/reference/rewrite.rs"]
mod reference;

mod carry;
mod edges;
mod enumerate;
mod exhaustive;
mod laws;
mod pair;
mod paper;
mod random;
mod scopes;
mod spec;
