//! Prints the record types of a spec as declarations in Python or Rust.

use language::{FieldType, RecordType};

/// The language of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Language {
    Python,
    Rust,
}

/// A record type with its name. Records that are written out inside it have names of their own, and come before it.
struct Named<'a> {
    name: String,
    doc: &'a str,
    fields: &'a [(String, FieldType)],
    /// Whether the spec itself gives the type this name.
    is_own: bool,
}

const PYTHON_HEAD: &str = "from dataclasses import dataclass\nfrom typing import Annotated\n\nimport dca\n";
const RUST_HEAD: &str = "use controllers::sdk::Message;\nuse serde::{Deserialize, Serialize};\n";
/// Words that cannot be the name of a field in Python.
const PYTHON_WORDS: &str = "False None True and as assert async await break class continue def del elif else except finally for from global \
                            if import in is lambda nonlocal not or pass raise return try while with yield";
/// Words that can be the name of a field in Rust only after `r#`.
const RUST_WORDS: &str = "abstract as async await become box break const continue do dyn else enum extern false final fn for gen if impl \
                          in let loop macro match mod move mut override priv pub ref return static struct trait true try type typeof \
                          unsafe unsized use virtual where while yield";

/// Returns the types as the text of a file.
///
/// # Errors
/// A type or a field cannot be expressed in this language.
pub(crate) fn printed(types: &[RecordType], language: Language) -> Result<String, String> {
    let mut all = Vec::new();
    for one in types {
        collect(&mut all, &one.name, &one.doc, &one.fields, true);
    }
    let mut text = if language == Language::Python { PYTHON_HEAD } else { RUST_HEAD }.to_owned();
    for one in in_order(&all) {
        text += &match language {
            Language::Python => python(one)?,
            Language::Rust => rust(one, &all)?,
        };
    }
    if !text.contains("Annotated[") {
        text = text.replace("from typing import Annotated\n", "");
    }
    if language == Language::Rust {
        let uses = |name: &str| [": ", "<", "["].iter().any(|before| text.contains(&format!("{before}{name}")));
        let names = [("Bytes", uses("Bytes")), ("Message", true), ("Time", uses("Time>"))];
        let used: Vec<&str> = names.into_iter().filter(|(_, is_used)| *is_used).map(|(name, _)| name).collect();
        if used.len() > 1 {
            text = text.replace("sdk::Message;", &format!("sdk::{{{}}};", used.join(", ")));
        }
    }
    Ok(text)
}

fn collect<'a>(all: &mut Vec<Named<'a>>, name: &str, doc: &'a str, fields: &'a [(String, FieldType)], is_own: bool) {
    for (field, kind) in fields {
        if let FieldType::Record(fields) = kind {
            collect(all, &inner_name(name, field), "", fields, false);
        }
    }
    all.push(Named { name: name.to_owned(), doc, fields, is_own });
}

/// Sorts the types so that each comes after the types that it uses. Python requires this.
fn in_order<'a, 'b>(all: &'b [Named<'a>]) -> Vec<&'b Named<'a>> {
    let (mut done, mut rest): (Vec<&Named<'_>>, Vec<&Named<'_>>) = (Vec::new(), all.iter().collect());
    while !rest.is_empty() {
        let is_ready = |one: &Named<'_>| {
            let waits = |kind: &FieldType| named(kind).is_some_and(|used| rest.iter().any(|other| other.name == used));
            !one.fields.iter().any(|(_, kind)| waits(kind))
        };
        let place = rest.iter().position(|one| is_ready(one)).unwrap_or(0);
        done.push(rest.remove(place));
    }
    done
}

/// Returns the name of the record type that a field uses, if any.
fn named(kind: &FieldType) -> Option<&str> {
    match kind {
        FieldType::Named(name) => Some(name),
        FieldType::List { of, .. } => named(of),
        FieldType::Plain(_) | FieldType::Record(_) => None,
    }
}

/// Returns the name for a record that is written out: `GoalPose` for the field `pose` of `Goal`.
fn inner_name(outer: &str, field: &str) -> String {
    let words = field.split('_').map(|word| {
        let mut letters = word.chars();
        letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
    });
    format!("{outer}{}", words.collect::<String>())
}

