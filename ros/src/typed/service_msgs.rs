//! The messages of `service_msgs`, written by `tests/all/typed.rs`.

super::message! {
    ServiceEventInfo, "service_msgs/msg/ServiceEventInfo", "ros.service.ServiceEventInfo";
    event_type: u8,
    stamp: super::builtin_interfaces::Time,
    client_gid: [u8; 16],
    sequence_number: i64,
    ;
    const REQUEST_SENT: u8 = 0;
    const REQUEST_RECEIVED: u8 = 1;
    const RESPONSE_SENT: u8 = 2;
    const RESPONSE_RECEIVED: u8 = 3;
}
