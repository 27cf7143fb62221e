//! Text for users: aligned columns, and counts in the plural.

pub use dbmanager::logic::view::table::table;
use std::fmt::Display;

/// Returns how many of something there are: `1 group`, `3 groups`.
pub fn counted<T: Display + PartialEq + From<u8>>(count: T, one: &str) -> String {
    format!("{count} {one}{}", if count == T::from(1) { "" } else { "s" })
}
