//! The record of the samples that arrive at an input, for any type of samples.

use comms::logic::time::Time;
use std::time::Duration;

/// Clocks of two hosts are not comparable. If a sample seems older than this when it arrives, or comes from the future,
/// its stamp is from another clock. Then its age is measured from its arrival.
const FOREIGN: Duration = Duration::from_secs(10);

/// If a sample has been repeated so often, this is reported when its reader fails.
const REPEATED_MIN: u64 = 3;

/// The samples of an input in one activation.
#[derive(Clone, Copy, Debug, Default)]
pub struct Arrivals {
    /// The stamp of the newest sample.
    stamp: Option<Time>,
    arrived: Time,
    received: u64,
    /// The number of samples that did not repeat the previous one, and how many of these a calculation has seen.
    new: u64,
    seen: u64,
    /// How often the newest sample has been repeated.
    repeated: u64,
    lost: u64,
    refusals: Refusals,
}

impl Arrivals {
    /// Records a sample with the stamp of its measurement, if it has one.
    pub fn accept(&mut self, stamp: Option<Time>, arrived: Time) {
        let is_repeated = self.received > 0 && self.stamp.is_some() && stamp == self.stamp;
        self.repeated = if is_repeated { self.repeated + 1 } else { 0 };
        self.new += u64::from(!is_repeated);
        (self.stamp, self.arrived) = (stamp, arrived);
        self.received += 1;
        self.refusals.accept();
    }

    /// Records a refused sample, in which a number is not finite.
    pub fn refuse(&mut self) {
        self.refusals.refuse();
    }

    /// Records that `count` samples were sent, but will not arrive.
    pub fn lose(&mut self, count: u64) {
        self.lost += count;
    }

    /// Records that a calculation has seen the newest sample.
    pub fn mark_seen(&mut self) {
        self.seen = self.new;
    }

    /// Returns when the newest sample was measured, on this host's clock: its stamp, or its arrival if it has no stamp
    /// of this clock. Returns none before the first sample.
    pub fn measured(&self) -> Option<Time> {
        let own = self.stamp.filter(|stamp| *stamp <= self.arrived && self.arrived.since(*stamp) <= FOREIGN);
        (self.received > 0).then(|| own.unwrap_or(self.arrived))
    }

    /// Returns how old the newest sample is at `now`, see [`Arrivals::measured`].
    pub fn age(&self, now: Time) -> Option<Duration> {
        self.measured().map(|measured| now.since(measured))
    }

    /// Returns whether there is a sample that is at most `age_max` old at `now`.
    pub fn is_fresh_within(&self, now: Time, age_max: Duration) -> bool {
        self.age(now).is_some_and(|age| age <= age_max)
    }

    /// Returns whether a sample that does not repeat the previous one has arrived since the last calculation.
    pub fn is_fresh(&self) -> bool {
        self.new > self.seen
    }

    /// Returns when the newest sample arrived, on this host's clock; none before the first sample.
    pub fn arrived(&self) -> Option<Time> {
        (self.received > 0).then_some(self.arrived)
    }

    /// Returns how many samples the input has taken.
    pub fn received(&self) -> u64 {
        self.received
    }

    /// Returns how many samples were sent to the input but have not arrived.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Returns how many samples were refused.
    pub fn refused(&self) -> u64 {
        self.refusals.all
    }

    /// Returns the present problem with the samples, for a person: `has refused its last 6 values ...`.
    pub fn trouble(&self) -> Option<String> {
        let is_stuck = self.repeated >= REPEATED_MIN;
        let stuck =
            is_stuck.then(|| format!("has received its last sample {} more times, with the same stamp", self.repeated));
        self.refusals.trouble().or(stuck)
    }
}

/// The values that an input has refused in this activation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Refusals {
    pub(super) all: u64,
    /// The number of refusals since the last accepted value.
    in_a_row: u64,
}

impl Refusals {
    pub(super) fn accept(&mut self) {
        self.in_a_row = 0;
    }

    pub(super) fn refuse(&mut self) {
        (self.all, self.in_a_row) = (self.all + 1, self.in_a_row + 1);
    }

    pub(super) fn trouble(self) -> Option<String> {
        match self.in_a_row {
            0 => None,
            1 => Some("has refused its last value: a number in it was not finite".to_owned()),
            count => Some(format!("has refused its last {count} values: a number in them was not finite")),
        }
    }
}
