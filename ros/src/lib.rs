//! The formats of ROS 2: its messages and their encoding.
//!
//! [`logic::library`] has the definitions of the standard messages and services as data. [`logic::schema`] is a type that is ready to use.
//! [`logic::cdr`] reads and writes its values, and [`logic::hash`] computes the hash that identifies a type. [`typed`] has the standard
//! messages as structs of Rust.
//!
//! ```
//! use ros::logic::cdr::{self, Value};
//! use ros::logic::{hash, library, name::TypeName};
//!
//! let name = library::by_spec("ros.std.String").ok_or("unknown")?;
//! assert_eq!(name, TypeName::parse("std_msgs/msg/String").ok_or("no name")?);
//! let schema = library::schema(&name)?;
//! assert!(hash::rihs01(&schema).starts_with("RIHS01_df668c74"));
//! let hello = Value::Record(vec![Value::Text("hi".to_owned())]);
//! let bytes = cdr::write(&schema, &hello)?;
//! assert_eq!(bytes, [0, 1, 0, 0, 3, 0, 0, 0, b'h', b'i', 0]);
//! assert_eq!(cdr::read(&schema, &bytes)?, hello);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod logic;
pub mod typed;
