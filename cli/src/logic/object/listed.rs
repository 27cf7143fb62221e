//! The rows of `dca list`.

use comms::logic::object::{Access, ExportKind, Exported, TypeForm};
use comms::logic::tap::{InnerOutput, OutputType};
use serde_json::{Value, json};

/// A name that `dca list` shows.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Listed {
    /// `door:main/hand`
    pub(crate) process: String,
    pub(crate) name: String,
    /// For a wire inside a group, the input that it leads to.
    pub(crate) to: Option<String>,
    pub(crate) kind: ListedKind,
    pub(crate) types: String,
    pub(crate) doc: String,
    /// The right that a user of a team needs for a call; nothing if the name is not a procedure.
    pub(crate) access: Option<Access>,
}

/// The kind of a listed name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum ListedKind {
    Procedure,
    State,
    Output,
    /// The end of a connection.
    Input,
    /// A wire between two members of an in-process group.
    InnerWire,
}

impl ListedKind {
    fn word(self) -> &'static str {
        match self {
            Self::Procedure => "proc",
            Self::State => "state",
            Self::Output => "out",
            Self::Input => "in",
            Self::InnerWire => "wire",
        }
    }
}

impl Listed {
    pub(crate) fn exported(process: &str, exported: Exported) -> Self {
        let kind = if exported.kind == ExportKind::State { ListedKind::State } else { ListedKind::Procedure };
        let types = match exported.kind {
            ExportKind::State => exported.signature.result.to_string(),
            ExportKind::Procedure => format!("{} -> {}", exported.signature.argument, exported.signature.result),
        };
        let access = (kind == ListedKind::Procedure).then_some(exported.access);
        Self { process: process.to_owned(), name: exported.name, to: None, kind, types, doc: exported.doc, access }
    }

    pub(crate) fn output(process: &str, output: OutputType) -> Self {
        let types = TypeForm::new(&output.type_name, &output.fields).to_string();
        let (process, kind) = (process.to_owned(), ListedKind::Output);
        Self { process, name: output.name, to: None, kind, types, doc: String::new(), access: None }
    }

    /// Returns a row for each wire inside a group that begins at this output.
    pub(crate) fn inner(process: &str, InnerOutput { output, inputs }: InnerOutput) -> Vec<Self> {
        let of_output = Self { kind: ListedKind::InnerWire, ..Self::output(process, output) };
        inputs.into_iter().map(|input| Self { to: Some(input), ..of_output.clone() }).collect()
    }

    /// Returns the cells of the row.
    pub(crate) fn cells(&self) -> [String; 4] {
        let name = match &self.to {
            Some(to) => format!("{} -> {to}", self.name),
            None => self.name.clone(),
        };
        let kind = match self.access {
            Some(access) if access != Access::default() => format!("{} ({access})", self.kind.word()),
            _ => self.kind.word().to_owned(),
        };
        [self.process.clone(), name, kind, self.types.clone()]
    }

    pub(crate) fn json(&self) -> Value {
        let (process, name, kind) = (&self.process, &self.name, self.kind.word());
        let mut row = json!({ "process": process, "name": name, "kind": kind, "type": self.types, "doc": self.doc });
        let more = [("to", self.to.clone()), ("access", self.access.map(|access| access.to_string()))];
        for (name, value) in more {
            if let (Some(value), Some(row)) = (value, row.as_object_mut()) {
                row.insert(name.to_owned(), value.into());
            }
        }
        row
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::object::Signature;

    #[test]
    fn rows() {
        let signature = Signature { argument: TypeForm::new("Push", "force: Force"), result: TypeForm::default() };
        let exported = |kind| Exported {
            name: "x".into(),
            kind,
            signature: signature.clone(),
            doc: "Does.".into(),
            is_answered_idle: false,
            access: Access::Look,
        };
        let row = Listed::exported("d:main/a", exported(ExportKind::Procedure));
        assert_eq!(row.cells(), ["d:main/a", "x", "proc (look)", "Push { force: Force } -> ()"]);
        assert_eq!((&row.json()["doc"], &row.json()["access"]), (&json!("Does."), &json!("look")));
        assert_eq!(Listed::exported("d:main/a", exported(ExportKind::State)).cells()[2..], ["state", "()"]);
        let output = OutputType { name: "Out".into(), type_name: "W".into(), fields: "x: Force".into() };
        assert_eq!(Listed::output("d:main/a", output.clone()).cells()[1..], ["Out", "out", "W { x: Force }"]);
        let output = OutputType { name: "b.Out".into(), ..output };
        let wires = Listed::inner("d:main/a", InnerOutput { output, inputs: vec!["c.In".into(), "d.In".into()] });
        let [one, other] = &wires[..] else { panic!("{wires:?}") };
        assert_eq!(one.cells()[1..], ["b.Out -> c.In", "wire", "W { x: Force }"]);
        assert_eq!((&other.json()["name"], &other.json()["to"]), (&json!("b.Out"), &json!("d.In")));
        assert_eq!(row.json().get("to"), None);
    }
}
