//! Typed ports, and the sets of ports that `#[derive(Inputs)]` and `#[derive(Outputs)]` implement.

use super::arrivals::{Arrivals, Refusals};
use super::calls::AnyCalls;
use super::database::Database;
use super::export::CallInterface;
use super::finite::is_finite;
use super::port_interface::PortInterface;
use comms::io::direct::Filler;
use comms::logic::decode::{Source, decode_from};
use comms::logic::time::Time;
use postcard::ser_flavors::Flavor;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::VecDeque;
use std::fmt::Debug;
use std::time::Duration;

/// A value that travels from port to port: plain data in SI units, encoded with postcard.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a message",
    note = "write `impl Message for {Self} {{ const TYPE: &'static str = \"...\"; }}`"
)]
pub trait Message: Serialize + DeserializeOwned + Debug + Send + 'static {
    /// The name of the type in interfaces; a wire only joins ports with the same name.
    const TYPE: &'static str;
    /// The fields, as a spec writes them in a record: `force: Force[3], torque: Torque[3]`. If it is empty, `dca check`
    /// compares only the name.
    const FIELDS: &'static str = "";
    /// Whether numbers in the message may be infinite or NaN. If not, an input refuses such a value and counts it, and
    /// an output that sends one aborts its controller.
    const ALLOW_NAN: bool = false;

    /// Returns when the message was measured, on the clock of the device's host. The age of the
    /// sample is measured from this time, even if the sample was in transit for long. Returns none
    /// if it was not measured; then its age is measured from its arrival.
    fn stamp(&self) -> Option<Time> {
        None
    }
}

/// No value: for a procedure without an argument, or without a result.
impl Message for () {
    const TYPE: &'static str = "";
}

/// A text alone, as in the ports of activities.
impl Message for String {
    const TYPE: &'static str = "Text";
}

/// A number alone.
impl Message for f64 {
    const TYPE: &'static str = "Number";
}

/// Returns whether a message may go through a port.
pub(super) fn is_fit<T: Message>(value: &T) -> bool {
    T::ALLOW_NAN || is_finite(value)
}

/// Why an input does not take a value.
#[derive(Clone, Debug, PartialEq)]
pub enum Unfit {
    /// The bytes are of another type or version.
    Encoding(postcard::Error),
    /// A number in the value is infinite or NaN.
    NotFinite,
}

impl From<postcard::Error> for Unfit {
    fn from(cause: postcard::Error) -> Self {
        Self::Encoding(cause)
    }
}

/// An input: holds the newest value that arrived.
#[derive(Debug)]
pub struct In<T> {
    value: Option<T>,
    arrivals: Arrivals,
}

impl<T> Default for In<T> {
    fn default() -> Self {
        Self { value: None, arrivals: Arrivals::default() }
    }
}

impl<T: Message> In<T> {
    /// Returns when the newest value was measured, on this host's clock: its stamp, or its arrival if it has no stamp of
    /// this clock.
    pub fn measured(&self) -> Option<Time> {
        self.arrivals.measured()
    }

    /// Returns how old the newest value is at `now`, see [`In::measured`].
    pub fn age(&self, now: Time) -> Option<Duration> {
        self.arrivals.age(now)
    }

    /// Returns the newest value, even if it is old.
    pub fn latest(&self) -> Option<&T> {
        self.value.as_ref()
    }

    /// Returns the newest value if it is at most `age_max` old at `now`; see [`In::age`].
    pub fn fresh_within(&self, now: Time, age_max: Duration) -> Option<&T> {
        self.value.as_ref().filter(|_| self.arrivals.is_fresh_within(now, age_max))
    }

    /// Returns whether the input lacks a value that is at most `age_max` old at `now`: no value has
    /// arrived, or the last value is too old.
    pub fn stale(&self, now: Time, age_max: Duration) -> bool {
        self.fresh_within(now, age_max).is_none()
    }

    /// Returns the newest value if it arrived after the last calculation. A sample with the stamp of the previous
    /// sample only repeats it, because the sensor hangs. Such a sample is not fresh.
    pub fn fresh(&self) -> Option<&T> {
        self.value.as_ref().filter(|_| self.arrivals.is_fresh())
    }

    /// Returns when the newest value arrived, on this host's clock.
    pub fn arrived(&self) -> Option<Time> {
        self.arrivals.arrived()
    }

    /// Returns how many values have arrived in this activation.
    pub fn received(&self) -> u64 {
        self.arrivals.received()
    }

