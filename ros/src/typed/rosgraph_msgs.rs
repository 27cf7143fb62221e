//! The messages of `rosgraph_msgs`, written by `tests/all/typed.rs`.

super::message! {
    Clock, "rosgraph_msgs/msg/Clock", "ros.rosgraph.Clock";
    clock: super::builtin_interfaces::Time,
}
