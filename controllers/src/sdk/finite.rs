//! Checks whether every number of a message is finite, for any type of message.
//!
//! The check is a serializer that only reads floats, so no message has to declare where its numbers are. It writes
//! nothing and allocates nothing. Measured at the optimisation of the tests, it takes 4 ns for a velocity of 15
//! numbers, 0.5 µs for a sweep of 361, and 2 ns for 1 MiB of bytes. This also holds for bytes in a `Vec<u8>`: the
//! compiler removes a loop that reads no float. To decode these bytes takes 4 ms.

use serde::Serialize;
use serde::ser::{
    Error, SerializeMap, SerializeSeq, SerializeStruct, SerializeStructVariant, SerializeTuple, SerializeTupleStruct,
    SerializeTupleVariant, Serializer,
};
use std::fmt;

/// Returns whether no number in `value` is infinite or NaN.
pub(super) fn is_finite<T: Serialize + ?Sized>(value: &T) -> bool {
    !matches!(value.serialize(Look), Err(Stop::NotFinite))
}

/// The serializer that checks a value.
#[derive(Clone, Copy)]
struct Look;

/// The reason why the check of a value ends early.
#[derive(Debug)]
enum Stop {
    NotFinite,
    /// The value cannot be serialized; its encoder will report that.
    Unwritable,
}

impl fmt::Display for Stop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotFinite => "a number is not finite",
            Self::Unwritable => "the value cannot be encoded",
        })
    }
}

impl std::error::Error for Stop {}

impl Error for Stop {
    fn custom<T: fmt::Display>(_: T) -> Self {
        Self::Unwritable
    }
}

/// Types without floats.
macro_rules! ignored {
    ($($name:ident($($type:ty),*);)+) => {
        $(
            #[inline]
            fn $name(self, $(_: $type),*) -> Result<(), Stop> {
                Ok(())
            }
        )+
    };
}

/// Types that contain values.
macro_rules! entered {
    ($($name:ident($($type:ty),*) -> $kind:ident;)+) => {
        $(
            #[inline]
            fn $name(self, $(_: $type),*) -> Result<Self, Stop> {
                Ok(self)
            }
        )+
    };
}

impl Serializer for Look {
    type Ok = ();
    type Error = Stop;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Self;
    type SerializeMap = Self;
    type SerializeStruct = Self;
    type SerializeStructVariant = Self;

    #[inline]
    fn serialize_f32(self, number: f32) -> Result<(), Stop> {
        if number.is_finite() { Ok(()) } else { Err(Stop::NotFinite) }
    }

    #[inline]
    fn serialize_f64(self, number: f64) -> Result<(), Stop> {
        if number.is_finite() { Ok(()) } else { Err(Stop::NotFinite) }
    }