    /// Returns how many values were sent to this input in this activation but have not arrived: the link has dropped
    /// them, or the queue of the wire was full. Values that a switch of connections has held back and
    /// dropped are reported with the switch.
    pub fn lost(&self) -> u64 {
        self.arrivals.lost()
    }

    /// Returns how many values arrived in this activation but were refused, because a number in them was not finite;
    /// see [`Message::ALLOW_NAN`].
    pub fn refused(&self) -> u64 {
        self.arrivals.refused()
    }

    fn take(&mut self, value: T, arrived: Time) -> Result<(), Unfit> {
        if !is_fit(&value) {
            self.arrivals.refuse();
            return Err(Unfit::NotFinite);
        }
        self.arrivals.accept(value.stamp(), arrived);
        self.value = Some(value);
        Ok(())
    }
}

/// The largest number of values that an [`Every`] keeps; a further value replaces the oldest.
pub const EVERY_MAX: usize = 8192;

/// An input that keeps every value that has arrived since the last calculation, in order. It is for
/// values that are all needed, not only the latest. With `queue 1000` the spec sets how many values
/// wait before the input.
#[derive(Debug)]
pub struct Every<T> {
    values: VecDeque<T>,
    lost: u64,
    refusals: Refusals,
}

impl<T> Default for Every<T> {
    fn default() -> Self {
        Self { values: VecDeque::new(), lost: 0, refusals: Refusals::default() }
    }
}

impl<T: Message> Every<T> {
    /// Returns the values that have arrived since the last calculation, the oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &T> {
        self.values.iter()
    }

    /// Returns how many values were sent to this input in this activation but were never among its values: see
    /// [`In::lost`]. Values for which this input had no room are also counted.
    pub fn lost(&self) -> u64 {
        self.lost
    }

    /// Returns how many values were refused in this activation: see [`In::refused`].
    pub fn refused(&self) -> u64 {
        self.refusals.all
    }

    fn take(&mut self, value: T) -> Result<(), Unfit> {
        if !is_fit(&value) {
            self.refusals.refuse();
            return Err(Unfit::NotFinite);
        }
        self.refusals.accept();
        if self.values.len() >= EVERY_MAX {
            self.values.pop_front();
            self.lost += 1;
        }
        self.values.push_back(value);
        Ok(())
    }
}

/// An output: holds the value of one calculation until it is sent.
#[derive(Debug)]
pub struct Out<T> {
    pending: Option<T>,
}

impl<T> Default for Out<T> {
    fn default() -> Self {
        Self { pending: None }
    }
}

impl<T> Out<T> {
    /// Sends `value` after this calculation. If a calculation sends two values, only the second one is sent.
    pub fn send(&mut self, value: T) {
        self.pending = Some(value);
    }

    /// Returns the value that waits to be sent, if there is one.
    pub fn pending(&self) -> Option<&T> {
        self.pending.as_ref()
    }
}

/// An input of any type. Implemented by [`In`] and [`Every`]; used by [`super::Module`].
pub trait AnyIn {
    /// Takes an encoded value.
    ///
    /// # Errors
    /// If `bytes` are not a value of this port's type, or a number in it is not finite.
    fn deliver(&mut self, bytes: &[u8], arrived: Time) -> Result<(), Unfit>;
    /// Takes an encoded value that can only be copied. Each byte is copied once, directly into the value.
    ///
    /// # Errors
    /// As in [`AnyIn::deliver`].
    fn deliver_from(&mut self, source: &mut dyn Source, arrived: Time) -> Result<(), Unfit>;
    /// Returns the present problem with the values of this input, for a person: `has refused its last 6 values ...`.
    fn trouble(&self) -> Option<String>;
    /// Records that `count` values were sent, but will not arrive.
    fn lose(&mut self, count: u64);
    /// Records that a calculation has seen the newest value.
    fn mark_seen(&mut self);
    /// Forgets all values and counts.
    fn clear(&mut self);
}

impl<T: Message> AnyIn for In<T> {
    fn deliver(&mut self, bytes: &[u8], arrived: Time) -> Result<(), Unfit> {
        self.take(postcard::from_bytes(bytes)?, arrived)
    }

    fn deliver_from(&mut self, source: &mut dyn Source, arrived: Time) -> Result<(), Unfit> {
        self.take(decode_from(source)?, arrived)
    }

    fn trouble(&self) -> Option<String> {
        self.arrivals.trouble()
    }

