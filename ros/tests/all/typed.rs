//! This test writes the structs of the standard messages from their definitions, and compares their bytes.
//!
//! `UPDATE_EXPECT=1 cargo test -p ros typed` writes the files.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use expect_test::expect_file;
use ros::logic::cdr::{CdrError, Reader};
use ros::logic::definition::{Constant, Count, Element, Field, Primitive};
use ros::logic::library;
use ros::logic::name::TypeName;
use ros::logic::schema::Schema;
use ros::typed::{self, Field as _, Message};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// The beginning of the file with the list of all messages.
const ALL: &str = "\
//! The list of all messages, written by `tests/all/typed.rs`.

/// Calls a macro with the path below [`typed`](crate::typed) of every message, each with a comma behind it.
#[macro_export]
macro_rules! for_each_message {
    ($call:ident) => {
        $call! {
";
/// The keywords of Rust that occur as names of fields.
const KEYWORDS: [&str; 2] = ["type", "loop"];

fn primitive(of: Primitive) -> &'static str {
    match of {
        Primitive::Bool => "bool",
        Primitive::Byte | Primitive::U8 => "u8",
        Primitive::I8 => "i8",
        Primitive::I16 => "i16",
        Primitive::U16 => "u16",
        Primitive::I32 => "i32",
        Primitive::U32 => "u32",
        Primitive::I64 => "i64",
        Primitive::U64 => "u64",
        Primitive::F32 => "f32",
        Primitive::F64 => "f64",
    }
}

/// Returns the type of a field in the module of `package`.
fn rust_type(schema: &Schema, field: &Field<usize>) -> String {
    let own = schema.name().package();
    let element = match &field.element {
        Element::Primitive(of) => primitive(*of).to_owned(),
        Element::Text { max } => {
            assert_eq!(*max, None, "there is no struct for texts with a limit yet");
            // There is also a message of this name.
            if own == "std_msgs" { "std::string::String".to_owned() } else { "String".to_owned() }
        }
        Element::Message(index) => {
            let name = &schema.at(*index).name;
            let module = if name.package() == own { String::new() } else { format!("super::{}::", name.package()) };
            format!("{module}{}", name.name())
        }
    };
    match field.count {
        Count::One => element,
        Count::Array(size) => format!("[{element}; {size}]"),
        Count::Any => format!("Vec<{element}>"),
        Count::Max(max) => format!("super::AtMost<{element}, {max}>"),
    }
}

fn constant(text: &mut String, Constant { name, of, value }: &Constant) {
    let (of, value) = match of {
        Element::Primitive(of @ (Primitive::F32 | Primitive::F64)) => (primitive(*of), format!("{value}_f64")),
        Element::Primitive(of) => (primitive(*of), value.clone()),
        Element::Text { .. } => ("&str", format!("{value:?}")),
        Element::Message(_) => panic!("{name} is a message"),
    };
    writeln!(text, "    const {name}: {of} = {value};").unwrap();
}

/// Returns the name of a struct: `TriggerRequest` for the request of a service.
fn struct_name(name: &TypeName) -> String {
    name.name().replace('_', "")
}

/// Returns the types with a struct: messages, and the parts of services and actions.
fn types() -> impl Iterator<Item = TypeName> {
    library::messages().chain(library::parts())
}

fn message(name: &TypeName) -> String {
    let schema = library::schema(name).unwrap();
    let root = schema.root();
    let own = struct_name(name);
    let mut text = format!("\nsuper::message! {{\n    {own}, \"{name}\", \"{}\";\n", name.spec());
    for field in &root.fields {
        let raw = if KEYWORDS.contains(&field.name.as_str()) { "r#" } else { "" };
        let default = field.default.as_ref().map(|default| format!(" = {default}.0")).unwrap_or_default();
        writeln!(text, "    {raw}{}: {}{default},", field.name, rust_type(&schema, field)).unwrap();
    }
    if !root.constants.is_empty() {
        text += "    ;\n";
        root.constants.iter().for_each(|one| constant(&mut text, one));
    }
    text + "}\n"
}

#[test]
fn the_structs_are_those_of_the_definitions() {
    let mut modules: BTreeMap<String, String> = BTreeMap::new();
    let mut list = String::new();
    for name in types() {
        let package = name.package();
        writeln!(list, "            {package}::{},", struct_name(&name)).unwrap();
        let title = || format!("//! The messages of `{package}`, written by `tests/all/typed.rs`.\n");
        *modules.entry(package.to_owned()).or_insert_with(title) += &message(&name);
    }
    modules.insert("all".to_owned(), format!("{ALL}{list}        }}\n    }};\n}}\n"));
    for (module, text) in modules {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("src/typed/{module}.rs"));
        expect_file![path].assert_eq(&text);
    }
}

/// Reads a value as a struct. Returns its bytes, and its bytes after a transfer over a wire.
type Again = fn(&[u8]) -> (Vec<u8>, Vec<u8>);

fn again<M: Message + Serialize + DeserializeOwned>(bytes: &[u8]) -> (Vec<u8>, Vec<u8>) {
    let value = M::from_cdr(bytes).unwrap();
    let sent: M = postcard::from_bytes(&postcard::to_stdvec(&value).unwrap()).unwrap();
    (value.to_cdr().unwrap(), sent.to_cdr().unwrap())
}

macro_rules! all {
    ($($package:ident::$name:ident,)+) => {
        BTreeMap::from([$((<typed::$package::$name as Message>::NAME, again::<typed::$package::$name> as Again),)+])
    };
}

#[test]
fn structs_have_the_bytes_of_rosbags() {
    let all: BTreeMap<&str, Again> = ros::for_each_message!(all);
    assert_eq!(all.len(), types().count());
    let mut values = 0;
    super::golden::each(|schema, line| {
        let bytes = super::text::bytes(line.split_once(' ').unwrap().0);
        let found = all[schema.name().to_string().as_str()](&bytes);
        assert_eq!(found, (bytes.clone(), bytes), "{}", schema.name());
        values += 1;
    });
    assert_eq!(values, 21);
}

#[test]
fn people_see_the_fields() {
    let marker = typed::visualization_msgs::MeshFile { filename: "a".to_owned(), data: vec![1, 2] };
    assert_eq!(serde_json::to_value(&marker).unwrap(), serde_json::json!({ "filename": "a", "data": [1, 2] }));
    let field =
        typed::shape_msgs::SolidPrimitive { r#type: typed::shape_msgs::SolidPrimitive::CONE, ..Default::default() };
    let shown = serde_json::to_value(&field).unwrap();
    assert_eq!((&shown["type"], &shown["dimensions"]), (&serde_json::json!(4), &serde_json::json!([])));
    let pose = typed::geometry_msgs::Pose::default();
    assert_eq!((pose.orientation.w, pose.orientation.x), (1.0, 0.0), "the default of ROS is no rotation");
}

/// In C++, the text that is sent also ends there.
#[test]
fn a_text_ends_at_its_first_zero_byte() {
    let text = typed::std_msgs::String { data: "ab\0c".to_owned() };
    let read = typed::std_msgs::String::from_cdr(&text.to_cdr().unwrap()).unwrap();
    assert_eq!(read.data, "ab");
}

#[test]
fn lists_with_a_limit_keep_it() {
    type Range = typed::rcl_interfaces::IntegerRange;
    assert!(typed::AtMost::<Range, 1>::new(vec![Range::default(); 2]).is_none());
    let integer_range = typed::AtMost::new(vec![Range::default()]).unwrap();
    let descriptor = typed::rcl_interfaces::ParameterDescriptor { integer_range, ..Default::default() };
    let bytes = descriptor.to_cdr().unwrap();
    assert_eq!(typed::rcl_interfaces::ParameterDescriptor::from_cdr(&bytes).as_ref(), Ok(&descriptor));
    let two = [0, 1, 0, 0, 2, 0, 0, 0, 7, 7];
    let read = |bytes: &[u8]| typed::AtMost::<u8, 1>::read(&mut Reader::new(bytes).unwrap());
    assert_eq!(read(&two), Err(CdrError::Long(2)));
    assert_eq!(read(&[0, 1, 0, 0, 1, 0, 0, 0, 7]).map(|one| one.to_vec()), Ok(vec![7]));
}
