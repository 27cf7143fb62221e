//! The messages of `diagnostic_msgs`, written by `tests/all/typed.rs`.

super::message! {
    DiagnosticArray, "diagnostic_msgs/msg/DiagnosticArray", "ros.diagnostic.DiagnosticArray";
    header: super::std_msgs::Header,
    status: Vec<DiagnosticStatus>,
}

super::message! {
    DiagnosticStatus, "diagnostic_msgs/msg/DiagnosticStatus", "ros.diagnostic.DiagnosticStatus";
    level: u8,
    name: String,
    message: String,
    hardware_id: String,
    values: Vec<KeyValue>,
    ;
    const OK: u8 = 0;
    const WARN: u8 = 1;
    const ERROR: u8 = 2;
    const STALE: u8 = 3;
}

super::message! {
    KeyValue, "diagnostic_msgs/msg/KeyValue", "ros.diagnostic.KeyValue";
    key: String,
    value: String,
}
