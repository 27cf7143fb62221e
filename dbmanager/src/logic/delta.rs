//! Delta push: the new transactions of a replica, encoded relative to the receivers' knowledge.
//!
//! *Rule.* A receiver takes a transaction only if it has the previous one of its origin, so both have the same
//! [`Head`]. Therefore the header of a transaction in a push is relative to the head: timestamp and wall clock are
//! differences, and seen origins are positions in the head's context instead of names. The hash of the previous
//! transaction is replaced by the transaction's own hash. This saves 45 bytes for a transaction that has seen three
//! other transactions. The digest of the transactions seen is left out, because the receiver can compute it. A receiver
//! that has another head, or has seen other transactions, decodes a different transaction. The hash shows this, and the
//! receiver pulls. Logs, disks and answers have complete transactions.

use crate::logic::clock::{Timestamp, Wall};
use crate::logic::log::Head;
use crate::logic::notary::SIGNATURE_SIZE;
use crate::logic::txn::{ChainHash, EncodedTxn, FORMAT, FORMAT_SIGNED, Header};
use crate::logic::version_vector::{Dot, ReplicaId, VersionVector};
use serde::{Deserialize, Serialize};

/// Consecutive transactions of one origin.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DeltaPush {
    /// The number of the transaction before the first one.
    after: u64,
    short: Vec<EncodedTxn>,
}

impl DeltaPush {
    /// Returns the delta of own transactions for a receiver with `head`, the head before them. `None` if the delta
    /// would not be shorter.
    pub fn of(mut head: Head, txns: &[EncodedTxn]) -> Option<Self> {
        let after = head.seq;
        let shorten = |encoded: &EncodedTxn| {
            let (header, rest) = encoded.split().ok()?;
            let (rest, signature) = split_signature(encoded.format, rest)?;
            let rest = encoded.seen().map_or(Some(rest), |seen| rest.strip_suffix(&seen.0))?;
            let rest = [rest, signature].concat();
            let short = EncodedTxn::join(encoded.format, &relative(&header, &head, encoded.hash())?, &rest);
            head = next(&head, &header, encoded.hash());
            Some(short)
        };
        Some(Self { after, short: txns.iter().map(shorten).collect::<Option<_>>()? })
    }

    /// Returns the transactions of `origin`; `None` if `head` is not the head before them. `seen` is
    /// [`Log::seen`](super::log::Log::seen).
    pub fn txns(
        &self,
        origin: ReplicaId,
        mut head: Head,
        seen: impl Fn(&VersionVector) -> Option<ChainHash>,
    ) -> Option<Vec<EncodedTxn>> {
        if head.seq != self.after {
            return None;
        }
        let lengthen = |short: &EncodedTxn| {
            let (said, rest) = short.split().ok()?;
            let header = absolute(&said, &head, origin)?;
            let rest = match short.format {
                FORMAT => [rest, &seen(&header.context)?.0].concat(),
                FORMAT_SIGNED => {
                    let (rest, signature) = split_signature(short.format, rest)?;
                    [rest, &seen(&header.context)?.0, signature].concat()
                }
                _ => rest.to_vec(),
            };
            let encoded = EncodedTxn::join(short.format, &header, &rest);
            head = next(&head, &header, said.prev);
            (encoded.hash() == said.prev).then_some(encoded)
        };
        self.short.iter().map(lengthen).collect()
    }

    /// Returns the numbers and hashes of the transactions.
    pub fn hashes(&self) -> impl Iterator<Item = (u64, ChainHash)> {
        let hashes = self.short.iter().filter_map(|short| short.split().ok()).map(|(said, _)| said.prev);
        hashes.zip(1..).map(|(hash, number)| (self.after.saturating_add(number), hash))
    }
}

