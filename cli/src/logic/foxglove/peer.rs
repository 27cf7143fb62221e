//! The user at the other end of a connection within this machine, from the table that the system keeps of its sockets.
//!
//! Source: proc_pid_net(5), `/proc/net/tcp`; the kernel writes addresses as 32-bit words in the byte order of the machine.

use std::fmt::Write as _;

/// One end of a connection.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Endpoint {
    /// Its address, with 4 bytes or with 16.
    pub(crate) octets: Vec<u8>,
    pub(crate) port: u16,
}

/// Returns the user of the socket at `near` that is connected to `far`, if the table has it.
pub(crate) fn user(table: &str, near: &Endpoint, far: &Endpoint) -> Option<u32> {
    let (near, far) = (near.written(), far.written());
    table.lines().skip(1).find_map(|line| {
        let mut words = line.split_whitespace().skip(1);
        let is_it = words.next() == Some(&near) && words.next() == Some(&far);
        // The state, two queues and a timer come before the user.
        if is_it { words.nth(4)?.parse().ok() } else { None }
    })
}

impl Endpoint {
    /// Returns it as the table writes it.
    fn written(&self) -> String {
        let mut text = String::new();
        for word in self.octets.chunks_exact(4) {
            let word = word.try_into().map_or(0, u32::from_ne_bytes);
            write!(text, "{word:08X}").unwrap_or_default();
        }
        format!("{text}:{:04X}", self.port)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_endian = "little")]
    fn the_user_is_that_of_the_other_end() {
        let table = "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n   \
                     0: 0100007F:223D 0100007F:9C40 01 00000000:00000000 00:00000000 00000000     0        0 11 1 0\n   \
                     1: 0100007F:9C40 0100007F:223D 01 00000000:00000000 00:00000000 00000000  1000        0 12 1 0\n   \
                     2: 0100007F:9C41 0100007F:223D 01 broken\n";
        let at = |port: u16| Endpoint { octets: vec![127, 0, 0, 1], port };
        assert_eq!(user(table, &at(40_000), &at(8765)), Some(1000));
        assert_eq!(user(table, &at(8765), &at(40_000)), Some(0));
        assert_eq!(user(table, &at(40_001), &at(8765)), None);
        assert_eq!(user(table, &at(40_002), &at(8765)), None);
        assert_eq!(user("", &at(40_000), &at(8765)), None);
        let six = Endpoint { octets: [vec![0; 15], vec![1]].concat(), port: 8765 };
        assert_eq!(six.written(), "00000000000000000000000001000000:223D");
    }
}
