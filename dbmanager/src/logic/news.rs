//! New transactions of their sender, as they are pushed: without what their receivers know.
//!
//! *Rule.* A frame is taken only by who has the one before it at its origin, hence the same [`Head`]. So in the header of a frame,
//! and there only, stamp and wall clock are said as differences, and what was seen by places in the head's context in place of
//! names; in place of the link before is the frame's own. That is 45 bytes less for one who has seen three others. The digest of what
//! was seen is left out: who has that works it out. Whoever has another head, or has seen other transactions, makes another frame of
//! it, which the link shows, and pulls. Logs, disks and answers have whole frames.

use crate::logic::clock::{Stamp, Wall};
use crate::logic::cut::{Cut, Dot, Origin};
use crate::logic::log::Head;
use crate::logic::txn::{FORMAT, Frame, Header, Link};
use serde::{Deserialize, Serialize};

/// Frames that follow each other.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct News {
    /// The number of the one before them.
    after: u64,
    short: Vec<Frame>,
}

impl News {
    /// Returns what to say of own frames to who has the head before them; `None` if that cannot be said shorter.
    pub fn of(mut head: Head, frames: &[Frame]) -> Option<Self> {
        let after = head.seq;
        let shorten = |frame: &Frame| {
            let (header, rest) = frame.split().ok()?;
            let rest = frame.seen().map_or(Some(rest), |seen| rest.strip_suffix(&seen.0))?;
            let short = Frame::join(frame.format, &relative(&header, &head, frame.link())?, rest);
            head = next(&head, &header, frame.link());
            Some(short)
        };
        Some(Self { after, short: frames.iter().map(shorten).collect::<Option<_>>()? })
    }

    /// Returns the frames of `origin`; `None` if `head` is not the one before them. `seen` is [`Log::seen`](super::log::Log::seen).
    pub fn frames(&self, origin: Origin, mut head: Head, seen: impl Fn(&Cut) -> Option<Link>) -> Option<Vec<Frame>> {
        if head.seq != self.after {
            return None;
        }
        let lengthen = |short: &Frame| {
            let (said, rest) = short.split().ok()?;
            let header = absolute(&said, &head, origin)?;
            let rest = match short.format {
                FORMAT => [rest, &seen(&header.context)?.0].concat(),
                _ => rest.to_vec(),
            };
            let frame = Frame::join(short.format, &header, &rest);
            head = next(&head, &header, said.prev);
            (frame.link() == said.prev).then_some(frame)
        };
        self.short.iter().map(lengthen).collect()
    }

    /// Returns numbers and links of the frames.
    pub fn links(&self) -> impl Iterator<Item = (u64, Link)> {
        let links = self.short.iter().filter_map(|short| short.split().ok()).map(|(said, _)| said.prev);
        links.zip(1..).map(|(link, number)| (self.after.saturating_add(number), link))
    }
}

fn next(head: &Head, header: &Header, link: Link) -> Head {
    let Header { stamp, seq, context, .. } = header;
    let context = head.seen_after(Dot { origin: stamp.origin, seq: *seq }, context);
    Head { seq: *seq, link, stamp: *stamp, context }
}

/// An origin that is not in the context before keeps its name, which must not look like a place.
fn relative(header: &Header, head: &Head, link: Link) -> Option<Header> {
    let names: Vec<Origin> = head.context.iter().map(|(origin, _)| origin).collect();
    let places = u64::try_from(names.len()).ok()?;
    let said = |(origin, seq): (Origin, u64)| match names.binary_search(&origin) {
        Ok(place) => Some((Origin::new(u64::try_from(place).ok()?), seq.checked_sub(head.context.get(origin))?)),
        Err(_) => (origin.number() >= places).then_some((origin, seq)),
    };
    let Stamp { epoch, hlc, .. } = header.stamp;
    let ahead = header.wall.millis.wrapping_sub(header.stamp.millis()).cast_signed();
    Some(Header {
        stamp: Stamp {
            epoch: epoch.wrapping_sub(head.stamp.epoch),
            hlc: hlc.wrapping_sub(head.stamp.hlc),
            origin: Origin::default(),
        },
        seq: 0,
        prev: link,
        wall: Wall { millis: (ahead << 1 ^ ahead >> 63).cast_unsigned(), ..header.wall },
        context: header.context.iter().map(said).collect::<Option<Cut>>()?,
    })
}

