//! The names that hosts can have.

/// The longest name of a host, in bytes. It must be one label of the domain name system. Source: RFC 1035, 2.3.4.
const NAME_SIZE_MAX: usize = 63;

/// Returns the reason if no node can have this name. Nodes check names with `HostName` of `comms`, which this crate does not depend on. A
/// test of several crates compares the two.
pub fn host_name_problem(name: &str) -> Option<&'static str> {
    let is_first = |byte: u8| byte.is_ascii_alphanumeric();
    let is_plain = |byte: u8| is_first(byte) || matches!(byte, b'_' | b'-' | b'.');
    if name.is_empty() {
        Some("it is empty")
    } else if name.len() > NAME_SIZE_MAX {
        Some("it is longer than 63 characters")
    } else if !name.bytes().next().is_some_and(is_first) {
        Some("it must start with a letter or digit")
    } else if !name.bytes().all(is_plain) {
        Some("only letters, digits, `_`, `-` and `.` are allowed")
    } else {
        None
    }
}