    ignored! {
        serialize_bool(bool);
        serialize_i8(i8);
        serialize_i16(i16);
        serialize_i32(i32);
        serialize_i64(i64);
        serialize_i128(i128);
        serialize_u8(u8);
        serialize_u16(u16);
        serialize_u32(u32);
        serialize_u64(u64);
        serialize_u128(u128);
        serialize_char(char);
        serialize_str(&str);
        serialize_bytes(&[u8]);
        serialize_none();
        serialize_unit();
        serialize_unit_struct(&'static str);
        serialize_unit_variant(&'static str, u32, &'static str);
    }

    entered! {
        serialize_seq(Option<usize>) -> SerializeSeq;
        serialize_tuple(usize) -> SerializeTuple;
        serialize_tuple_struct(&'static str, usize) -> SerializeTupleStruct;
        serialize_tuple_variant(&'static str, u32, &'static str, usize) -> SerializeTupleVariant;
        serialize_map(Option<usize>) -> SerializeMap;
        serialize_struct(&'static str, usize) -> SerializeStruct;
        serialize_struct_variant(&'static str, u32, &'static str, usize) -> SerializeStructVariant;
    }

    #[inline]
    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result<(), Stop> {
        value.serialize(self)
    }

    #[inline]
    fn serialize_newtype_struct<T: Serialize + ?Sized>(self, _: &'static str, value: &T) -> Result<(), Stop> {
        value.serialize(self)
    }

    #[inline]
    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        value: &T,
    ) -> Result<(), Stop> {
        value.serialize(self)
    }

    fn collect_str<T: fmt::Display + ?Sized>(self, _: &T) -> Result<(), Stop> {
        Ok(())
    }

    /// Differs from postcard, because messages of ROS 2 show their fields only to serializers for people, and bytes of
    /// CDR to all others.
    fn is_human_readable(&self) -> bool {
        true
    }
}

macro_rules! elements {
    ($($kind:ident::$name:ident;)+) => {
        $(
            impl $kind for Look {
                type Ok = ();
                type Error = Stop;

                #[inline]
                fn $name<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), Stop> {
                    value.serialize(*self)
                }

                fn end(self) -> Result<(), Stop> {
                    Ok(())
                }
            }
        )+
    };
}

elements! {
    SerializeSeq::serialize_element;
    SerializeTuple::serialize_element;
    SerializeTupleStruct::serialize_field;
    SerializeTupleVariant::serialize_field;
}

macro_rules! fields {
    ($($kind:ident;)+) => {
        $(
            impl $kind for Look {
                type Ok = ();
                type Error = Stop;

                #[inline]
                fn serialize_field<T: Serialize + ?Sized>(&mut self, _: &'static str, value: &T) -> Result<(), Stop> {
                    value.serialize(*self)
                }

                fn end(self) -> Result<(), Stop> {
                    Ok(())
                }
            }
        )+
    };
}

fields! {
    SerializeStruct;
    SerializeStructVariant;
}

impl SerializeMap for Look {
    type Ok = ();
    type Error = Stop;

    #[inline]
    fn serialize_key<T: Serialize + ?Sized>(&mut self, key: &T) -> Result<(), Stop> {
        key.serialize(*self)
    }

    #[inline]
    fn serialize_value<T: Serialize + ?Sized>(&mut self, value: &T) -> Result<(), Stop> {
        value.serialize(*self)
    }

    fn end(self) -> Result<(), Stop> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sdk::messaging::{Full, Label, Queue, QueueClient, QueueMessage, Receipt, Rejected};
    use crate::sdk::{
        About, Answered, AnyCalls, Arguments, Bytes, CallOrder, Calls, Controller, DeliveryError, Every, In, Inputs,
        Kind, Message, Module, Out, Outputs, Parameter, Progress, Registry, Stopping, Tick, Time,
    };
    use comms::io::clock::now;
    use serde::Deserialize;
    use std::collections::BTreeMap;
    use std::time::Duration;

    #[derive(Serialize)]
    struct Deep {
        name: String,
        place: Option<[f64; 3]>,
        rows: Vec<(u32, Vec<f32>)>,
        by_name: BTreeMap<u8, Shape>,
        unit: Unit,
    }

    #[derive(Serialize)]
    struct Unit;

    #[derive(Serialize)]
    struct Newtype(f64);

    #[derive(Serialize)]
    enum Shape {
        None,
        Named { height: f64 },
        Pair(f64, f64),
        One(Newtype),
    }

    fn deep(number: f64, at: usize) -> Deep {
        let of = |place: usize| if place == at { number } else { 1e308 };
        #[expect(clippy::cast_possible_truncation, reason = "what is not finite stays so")]
        let small = if at == 1 { number as f32 } else { 1.0 };
        let kinds = [Shape::None, Shape::Named { height: of(2) }, Shape::Pair(0.0, of(3)), Shape::One(Newtype(of(4)))];
        Deep {
            name: "NaN".to_owned(),
            place: Some([0.0, -0.0, of(0)]),
            rows: vec![(0, Vec::new()), (7, vec![f32::MIN_POSITIVE, small])],
            by_name: (0..).zip(kinds).collect(),
            unit: Unit,
        }
    }

    #[test]
    fn a_number_that_is_not_finite_is_found_wherever_it_is() {
        assert!(is_finite(&deep(f64::NAN, usize::MAX)), "it has none");
        for number in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for at in 0..5 {
                assert!(!is_finite(&deep(number, at)), "{number} at {at}");
            }
        }
    }

    #[test]
    fn what_has_no_numbers_is_finite() {
        assert!(is_finite(&()) && is_finite("inf") && is_finite(&None::<f64>) && is_finite(&vec![0xff_u8; 1 << 10]));
    }

