//! The messages of topics that wait for the loop, and the counts of received, lost and refused messages.

use super::conversion::Conversion;
use super::senders::Senders;
use super::value;
use ros::logic::attachment::Attachment;
use ros::logic::cdr::{self, CdrError};
use ros::logic::schema::Schema;
use std::borrow::Cow;
use std::collections::VecDeque;
use thiserror::Error;

/// The longest message, in bytes.
const MESSAGE_MAX: usize = 64 << 20;

/// Why a message of a topic is not passed on.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub(crate) enum Refused {
    /// ROS 2 sends none without an attachment.
    #[error("it has no attachment, or the attachment has another form")]
    Attachment,
    /// It is longer than any message may be.
    #[error("it has {0} bytes, and {MESSAGE_MAX} are the limit")]
    Long(usize),
    /// Its bytes are not a message of its type.
    #[error("its bytes are not a message of its type: {0}")]
    Bytes(#[from] CdrError),
    /// A static transform would make consumers refuse all static transforms.
    #[error("a number of a static transform is not finite")]
    NotFinite,
    /// More static transforms would take too much memory.
    #[error("there are more static transforms than {0}")]
    Many(usize),
    /// It answers another request.
    #[error("its attachment belongs to another request")]
    OtherRequest,
}

/// A refused message, and the number of refused messages until then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Told {
    pub(crate) why: Refused,
    pub(crate) refused: u64,
}

/// How many messages of a topic were received, lost and refused.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    pub(crate) received: u64,
    pub(crate) lost: u64,
    pub(crate) refused: u64,
}

/// A value for a wire.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Arrived {
    /// How many values before it are lost.
    pub(crate) lost: u64,
    pub(crate) value: Vec<u8>,
}

/// A message that is passed on.
struct Passed {
    attachment: Attachment,
    value: Vec<u8>,
}

/// The messages of one topic.
#[derive(Debug)]
pub(crate) struct Arrivals {
    conversion: Conversion,
    depth: usize,
    waiting: VecDeque<Arrived>,
    senders: Senders,
    counts: Counts,
}

impl Arrivals {
    /// Returns the messages of a topic with this conversion, of which `depth` wait at most.
    pub(crate) fn new(conversion: Conversion, depth: usize) -> Self {
        let (waiting, senders, counts) = (VecDeque::new(), Senders::default(), Counts::default());
        Self { conversion, depth: depth.max(1), waiting, senders, counts }
    }

    /// Takes a message in parts. The oldest waiting message is dropped for it.
    ///
    /// # Errors
    /// It is not passed on.
    pub(crate) fn take(&mut self, attachment: Option<&[u8]>, parts: &[&[u8]]) -> Result<(), Told> {
        let Passed { attachment, value } = self.passed(attachment, parts).map_err(|why| {
            self.counts.refused += 1;
            Told { why, refused: self.counts.refused }
        })?;
        self.counts.received += 1;
        let mut lost = self.senders.hear(&attachment);
        self.counts.lost += lost;
        if self.waiting.len() >= self.depth
            && let Some(oldest) = self.waiting.pop_front()
        {
            let own = u64::from(!self.conversion.is_cumulative());
            self.counts.lost += own;
            let before = self.waiting.front_mut().map_or(&mut lost, |next| &mut next.lost);
            *before += oldest.lost + own;
        }
        self.waiting.push_back(Arrived { lost, value });
        Ok(())
    }

    /// Returns the value of a message, and its attachment. The bytes are copied once if nothing changes them.
    fn passed(&mut self, attachment: Option<&[u8]>, parts: &[&[u8]]) -> Result<Passed, Refused> {
        let attachment = decoded(attachment)?;
        let length = parts.iter().map(|part| part.len()).sum::<usize>();
        if length > MESSAGE_MAX {
            return Err(Refused::Long(length));
        }
        let value = value::of_parts(parts);
        let message = value::message_in(&value).unwrap_or_default();
        let changed = match self.conversion.convert(Cow::Borrowed(message))? {
            Cow::Borrowed(_) => None,
            Cow::Owned(changed) => Some(value::of_message(&changed)),
        };
        Ok(Passed { attachment, value: changed.unwrap_or(value) })
    }

