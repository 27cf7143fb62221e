//! Text for users: aligned columns, and counts with the right plural.

pub use dbmanager::logic::view::table::table;
use std::fmt::Display;

/// Returns a count together with its noun: `1 group`, `3 groups`.
pub fn counted<T: Display + PartialEq + From<u8>>(count: T, one: &str) -> String {
    format!("{count} {one}{}", if count == T::from(1) { "" } else { "s" })
}