/// Splits the signature from the end, if there is one.
fn split_signature(format: u8, rest: &[u8]) -> Option<(&[u8], &[u8])> {
    if format == FORMAT_SIGNED {
        rest.split_at_checked(rest.len().checked_sub(SIGNATURE_SIZE)?)
    } else {
        Some((rest, &[]))
    }
}

fn next(head: &Head, header: &Header, hash: ChainHash) -> Head {
    let Header { stamp, seq, context, .. } = header;
    let context = head.seen_after(Dot { origin: stamp.origin, seq: *seq }, context);
    Head { seq: *seq, hash, stamp: *stamp, context }
}

/// Returns the header relative to the head. An origin that is not in the head's context keeps its name, which must not
/// look like a position.
fn relative(header: &Header, head: &Head, hash: ChainHash) -> Option<Header> {
    let names: Vec<ReplicaId> = head.context.iter().map(|(origin, _)| origin).collect();
    let places = u64::try_from(names.len()).ok()?;
    let said = |(origin, seq): (ReplicaId, u64)| match names.binary_search(&origin) {
        Ok(place) => Some((ReplicaId::new(u64::try_from(place).ok()?), seq.checked_sub(head.context.get(origin))?)),
        Err(_) => (origin.number() >= places).then_some((origin, seq)),
    };
    let Timestamp { epoch, hlc, .. } = header.stamp;
    let ahead = header.wall.millis.wrapping_sub(header.stamp.millis()).cast_signed();
    Some(Header {
        stamp: Timestamp {
            epoch: epoch.wrapping_sub(head.stamp.epoch),
            hlc: hlc.wrapping_sub(head.stamp.hlc),
            origin: ReplicaId::default(),
        },
        seq: 0,
        prev: hash,
        wall: Wall { millis: (ahead << 1 ^ ahead >> 63).cast_unsigned(), ..header.wall },
        context: header.context.iter().map(said).collect::<Option<VersionVector>>()?,
    })
}

