//! The messages of `unique_identifier_msgs`, written by `tests/all/typed.rs`.

super::message! {
    UUID, "unique_identifier_msgs/msg/UUID", "ros.unique_identifier.UUID";
    uuid: [u8; 16],
}