    /// Sends its input, multiplied by a factor.
    struct Scale {
        factor: f64,
    }

    #[derive(Clone, Debug, Serialize, Deserialize)]
    struct Number(f64);

    impl Message for Number {
        const TYPE: &'static str = "Number";
    }

    /// A message whose number may also be infinite or NaN.
    #[derive(Clone, Debug, Serialize, Deserialize)]
    struct Any(f64);

    impl Message for Any {
        const TYPE: &'static str = "Any";
        const ALLOW_NAN: bool = true;
    }

    #[derive(Debug, Inputs)]
    struct In1 {
        #[port("In")]
        number: In<Number>,
        #[port("Any")]
        any: In<Any>,
        #[port("All")]
        all: Every<Number>,
    }

    #[derive(Debug, Outputs)]
    struct Out1 {
        #[port("Out")]
        number: Out<Number>,
        #[port("Any")]
        any: Out<Any>,
    }

    impl Controller for Scale {
        type Inputs = In1;
        type Outputs = Out1;
        const TYPE: &'static str = "Scale";

        fn about() -> About {
            const FACTOR: &[Parameter] = &[Parameter::new("factor", Kind::Number(-1e300, 1e300))];
            About::service("Scales a number.").with(FACTOR)
        }

        fn new(arguments: &Arguments) -> Result<Self, String> {
            Ok(Self { factor: arguments.number("factor") })
        }

        fn main_calc(&mut self, _: Tick, inputs: &In1, outputs: &mut Out1) -> Progress {
            if inputs.all.refused() > 2 && inputs.all.iter().count() == 0 {
                return Progress::Aborted("nothing has come".to_owned());
            }
            if let Some(Any(number)) = inputs.any.fresh() {
                outputs.any.send(Any(*number));
            }
            if let Some(Number(number)) = inputs.number.fresh() {
                outputs.number.send(Number(number * self.factor));
            }
            Progress::Continue
        }

        fn stop(&mut self, _: Tick, inputs: &In1, outputs: &mut Out1) -> Stopping {
            if let Some(Number(number)) = inputs.number.latest() {
                outputs.number.send(Number(number * self.factor));
            }
            Stopping::Finished
        }
    }

    fn scale(factor: &str) -> Box<dyn Module> {
        let mut module = Registry::default().add::<Scale>().create("Scale", &[factor]).unwrap();
        module.init(&[], Time::ZERO).unwrap();
        module
    }

    fn sent(module: &mut dyn Module) -> Vec<(&'static str, f64)> {
        let mut sent = Vec::new();
        module.drain(&mut |port, bytes| sent.push((port, postcard::from_bytes(&bytes).unwrap())));
        sent
    }

