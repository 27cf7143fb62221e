//! The interface of a controller type: everything that can be known without running it.

use super::arguments::Parameter;
use super::controller::About;
use super::export::{CallInterface, ExportInterface};
pub use super::port_interface::{Binding, Device, Direction, PortInterface};
use std::fmt::Write as _;

/// Everything about a controller type that can be known without running it.
#[derive(Clone, Debug)]
pub struct Interface {
    /// The process type: `ForceTorque`.
    pub type_name: &'static str,
    /// Purpose, ending, schedule and parameters.
    pub about: About,
    /// Inputs, then outputs, each in order of declaration.
    pub ports: Vec<PortInterface>,
    /// The exports, in order of declaration.
    pub exports: Vec<ExportInterface>,
    /// The calls of other processes, in order of declaration.
    pub calls: Vec<CallInterface>,
    /// For an in-process group: the outputs of members that lead to other members, by member in the order of their
    /// turns.
    pub inner: Vec<InnerOutput>,
}

/// An output of a member of an in-process group, and the inputs inside the group that get its values. It is not part of
/// specs, but people can watch it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InnerOutput {
    /// The member and its port: `smooth.Out`.
    pub name: String,
    /// The message type.
    pub type_name: &'static str,
    /// The fields of the message, as in a record; empty if the message type does not name them.
    pub fields: &'static str,
    /// The inputs that get its values, in order of the wires: `limit.In`.
    pub inputs: Vec<String>,
}

impl Interface {
    /// Returns the port called `name`.
    pub fn port(&self, name: &str) -> Option<&PortInterface> {
        self.ports.iter().find(|port| port.name == name)
    }

    /// Returns the devices that this program owns, each once, in order of declaration.
    pub fn owns(&self) -> Vec<&'static str> {
        self.devices(Binding::Owner)
    }

    /// Returns the devices of other programs that this program needs, each once, in order of declaration.
    pub fn needs(&self) -> Vec<&'static str> {
        self.devices(Binding::Client)
    }

    fn devices(&self, binding: Binding) -> Vec<&'static str> {
        let mut names = Vec::new();
        for device in self.ports.iter().filter(|port| port.binding == binding).filter_map(PortInterface::device_key) {
            if !names.contains(&device.name) {
                names.push(device.name);
            }
        }
        names
    }

    /// Returns the messages of the wires that name their fields, each with its fields.
    pub fn messages(&self) -> impl Iterator<Item = (&str, &str)> {
        let wires = self.ports.iter().filter(|port| port.binding == Binding::Wire);
        let start = self.about.start.iter().map(|start| (start.type_name, start.fields));
        let wires = wires.map(|port| (port.type_name, port.fields)).chain(start);
        let wires = wires.map(|(name, fields)| (name, fields.trim_end_matches([',', ' '])));
        let exports = self.exports.iter().map(|export| &export.signature);
        let signatures = exports.chain(self.calls.iter().map(|call| &call.signature));
        let forms = signatures.flat_map(|signature| [&signature.argument, &signature.result]);
        let forms = forms.map(|form| (form.name.as_str(), form.fields.as_str()));
        wires.chain(forms).filter(|(_, fields)| !fields.is_empty())
    }

    /// Returns the interface as a `module` block of the `.dca` language; device ports are not part of it.
    pub fn text(&self) -> String {
        let mut text = String::new();
        let parameters = Parameter::texts(self.about.parameters);
        let head: Vec<String> = std::iter::once("host: Host".to_owned()).chain(parameters).collect();
        let mut line = |line: String| {
            text.push_str(&line);
            text.push('\n');
        };
        doc_lines("", self.about.doc).for_each(&mut line);
        line(format!("module {}({}) {{", self.type_name, head.join(", ")));
        for port in self.ports.iter().filter(|port| port.binding == Binding::Wire) {
            let direction = match port.direction {
                Direction::In => "in",
                Direction::Out => "out",
            };
            doc_lines("  ", port.doc).for_each(&mut line);
            let optional = if port.required { "" } else { " optional" };
            line(format!("  {direction} {}: {}{optional};", port.name, port.type_name));
        }
        let exports = self.exports.iter().map(|export| (export.doc, export.text()));
        for (doc, text) in exports.chain(self.calls.iter().map(|call| (call.doc, call.text()))) {
            doc_lines("  ", doc).for_each(&mut line);
            line(format!("  {text}"));
        }
        if let Some(start) = &self.about.start {
            line(format!("  init value: {};", start.type_name));
        }
        line(if self.about.service { "  service;".to_owned() } else { self.done() });
        if self.about.remembers {
            line("  remembers;".to_owned());
        }
        let mut stop = String::new();
        write!(stop, "  stop within {} ms;", self.about.stop_within.as_millis()).expect("a String takes any text");
        line(stop);
        line("}".to_owned());
        text
    }

    /// Returns for example `  done;` or `  done(found: Pose | missing);`.
    fn done(&self) -> String {
        let outcomes = self.about.outcomes.iter().map(|outcome| {
            let value = outcome.type_name.map_or(String::new(), |name| format!(": {name}"));
            format!("{}{value}", outcome.tag)
        });
        let outcomes: Vec<String> = outcomes.collect();
        if outcomes.is_empty() { "  done;".to_owned() } else { format!("  done({});", outcomes.join(" | ")) }
    }

    /// Returns whether a process of this type may end with `value`. Any value is allowed, unless the type has declared
    /// its outcomes.
    pub fn may_end_with(&self, value: &[u8]) -> bool {
        let has_tag = |tag: &str| {
            let (length, rest) = value.split_first().map_or((0, value), |(&length, rest)| (usize::from(length), rest));
            length == tag.len() && rest.starts_with(tag.as_bytes())
        };
        self.about.outcomes.is_empty() || self.about.outcomes.iter().any(|outcome| has_tag(outcome.tag))
    }
}

