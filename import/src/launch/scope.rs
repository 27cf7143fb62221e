//! The settings that apply to an action: variables, environment, namespace, and settings for later nodes.

use super::value::Value;
use std::collections::BTreeMap;

/// A part of the settings of a node.
#[derive(Clone, Debug)]
pub(super) enum Setting {
    Parameter { name: String, value: Value, kind: Option<String> },
    File(String),
    Remap { from: String, to: String },
}

/// The settings of one group.
#[derive(Clone, Debug, Default)]
pub(super) struct Frame {
    pub(super) variables: BTreeMap<String, Value>,
    /// None for a variable that was removed.
    pub(super) environment: BTreeMap<String, Option<String>>,
    pub(super) settings: Vec<Setting>,
    pub(super) namespace: Option<String>,
    /// Whether the settings around it do not hold in it.
    pub(super) is_closed: bool,
}

/// The groups around an action, the outermost first.
#[derive(Clone, Debug)]
pub(super) struct Scopes {
    frames: Vec<Frame>,
}

impl Scopes {
    /// Returns the settings at the start.
    pub(super) fn new() -> Self {
        Self { frames: vec![Frame::default()] }
    }

    /// Enters a group.
    pub(super) fn enter(&mut self, is_closed: bool) {
        self.frames.push(Frame { is_closed, ..Frame::default() });
    }

    /// Leaves a group.
    pub(super) fn leave(&mut self) {
        self.frames.pop();
    }

    /// Returns the settings of the innermost group.
    pub(super) fn top(&mut self) -> &mut Frame {
        if self.frames.is_empty() {
            self.frames.push(Frame::default());
        }
        let last = self.frames.len() - 1;
        &mut self.frames[last]
    }

    /// The groups whose settings hold, the innermost first.
    fn open(&self) -> impl DoubleEndedIterator<Item = &Frame> {
        let first = self.frames.iter().rposition(|frame| frame.is_closed).unwrap_or(0);
        self.frames[first..].iter().rev()
    }

    /// Returns the value of a variable.
    pub(super) fn variable(&self, name: &str) -> Option<&Value> {
        self.open().find_map(|frame| frame.variables.get(name))
    }

    /// Returns the namespace of a node without one of its own.
    pub(super) fn namespace(&self) -> &str {
        self.open().find_map(|frame| frame.namespace.as_deref()).unwrap_or("/")
    }

    /// Returns the variables of the environment.
    pub(super) fn environment(&self) -> BTreeMap<String, String> {
        let mut all = BTreeMap::new();
        for (name, value) in self.open().rev().flat_map(|frame| &frame.environment) {
            match value {
                Some(value) => all.insert(name.clone(), value.clone()),
                None => all.remove(name),
            };
        }
        all
    }

    /// Returns the settings of each node, the outermost first.
    pub(super) fn settings(&self) -> Vec<Setting> {
        self.open().rev().flat_map(|frame| frame.settings.iter().cloned()).collect()
    }
}

/// Returns a namespace inside another one.
pub(super) fn inside(around: &str, namespace: &str) -> String {
    let namespace = namespace.trim_end_matches('/');
    match namespace {
        "" => around.to_owned(),
        absolute if absolute.starts_with('/') => absolute.to_owned(),
        relative => format!("{}/{relative}", around.trim_end_matches('/')),
    }
}
