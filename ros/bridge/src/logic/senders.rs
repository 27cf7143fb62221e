//! The publishers of a topic, and how many of their messages did not arrive.

use ros::logic::attachment::{Attachment, Gid};
use std::collections::BTreeMap;

/// The largest number of publishers that are known at one time. If a forgotten publisher sends again, it counts as new.
const SENDERS_MAX: usize = 256;
/// The largest gap that counts as a loss. A larger gap means that the publisher was restarted or sends nonsense.
const GAP_MAX: i64 = 1_000_000;

/// For each publisher, the number of its last message, and the position of this message among all messages.
#[derive(Debug, Default)]
pub(crate) struct Senders {
    last: BTreeMap<Gid, (i64, u64)>,
    heard: u64,
}

impl Senders {
    /// Records a message; returns how many messages of its sender are missing before it.
    pub(crate) fn hear(&mut self, message: &Attachment) -> u64 {
        self.heard += 1;
        let before = self.last.insert(message.sender, (message.sequence, self.heard));
        if self.last.len() > SENDERS_MAX {
            let oldest = self.last.iter().min_by_key(|(_, (_, heard))| *heard).map(|(sender, _)| *sender);
            self.last.retain(|sender, _| Some(*sender) != oldest);
        }
        let Some((last, _)) = before else { return 0 };
        let missing = message.sequence.saturating_sub(last).saturating_sub(1);
        if (0..=GAP_MAX).contains(&missing) { missing.unsigned_abs() } else { 0 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn message(sender: u16, sequence: i64) -> Attachment {
        let mut gid = [0; 16];
        gid[..2].copy_from_slice(&sender.to_le_bytes());
        Attachment { sequence, nanos: 0, sender: Gid(gid) }
    }

    #[test]
    fn gaps_are_counted_for_each_sender() {
        let mut senders = Senders::default();
        let missing = [(1, 5), (1, 6), (2, 1), (1, 9), (2, 2), (2, 2), (2, 1), (2, 4)]
            .map(|(sender, sequence)| senders.hear(&message(sender, sequence)));
        assert_eq!(missing, [0, 0, 0, 2, 0, 0, 0, 2]);
    }

    #[test]
    fn nonsense_is_no_gap_and_takes_no_memory() {
        let mut senders = Senders::default();
        for sequence in [1, i64::MAX, i64::MIN, -1, GAP_MAX + 1] {
            assert_eq!(senders.hear(&message(1, sequence)), 0, "{sequence}");
        }
        for sender in 0..1000 {
            assert_eq!(senders.hear(&message(sender, 1)), 0);
        }
        assert_eq!(senders.last.len(), SENDERS_MAX);
        assert_eq!(senders.hear(&message(999, 3)), 1, "it is one of the last");
        assert_eq!(senders.hear(&message(1, 3)), 0, "it is forgotten");
    }
}