/// Returns the lines of a doc comment; no line for an empty text.
fn doc_lines<'a>(indent: &'a str, doc: &'a str) -> impl Iterator<Item = String> + 'a {
    doc.trim().lines().map(move |text| format!("{indent}/// {}", text.trim()))
}

#[cfg(test)]
mod tests {
    use super::super::controller::{Outcome, Progress, TAG_MAX};
    use super::*;

    const OUTCOMES: &[Outcome] =
        &[Outcome { tag: "found", type_name: Some("Pose") }, Outcome { tag: "missing", type_name: None }];

    fn interface() -> Interface {
        let about = About::task("Looks for something.").ends_with(OUTCOMES);
        Interface {
            type_name: "Search",
            about,
            ports: Vec::new(),
            exports: Vec::new(),
            calls: Vec::new(),
            inner: Vec::new(),
        }
    }

    #[test]
    fn outcomes_are_declared_in_the_text_and_kept_to() {
        assert!(interface().text().contains("  done(found: Pose | missing);\n"), "{}", interface().text());
        assert_eq!(Progress::outcome("found", b"pose"), Progress::Done(b"\x05foundpose".to_vec()));
        assert_eq!(Progress::outcome("missing", &()), Progress::Done(b"\x07missing".to_vec()));
        assert_eq!(Progress::outcome("found", &(1_u8, "at")), Progress::done(&("found", (1_u8, "at"))));
        assert!(matches!(Progress::outcome("found", &f64::NAN), Progress::Aborted(_)));
        for (value, is_one) in
            [(&b"\x05foundpose"[..], true), (b"\x07missing", true), (b"\x04lost", false), (b"", false)]
        {
            assert_eq!(interface().may_end_with(value), is_one, "{value:?}");
        }
        for tag in [String::new(), "t".repeat(TAG_MAX + 1)] {
            assert!(matches!(Progress::outcome(&tag, b""), Progress::Aborted(_)), "{tag}");
        }
    }

    /// The place to drive to.
    #[derive(Debug, serde::Serialize, serde::Deserialize)]
    struct Place {
        x: f64,
    }

    impl super::super::port::Message for Place {
        const TYPE: &'static str = "Place";
        const FIELDS: &'static str = "x: Length";
    }

    #[test]
    fn the_start_value_is_declared_with_its_type() {
        let about = About::task("Drives.").starts_with::<Place>();
        let interface = Interface { about, ..interface() };
        assert!(interface.text().contains("  init value: Place;\n"), "{}", interface.text());
        assert_eq!(interface.messages().collect::<Vec<_>>(), [("Place", "x: Length")]);
    }

    #[test]
    fn what_remembers_says_so_in_its_text() {
        let told = |about| {
            Interface {
                type_name: "Count",
                about,
                ports: Vec::new(),
                exports: Vec::new(),
                calls: Vec::new(),
                inner: Vec::new(),
            }
            .text()
            .contains("  remembers;\n")
        };
        assert!(told(About::service("Counts.").remembers()) && !told(About::service("Counts.")));
    }

    #[test]
    fn what_declares_no_outcomes_ends_as_it_likes() {
        let about = About::task("Ends.");
        let interface = Interface {
            type_name: "Step",
            about,
            ports: Vec::new(),
            exports: Vec::new(),
            calls: Vec::new(),
            inner: Vec::new(),
        };
        assert!(interface.text().contains("  done;\n") && interface.may_end_with(b"anything"));
    }
}
