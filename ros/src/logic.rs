//! The formats of ROS 2: types, values and names. All functions are pure.

pub mod attachment;
pub mod cdr;
pub mod definition;
pub mod frame;
pub mod hash;
pub mod key;
pub mod library;
pub mod name;
pub mod parameters;
pub mod qos;
pub mod route;
pub mod schema;
pub mod token;
pub mod yaml;
