//! The exports of a program, for `dca call` and `dca get`: finds their owner, encodes arguments, and shows results as JSON.

mod listed;

pub(crate) use listed::{Listed, ListedKind};

use crate::logic::process_name::ProcessName;
use crate::logic::queues::Shown;
use crate::logic::record::{RecordedValue, ValueForm, decoded, message_schema, messages};
use crate::logic::replay::encode;
use crate::logic::ros;
use ::ros::logic::name::is_spec_name;
use comms::logic::layout::{Field, Layout, Message, Part, Writer, write};
use comms::logic::messaging::wire::{LockStatus, QueueStatus, RouterStatus};
use comms::logic::object::{Exports, Signature, TypeForm};
use language::plan::Constant;
use language::{Code, Options, Severity, Source, compile};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Display, Formatter};
use std::time::Duration;

/// The export that a user names: `Grip` of `hand`, `door:main/hand.Grip`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ObjectName {
    pub(crate) process: ProcessName,
    /// The procedure or state.
    pub(crate) name: String,
}

impl ObjectName {
    /// Reads a name. If it is not valid, returns the mistake.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let (process, name) = ProcessName::with_name(text);
        let name = name.filter(|name| !name.is_empty() && process.process().is_some()).ok_or_else(|| {
            format!("`{text}` names nothing to call: expected [DEPLOYMENT:]INSTANCE.NAME, such as `hand.Grip`")
        })?;
        Ok(Self { process, name: name.to_owned() })
    }
}

impl Display for ObjectName {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.process, self.name)
    }
}

/// Returns the types that a program lists, as items of a spec. Each name occurs once.
fn types(exports: &Exports) -> String {
    let signatures = exports.exports.iter().map(|export| &export.signature);
    let forms = signatures.flat_map(|signature| [&signature.argument, &signature.result]);
    let forms: BTreeMap<&str, &str> =
        forms.filter(|form| !form.fields.is_empty()).map(|form| (form.name.as_str(), form.fields.as_str())).collect();
    forms.iter().map(|(name, fields)| format!("type {name} = {{ {fields} }};\n")).collect()
}

/// Returns the fields of a type's values, as far as the program lists them.
fn message(exports: &Exports, form: &TypeForm) -> Option<Message> {
    let text = format!("{}module Program(host: Host) {{ out Out: {}; done; }}\n", types(exports), form.name);
    messages(&[Source::new("exports", text)]).remove("Program")?.remove("Out")
}

/// Encodes an argument that is written as in a spec: `'{ force = 20 N }'`, or `force='20 N'` for each field.
///
/// # Errors
/// One sentence about the mistake.
pub(crate) fn argument(exports: &Exports, signature: &Signature, given: &[String]) -> Result<Vec<u8>, String> {
    let form = &signature.argument;
    if form.name.is_empty() {
        return if given.is_empty() { Ok(Vec::new()) } else { Err("it takes no argument".to_owned()) };
    }
    if is_spec_name(&form.name) {
        // On a wire, a message of ROS 2 is the length of its CDR, followed by the CDR.
        let (message, mut bytes) = (ros::encode(&form.name, given)?, Vec::new());
        Writer::new(&mut bytes).piece(&message);
        return Ok(bytes);
    }
    let expected = |why: &str| format!("{why}; expected {form}");
    if given.is_empty() {
        return Err(expected("its argument is missing"));
    }
    let message = message(exports, form);
    let message = message.ok_or_else(|| format!("its program does not declare the fields of a `{}`", form.name))?;
    let is_record = matches!(message.layout, Layout::Record(_));
    let value = match given {
        [whole] if !is_record || whole.trim_start().starts_with('{') => whole.clone(),
        fields if is_record => format!("{{ {} }}", fields.join(", ")),
        _ => return Err(expected("it takes one argument")),
    };
    let constants = constants(&types(exports), &form.name, &value).map_err(|why| expected(&why))?;
    let (value, mut bytes) = (Named { name: "value".to_owned(), constants: &constants }, Vec::new());
    write(&message.layout, &value, &mut Writer::new(&mut bytes))
        .map_err(|NoSuchPart| expected("this argument does not have its type"))?;
    Ok(bytes)
}