    /// Returns the next message that waits.
    pub(crate) fn next(&mut self) -> Option<Arrived> {
        self.waiting.pop_front()
    }

    /// Returns how many messages were received, lost and refused.
    pub(crate) fn counts(&self) -> Counts {
        self.counts
    }
}

/// Returns the attachment of a message, if both are valid.
///
/// # Errors
/// The message is not passed on.
pub(crate) fn checked(schema: &Schema, attachment: Option<&[u8]>, message: &[u8]) -> Result<Attachment, Refused> {
    let attachment = decoded(attachment)?;
    cdr::check(schema, short(message)?)?;
    Ok(attachment)
}

fn decoded(attachment: Option<&[u8]>) -> Result<Attachment, Refused> {
    attachment.and_then(Attachment::decode).ok_or(Refused::Attachment)
}

/// Checks the response to a request. A server of ROS 2 sends the number of the request and the name of its client back.
///
/// # Errors
/// The response is not passed on.
pub(crate) fn answered(
    schema: &Schema,
    request: &Attachment,
    attachment: Option<&[u8]>,
    response: &[u8],
) -> Result<(), Refused> {
    let own = checked(schema, attachment, response)?;
    let is_answer = own.sequence == request.sequence && own.sender == request.sender;
    if is_answer { Ok(()) } else { Err(Refused::OtherRequest) }
}

