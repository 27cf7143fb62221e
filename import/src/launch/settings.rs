//! The settings of a node: parameters, parameter files, and remapped names.

use super::entity::Entity;
use super::parameter::{Literal, is_name};
use super::program::Parameter;
use super::scope::Setting;
use super::value::Value;
use super::walk::Importer;
use super::words;
use crate::name::{identifier, is_hidden};
use crate::remark::RemarkKind;
use std::collections::BTreeMap;

/// The settings of a node, in the order in which they apply.
#[derive(Debug, Default)]
pub(super) struct Settings {
    pub(super) parameters: Vec<Parameter>,
    pub(super) files: Vec<String>,
    pub(super) remaps: Vec<[String; 2]>,
    /// Words behind `--ros-args`, for settings without another form in a spec.
    pub(super) words: Vec<String>,
}

impl Settings {
    /// Reads the settings of all nodes around a node, and the node's own settings.
    pub(super) fn read(&mut self, importer: &mut Importer<'_>, entity: &Entity) {
        let mut all = importer.scopes.settings();
        own_settings(importer, entity, "", &mut all);
        apply(importer, entity, all, self);
    }
}

impl Importer<'_> {
    /// Returns the number of the argument whose value this is, and how a spec writes the value.
    pub(super) fn link(&self, value: &Value) -> Option<(usize, Literal)> {
        let number = *value.arguments.first().filter(|_| value.is_argument && value.open.is_none())?;
        let argument = self.arguments.get(number).filter(|argument| argument.value.text == value.text)?;
        let literal = Literal::of(&argument.value.text, None).filter(Literal::is_of_spec)?;
        Some((number, literal))
    }

    /// Returns the parameter of `main` for an argument with this value.
    pub(super) fn given(&mut self, number: usize, literal: Literal) -> String {
        let argument = &mut self.arguments[number];
        if let Some((name, _)) = &argument.parameter {
            return name.clone();
        }
        let name = self.names.take(&identifier(&argument.name));
        argument.parameter = Some((name.clone(), literal));
        name
    }
}

/// Notes the settings that a node has itself. Names of parameters inside others begin with `prefix`.
fn own_settings(importer: &mut Importer<'_>, entity: &Entity, prefix: &str, all: &mut Vec<Setting>) {
    for part in entity.children.iter().filter(|part| matches!(part.kind.as_str(), "param" | "remap")) {
        if !importer.is_on(part) {
            continue;
        }
        if part.kind == "remap" {
            if let (Ok(from), Ok(to)) = (importer.needed(part, "from"), importer.needed(part, "to")) {
                all.push(Setting::Remap { from, to });
            }
            continue;
        }
        if part.get("from").is_some() {
            if importer.truth(part, "allow_substs") == Some(true) {
                importer.missing(part, "substitutions inside the file are not replaced");
            }
            importer.unread(part, &["from", "name", "allow_substs"]);
            all.extend(importer.needed(part, "from").ok().map(Setting::File));
            continue;
        }
        let Ok(name) = importer.needed(part, "name") else { continue };
        let name = format!("{prefix}{name}");
        importer.unread(part, &["name", "value", "type"]);
        match part.get("value") {
            Some(value) => {
                let value = importer.value(value);
                let kind = part.get("type").map(str::to_owned);
                all.push(Setting::Parameter { name, value, kind });
            }
            None => own_settings(importer, part, &format!("{name}."), all),
        }
    }
}

/// Turns settings into settings of a spec.
fn apply(importer: &mut Importer<'_>, entity: &Entity, all: Vec<Setting>, settings: &mut Settings) {
    let mut parameters: BTreeMap<String, Result<Parameter, String>> = BTreeMap::new();
    for setting in all {
        match setting {
            Setting::File(file) => {
                if file.is_empty() || file.contains(':') || file.chars().any(is_hidden) {
                    importer.missing(entity, &format!("`{file}` is not the path of a file of parameters"));
                    continue;
                }
                if !parameters.is_empty() {
                    let why = format!(
                        "values of the node replace the values in `{file}`; in launch, the file replaces the values of the node"
                    );
                    importer.remark(entity, RemarkKind::Differs, &why);
                }
                if !file.starts_with('/') {
                    let why = format!("`{file}` is relative to the folder in which the node of DCA runs");
                    importer.remark(entity, RemarkKind::Differs, &why);
                }
                settings.files.push(file);
            }
            Setting::Remap { from, to } => remap(importer, entity, [from, to], settings),
            Setting::Parameter { name, value, kind } => match parameter(importer, &name, value, kind.as_deref()) {
                Ok(found) => drop(parameters.insert(name, found)),
                Err(why) => drop(importer.missing(entity, &format!("parameter `{name}` is left out: {why}"))),
            },
        }
    }
    for (name, found) in parameters {
        match found {
            Ok(parameter) => settings.parameters.push(parameter),
            Err(text) => settings.words.extend(["-p".to_owned(), format!("{name}:={text}")]),
        }
    }
}

/// Returns a parameter of the module, or the text of a parameter whose name no parameter of a module has.
fn parameter(
    importer: &mut Importer<'_>,
    name: &str,
    value: Value,
    kind: Option<&str>,
) -> Result<Result<Parameter, String>, String> {
    let kind = match kind {
        None | Some("str" | "int" | "float" | "bool") => kind,
        Some(list) if list.ends_with("[]") && value.text.starts_with('[') => None,
        Some(other) => return Err(format!("its type `{other}` is not known here")),
    };
    let linked = importer.link(&value);
    if is_name(name)
        && let Some((number, literal)) = linked
        && Literal::of(&value.text, kind).as_ref() == Some(&literal)
    {
        let parameter =
            Parameter { name: name.to_owned(), value: literal.clone(), given: Some(importer.given(number, literal)) };
        return Ok(Ok(parameter));
    }
    let text = importer.fixed(value)?;
    let value = Literal::of(&text, kind).ok_or_else(|| format!("a spec cannot have the value `{text}`"))?;
    if is_name(name) && value.is_of_spec() {
        return Ok(Ok(Parameter { name: name.to_owned(), value, given: None }));
    }
    let text = value.yaml();
    words::written(&format!("{name}:={text}")).map(|_| Err(text))
}

/// Other names, as an item of the module or as words of the command line.
fn remap(importer: &mut Importer<'_>, entity: &Entity, [from, to]: [String; 2], settings: &mut Settings) {
    let is_part = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '/' | '~');
    let is_fit = |text: &str| !text.is_empty() && !text.starts_with("__") && text.chars().all(is_part);
    if is_fit(&from) && is_fit(&to) {
        settings.remaps.push([from, to]);
        return;
    }
    let rule = format!("{from}:={to}");
    if from.is_empty() || to.is_empty() || words::written(&rule).is_err() {
        importer.missing(entity, &format!("`{rule}` does not give another name"));
    } else {
        settings.words.extend(["-r".to_owned(), rule]);
    }
}
