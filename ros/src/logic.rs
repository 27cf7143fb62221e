//! The formats of ROS 2: types, values and names. It is all pure.

pub mod cdr;
pub mod definition;
pub mod hash;
pub mod library;
pub mod name;
pub mod schema;