/// Encodes an argument that is written as a JSON object with the fields of its type, in SI units. An argument that is
/// not a record is written as the field `value`.
///
/// # Errors
/// One sentence about the mistake.
pub(crate) fn argument_of_json(exports: &Exports, signature: &Signature, given: &Value) -> Result<Vec<u8>, String> {
    let form = &signature.argument;
    if form.name.is_empty() {
        let is_nothing = given.is_null() || given.as_object().is_some_and(serde_json::Map::is_empty);
        return if is_nothing { Ok(Vec::new()) } else { Err("it takes no argument; write `{}`".to_owned()) };
    }
    if is_spec_name(&form.name) {
        return argument(exports, signature, &[given.to_string()]);
    }
    let message = message(exports, form);
    let message = message.ok_or_else(|| format!("its program does not declare the fields of a `{}`", form.name))?;
    let data = given.to_string().into_bytes();
    let (from, to) = (String::new(), String::new());
    let value = RecordedValue { from, to, at: Duration::ZERO, form: ValueForm::Json, data };
    let encoded = encode(&value, Some(&message));
    Ok(encoded
        .ok_or_else(|| format!("this argument does not have its type; expected {form}, with numbers in SI units"))?
        .bytes)
}

/// Returns the schema of the argument of a procedure as JSON; `doc` is for people.
pub(crate) fn request_schema(exports: &Exports, signature: &Signature, doc: &str) -> Value {
    let mut schema = form_schema(exports, &signature.argument);
    if !doc.is_empty() {
        schema["description"] = json!(doc);
    }
    schema
}

/// Returns the schema of the result of a procedure as JSON.
pub(crate) fn response_schema(exports: &Exports, signature: &Signature) -> Value {
    form_schema(exports, &signature.result)
}

fn form_schema(exports: &Exports, form: &TypeForm) -> Value {
    let message = message(exports, form).filter(|_| !form.name.is_empty());
    message.map_or_else(|| json!({ "type": "object", "properties": {} }), |known| message_schema(&form.name, &known))
}

/// Lets the compiler read a value. Returns its parts by name: `value.force`, `value.corner.0`.
fn constants(types: &str, kind: &str, value: &str) -> Result<BTreeMap<String, Constant>, String> {
    let before = format!(
        "{types}module Called(host: Host, value: {kind}) {{ done; }}\nprocess main() {{ host {{ c1 }}\n\
         instantiated_processes {{ call instof Called(c1, value = "
    );
    let end = before.len() + value.len();
    let text = format!("{before}{value}); }}\ninternal_event_actions {{ call }} }}\n");
    let compiled = compile(&Source::new("call", text), &[], &Options::named("call"));
    let error = compiled.diagnostics.iter().find(|found| found.severity == Severity::Error);
    // If the first error is after the value, the value is not whole: the text after it belongs to the spec around it.
    let is_behind =
        error.is_some_and(|error| usize::try_from(error.primary.span.start).is_ok_and(|start| start >= end));
    if !is_one(value) || is_behind {
        return Err(format!("`{value}` is not exactly one value"));
    }
    let plan = compiled.plan.filter(|plan| plan.leaves.len() == 1);
    let Some(leaf) = plan.and_then(|mut plan| plan.leaves.pop()) else {
        return Err(match error {
            None => format!("`{value}` is not a value"),
            Some(error) if error.code == Code::E0001 => format!("`{value}` cannot be read: {}", error.message),
            Some(error) => error.message.clone(),
        });
    };
    let named = leaf.arguments.into_iter().filter_map(|argument| Some((argument.name?, argument.value)));
    Ok(named.collect())
}

/// Returns whether a text is one value: each closing bracket has an opening one before it, and no separator is outside of brackets.
fn is_one(value: &str) -> bool {
    let (mut depth, mut is_text, mut is_escaped) = (0_usize, false, false);
    for sign in value.chars() {
        match sign {
            _ if is_escaped => is_escaped = false,
            '\\' if is_text => is_escaped = true,
            '"' => is_text = !is_text,
            _ if is_text => {}
            '{' | '[' | '(' => depth += 1,
            '}' | ']' | ')' if depth == 0 => return false,
            '}' | ']' | ')' => depth -= 1,
            ',' | ';' if depth == 0 => return false,
            _ => {}
        }
    }
    depth == 0 && !is_text
}

/// A value whose parts have names: `value.force`, `value.corner.0`. A part that is missing or of another kind is an error.
struct Named<'a> {
    name: String,
    constants: &'a BTreeMap<String, Constant>,
}

/// A part is missing, or of another kind.
struct NoSuchPart;

impl Named<'_> {
    fn part(&self, part: impl Display) -> Self {
        Self { name: format!("{}.{part}", self.name), constants: self.constants }
    }
}

