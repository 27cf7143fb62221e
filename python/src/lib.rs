//! The native half of the Python package `dca`: Python classes as controllers of the kit.
//!
//! A class becomes a [`Module`](controllers::sdk::Module), and the kit's process runs it like a controller in Rust. The loop, the wires,
//! the watchdog and the node's orders stay in Rust, on threads that do not hold the interpreter's lock. Python is called once per
//! calculation. Values wait as bytes: an input decodes a value when the controller reads it, and an output encodes it at once.
//!
//! - `declaration`: a class; `instance`: its module; `input` and `output`: its ports; `form` and `message`: its message types
//! - `exports` and `calls`: procedures of the class and of other processes; `database` and `stored`: the database
//! - `program`: the process; `forked`: its child processes; `failure`: exceptions; `standard`: the messages of ROS 2

mod calls;
mod database;
mod declaration;
mod encoded;
mod ending;
mod exports;
mod failure;
mod forked;
mod form;
mod harness;
mod input;
mod instance;
mod keys;
mod message;
mod messaging;
mod output;
mod piece;
mod program;
mod quantity;
mod standard;
mod stored;

use pyo3::prelude::*;

/// The native half of `dca`.
#[pymodule]
fn _dca(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    module.add_class::<message::MessageType>()?;
    module.add_class::<input::Input>()?;
    module.add_class::<input::EveryInput>()?;
    module.add_class::<output::Output>()?;
    module.add_class::<calls::Calls>()?;
    module.add_class::<calls::Call>()?;
    module.add_class::<exports::Reply>()?;
    module.add_class::<database::DatabaseOf>()?;
    module.add_class::<database::Request>()?;
    module.add_class::<database::Watch>()?;
    module.add_class::<database::WatchChange>()?;
    module.add_class::<stored::EntryOf>()?;
    module.add_class::<stored::Opaque>()?;
    module.add_class::<messaging::QueueOf>()?;
    module.add_class::<messaging::Taken>()?;
    module.add_class::<messaging::SenderOf>()?;
    module.add_class::<messaging::Sending>()?;
    module.add_class::<messaging::LockOf>()?;
    module.add_class::<messaging::LockUserOf>()?;
    module.add_class::<messaging::RouterOf>()?;
    module.add_class::<messaging::SubscriberOf>()?;
    module.add_class::<keys::KeyNewsOf>()?;
    module.add_class::<keys::KeyAnswersOf>()?;
    module.add_class::<keys::KeyWriterOf>()?;
    module.add("SendError", module.py().get_type::<messaging::SendError>())?;
    module.add("DatabaseFailure", module.py().get_type::<database::DatabaseFailure>())?;
    module.add("DatabaseUnknown", module.py().get_type::<database::DatabaseUnknown>())?;
    module.add("CallError", module.py().get_type::<calls::CallError>())?;
    module.add("Refused", module.py().get_type::<exports::Refused>())?;
    module.add_class::<harness::NativeHarness>()?;
    module.add_class::<standard::RosDefinition>()?;
    module.add_class::<standard::RosField>()?;
    module.add_function(wrap_pyfunction!(standard::ros_definition, module)?)?;
    module.add_function(wrap_pyfunction!(standard::ros_names, module)?)?;
    module.add_class::<ending::Tick>()?;
    module.add_class::<ending::Done>()?;
    module.add_class::<ending::Abort>()?;
    module.add_function(wrap_pyfunction!(program::run, module)?)?;
    module.add_function(wrap_pyfunction!(program::interface, module)?)?;
    module.add_function(wrap_pyfunction!(quantity::si, module)?)
}