    const NOT_FINITE: [f64; 3] = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];

    #[test]
    fn an_input_refuses_what_is_not_finite_and_counts_it() {
        let mut module = scale("2");
        let deliver = |module: &mut dyn Module, port: &str, number: f64| {
            let bytes = postcard::to_stdvec(&number).unwrap();
            let whole = module.deliver(port, &bytes, Time::ZERO);
            let pieces = module.deliver_from(port, &mut &bytes[..], Time::ZERO);
            assert_eq!(whole, pieces);
            whole
        };
        assert!(deliver(&mut *module, "In", 3.0).is_ok());
        for number in NOT_FINITE {
            let refused = Err(DeliveryError::NotFinite { port: "In" });
            assert_eq!(deliver(&mut *module, "In", number), refused);
            assert!(deliver(&mut *module, "Any", number).is_ok(), "it wants them");
        }
        // The input keeps the older value.
        assert_eq!(module.calculate(Time::ZERO), Progress::Continue);
        let sent = sent(&mut *module);
        assert_eq!(sent, [("Out", 6.0), ("Any", f64::NEG_INFINITY)]);
        // If a controller aborts because it has no values, it also reports that some were not finite.
        assert!(NOT_FINITE.iter().all(|number| deliver(&mut *module, "All", *number).is_err()));
        let Progress::Aborted(why) = module.calculate(Time::ZERO) else { panic!("it goes on") };
        let told = "`All` has refused its last 6 values: a number in them was not finite";
        assert!(why.starts_with("nothing has come; ") && why.contains(told), "{why}");
    }

    #[test]
    fn an_output_that_is_not_finite_is_an_abort_and_never_leaves() {
        let mut module = scale("1e300");
        let huge = postcard::to_stdvec(&1e300).unwrap();
        module.deliver("In", &huge, Time::ZERO).unwrap();
        let aborted = Progress::Aborted("a number of output `Out` is not finite".to_owned());
        assert_eq!(module.calculate(Time::ZERO), aborted);
        assert_eq!(sent(&mut *module), []);
        assert_eq!(module.stop(Time::ZERO), Stopping::Finished);
        assert_eq!(sent(&mut *module), [], "nor while it stops");
    }

    #[test]
    fn a_process_leaves_no_value_that_is_not_finite() {
        for number in NOT_FINITE {
            let ending = Progress::done(&[1.0, number]);
            assert!(matches!(&ending, Progress::Aborted(why) if why.contains("not finite")), "{ending:?}");
        }
        assert_eq!(Progress::done(&1.0), Progress::Done(postcard::to_stdvec(&1.0).unwrap()));
    }

    #[test]
    fn a_call_takes_no_number_that_is_not_finite() {
        let mut calls = Calls::<Number, Number>::default();
        let number = calls.call(Number(f64::NAN), Duration::from_secs(1));
        let told = |answer: Option<Answered<Number>>| answer.and_then(|(_, result)| result.err()).unwrap().to_string();
        assert!(calls.take().is_empty() && told(calls.answer()).contains("a number of the argument is not finite"));
        let second = calls.call(Number(1.0), Duration::from_secs(1));
        calls.deliver(second, Ok(postcard::to_stdvec(&f64::INFINITY).unwrap()));
        assert!(second > number && told(calls.answer()).contains("a number of the answer is not finite"));
    }

    #[test]
    fn a_queue_turns_away_a_number_that_is_not_finite() {
        let mut client = QueueClient::<Number>::new("c").unwrap();
        let within = Duration::from_secs(1);
        assert!(
            client
                .send(Time::ZERO, Label { category: "k", priority: 0, marker: 0 }, &Number(f64::NAN), None, within)
                .is_err()
        );
        client.send(Time::ZERO, Label { category: "k", priority: 0, marker: 0 }, &Number(1.0), None, within).unwrap();
        let mut calls = Calls::<QueueMessage, Receipt>::default();
        client.work(Time::ZERO, &mut calls);
        let [CallOrder::Make { argument, .. }] = &calls.take()[..] else { panic!("it is sent") };
        let message: QueueMessage = postcard::from_bytes(argument).unwrap();
        let mut queue = Queue::<Number>::new(4, Full::Reject);
        let poisoned = QueueMessage { data: postcard::to_stdvec(&f64::NAN).unwrap(), ..message.clone() };
        assert!(matches!(queue.receive(poisoned), Receipt::Rejected(Rejected::WrongType { .. })));
        assert_eq!(queue.receive(message), Receipt::Accepted);
    }

    /// The cost of the check: `cargo test -p controllers --lib finite -- --ignored --nocapture`.
    #[test]
    #[ignore = "long: a measurement"]
    fn the_cost_of_looking() {
        let velocity = crate::message::Velocity::REST;
        let sweep = crate::message::LaserScan { ranges: vec![1.0; 361] };
        let (bytes, raw) = (vec![7_u8; 1 << 20], Bytes::from(vec![7_u8; 1 << 20]));
        let encoded = postcard::to_stdvec(&bytes).unwrap();
        let time = |what: &str, count: u32, look: &dyn Fn() -> bool| {
            let began = now();
            assert!((0..count).all(|_| std::hint::black_box(look())));
            println!("{what}: {:?}", now().since(began) / count);
        };
        time("a velocity", 1_000_000, &|| is_finite(&velocity));
        time("a sweep of 361", 100_000, &|| is_finite(&sweep));
        time("1 MiB in a Vec<u8>", 100, &|| is_finite(&bytes));
        time("its decoding", 100, &|| postcard::from_bytes::<Vec<u8>>(&encoded).is_ok());
        time("1 MiB in a Bytes", 1_000_000, &|| is_finite(&raw));
    }
}
