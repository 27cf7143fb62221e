//! The names of frames in messages, which have the prefix of their robot in ROS 2: `base_link` is `r1/base_link` there.
//!
//! A frame of ROS 2 without the prefix begins with `/` inside a mission, as a global name does: `map` is `/map`, and `r2/base_link` is
//! `/r2/base_link`. So two frames of ROS 2 never have one name.

use super::cdr::{CdrError, Reader, Writer};
use super::definition::{Count, Element, Field};
use super::schema::{Schema, Struct};
use std::fmt;

/// The longest prefix.
const LENGTH_MAX: usize = 64;
/// The end of the name of each field that has the name of a frame: `frame_id`, `child_frame_id`, `body_frame_id`.
const FIELD: &str = "frame_id";
/// Begins the name of a frame of ROS 2 without the prefix.
const GLOBAL: char = '/';

/// The text before the names of a robot's frames in ROS 2: `r1/`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FramePrefix(String);

impl FramePrefix {
    /// Reads a prefix: words of letters, digits, `-` and `_` between slashes, and a slash or `_` at the end. ROS 2 puts no slash
    /// between a prefix and a frame, so a prefix such as `r1` would make `r1base_link`.
    pub fn parse(text: &str) -> Option<Self> {
        let is_word = |word: &str| word.chars().all(|c| c.is_ascii_alphanumeric() || c == '_' || c == '-');
        let words = text.strip_suffix('/').or_else(|| text.ends_with('_').then_some(text))?;
        let is_fit = text.len() <= LENGTH_MAX && words.split('/').all(|word| !word.is_empty() && is_word(word));
        is_fit.then(|| Self(text.to_owned()))
    }

    /// Returns the text of the prefix.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// Returns the name that a frame of a mission has in ROS 2. A frame without a name stays without one.
    pub fn outward(&self, frame: &str) -> String {
        match frame.strip_prefix(GLOBAL) {
            Some(global) => global.to_owned(),
            None if frame.is_empty() => String::new(),
            None => format!("{}{frame}", self.0),
        }
    }

    /// Returns the name that a frame of ROS 2 has in a mission. A slash at its beginning means nothing, as in `tf2`.
    pub fn inward(&self, frame: &str) -> String {
        let frame = frame.strip_prefix(GLOBAL).unwrap_or(frame);
        match frame.strip_prefix(&self.0).filter(|own| !own.is_empty() && !own.starts_with(GLOBAL)) {
            Some(own) => own.to_owned(),
            None if frame.is_empty() => String::new(),
            None => format!("{GLOBAL}{frame}"),
        }
    }
}

impl fmt::Display for FramePrefix {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// Returns whether messages of this type name frames.
pub fn has_frames(schema: &Schema) -> bool {
    schema.structs().iter().any(|one| one.fields.iter().any(is_frame))
}

/// Returns a message with other names of its frames. Lists of numbers are copied as a whole.
///
/// # Errors
/// The bytes are not a message of this type, or a new name has a zero byte in it.
pub fn renamed(schema: &Schema, message: &[u8], name: impl Fn(&str) -> String) -> Result<Vec<u8>, CdrError> {
    let (mut reader, writer) = (Reader::new(message)?, Writer::with_capacity(message.len() + LENGTH_MAX));
    let mut copy = Copying { schema, name, writer };
    copy.record(schema.root(), &mut reader)?;
    reader.end()?;
    Ok(copy.writer.finish())
}

fn is_frame(field: &Field<usize>) -> bool {
    matches!(field.element, Element::Text { .. }) && field.name.ends_with(FIELD)
}

/// A copy of a message with other names.
struct Copying<'a, N> {
    schema: &'a Schema,
    name: N,
    writer: Writer,
}