impl Part for Named<'_> {
    type Error = NoSuchPart;

    fn leaf(&self, layout: &Layout, writer: &mut Writer<'_>) -> Result<(), NoSuchPart> {
        match (layout, self.constants.get(&self.name)) {
            (Layout::Number { .. }, Some(Constant::Number(number))) => writer.number(*number),
            (Layout::Truth, Some(Constant::Truth(truth))) => writer.truth(*truth),
            (Layout::Text, Some(Constant::Text(text))) => writer.text(text),
            _ => return Err(NoSuchPart),
        }
        Ok(())
    }

    fn field(&self, field: &Field) -> Result<Self, NoSuchPart> {
        Ok(self.part(&field.name))
    }

    fn elements(&self, _: &Layout, count: Option<usize>) -> Result<Vec<Self>, NoSuchPart> {
        let index = |rest: &str| rest.split('.').next().and_then(|index| index.parse::<usize>().ok());
        let own = format!("{}.", self.name);
        let given: BTreeSet<usize> = self.constants.keys().filter_map(|key| index(key.strip_prefix(&own)?)).collect();
        Ok((0..count.unwrap_or(given.len())).map(|index| self.part(index)).collect())
    }
}

/// Returns a result as JSON: null without a result, and only its length if the program does not list its fields.
pub(crate) fn result(exports: &Exports, signature: &Signature, bytes: &[u8]) -> Value {
    let known = match signature.result.name.as_str() {
        "" => return Value::Null,
        "QueueStatus" => fields::<QueueStatus>(bytes),
        "RouterStatus" => fields::<RouterStatus>(bytes),
        "LockStatus" => fields::<LockStatus>(bytes),
        _ => message(exports, &signature.result).and_then(|message| decoded(&message, bytes)),
    };
    known.unwrap_or_else(|| json!({ "size": bytes.len() }))
}