fn absolute(said: &Header, head: &Head, origin: ReplicaId) -> Option<Header> {
    let names: Vec<(ReplicaId, u64)> = head.context.iter().collect();
    let meant =
        |(origin, seq): (ReplicaId, u64)| match usize::try_from(origin.number()).ok().and_then(|at| names.get(at)) {
            Some((origin, before)) => Some((*origin, before.checked_add(seq)?)),
            None => Some((origin, seq)),
        };
    let (epoch, hlc) = (said.stamp.epoch.wrapping_add(head.stamp.epoch), said.stamp.hlc.wrapping_add(head.stamp.hlc));
    let ahead = (said.wall.millis >> 1) ^ (said.wall.millis & 1).wrapping_neg();
    let stamp = Timestamp { epoch, hlc, origin };
    Some(Header {
        stamp,
        seq: head.seq.checked_add(1)?,
        prev: head.hash,
        wall: Wall { millis: stamp.millis().wrapping_add(ahead), ..said.wall },
        context: said.context.iter().map(meant).collect::<Option<VersionVector>>()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Quality;
    use crate::logic::key::Key;
    use crate::logic::txn::{Txn, Write};
    use proptest::prelude::*;

    /// A step of one origin: which transactions of eight others it has seen, and the progress of the clocks.
    type Step = (Vec<(u64, u64)>, u64, u64);

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let seen = proptest::collection::vec((0..8_u64, 1..300_u64), 0..5);
        proptest::collection::vec((seen, 0..1_u64 << 40, any::<u64>()), 1..6)
    }

    const SEEN: ChainHash = ChainHash([9; 8]);

    fn name(number: u64) -> ReplicaId {
        ReplicaId::new(0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(number + 1))
    }

    /// Returns the transactions of a chain, with the head before each.
    fn chain(steps: &[Step]) -> Vec<(Head, EncodedTxn)> {
        let (mut head, mut chain, me) = (Head::default(), Vec::new(), name(100));
        for (seen, later, wall) in steps {
            let vector: VersionVector =
                seen.iter().map(|(of, more)| (name(*of), head.context.get(name(*of)) + more)).collect();
            let stamp = Timestamp { epoch: head.stamp.epoch, hlc: head.stamp.hlc.wrapping_add(*later), origin: me };
            let wall = Wall { millis: *wall, quality: Quality::Network };
            let write = Write { key: Key::new("team/a").unwrap(), value: Some(b"v".into()) };
            let (seq, prev, context) = (head.seq + 1, head.hash, vector);
            let (reason, requires, writes) = (String::new(), Vec::new(), vec![write]);
            let txn = Txn { stamp, seq, prev, wall, context, reason, requires, writes, wants_ack: false, rebase: None };
            let encoded = EncodedTxn::seal_on(&txn, SEEN).unwrap();
            let after = next(&head, &encoded.split().unwrap().0, encoded.hash());
            chain.push((std::mem::replace(&mut head, after), encoded));
        }
        chain
    }

    proptest! {
        #[test]
        fn who_has_the_head_gets_the_frames_and_nobody_else_gets_others(steps in steps(), split in 0..6_usize) {
            let chain = chain(&steps);
            let split = split.min(chain.len() - 1);
            let txns: Vec<EncodedTxn> = chain[split..].iter().map(|(_, encoded)| encoded.clone()).collect();
            let push = DeltaPush::of(chain[split].0.clone(), &txns).unwrap();
            let bytes = postcard::to_stdvec(&push).unwrap();
            let push: DeltaPush = postcard::from_bytes(&bytes).unwrap();
            let hashes: Vec<ChainHash> = push.hashes().map(|(_, hash)| hash).collect();
            prop_assert_eq!(hashes, txns.iter().map(EncodedTxn::hash).collect::<Vec<_>>());
            for (head, _) in &chain {
                let expected = (head.seq == chain[split].0.seq).then_some(&txns);
                let meant = push.txns(name(100), head.clone(), |_| Some(SEEN));
                prop_assert_eq!(meant.as_ref(), expected);
            }
            let other = Head { hash: ChainHash([7; 8]), ..chain[split].0.clone() };
            prop_assert_eq!(push.txns(name(100), other, |_| Some(SEEN)), None);
            let elsewhere = push.txns(name(100), chain[split].0.clone(), |_| Some(ChainHash([8; 8])));
            prop_assert_eq!(elsewhere, None, "who has seen another transaction by such a number makes nothing of it");
        }

        #[test]
        fn any_bytes_are_read_or_refused(format: u8, body: Vec<u8>, seq: u64) {
            let head = Head { seq, ..Head::default() };
            let push = DeltaPush { after: seq, short: vec![EncodedTxn { format, body }] };
            prop_assert!(push.txns(name(100), head, |_| Some(SEEN)).is_none_or(|txns| txns.len() == 1));
        }
    }

    #[test]
    fn what_three_others_wrote_costs_a_few_bytes() {
        let seen = |more: u64| (0..3).map(|of| (of, more)).collect::<Vec<_>>();
        let chain = chain(&[(seen(1000), 1 << 57, 1 << 41), (seen(1), 400 << 16, (1 << 41) + 400)]);
        let (head, encoded) = &chain[1];
        let push = DeltaPush::of(head.clone(), std::slice::from_ref(encoded)).unwrap();
        let size = |short: usize| encoded.body.len() - short;
        assert!(size(push.short[0].body.len()) >= 40, "{} bytes less", size(push.short[0].body.len()));
    }

    #[test]
    fn a_name_that_looks_like_a_place_is_not_said_shorter() {
        let chain = chain(&[(vec![(1, 1)], 1, 1), (vec![(1, 1)], 1, 1)]);
        let (head, _) = &chain[1];
        let header =
            Header { context: [(ReplicaId::new(0), 1)].into_iter().collect(), ..chain[1].1.split().unwrap().0 };
        assert_eq!(relative(&header, head, ChainHash::default()), None);
    }
}