    fn lose(&mut self, count: u64) {
        self.arrivals.lose(count);
    }

    fn mark_seen(&mut self) {
        self.arrivals.mark_seen();
    }

    fn clear(&mut self) {
        *self = Self::default();
    }
}

impl<T: Message> AnyIn for Every<T> {
    fn deliver(&mut self, bytes: &[u8], _: Time) -> Result<(), Unfit> {
        self.take(postcard::from_bytes(bytes)?)
    }

    fn deliver_from(&mut self, source: &mut dyn Source, _: Time) -> Result<(), Unfit> {
        self.take(decode_from(source)?)
    }

    fn trouble(&self) -> Option<String> {
        self.refusals.trouble()
    }

    fn lose(&mut self, count: u64) {
        self.lost += count;
    }

    fn mark_seen(&mut self) {
        self.values.clear();
    }

    fn clear(&mut self) {
        *self = Self::default();
    }
}

/// An output of any type. Implemented by [`Out`]; used by [`super::Module`].
pub trait AnyOut {
    /// Takes the waiting value, encoded, if there is one.
    fn take(&mut self) -> Option<Vec<u8>>;

    /// Returns whether a value waits.
    fn is_pending(&self) -> bool;

    /// Drops the waiting value if a number in it is not finite. Returns whether it has dropped the value.
    fn refuse(&mut self) -> bool;

    /// Encodes the waiting value directly into memory; returns whether there was room. In this case the value does not
    /// wait any more.
    fn fill(&mut self, filler: &mut Filler<'_>) -> bool;
}

impl<T: Message> AnyOut for Out<T> {
    fn take(&mut self) -> Option<Vec<u8>> {
        let value = self.pending.take()?;
        Some(postcard::to_stdvec(&value).expect("a message is plain data, which postcard always encodes"))
    }

    fn is_pending(&self) -> bool {
        self.pending.is_some()
    }

    fn refuse(&mut self) -> bool {
        self.pending.take_if(|value| !is_fit(value)).is_some()
    }

    fn fill(&mut self, filler: &mut Filler<'_>) -> bool {
        let value = self.pending.as_ref();
        let is_filled = value.is_some_and(|value| postcard::serialize_with_flavor(value, Memory(filler)).is_ok());
        if is_filled {
            self.pending = None;
        }
        is_filled
    }
}

/// The memory into which a value is encoded.
struct Memory<'a, 'b>(&'a mut Filler<'b>);

impl Flavor for Memory<'_, '_> {
    type Output = ();

    #[inline]
    fn try_extend(&mut self, bytes: &[u8]) -> postcard::Result<()> {
        if self.0.put(bytes) { Ok(()) } else { Err(postcard::Error::SerializeBufferFull) }
    }

    #[inline]
    fn try_push(&mut self, byte: u8) -> postcard::Result<()> {
        self.try_extend(&[byte])
    }

    fn finalize(self) -> postcard::Result<()> {
        Ok(())
    }
}

/// A field of a struct of inputs: [`In`] or [`Every`].
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not an input port",
    label = "expected `In<T>`, where `T` is a message",
    note = "a field of a struct with `#[derive(Inputs)]` is an `In<T>` or an `Every<T>`"
)]
pub trait InputPort: AnyIn + Default {
    /// The message type.
    type Message: Message;
}

impl<T: Message> InputPort for In<T> {
    type Message = T;
}

impl<T: Message> InputPort for Every<T> {
    type Message = T;
}

/// A field of a struct of outputs. Only [`Out`] implements this trait.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not an output port",
    label = "expected `Out<T>`, where `T` is a message",
    note = "a field of a struct with `#[derive(Outputs)]` is an `Out<T>`"
)]
pub trait OutputPort: AnyOut + Default {
    /// The message type.
    type Message: Message;
}

impl<T: Message> OutputPort for Out<T> {
    type Message = T;
}

/// The inputs of a controller. `#[derive(Inputs)]` implements this for a struct. A controller without inputs uses `()`.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a set of inputs",
    note = "a struct becomes one with `#[derive(Inputs)]`; `()` is for a controller without inputs"
)]
pub trait InputSet: Sized + Send + 'static {
    /// Returns the ports before anything has arrived.
    fn unconnected() -> Self;
    /// Returns the ports in order.
    fn declared() -> Vec<PortInterface>;
    /// Visits the ports in the same order.
    fn visit(&mut self, visit: &mut dyn FnMut(usize, &mut dyn AnyIn));
}

