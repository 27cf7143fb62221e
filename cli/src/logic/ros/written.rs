//! Makes messages of ROS 2 from the words of a command line: `data=true names='["gain"]'`, or from one JSON object.

use super::schema;
use ros::logic::cdr::{self, Value};
use ros::logic::definition::{Count, Element, Field, Primitive};
use ros::logic::schema::{Schema, Struct};
use serde_json::{Map, Value as Json};

/// Returns the message of this type that the words describe. A field that is not given has its default.
///
/// # Errors
/// One sentence about the mistake.
pub(crate) fn encode(of: &str, words: &[String]) -> Result<Vec<u8>, String> {
    let schema = schema(of).ok_or_else(|| format!("`{of}` is not a standard type of ROS 2"))?;
    let given = object(words)?;
    let value = record(&schema, schema.root(), &given)?;
    cdr::write(&schema, &value).map_err(|_misfit| format!("a number or a list in the value does not fit a `{of}`"))
}

fn object(words: &[String]) -> Result<Map<String, Json>, String> {
    if let [whole] = words
        && whole.trim_start().starts_with('{')
    {
        return match serde_json::from_str(whole) {
            Ok(Json::Object(object)) => Ok(object),
            Ok(_) | Err(_) => Err(format!("`{whole}` is not an object of JSON")),
        };
    }
    let field = |word: &String| {
        let (name, text) = word.split_once('=').ok_or_else(|| format!("`{word}` is not `FIELD=VALUE`"))?;
        // A word that is not JSON is taken as a text.
        let value = serde_json::from_str(text).unwrap_or_else(|_text| Json::String(text.to_owned()));
        Ok((name.to_owned(), value))
    };
    words.iter().map(field).collect()
}

fn record(schema: &Schema, of: &Struct, given: &Map<String, Json>) -> Result<Value, String> {
    let is_known = |name: &&String| of.fields.iter().any(|field| field.name == **name);
    if let Some(unknown) = given.keys().find(|name| !is_known(name)) {
        let known: Vec<String> = of.fields.iter().map(|field| format!("`{}`", field.name)).collect();
        let has = if known.is_empty() { "no fields".to_owned() } else { known.join(", ") };
        return Err(format!("`{}` has no field `{unknown}`; it has {has}", of.name));
    }
    let values = of.fields.iter().map(|one| match given.get(&one.name) {
        Some(value) => field(schema, one, value).ok_or_else(|| format!("`{}` cannot be {value}", one.name))?,
        None => initial(schema, one),
    });
    Ok(Value::Record(values.collect::<Result<_, _>>()?))
}

fn field(schema: &Schema, of: &Field<usize>, value: &Json) -> Option<Result<Value, String>> {
    if of.count == Count::One {
        return element(schema, &of.element, value);
    }
    let values = value.as_array()?.iter().map(|value| element(schema, &of.element, value));
    let values: Option<Result<Vec<Value>, String>> = values.collect();
    Some(values?.map(Value::List))
}

fn element(schema: &Schema, of: &Element<usize>, value: &Json) -> Option<Result<Value, String>> {
    Some(Ok(match of {
        Element::Message(index) => return Some(record(schema, schema.at(*index), value.as_object()?)),
        Element::Text { .. } => Value::Text(value.as_str()?.to_owned()),
        Element::Primitive(of) => match of {
            Primitive::Bool => Value::Truth(value.as_bool()?),
            #[expect(clippy::cast_possible_truncation, reason = "the nearest number of the type")]
            Primitive::F32 => Value::Single(value.as_f64()? as f32),
            Primitive::F64 => Value::Double(value.as_f64()?),
            Primitive::I8 | Primitive::I16 | Primitive::I32 | Primitive::I64 => Value::Signed(value.as_i64()?),
            Primitive::Byte | Primitive::U8 | Primitive::U16 | Primitive::U32 | Primitive::U64 => {
                Value::Unsigned(value.as_u64()?)
            }
        },
    }))
}

/// Returns the value of a field that is not given.
fn initial(schema: &Schema, of: &Field<usize>) -> Result<Value, String> {
    let zero = match &of.element {
        Element::Message(_) => Json::Object(Map::new()),
        Element::Text { .. } => Json::String(String::new()),
        Element::Primitive(Primitive::Bool) => Json::Bool(false),
        Element::Primitive(_) => of.default.as_ref().and_then(|text| number(text)).unwrap_or_else(|| Json::from(0)),
    };
    let one = || {
        let misfit = || format!("`{}` has no default", of.name);
        element(schema, &of.element, &zero).ok_or_else(misfit)?
    };
    match of.count {
        Count::One => one(),
        Count::Array(count) => Ok(Value::List(vec![one()?; count])),
        Count::Any | Count::Max(_) => Ok(Value::List(Vec::new())),
    }
}

/// Reads the number that a definition gives as a default.
fn number(text: &str) -> Option<Json> {
    serde_json::from_str(text).ok().filter(Json::is_number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use ros::typed::Message;
    use ros::typed::geometry_msgs::Pose;
    use ros::typed::rcl_interfaces::{GetParametersRequest, SetParametersRequest};
    use ros::typed::std_srvs::{SetBoolRequest, TriggerRequest};

    fn words(words: &[&str]) -> Vec<String> {
        words.iter().map(|word| (*word).to_owned()).collect()
    }

    #[track_caller]
    fn check<M: Message + PartialEq + std::fmt::Debug>(given: &[&str], expected: &M) {
        let bytes = encode(M::SPEC, &words(given)).unwrap();
        assert_eq!(M::from_cdr(&bytes).as_ref(), Ok(expected));
    }

    #[test]
    fn words_are_fields_and_an_object_is_a_message() {
        check(&[], &TriggerRequest::default());
        check(&["data=true"], &SetBoolRequest { data: true });
        check(&["{\"data\": true}"], &SetBoolRequest { data: true });
        check(&["names=[\"gain\"]"], &GetParametersRequest { names: vec!["gain".to_owned()] });
        let mut pose = Pose::default();
        pose.position.x = 1.5;
        check(&["position={\"x\": 1.5}"], &pose);
        let mut expected = SetParametersRequest::default();
        let mut parameter = ros::typed::rcl_interfaces::Parameter { name: "gain".to_owned(), ..Default::default() };
        (parameter.value.r#type, parameter.value.double_value) = (3, 0.5);
        expected.parameters.push(parameter);
        let given = "parameters=[{\"name\": \"gain\", \"value\": {\"type\": 3, \"double_value\": 0.5}}]";
        check(&[given], &expected);
    }

    #[test]
    fn mistakes_are_told() {
        let told = |of: &str, given: &[&str]| encode(of, &words(given)).unwrap_err();
        let set = "ros.std_srvs.SetBool_Request";
        assert_eq!(told(set, &["data=1"]), "`data` cannot be 1");
        assert_eq!(told(set, &["date=true"]), "`std_srvs/srv/SetBool_Request` has no field `date`; it has `data`");
        assert_eq!(told(set, &["true"]), "`true` is not `FIELD=VALUE`");
        assert_eq!(told(set, &["{data}"]), "`{data}` is not an object of JSON");
        let trigger = told("ros.std_srvs.Trigger_Request", &["data=true"]);
        assert_eq!(trigger, "`std_srvs/srv/Trigger_Request` has no field `data`; it has no fields");
        assert_eq!(
            told("ros.std.UInt8", &["data=256"]),
            "a number or a list in the value does not fit a `ros.std.UInt8`"
        );
        assert_eq!(told("ros.std.Uint8", &[]), "`ros.std.Uint8` is not a standard type of ROS 2");
    }
}
