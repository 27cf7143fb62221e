//! Files of the command line: the record of a run, and files that a user names. Also the machine that the command runs on.

mod interpreter;
pub(crate) mod keyring;
pub mod machine;
pub mod named_file;
pub mod observer;
pub mod recorder;
pub(crate) mod screen;
pub(crate) mod taps;
pub mod user;
pub(crate) mod value_queue;
pub mod whole_file;
