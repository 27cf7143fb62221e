//! This test writes the Python modules that declare the standard messages to people and type checkers, from the definitions.
//!
//! `UPDATE_EXPECT=1 cargo test -p ros python` writes the files. A running program makes its classes from the same definitions.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use expect_test::expect_file;
use ros::logic::definition::{Constant, Count, Element, Field, Primitive};
use ros::logic::library;
use ros::logic::name::{TypeName, spec_package};
use ros::logic::schema::Schema;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;
use std::path::Path;

/// A module: the packages that its messages name, and its classes.
#[derive(Default)]
struct Module {
    package: String,
    others: BTreeSet<String>,
    classes: String,
}

fn primitive(of: Primitive) -> (&'static str, &'static str) {
    match of {
        Primitive::Bool => ("bool", "False"),
        Primitive::F32 | Primitive::F64 => ("float", "0.0"),
        Primitive::Byte
        | Primitive::I8
        | Primitive::U8
        | Primitive::I16
        | Primitive::U16
        | Primitive::I32
        | Primitive::U32
        | Primitive::I64
        | Primitive::U64 => ("int", "0"),
    }
}

/// Returns the type of a field, and its default.
fn declared(module: &mut Module, schema: &Schema, field: &Field<usize>) -> (String, String) {
    let (one, zero) = match &field.element {
        Element::Primitive(of) => {
            let (word, zero) = primitive(*of);
            if field.count != Count::One && *of != Primitive::Bool {
                let is_bytes = matches!(of, Primitive::Byte | Primitive::U8);
                let kind = if is_bytes { "Octets".to_owned() } else { format!("Numbers[{word}]") };
                return (kind.clone(), format!("{kind}()"));
            }
            (word.to_owned(), zero.to_owned())
        }
        Element::Text { .. } => ("str".to_owned(), "\"\"".to_owned()),
        Element::Message(index) => {
            let name = &schema.at(*index).name;
            let package = spec_package(name.package());
            let path = if name.package() == module.package {
                name.name().to_owned()
            } else {
                module.others.insert(package.to_owned());
                format!("_{package}.{}", name.name())
            };
            // Type checkers do not accept a class as a default if it has a field with a descriptor.
            let zero = format!("field(default_factory=lambda: {path}())");
            (path, zero)
        }
    };
    match (field.count, &field.default) {
        (Count::One, None) => (one, zero),
        (Count::One, Some(default)) => {
            let default = if one == "float" { format!("{default}.0") } else { default.clone() };
            (one, default)
        }
        _ => (format!("list[{one}]"), "field(default_factory=list)".to_owned()),
    }
}

fn constant(text: &mut String, Constant { name, of, value }: &Constant) {
    let (of, value) = match of {
        Element::Primitive(Primitive::Bool) => panic!("{name} is a truth value"),
        Element::Primitive(of) => (primitive(*of).0, value.clone()),
        Element::Text { .. } => ("str", format!("{value:?}")),
        Element::Message(_) => panic!("{name} is a message"),
    };
    writeln!(text, "        {name}: ClassVar[{of}] = {value}").unwrap();
}

fn class(module: &mut Module, name: &TypeName) {
    let schema = library::schema(name).unwrap();
    let mut text = format!("\n    @dataclass(eq=False)\n    class {}(Message):\n", name.name());
    writeln!(text, "        \"\"\"A message of the type `{name}`.\"\"\"").unwrap();
    let root = schema.root();
    if !root.constants.is_empty() {
        text.push('\n');
        root.constants.iter().for_each(|one| constant(&mut text, one));
    }
    if !root.fields.is_empty() {
        text.push('\n');
    }
    for field in &root.fields {
        let (of, default) = declared(module, &schema, field);
        writeln!(text, "        {}: {of} = {default}", field.name).unwrap();
    }
    module.classes += &text;
}

impl Module {
    fn text(&self) -> String {
        let has = |word: &str| self.classes.contains(word);
        let mut text =
            format!("\"\"\"The messages of `{}`, written by `ros/tests/all/python.rs`.\"\"\"\n\n", self.package);
        text += "from typing import TYPE_CHECKING\n\nif TYPE_CHECKING:\n";
        let words = |all: &[(&'static str, &str)]| {
            let named: Vec<&str> = all.iter().filter(|(_, mark)| has(mark)).map(|(word, _)| *word).collect();
            named.join(", ")
        };
        let of_dataclasses = words(&[("dataclass", ""), ("field", "field(")]);
        writeln!(text, "    from dataclasses import {of_dataclasses}").unwrap();
        if has("ClassVar[") {
            text += "    from typing import ClassVar\n";
        }
        text.push('\n');
        for other in &self.others {
            writeln!(text, "    from . import {other} as _{other}").unwrap();
        }
        let own = words(&[("Message", ""), ("Numbers", "Numbers["), ("Octets", "Octets(")]);
        writeln!(text, "    from ._standard import {own}").unwrap();
        text += &self.classes;
        text += "\nelse:\n    from ._standard import lazily\n\n    __getattr__, __dir__ = lazily(__name__)\n";
        text
    }
}

#[test]
fn the_modules_of_python_are_those_of_the_definitions() {
    let mut modules: BTreeMap<String, Module> = BTreeMap::new();
    let mut written = BTreeSet::new();
    for name in library::messages().chain(library::parts()) {
        // The messages in a message come before that message.
        for one in library::schema(&name).unwrap().structs().iter().rev() {
            if written.insert(one.name.clone()) {
                let module = modules.entry(spec_package(one.name.package()).to_owned()).or_default();
                module.package = one.name.package().to_owned();
                class(module, &one.name);
            }
        }
    }
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../python/dca/ros");
    for (package, module) in modules {
        expect_file![folder.join(format!("{package}.py"))].assert_eq(&module.text());
    }
}
