//! The messages of `builtin_interfaces`, written by `tests/all/typed.rs`.

super::message! {
    Duration, "builtin_interfaces/msg/Duration", "ros.builtin.Duration";
    sec: i32,
    nanosec: u32,
}

super::message! {
    Time, "builtin_interfaces/msg/Time", "ros.builtin.Time";
    sec: i32,
    nanosec: u32,
}