fn python(one: &Named<'_>) -> Result<String, String> {
    let mut text = String::from("\n\n");
    text += if one.is_own { "@dca.message\n" } else { "" };
    text += &format!("@dataclass(slots=True)\nclass {}:\n", one.name);
    if let Some(doc) = one.doc.trim().lines().next() {
        text += &format!("    \"\"\"{}\"\"\"\n\n", doc.replace('\\', "\\\\").replace('"', "\\\""));
    }
    for (field, kind) in one.fields {
        if PYTHON_WORDS.split_whitespace().any(|word| word == field) {
            return Err(format!("`{}.{field}`: this word is not the name of a field in Python", one.name));
        }
        let is_optional = is_optional_stamp(field, kind);
        let kind = if is_optional { "dca.Time | None".to_owned() } else { python_kind(kind, &one.name, field)? };
        text += &format!("    {field}: {kind}\n");
    }
    Ok(text)
}

/// Returns whether a field is an optional time of measurement: the list `stamp` of type `Time[]`, with at most one element.
fn is_optional_stamp(field: &str, kind: &FieldType) -> bool {
    let is_time = |of: &FieldType| matches!(of, FieldType::Plain(plain) if plain == "Time");
    field == "stamp" && matches!(kind, FieldType::List { of, count: None } if is_time(of))
}

fn python_kind(kind: &FieldType, name: &str, field: &str) -> Result<String, String> {
    Ok(match kind {
        FieldType::Plain(plain) => match plain.as_str() {
            "Number" => "float".to_owned(),
            "Truth" => "bool".to_owned(),
            "Text" => "str".to_owned(),
            other => format!("dca.{}", known(other, name, field)?),
        },
        FieldType::Named(used) => used.clone(),
        FieldType::Record(_) => inner_name(name, field),
        FieldType::List { of, count: None } => format!("list[{}]", python_kind(of, name, field)?),
        FieldType::List { of, count: Some(count) } => {
            format!("Annotated[list[{}], dca.Count({count})]", python_kind(of, name, field)?)
        }
    })
}

fn rust(one: &Named<'_>, all: &[Named<'_>]) -> Result<String, String> {
    let mut text = String::from("\n");
    for line in one.doc.trim().lines() {
        text += &format!("/// {}\n", line.trim());
    }
    text += &format!("#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]\npub struct {} {{\n", one.name);
    for (field, kind) in one.fields {
        let raw = if RUST_WORDS.split_whitespace().any(|word| word == field) { "r#" } else { "" };
        let is_optional = is_optional_stamp(field, kind);
        let kind = if is_optional { "Option<f64>".to_owned() } else { rust_kind(kind, &one.name, field)? };
        text += &format!("    pub {raw}{field}: {kind},\n");
    }
    text += "}\n";
    if one.is_own {
        let fields = spelt(one.fields, all);
        text += &format!("\nimpl Message for {} {{\n    const TYPE: &'static str = \"{}\";\n", one.name, one.name);
        text +=
            &format!("    const FIELDS: &'static str = \"{fields}\";{}\n}}\n", stamp(one.fields).unwrap_or_default());
    }
    Ok(text)
}

fn rust_kind(kind: &FieldType, name: &str, field: &str) -> Result<String, String> {
    Ok(match kind {
        FieldType::Plain(plain) => match plain.as_str() {
            "Truth" => "bool".to_owned(),
            "Text" => "String".to_owned(),
            "Bytes" => "Bytes".to_owned(),
            other => known(other, name, field).map(|_quantity| "f64".to_owned())?,
        },
        FieldType::Named(used) => used.clone(),
        FieldType::Record(_) => inner_name(name, field),
        FieldType::List { of, count: None } => format!("Vec<{}>", rust_kind(of, name, field)?),
        FieldType::List { of, count: Some(count) } => format!("[{}; {count}]", rust_kind(of, name, field)?),
    })
}

/// Returns `plain` if the language knows this type. Refuses a type that only one program knows.
fn known<'a>(plain: &'a str, name: &str, field: &str) -> Result<&'a str, String> {
    let is_known = plain == "Number" || plain == "Bytes" || language::quantity("1", plain).is_some();
    is_known.then_some(plain).ok_or_else(|| format!("`{name}.{field}`: the spec does not declare the type `{plain}`"))
}

/// Returns the method that gives the time of measurement of a message; nothing if the message has no field for it.
fn stamp(fields: &[(String, FieldType)]) -> Option<String> {
    let (_, kind) = fields.iter().find(|(name, _)| name == "stamp")?;
    let value = match kind {
        FieldType::Plain(plain) if plain == "Time" => "self.stamp",
        FieldType::List { .. } if is_optional_stamp("stamp", kind) => "self.stamp?",
        FieldType::Plain(_) | FieldType::Named(_) | FieldType::Record(_) | FieldType::List { .. } => return None,
    };
    Some(format!(
        "\n\n    fn stamp(&self) -> Option<Time> {{\n        let since = std::time::Duration::try_from_secs_f64({value}).ok()?;\n        \
         Some(Time::ZERO + since)\n    }}"
    ))
}

