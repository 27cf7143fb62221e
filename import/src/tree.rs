//! Imports behavior trees of BehaviorTree.CPP, version 4.
//!
//! Each tree becomes a group, and each action becomes a module. Each port that reads or writes the blackboard becomes a
//! port of its module. If a tree ticks a node repeatedly, such as a condition in a `ReactiveSequence`, the node becomes a
//! process that watches.

mod attribute;
mod condition;
mod context;
mod control;
mod decorator;
mod leaf;
mod library;
mod module;
mod navigation;
mod piece;
mod reactive;
mod scope;

use crate::Imported;
use crate::remark::{Remark, RemarkKind};
use crate::xml::{File, ImportError, tag};
use context::Context;
use library::Library;
use std::collections::BTreeMap;

/// Makes a spec of the trees of some files; the first file has the main tree.
pub(crate) fn import(files: &[File<'_>]) -> Result<Imported, ImportError> {
    let library = Library::read(files)?;
    let mut remarks = Vec::new();
    let missing = RemarkKind::Missing;
    for include in &library.includes {
        let name = tag(include.element);
        let why = match name {
            "include" => "the included file is not read; give it to `dca import` with `--with`".to_owned(),
            _ => format!("<{name}> has no counterpart"),
        };
        remarks.push(Remark::new(include.file, include.element, missing, why));
    }
    let mut main = None;
    for file in files.iter().take(1) {
        if file.root.attribute("BTCPP_format") != Some("4") {
            let why = "the format is not 4; it is read as format 4";
            remarks.push(Remark::new(file.name, file.root, RemarkKind::Differs, why));
        }
        main = Some(library.main(*file)?);
    }
    let head: String = remarks.iter().map(Remark::comment).collect();
    let mut context = Context::new(&library, main.unwrap_or_default());
    for name in main.iter().chain(library.trees.keys()) {
        context::build_tree(&mut context, name)?;
    }
    remarks.extend(context.groups.iter().flat_map(|group| group.scope.remarks.iter().cloned()));
    let groups: String = context.groups.iter().map(|group| group.text(&context.modules, &library)).collect();
    let text = format!("{head}{}{groups}", context.modules.text());
    Ok(Imported { text, remarks, states: BTreeMap::new(), ports: BTreeMap::new() })
}