impl<N: Fn(&str) -> String> Copying<'_, N> {
    fn record(&mut self, of: &Struct, reader: &mut Reader<'_>) -> Result<(), CdrError> {
        if of.fields.is_empty() {
            // It has a byte, which means nothing.
            self.writer.number(reader.number::<1>()?);
        }
        of.fields.iter().try_for_each(|one| self.field(one, reader))
    }

    fn field(&mut self, of: &Field<usize>, reader: &mut Reader<'_>) -> Result<(), CdrError> {
        let size_min = self.schema.size_min(&of.element);
        let count = match of.count {
            Count::One => 1,
            Count::Array(size) => {
                reader.fits(size, size_min)?;
                size
            }
            Count::Any | Count::Max(_) => {
                let count = reader.count(size_min)?;
                self.writer.count(count)?;
                count
            }
        };
        match &of.element {
            Element::Primitive(of) if of.size() == 1 => self.writer.bytes(reader.numbers(count, 1)?),
            Element::Primitive(of) => {
                let numbers = reader.numbers(count, of.size())?;
                self.writer.numbers(count, of.size()).copy_from_slice(numbers);
            }
            Element::Text { .. } if is_frame(of) => {
                for _ in 0..count {
                    let frame = (self.name)(reader.text()?);
                    self.writer.text(&frame)?;
                }
            }
            Element::Text { .. } => (0..count).try_for_each(|_| self.writer.text(reader.text()?))?,
            Element::Message(index) => {
                let of = self.schema.at(*index);
                (0..count).try_for_each(|_| self.record(of, reader))?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::cdr::{self, Value};
    use crate::logic::definition::Primitive;
    use crate::logic::library;
    use crate::logic::name::TypeName;
    use crate::typed::Message as _;
    use crate::typed::geometry_msgs::TransformStamped;
    use crate::typed::sensor_msgs::PointCloud2;
    use crate::typed::tf2_msgs::TFMessage;
    use proptest::prelude::*;

    fn prefix() -> FramePrefix {
        FramePrefix::parse("r1/").unwrap()
    }

    fn schema(name: &str) -> Schema {
        library::schema(&TypeName::parse(name).unwrap()).unwrap()
    }

    #[test]
    fn frames_have_the_prefix_outside() {
        let prefix = prefix();
        for (inside, outside) in [
            ("base_link", "r1/base_link"),
            ("/map", "map"),
            ("/r2/base_link", "r2/base_link"),
            ("", ""),
            ("a/b", "r1/a/b"),
        ] {
            assert_eq!((prefix.outward(inside).as_str(), prefix.inward(outside).as_str()), (outside, inside));
        }
        // An old publisher writes a slash in front. A name that is only the prefix does not belong to this robot.
        let inward =
            ["/r1/base_link", "/map", "r1/", "r1//map", "r10/base_link", "/"].map(|frame| prefix.inward(frame));
        assert_eq!(inward, ["base_link", "/map", "/r1/", "/r1//map", "/r10/base_link", ""]);
        // The global name of an own frame means that frame.
        assert_eq!(prefix.outward("/r1/base_link"), "r1/base_link");
    }

    #[test]
    fn a_prefix_has_an_end() {
        for text in ["r1/", "r1_", "fleet/r1/", "_/", "r-1/", &format!("{}/", "r".repeat(63))] {
            assert_eq!(FramePrefix::parse(text).as_ref().map(FramePrefix::as_str), Some(text));
        }
        for text in ["", "/", "r1", "/r1/", "r1//", "r 1/", "r1;/", "ä/", "a//b_", &format!("{}/", "r".repeat(64))] {
            assert_eq!(FramePrefix::parse(text), None, "{text}");
        }
    }

    #[test]
    fn types_that_name_frames_are_known() {
        for name in ["tf2_msgs/TFMessage", "nav_msgs/Odometry", "geometry_msgs/VelocityStamped", "nav_msgs/Path"] {
            assert!(has_frames(&schema(name)), "{name}");
        }
        for name in ["std_msgs/String", "geometry_msgs/Twist", "geometry_msgs/Pose", "sensor_msgs/JoyFeedback"] {
            assert!(!has_frames(&schema(name)), "{name}");
        }
    }

    #[test]
    fn only_the_names_of_frames_change() {
        let prefix = prefix();
        let mut transform = TransformStamped { child_frame_id: "base_link".to_owned(), ..TransformStamped::default() };
        transform.header.frame_id = "/map".to_owned();
        transform.transform.translation.x = 1.5;
        let inside = TFMessage { transforms: vec![transform.clone(), transform.clone()] };
        transform.header.frame_id = "map".to_owned();
        transform.child_frame_id = "r1/base_link".to_owned();
        let outside = TFMessage { transforms: vec![transform.clone(), transform] };
        let (inside, outside) = (inside.to_cdr().unwrap(), outside.to_cdr().unwrap());
        let of = schema(TFMessage::NAME);
        assert_eq!(renamed(&of, &inside, |frame| prefix.outward(frame)).as_ref(), Ok(&outside));
        assert_eq!(renamed(&of, &outside, |frame| prefix.inward(frame)).as_ref(), Ok(&inside));
        // A text that names no frame stays: the fields of a cloud have names.
        let mut cloud = PointCloud2 { data: vec![7; 1000], ..PointCloud2::default() };
        cloud.fields = vec![crate::typed::sensor_msgs::PointField { name: "x".to_owned(), ..Default::default() }];
        let unnamed = renamed(&schema(PointCloud2::NAME), &cloud.to_cdr().unwrap(), |frame| prefix.outward(frame));
        assert_eq!(unnamed, cloud.to_cdr());
        cloud.header.frame_id = "laser".to_owned();
        let named = renamed(&schema(PointCloud2::NAME), &cloud.to_cdr().unwrap(), |frame| prefix.outward(frame));
        cloud.header.frame_id = "r1/laser".to_owned();
        assert_eq!(named, cloud.to_cdr());
    }

    /// The same on values, which have no alignment.
    fn rename_value(schema: &Schema, of: &Struct, value: &mut Value, name: &dyn Fn(&str) -> String) {
        let Value::Record(values) = value else { panic!("not a record") };
        for (field, value) in std::iter::zip(&of.fields, values) {
            let values = if let Value::List(values) = value { values.iter_mut().collect() } else { vec![value] };
            for value in values {
                match (&field.element, value) {
                    (Element::Message(index), value) => rename_value(schema, schema.at(*index), value, name),
                    (Element::Text { .. }, Value::Text(text)) if field.name.ends_with("frame_id") => *text = name(text),
                    _ => {}
                }
            }
        }
    }

    /// Returns a value with lists and texts of lengths that follow from a seed.
    fn value(schema: &Schema, of: &Struct, seed: &mut u64) -> Value {
        let fields = of.fields.iter().map(|field| {
            let count = match field.count {
                Count::One => return element(schema, &field.element, seed),
                Count::Array(count) => count,
                Count::Any => next(seed, 4),
                Count::Max(max) => next(seed, 4).min(max),
            };
            if let Element::Primitive(Primitive::U8 | Primitive::Byte) = field.element {
                return Value::Bytes(vec![7; count]);
            }
            Value::List((0..count).map(|_| element(schema, &field.element, seed)).collect())
        });
        Value::Record(fields.collect())
    }

    fn element(schema: &Schema, of: &Element<usize>, seed: &mut u64) -> Value {
        match of {
            Element::Message(index) => value(schema, schema.at(*index), seed),
            Element::Text { .. } => Value::Text("/a_b".chars().skip(next(seed, 2)).take(next(seed, 5)).collect()),
            Element::Primitive(Primitive::Bool) => Value::Truth(next(seed, 2) == 1),
            Element::Primitive(Primitive::F32) => Value::Single(0.5),
            Element::Primitive(Primitive::F64) => Value::Double(-1.5),
            Element::Primitive(Primitive::I8 | Primitive::I16 | Primitive::I32 | Primitive::I64) => Value::Signed(-3),
            Element::Primitive(_) => Value::Unsigned(5),
        }
    }

    /// Returns a number below a bound. Source: Knuth's generator MMIX.
    fn next(seed: &mut u64, bound: u64) -> usize {
        *seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        usize::try_from((*seed >> 33) % bound).unwrap()
    }

    #[test]
    fn every_message_is_renamed_as_its_value_is() {
        let (prefix, mut with_frames) = (prefix(), 0);
        for (name, seed) in library::messages().flat_map(|name| (0..10).map(move |seed| (name.clone(), seed))) {
            let schema = library::schema(&name).unwrap();
            let mut expected = value(&schema, schema.root(), &mut (seed + 1));
            let bytes = cdr::write(&schema, &expected).unwrap();
            rename_value(&schema, schema.root(), &mut expected, &|frame| prefix.outward(frame));
            let found = renamed(&schema, &bytes, |frame| prefix.outward(frame)).unwrap();
            assert_eq!(cdr::read(&schema, &found), Ok(expected), "{name} {seed}");
            with_frames += usize::from(found != bytes);
        }
        assert!(with_frames > 300, "{with_frames}");
    }

    proptest! {
        #[test]
        fn two_frames_never_have_one_name(one in "(r1/|r2/|/)?[a-c/]{0,3}", other in "(r1/|r2/|/)?[a-c/]{0,3}") {
            let prefix = prefix();
            // A slash in front means nothing in ROS 2.
            let plain = |frame: &str| frame.strip_prefix('/').unwrap_or(frame).to_owned();
            prop_assert_eq!(prefix.outward(&prefix.inward(&one)), plain(&one));
            prop_assert_eq!(prefix.inward(&one) == prefix.inward(&other), plain(&one) == plain(&other));
        }
    }
}