/// Reads a value that is shown in a table of its own. Returns nothing if the program was built with another version of DCA.
fn fields<T: Shown + DeserializeOwned>(bytes: &[u8]) -> Option<Value> {
    postcard::from_bytes::<T>(bytes).ok().map(|value| value.fields())
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::messaging::wire::LockCounters;
    use comms::logic::object::{Access, ExportKind, Exported};

    fn exports(arguments: &[(&str, &str)]) -> Exports {
        let exported = |(name, fields): &(&str, &str)| Exported {
            name: (*name).to_owned(),
            kind: ExportKind::Procedure,
            signature: Signature { argument: TypeForm::new(name, fields), result: TypeForm::default() },
            doc: String::new(),
            is_answered_idle: false,
            access: Access::Operate,
        };
        Exports { exports: arguments.iter().map(exported).collect() }
    }

    #[test]
    fn an_argument_of_ros_is_a_message() {
        let form = |name: &str| TypeForm::new(&format!("ros.std_srvs.{name}"), "");
        let signature = Signature { argument: form("SetBool_Request"), result: form("SetBool_Response") };
        let given = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(|word| (*word).to_owned()).collect();
            argument(&Exports::default(), &signature, &words)
        };
        assert_eq!(given(&["data=true"]), Ok(vec![5, 0, 1, 0, 0, 1]));
        assert!(given(&["data=5"]).is_err());
        let response = [&[17, 0, 1, 0, 0, 1, 0, 0, 0, 5, 0, 0, 0][..], b"done\0"].concat();
        let shown = result(&Exports::default(), &signature, &response);
        assert_eq!(shown, json!({ "success": true, "message": "done" }));
    }

    #[test]
    fn names() {
        let name =
            |process: &str, name: &str| Ok(ObjectName { process: ProcessName::new(process), name: name.to_owned() });
        assert_eq!(ObjectName::parse("hand.Grip"), name("hand", "Grip"));
        assert_eq!(ObjectName::parse("door:main/arm/hand.Grip"), name("door:main/arm/hand", "Grip"));
        for wrong in ["Grip", ".Grip", "hand.", "door:Grip", "door:.Grip", "door.2:Grip", ""] {
            assert!(ObjectName::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn arguments_are_written_as_in_a_spec() {
        let exports = exports(&[
            ("Push", "force: Force, soft: Truth"),
            ("Way", "at: Point[2], name: Text, near: Length[]"),
            ("Point", "x: Length"),
            ("Odd", ""),
            ("Length", ""),
        ]);
        let read = |index: usize, given: &[&str]| {
            let given: Vec<String> = given.iter().map(|&text| text.to_owned()).collect();
            argument(&exports, &exports.exports[index].signature, &given)
        };
        let push: Vec<u8> = 20_f64.to_le_bytes().into_iter().chain([1]).collect();
        assert_eq!(read(0, &["{ force = 20 N, soft = true }"]), Ok(push.clone()));
        assert_eq!(read(0, &["force=0.02 kN", "soft=true"]), Ok(push));
        let numbers = |all: &[f64]| all.iter().flat_map(|number| number.to_le_bytes()).collect::<Vec<u8>>();
        let way = [numbers(&[1.0, 2.0]), vec![2], b"ab".to_vec(), vec![1], numbers(&[0.5])].concat();
        let given = "{ at = [{ x = 1 m }, { x = 2 m }], name = \"ab\", near = [50 cm] }";
        assert_eq!(read(1, &[given]), Ok(way));
        assert_eq!(read(4, &["20 cm"]), Ok(numbers(&[0.2])));
        for (index, given, why) in [
            (0, &["{ force = 20 m, soft = true }"][..], "Force"),
            (0, &["force=20 N"], "soft"),
            (0, &[], "its argument is missing; expected Push { force: Force, soft: Truth }"),
            (0, &["force=1 N); } process"], "`{ force=1 N); } process }` is not exactly one value"),
            (0, &["force=1 N", "soft=true // c"], "`{ force=1 N, soft=true // c }` is not exactly one value"),
            (0, &["force=1 N }, { soft=true"], "is not exactly one value"),
            (0, &["force=1 N soft=true"], "cannot be read: expected"),
            (1, &["{ name = \"}\\\"}\" }"], "expected Way"),
            (4, &["1 m), c2, (2 m"], "is not exactly one value"),
            (4, &["\"1"], "is not exactly one value"),
            (3, &["1"], "its program does not declare the fields of a `Odd`"),
            (4, &["1", "2"], "it takes one argument"),
        ] {
            let refused = read(index, given).unwrap_err();
            assert!(refused.contains(why), "{given:?}: {refused}");
        }
    }

    #[test]
    fn a_program_without_argument_takes_none() {
        let (exports, nothing) = (Exports::default(), Signature::default());
        assert_eq!(argument(&exports, &nothing, &[]), Ok(Vec::new()));
        assert_eq!(argument(&exports, &nothing, &["1".to_owned()]), Err("it takes no argument".to_owned()));
        assert_eq!(result(&exports, &nothing, &[]), Value::Null);
        let result =
            |bytes| result(&exports, &Signature { result: TypeForm::new("Length", ""), ..nothing.clone() }, bytes);
        let two = 2_f64.to_le_bytes();
        assert_eq!(result(&two), json!({ "value": 2.0 }));
        assert_eq!(result(b"abc"), json!({ "size": 3 }));
    }

    #[test]
    fn arguments_of_json_have_the_fields_of_the_type() {
        let exports = exports(&[("Push", "force: Force, soft: Truth"), ("Length", ""), ("Odd", "")]);
        let read = |index: usize, given: Value| argument_of_json(&exports, &exports.exports[index].signature, &given);
        let push: Vec<u8> = 20_f64.to_le_bytes().into_iter().chain([1]).collect();
        assert_eq!(read(0, json!({ "force": 20, "soft": true })), Ok(push));
        assert_eq!(read(1, json!({ "value": 0.2 })), Ok(0.2_f64.to_le_bytes().to_vec()));
        for wrong in [json!({}), json!({ "force": "x", "soft": true }), json!([1]), json!(null), json!({ "force": 1 })]
        {
            assert!(read(0, wrong.clone()).unwrap_err().contains("expected Push { force"), "{wrong}");
        }
        assert!(read(2, json!({})).unwrap_err().contains("does not declare the fields of a `Odd`"));
        let nothing = Signature::default();
        assert_eq!(argument_of_json(&exports, &nothing, &json!({})), Ok(vec![]));
        assert!(argument_of_json(&exports, &nothing, &json!({ "x": 1 })).is_err());
        let schema = request_schema(&exports, &exports.exports[0].signature, "Pushes.");
        assert_eq!(schema["properties"]["soft"], json!({ "type": "boolean" }));
        assert_eq!(schema["description"], json!("Pushes."));
        assert_eq!(response_schema(&exports, &nothing), json!({ "type": "object", "properties": {} }));
    }

    #[test]
    fn who_holds_a_lock_is_told() {
        let lock = LockStatus {
            holder: Some("drive".into()),
            fence: Some(7),
            left: None,
            lease: Duration::from_millis(600),
            waiting: vec![],
            counters: LockCounters { grants: 1, ..LockCounters::default() },
        };
        let signature = Signature { result: TypeForm::new("LockStatus", ""), ..Signature::default() };
        let bytes = postcard::to_allocvec(&lock).unwrap();
        assert_eq!(result(&Exports::default(), &signature, &bytes)["holder"], json!("drive"));
        assert_eq!(result(&Exports::default(), &signature, &[9]), json!({ "size": 1 }));
    }
}
