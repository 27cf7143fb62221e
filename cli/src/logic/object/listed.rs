//! The rows of `dca list`.

use crate::logic::tap::is_path;
use comms::logic::object::{ExportKind, Exported, TypeForm};
use comms::logic::tap::OutputType;
use serde_json::{Value, json};

/// A name of a running program.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Listed {
    /// `door:main/hand`
    pub(crate) process: String,
    pub(crate) name: String,
    pub(crate) kind: ListedKind,
    pub(crate) types: String,
    pub(crate) doc: String,
}

/// What a name stands for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum ListedKind {
    Procedure,
    State,
    Output,
    /// The end of a connection.
    Input,
}

impl ListedKind {
    fn word(self) -> &'static str {
        match self {
            Self::Procedure => "proc",
            Self::State => "state",
            Self::Output => "out",
            Self::Input => "in",
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
        Self { process: process.to_owned(), name: exported.name, kind, types, doc: exported.doc }
    }

    pub(crate) fn output(process: &str, output: OutputType) -> Self {
        let types = TypeForm::new(&output.type_name, &output.fields).to_string();
        let (process, kind) = (process.to_owned(), ListedKind::Output);
        Self { process, name: output.name, kind, types, doc: String::new() }
    }

    /// Returns the cells of its row.
    pub(crate) fn cells(&self) -> [String; 4] {
        [self.process.clone(), self.name.clone(), self.kind.word().to_owned(), self.types.clone()]
    }

    pub(crate) fn json(&self) -> Value {
        let (process, name, kind) = (&self.process, &self.name, self.kind.word());
        json!({ "process": process, "name": name, "kind": kind, "type": self.types, "doc": self.doc })
    }
}

/// Returns whether a process is meant by `[DEPLOYMENT:]INSTANCE`; all are without a word.
pub(crate) fn is_listed(meant: Option<&str>, deployment: &str, path: &str) -> bool {
    meant.is_none_or(|meant| match meant.split_once(':') {
        Some((named, process)) => named == deployment && (process.is_empty() || is_path(path, process)),
        None => is_path(path, meant),
    })
}

#[cfg(test)]
mod tests {
    use super::super::ObjectName;
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
        };
        let row = Listed::exported("d:main/a", exported(ExportKind::Procedure));
        assert_eq!(row.cells(), ["d:main/a", "x", "proc", "Push { force: Force } -> ()"]);
        assert_eq!(row.json()["doc"], "Does.");
        assert_eq!(Listed::exported("d:main/a", exported(ExportKind::State)).cells()[2..], ["state", "()"]);
        let output = OutputType { name: "Out".into(), type_name: "W".into(), fields: "x: Force".into() };
        assert_eq!(Listed::output("d:main/a", output).cells()[1..], ["Out", "out", "W { x: Force }"]);
        for (meant, is_meant) in [
            (None, true),
            (Some("a"), true),
            (Some("d:a"), true),
            (Some("d:"), true),
            (Some("e:a"), false),
            (Some("b"), false),
        ] {
            assert_eq!(is_listed(meant, "d", "main/a"), is_meant, "{meant:?}");
        }
        assert!(ObjectName::parse("d:a.x").unwrap().is_process("d", "main/a"));
    }
}