/// Returns a message, unless it is too long.
///
/// # Errors
/// It is longer than any message may be.
pub(crate) fn short<M: AsRef<[u8]>>(message: M) -> Result<M, Refused> {
    let length = message.as_ref().len();
    if length > MESSAGE_MAX { Err(Refused::Long(length)) } else { Ok(message) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use controllers::ros::{geometry_msgs::TransformStamped, tf2_msgs::TFMessage};
    use proptest::prelude::*;
    use ros::logic::attachment::Gid;
    use ros::logic::library;
    use ros::logic::name::TypeName;
    use ros::logic::route::Route;
    use ros::typed::Message as _;

    /// A message `std_msgs/msg/UInt8`.
    fn arrivals(depth: usize) -> Arrivals {
        let schema = library::schema(&TypeName::parse("std_msgs/UInt8").unwrap()).unwrap();
        Arrivals::new(Conversion::none(schema), depth)
    }

    fn attachment(sequence: i64) -> [u8; 33] {
        Attachment { sequence, nanos: 0, sender: Gid([1; 16]) }.encode()
    }

    fn take(arrivals: &mut Arrivals, sequence: i64) {
        arrivals.take(Some(&attachment(sequence)), &[&[0, 1, 0, 0, 7]]).unwrap();
    }

    #[test]
    fn every_loss_is_told_before_the_next_value() {
        let mut arrivals = arrivals(2);
        for sequence in [1, 2, 5, 6, 8] {
            take(&mut arrivals, sequence);
        }
        // 1 and 2 gave way; 3 and 4 did not come; 5 gave way; 7 did not come.
        let told: Vec<u64> = std::iter::from_fn(|| arrivals.next()).map(|one| one.lost).collect();
        assert_eq!(told, [5, 1]);
        assert_eq!(arrivals.counts(), Counts { received: 5, lost: 6, refused: 0 });
        take(&mut arrivals, 9);
        assert_eq!(arrivals.next(), Some(Arrived { lost: 0, value: vec![5, 0, 1, 0, 0, 7] }));
    }

    proptest! {
        /// Messages of two publishers get lost, wait, give way and are taken, in any order. Each number of each
        /// publisher is a value, or is counted before the next value.
        #[test]
        fn each_message_is_a_value_or_is_counted(
            depth in 1..6_usize,
            steps in prop::collection::vec((0..2_u8, prop::option::weighted(0.7, 0..4_i64)), 0..100),
        ) {
            let schema = library::schema(&TypeName::parse("std_msgs/UInt8").unwrap()).unwrap();
            let mut arrivals = Arrivals::new(Conversion::none(schema), depth);
            let (mut last, mut taken, mut told, mut received) = ([0; 2], 0, 0, 0);
            for (sender, missing) in steps {
                let Some(missing) = missing else {
                    let next = arrivals.next();
                    told += next.as_ref().map_or(0, |next| next.lost);
                    taken += u64::from(next.is_some());
                    continue;
                };
                let last = &mut last[usize::from(sender)];
                // The messages before the first one of a publisher are not missed.
                *last += 1 + if *last == 0 { 0 } else { missing };
                let attachment = Attachment { sequence: *last, nanos: 0, sender: Gid([sender; 16]) }.encode();
                arrivals.take(Some(&attachment), &[&[0, 1, 0, 0, 7]]).unwrap();
                received += 1;
            }
            let counts = arrivals.counts();
            while let Some(next) = arrivals.next() {
                (taken, told) = (taken + 1, told + next.lost);
            }
            prop_assert_eq!(i64::try_from(taken + told).unwrap(), last[0] + last[1]);
            prop_assert_eq!(counts, Counts { received, lost: told, refused: 0 });
        }
    }

    #[test]
    fn one_message_at_a_time_is_the_newest() {
        let mut arrivals = arrivals(1);
        for sequence in 1..=3 {
            take(&mut arrivals, sequence);
        }
        assert_eq!(arrivals.next().map(|one| one.lost), Some(2));
        assert_eq!(arrivals.next(), None);
    }

    /// The newer message has all transforms of the older one.
    #[test]
    fn a_static_transform_that_gives_way_is_not_lost() {
        let route = Route::list("</tf_static tf2_msgs/msg/TFMessage :1:,1:,:,:,,").unwrap().remove(0);
        let schema = library::schema(&route.of).unwrap();
        let mut arrivals = Arrivals::new(Conversion::new(&route, schema), 1);
        for (sender, child) in [(1, "a"), (2, "b"), (3, "c")] {
            let transform = TransformStamped { child_frame_id: child.to_owned(), ..TransformStamped::default() };
            let message = TFMessage { transforms: vec![transform] }.to_cdr().unwrap();
            let attachment = Attachment { sequence: 1, nanos: 0, sender: Gid([sender; 16]) }.encode();
            arrivals.take(Some(&attachment), &[&message]).unwrap();
        }
        let Arrived { lost, value } = arrivals.next().unwrap();
        let all = TFMessage::from_cdr(value::message_in(&value).unwrap()).unwrap();
        assert_eq!(all.transforms.iter().map(|one| one.child_frame_id.as_str()).collect::<Vec<_>>(), ["a", "b", "c"]);
        assert_eq!((lost, arrivals.counts()), (0, Counts { received: 3, ..Counts::default() }));
    }

    #[test]
    fn what_is_no_message_is_refused() {
        let mut arrivals = arrivals(8);
        let whole = attachment(1);
        let message = [0, 1, 0, 0, 7];
        let long = vec![0; MESSAGE_MAX + 1];
        for (refused, (attachment, message, why)) in (1..).zip([
            (None, &message[..], Refused::Attachment),
            (Some(&whole[..32]), &message, Refused::Attachment),
            (Some(&[&whole[..], &[0]].concat()[..]), &message, Refused::Attachment),
            (Some(&whole), &[], Refused::Bytes(CdrError::Header)),
            (Some(&whole), &[0, 1, 0, 0], Refused::Bytes(CdrError::End)),
            (Some(&whole), &[0, 0, 0, 0, 7], Refused::Bytes(CdrError::Header)),
            (Some(&whole), &[0, 1, 0, 0, 7, 0, 0, 0, 0], Refused::Bytes(CdrError::Rest(4))),
            (Some(&whole), &long, Refused::Long(long.len())),
        ]) {
            assert_eq!(arrivals.take(attachment, &[message]), Err(Told { why, refused }));
        }
        assert_eq!((arrivals.next(), arrivals.counts()), (None, Counts { refused: 8, ..Counts::default() }));
    }
}
