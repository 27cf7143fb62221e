//! Shows messages of ROS 2 as JSON.

mod written;

pub(crate) use written::encode;

use ros::logic::cdr::{self, Value};
use ros::logic::library;
use ros::logic::schema::{Schema, Struct};
use serde_json::{Map, json};

/// The most bytes of a field that are shown one by one. More bytes are usually an image or a cloud of points.
const BYTES_MAX: usize = 1024;

/// Decodes CDR bytes to an object with the names of the fields. Returns nothing if there is no such standard type, or
/// if the bytes do not fit it. A number that JSON cannot hold becomes a text: `"inf"`, `"-inf"`, `"NaN"`.
pub(crate) fn decode(of: &str, bytes: &[u8]) -> Option<serde_json::Value> {
    let schema = schema(of)?;
    let value = cdr::read(&schema, bytes).ok()?;
    Some(shown(&schema, schema.root(), &value))
}

/// Returns the standard type that a name in a spec stands for: `ros.sensor.LaserScan`.
pub(crate) fn schema(of: &str) -> Option<Schema> {
    library::schema(&library::by_spec(of)?).ok()
}

/// Shows a value. `of` is the type of the records that it contains.
fn shown(schema: &Schema, of: &Struct, value: &Value) -> serde_json::Value {
    match value {
        Value::Truth(truth) => json!(truth),
        Value::Signed(number) => json!(number),
        Value::Unsigned(number) => json!(number),
        // This keeps the number as short as a single-precision number is written.
        Value::Single(number) => number_of(number.to_string().parse().unwrap_or(f64::from(*number))),
        Value::Double(number) => number_of(*number),
        Value::Text(text) => json!(text),
        Value::Bytes(bytes) if bytes.len() > BYTES_MAX => json!({ "size": bytes.len() }),
        Value::Bytes(bytes) => json!(bytes),
        Value::List(values) => values.iter().map(|value| shown(schema, of, value)).collect(),
        Value::Record(values) => {
            let fields = std::iter::zip(&of.fields, values).map(|(field, value)| {
                let inner = schema.message(field).unwrap_or(of);
                (field.name.clone(), shown(schema, inner, value))
            });
            serde_json::Value::Object(fields.collect::<Map<_, _>>())
        }
    }
}

fn number_of(number: f64) -> serde_json::Value {
    if number.is_finite() { json!(number) } else { json!(number.to_string()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros::typed::Message;
    use ros::typed::geometry_msgs::{Point32, PolygonInstance};
    use ros::typed::sensor_msgs::{CompressedImage, LaserScan};
    use ros::typed::std_msgs::Header;

    fn check<M: Message>(message: &M, expected: &serde_json::Value) {
        assert_eq!(decode(M::SPEC, &message.to_cdr().unwrap()).as_ref(), Some(expected));
    }

    #[test]
    fn messages_have_the_names_of_their_fields() {
        let header = Header { frame_id: "laser".to_owned(), ..Header::default() };
        let scan = LaserScan { header, angle_min: 0.1, ranges: vec![1.5, f32::INFINITY], ..LaserScan::default() };
        let header = json!({ "stamp": { "sec": 0, "nanosec": 0 }, "frame_id": "laser" });
        let expected = json!({
            "header": header, "angle_min": 0.1, "angle_max": 0.0, "angle_increment": 0.0, "time_increment": 0.0,
            "scan_time": 0.0, "range_min": 0.0, "range_max": 0.0, "ranges": [1.5, "inf"], "intensities": [],
        });
        check(&scan, &expected);
        let mut polygon = PolygonInstance { id: -7, ..PolygonInstance::default() };
        polygon.polygon.points = vec![Point32 { x: -0.0, y: 1e30, z: 2.5 }];
        check(&polygon, &json!({ "polygon": { "points": [{ "x": -0.0, "y": 1e30, "z": 2.5 }] }, "id": -7 }));
    }

    #[test]
    fn long_bytes_are_not_shown_one_by_one() {
        let image = |size| CompressedImage { data: vec![7; size], ..CompressedImage::default() };
        let data = |size| decode("ros.sensor.CompressedImage", &image(size).to_cdr().unwrap()).unwrap()["data"].clone();
        assert_eq!(data(3), json!([7, 7, 7]));
        assert_eq!(data(BYTES_MAX + 1), json!({ "size": BYTES_MAX + 1 }));
    }

    #[test]
    fn other_bytes_and_other_types_are_not_shown() {
        let bytes = Header::default().to_cdr().unwrap();
        assert!(decode("ros.std.Header", &bytes).is_some());
        assert_eq!(decode("ros.std.Header", &bytes[..bytes.len() - 1]), None);
        assert_eq!(decode("ros.std.Heather", &bytes), None);
    }
}