fn absolute(said: &Header, head: &Head, origin: Origin) -> Option<Header> {
    let names: Vec<(Origin, u64)> = head.context.iter().collect();
    let meant = |(origin, seq): (Origin, u64)| match usize::try_from(origin.number()).ok().and_then(|at| names.get(at))
    {
        Some((origin, before)) => Some((*origin, before.checked_add(seq)?)),
        None => Some((origin, seq)),
    };
    let (epoch, hlc) = (said.stamp.epoch.wrapping_add(head.stamp.epoch), said.stamp.hlc.wrapping_add(head.stamp.hlc));
    let ahead = (said.wall.millis >> 1) ^ (said.wall.millis & 1).wrapping_neg();
    let stamp = Stamp { epoch, hlc, origin };
    Some(Header {
        stamp,
        seq: head.seq.checked_add(1)?,
        prev: head.link,
        wall: Wall { millis: stamp.millis().wrapping_add(ahead), ..said.wall },
        context: said.context.iter().map(meant).collect::<Option<Cut>>()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::clock::Quality;
    use crate::logic::key::Key;
    use crate::logic::txn::{Txn, Write};
    use proptest::prelude::*;

    /// A transaction by what it has seen besides: some of eight origins, and how far the clocks went.
    type Step = (Vec<(u64, u64)>, u64, u64);

    fn steps() -> impl Strategy<Value = Vec<Step>> {
        let seen = proptest::collection::vec((0..8_u64, 1..300_u64), 0..5);
        proptest::collection::vec((seen, 0..1_u64 << 40, any::<u64>()), 1..6)
    }

    const SEEN: Link = Link([9; 8]);

    fn name(number: u64) -> Origin {
        Origin::new(0x9e37_79b9_7f4a_7c15_u64.wrapping_mul(number + 1))
    }

    /// Returns the frames of a chain, with the head before each.
    fn chain(steps: &[Step]) -> Vec<(Head, Frame)> {
        let (mut head, mut chain, me) = (Head::default(), Vec::new(), name(100));
        for (seen, later, wall) in steps {
            let cut: Cut = seen.iter().map(|(of, more)| (name(*of), head.context.get(name(*of)) + more)).collect();
            let stamp = Stamp { epoch: head.stamp.epoch, hlc: head.stamp.hlc.wrapping_add(*later), origin: me };
            let wall = Wall { millis: *wall, quality: Quality::Network };
            let write = Write { key: Key::new("team/a").unwrap(), value: Some(b"v".into()) };
            let (seq, prev, context) = (head.seq + 1, head.link, cut);
            let (reason, requires, writes) = (String::new(), Vec::new(), vec![write]);
            let txn = Txn { stamp, seq, prev, wall, context, reason, requires, writes, wants_ack: false, rebase: None };
            let frame = Frame::seal_on(&txn, SEEN).unwrap();
            let after = next(&head, &frame.split().unwrap().0, frame.link());
            chain.push((std::mem::replace(&mut head, after), frame));
        }
        chain
    }

    proptest! {
        #[test]
        fn who_has_the_head_gets_the_frames_and_nobody_else_gets_others(steps in steps(), split in 0..6_usize) {
            let chain = chain(&steps);
            let split = split.min(chain.len() - 1);
            let frames: Vec<Frame> = chain[split..].iter().map(|(_, frame)| frame.clone()).collect();
            let news = News::of(chain[split].0.clone(), &frames).unwrap();
            let bytes = postcard::to_stdvec(&news).unwrap();
            let news: News = postcard::from_bytes(&bytes).unwrap();
            let links: Vec<Link> = news.links().map(|(_, link)| link).collect();
            prop_assert_eq!(links, frames.iter().map(Frame::link).collect::<Vec<_>>());
            for (head, _) in &chain {
                let expected = (head.seq == chain[split].0.seq).then_some(&frames);
                let meant = news.frames(name(100), head.clone(), |_| Some(SEEN));
                prop_assert_eq!(meant.as_ref(), expected);
            }
            let other = Head { link: Link([7; 8]), ..chain[split].0.clone() };
            prop_assert_eq!(news.frames(name(100), other, |_| Some(SEEN)), None);
            let elsewhere = news.frames(name(100), chain[split].0.clone(), |_| Some(Link([8; 8])));
            prop_assert_eq!(elsewhere, None, "who has seen another transaction by such a number makes nothing of it");
        }

        #[test]
        fn any_bytes_are_read_or_refused(format: u8, body: Vec<u8>, seq: u64) {
            let head = Head { seq, ..Head::default() };
            let news = News { after: seq, short: vec![Frame { format, body }] };
            prop_assert!(news.frames(name(100), head, |_| Some(SEEN)).is_none_or(|frames| frames.len() == 1));
        }
    }

    #[test]
    fn what_three_others_wrote_costs_a_few_bytes() {
        let seen = |more: u64| (0..3).map(|of| (of, more)).collect::<Vec<_>>();
        let chain = chain(&[(seen(1000), 1 << 57, 1 << 41), (seen(1), 400 << 16, (1 << 41) + 400)]);
        let (head, frame) = &chain[1];
        let news = News::of(head.clone(), std::slice::from_ref(frame)).unwrap();
        let size = |short: usize| frame.body.len() - short;
        assert!(size(news.short[0].body.len()) >= 40, "{} bytes less", size(news.short[0].body.len()));
    }

    #[test]
    fn a_name_that_looks_like_a_place_is_not_said_shorter() {
        let chain = chain(&[(vec![(1, 1)], 1, 1), (vec![(1, 1)], 1, 1)]);
        let (head, _) = &chain[1];
        let header = Header { context: [(Origin::new(0), 1)].into_iter().collect(), ..chain[1].1.split().unwrap().0 };
        assert_eq!(relative(&header, head, Link::default()), None);
    }
}
