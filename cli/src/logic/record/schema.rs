//! The names and schemas of a record, in the form that viewers require.

use serde_json::{Map, Value, json};

/// The field with the time of a sample, in seconds on the clock of the program's host.
pub(super) const STAMP: &str = "stamp";

/// Returns a name of letters, digits and `_`. Expressions of viewers can use such a name without quotes.
pub(crate) fn plain_name(text: &str) -> String {
    let mut name = String::with_capacity(text.len());
    for c in text.chars() {
        if c.is_ascii_alphanumeric() {
            name.push(c);
        } else if !name.ends_with('_') {
            name.push('_');
        }
    }
    let name = name.trim_matches('_');
    if name.is_empty() || name.starts_with(|c: char| c.is_ascii_digit()) { format!("_{name}") } else { name.to_owned() }
}

/// Returns a path whose parts are plain names.
pub(crate) fn plain_path(path: &str) -> String {
    path.split('/').map(plain_name).collect::<Vec<_>>().join("/")
}

/// Returns `name`; if it is taken, returns `name_2`, `name_3` and so on.
pub(crate) fn free_name(name: String, is_taken: impl Fn(&str) -> bool) -> String {
    let numbered = (2_u32..).map(|number| format!("{name}_{number}"));
    let free = std::iter::once(name.clone()).chain(numbered).find(|name| !is_taken(name));
    free.unwrap_or(name)
}

/// Returns the schema of reports.
pub(crate) fn event() -> Value {
    object(
        "dca.Event",
        [
            ("since_go", "number", "the time of the event, in seconds since GO; 0 before GO"),
            (
                "kind",
                "string",
                "the kind of the event, in one word: `activated`, `done`, `aborted`, `stopped`, `go` ...",
            ),
            ("process", "string", "the path of the process; empty for an event of all processes"),
            ("host", "string", "the host of the event, if the host is known"),
            ("text", "string", "the event as a sentence"),
            ("output", "string", "the last lines of a program that failed"),
            ("report", "string", "the event as JSON, for `dca report`"),
        ],
    )
}

/// Returns the schema for the output of programs: `foxglove.Log`, for which viewers have a panel.
pub(crate) fn log() -> Value {
    let time = object("time", [("sec", "integer", "seconds since 1970"), ("nsec", "integer", "and nanoseconds")]);
    let mut schema = object(
        "foxglove.Log",
        [
            ("level", "integer", "always 0: lines of a program's output have no level"),
            ("message", "string", "whole lines"),
            ("name", "string", "the path of the process"),
            ("file", "string", "unused"),
            ("line", "integer", "unused"),
        ],
    );
    schema["properties"]["timestamp"] = time;
    schema
}

/// Returns the schema for counts of values that are not in the record.
pub(super) fn missing() -> Value {
    object(
        "dca.Missing",
        [
            ("output", "string", "the path of the output that sent the values"),
            ("input", "string", "the path of the input at the other end of the wire"),
            ("early", "integer", "the number of values before the recorder was linked to the program"),
            ("lost", "integer", "the number of later values that are not in the record, since the previous count"),
            (
                "breaks",
                "integer",
                "how often the values broke off before the wire was closed, since the previous count",
            ),
        ],
    )
}

/// Returns the schema for values that only the programs at both ends of the wire can read. No interface describes the
/// values, or they do not match the interface.
pub(super) fn port() -> Value {
    let size = ("size", "integer", "the size of the value in bytes");
    let mut schema = object("dca.Encoded", [size, ("bytes", "string", "the value, encoded with postcard")]);
    schema["properties"]["bytes"]["contentEncoding"] = json!("base64");
    schema
}

/// Returns the schema for the samples of a program. Each signal (field, unit) is a number. Other values are left out.
pub(super) fn signals<'a>(title: &str, fields: impl Iterator<Item = (&'a str, &'a str)>) -> Value {
    let stamp = (STAMP, "number", "when the sample was taken, in seconds on the clock of the program's host");
    object(title, std::iter::once(stamp).chain(fields.map(|(name, unit)| (name, "number", unit))))
}

fn object<'a>(title: &str, fields: impl IntoIterator<Item = (&'a str, &'a str, &'a str)>) -> Value {
    let property =
        |(name, kind, what): (&str, &str, &str)| (name.to_owned(), json!({ "type": kind, "description": what }));
    let properties: Map<String, Value> = fields.into_iter().map(property).collect();
    json!({ "title": title, "type": "object", "properties": properties })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_have_letters_digits_and_underlines() {
        for (text, name) in [
            ("door angle", "door_angle"),
            ("joint 1 speed (max)", "joint_1_speed_max"),
            ("µ", "_"),
            ("", "_"),
            ("3d", "_3d"),
            ("x", "x"),
        ] {
            assert_eq!(plain_name(text), name, "{text}");
        }
        assert_eq!(plain_path("main/robot[2]/hit force"), "main/robot_2/hit_force");
        assert_eq!(free_name("x".into(), |name| ["x", "x_2"].contains(&name)), "x_3");
    }
}
