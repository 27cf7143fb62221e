//! What goes over a wire, as far as the interface of its sender says it.

/// A message that an output sends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Its type: `Wrench`.
    pub name: String,
    /// What is in it.
    pub layout: Layout,
}

/// What is in a message, one after the other in the order of its type, as postcard encodes it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Layout {
    /// A number of 64 bits, `f64`, in SI units.
    Number {
        /// What it measures: `Force`, or `Number`.
        of: String,
    },
    /// `bool`.
    Truth,
    /// `String`.
    Text,
    /// Fields with their names.
    Record(Vec<(String, Self)>),
    /// Elements of one type.
    List {
        /// Of which.
        of: Box<Self>,
        /// How many; any number, which is sent with them, if that is not said.
        count: Option<usize>,
    },
}