/// The outputs of a controller. Implemented by `#[derive(Outputs)]`; `()` for none.
#[diagnostic::on_unimplemented(
    message = "`{Self}` is not a set of outputs",
    note = "a struct becomes one with `#[derive(Outputs)]`; `()` is for a controller without outputs"
)]
pub trait OutputSet: Sized + Send + 'static {
    /// Returns the ports before anything is sent.
    fn unconnected() -> Self;
    /// Returns the ports in order.
    fn declared() -> Vec<PortInterface>;
    /// Visits the ports in the same order.
    fn visit(&mut self, visit: &mut dyn FnMut(usize, &mut dyn AnyOut));
    /// Returns the calls in order.
    fn declared_calls() -> Vec<CallInterface> {
        Vec::new()
    }
    /// Visits the calls in the same order.
    fn visit_calls(&mut self, _: &mut dyn FnMut(usize, &mut dyn AnyCalls)) {}
    /// Returns the database, if it is one of the fields.
    fn database(&mut self) -> Option<&mut Database> {
        None
    }
}

impl InputSet for () {
    fn unconnected() -> Self {}
    fn declared() -> Vec<PortInterface> {
        Vec::new()
    }
    fn visit(&mut self, _: &mut dyn FnMut(usize, &mut dyn AnyIn)) {}
}

impl OutputSet for () {
    fn unconnected() -> Self {}
    fn declared() -> Vec<PortInterface> {
        Vec::new()
    }
    fn visit(&mut self, _: &mut dyn FnMut(usize, &mut dyn AnyOut)) {}
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Clone, Debug, Serialize, Deserialize)]
    struct Sample {
        stamp: Time,
    }

    impl Message for Sample {
        const TYPE: &'static str = "Sample";

        fn stamp(&self) -> Option<Time> {
            Some(self.stamp)
        }
    }

    #[test]
    fn every_value_is_kept_until_a_calculation_has_seen_it() {
        let mut input = Every::<Sample>::default();
        for nanos in 1..=3 {
            input
                .deliver(&postcard::to_stdvec(&Sample { stamp: Time::from_nanos(nanos) }).unwrap(), Time::ZERO)
                .unwrap();
        }
        assert!(input.iter().map(|sample| sample.stamp).eq((1..=3).map(Time::from_nanos)));
        input.mark_seen();
        input.lose(3);
        assert_eq!((input.iter().count(), input.lost()), (0, 3));
    }

    #[test]
    fn a_sample_that_comes_again_is_not_fresh() {
        let mut input = In::<Sample>::default();
        let mut deliver = |nanos| {
            input
                .deliver(&postcard::to_stdvec(&Sample { stamp: Time::from_nanos(nanos) }).unwrap(), Time::ZERO)
                .unwrap();
            let fresh = input.fresh().map(|sample| sample.stamp);
            input.mark_seen();
            (fresh.is_some(), input.trouble().is_some())
        };
        assert_eq!(deliver(7), (true, false));
        assert_eq!([7; 4].map(&mut deliver), [(false, false), (false, false), (false, true), (false, true)]);
        assert_eq!(deliver(9), (true, false), "and then it goes on");
        assert_eq!(deliver(7), (true, false), "another clock, after a device was started again");
        assert_eq!(input.received(), 7);
    }

    #[test]
    fn a_sample_is_as_old_as_its_stamp_and_not_as_its_arrival() {
        let at = |ms| Time::ZERO + Duration::from_millis(ms);
        let age = |stamp, arrived, now| {
            let mut input = In::<Sample>::default();
            input.deliver(&postcard::to_stdvec(&Sample { stamp: at(stamp) }).unwrap(), at(arrived)).unwrap();
            let limit = Duration::from_millis(100);
            assert_eq!(input.fresh_within(at(now), limit).is_some(), input.age(at(now)) <= Some(limit));
            assert_eq!(input.stale(at(now), limit), input.age(at(now)) > Some(limit));
            input.age(at(now)).unwrap().as_millis()
        };
        // The value was in transit for 80 ms and has waited for 30 ms.
        assert_eq!(age(20_000, 20_080, 20_110), 110);
        // Clocks of other hosts: one is ahead of this clock, and one is far behind.
        assert_eq!(age(30_000, 20_080, 20_110), 30);
        assert_eq!(age(5, 20_080, 20_110), 30);
    }
}