/// Returns fields as a spec writes them. A record in a record is written out, because a program in Python declares it
/// so. A record in a list keeps its name.
fn spelt(fields: &[(String, FieldType)], all: &[Named<'_>]) -> String {
    let kind = |one: &FieldType| match one {
        FieldType::Plain(text) => text.clone(),
        FieldType::Record(fields) => format!("{{ {} }}", spelt(fields, all)),
        FieldType::Named(name) => match all.iter().find(|other| other.name == *name) {
            Some(other) => format!("{{ {} }}", spelt(other.fields, all)),
            None => name.clone(),
        },
        FieldType::List { of, count } => {
            let count = count.map(|count| count.to_string()).unwrap_or_default();
            format!("{}[{count}]", element(of))
        }
    };
    fields.iter().map(|(name, one)| format!("{name}: {}", kind(one))).collect::<Vec<_>>().join(", ")
}

fn element(of: &FieldType) -> String {
    match of {
        FieldType::Plain(text) | FieldType::Named(text) => text.clone(),
        FieldType::Record(_) | FieldType::List { .. } => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::{Source, record_types};

    const SPEC: &str = "
        /// Describes a way to go.
        type Way = { points: Point[], goal: { at: Point, in: Truth }, stamp: Time[] };
        type Point = { x: Length, y: Length, label: Text };
        type Frame = { image: Bytes, box: Number[4] };";

    fn shown(spec: &str, language: Language) -> Result<String, String> {
        printed(&record_types(&[Source::new("a.dca", spec)]), language)
    }

    #[test]
    fn types_are_printed_for_python() {
        let refused = shown(SPEC, Language::Python).unwrap_err();
        assert_eq!(refused, "`WayGoal.in`: this word is not the name of a field in Python");
        expect_test::expect![[r#"
            from dataclasses import dataclass
            from typing import Annotated

            import dca


            @dca.message
            @dataclass(slots=True)
            class Point:
                x: dca.Length
                y: dca.Length
                label: str


            @dataclass(slots=True)
            class WayGoal:
                at: Point
                inside: bool


            @dca.message
            @dataclass(slots=True)
            class Way:
                """Describes a way to go."""

                points: list[Point]
                goal: WayGoal
                stamp: dca.Time | None


            @dca.message
            @dataclass(slots=True)
            class Frame:
                image: dca.Bytes
                box: Annotated[list[float], dca.Count(4)]
        "#]]
        .assert_eq(&shown(&SPEC.replace("in: Truth", "inside: Truth"), Language::Python).unwrap());
        let foreign = shown("type A = { x: Wrench };", Language::Python).unwrap_err();
        assert_eq!(foreign, "`A.x`: the spec does not declare the type `Wrench`");
    }

    #[test]
    fn types_are_printed_for_rust() {
        expect_test::expect![[r#"
            use controllers::sdk::{Bytes, Message, Time};
            use serde::{Deserialize, Serialize};

            #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
            pub struct Point {
                pub x: f64,
                pub y: f64,
                pub label: String,
            }

            impl Message for Point {
                const TYPE: &'static str = "Point";
                const FIELDS: &'static str = "x: Length, y: Length, label: Text";
            }

            #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
            pub struct WayGoal {
                pub at: Point,
                pub r#in: bool,
            }

            /// Describes a way to go.
            #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
            pub struct Way {
                pub points: Vec<Point>,
                pub goal: WayGoal,
                pub stamp: Option<f64>,
            }

            impl Message for Way {
                const TYPE: &'static str = "Way";
                const FIELDS: &'static str = "points: Point[], goal: { at: { x: Length, y: Length, label: Text }, in: Truth }, stamp: Time[]";

                fn stamp(&self) -> Option<Time> {
                    let since = std::time::Duration::try_from_secs_f64(self.stamp?).ok()?;
                    Some(Time::ZERO + since)
                }
            }

            #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
            pub struct Frame {
                pub image: Bytes,
                pub r#box: [f64; 4],
            }

            impl Message for Frame {
                const TYPE: &'static str = "Frame";
                const FIELDS: &'static str = "image: Bytes, box: Number[4]";
            }
        "#]]
        .assert_eq(&shown(SPEC, Language::Rust).unwrap());
    }
}
