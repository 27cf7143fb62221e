//! Scripts of activities: computations in Rhai that give the value of an opaque variable.
//!
//! A script is a pure function of its inputs: it has no clock, no file, no network and no memory. The engine counts
//! operations in place of time, so the same inputs always give the same result, on a robot and in a simulation. A script
//! cannot start processes and cannot assign finite variables, so the control flow of an activity stays visible.

mod engine;
mod reader;
#[cfg(test)]
mod tests;
mod value;

use crate::algebra::Value;
use crate::message::Layout;
use rhai::{Dynamic, EvalAltResult, Scope};
use serde::{Deserialize, Serialize};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

pub(crate) use engine::{SCRIPT_INPUTS_MAX, SCRIPT_TEXT_MAX, SCRIPTS_MAX};
pub(crate) use reader::{Mistake, ScriptMistake, ScriptReader};

/// The longest text that explains an error, in bytes.
const WHY_MAX: usize = 256;

/// A script, with the values that it reads and the form of its result.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Script {
    /// The text between the braces.
    pub text: String,
    /// The values that the script reads.
    pub inputs: Vec<ScriptInput>,
    /// The variable that gets the result.
    pub result: ScriptResult,
}

/// The variable that gets the result of a script.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ScriptResult {
    /// The name of the variable, for errors.
    pub variable: String,
    /// The declared type, for errors.
    pub of: String,
    /// The layout of the type.
    pub layout: Layout,
}

/// A value that a script reads.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ScriptInput {
    /// The name of the value in the script.
    pub name: String,
    /// Where the value comes from.
    pub source: ScriptSource,
}

/// Where a value that a script reads comes from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ScriptSource {
    /// The value of the event, with this layout.
    Event(Layout),
    /// A value that the activity keeps.
    Slot {
        /// The number of the slot.
        slot: usize,
        /// The layout of the value.
        layout: Layout,
    },
    /// A finite variable.
    Variable(usize),
}

/// The present value of a [`ScriptSource`].
#[derive(Clone, Debug)]
pub(crate) enum Given {
    /// Bytes of the layout of the source.
    Bytes(Value),
    /// A number of a finite variable.
    Number(i32),
    /// A truth value of a finite variable.
    Truth(bool),
    /// The name of a value of a finite variable.
    Name(String),
}

/// Why a script gave no value.
#[derive(Clone, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct ScriptError {
    /// The kind of the error.
    pub kind: ScriptErrorKind,
    /// The error as a clause of a sentence, with its line in the script.
    pub why: Arc<str>,
}

/// The kinds of errors of scripts.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum ScriptErrorKind {
    /// The script needs more operations, calls or memory than it may have.
    Budget,
    /// The script made an error, or its result is not of the declared type.
    Failed,
}

impl ScriptErrorKind {
    /// All kinds.
    pub const ALL: [Self; 2] = [Self::Budget, Self::Failed];
}

impl ScriptError {
    /// Returns the error for which an exploration lets a script fail.
    pub(crate) fn assumed(kind: ScriptErrorKind) -> Self {
        Self { kind, why: "".into() }
    }

    /// Returns the error of a script that its reaction may not run any more.
    pub(crate) fn too_many() -> Self {
        Self::budget(&format!("more than {SCRIPTS_MAX} scripts in one reaction"))
    }

    fn new(kind: ScriptErrorKind, why: &str) -> Self {
        Self { kind, why: why[..why.floor_char_boundary(WHY_MAX)].into() }
    }

    fn budget(why: &str) -> Self {
        Self::new(ScriptErrorKind::Budget, why)
    }

    fn failed(why: &str) -> Self {
        Self::new(ScriptErrorKind::Failed, why)
    }
}

impl std::fmt::Display for ScriptError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.kind {
            ScriptErrorKind::Budget => write!(f, "a script has used up its budget: {}", self.why),
            ScriptErrorKind::Failed => write!(f, "a script has failed: {}", self.why),
        }
    }
}

impl Script {
    /// Carries out the script. `given` returns the present value of a source.
    ///
    /// # Errors
    /// If the script makes an error, has used up its budget, or gives a value of another type.
    pub(crate) fn run(&self, given: &dyn Fn(&ScriptSource) -> Given) -> Result<Value, ScriptError> {
        let mut scope = Scope::new();
        for input in self.inputs.iter().take(SCRIPT_INPUTS_MAX) {
            let value = match (&input.source, given(&input.source)) {
                (ScriptSource::Event(layout) | ScriptSource::Slot { layout, .. }, Given::Bytes(value)) => {
                    value::read(&value, layout, &input.name)?
                }
                (_, Given::Bytes(_)) => Dynamic::UNIT,
                (_, Given::Number(number)) => Dynamic::from_int(i64::from(number)),
                (_, Given::Truth(truth)) => Dynamic::from_bool(truth),
                (_, Given::Name(name)) => Dynamic::from(name),
            };
            scope.push_constant_dynamic(input.name.as_str(), value);
        }
        // A defect of the engine ends one activity, and not the node.
        let computed = catch_unwind(AssertUnwindSafe(|| computed(&self.text, &mut scope)));
        let result = computed.unwrap_or_else(|_| Err(ScriptError::failed("the engine of scripts has a defect")))?;
        value::written(&result, &self.result)
    }
}

fn computed(text: &str, scope: &mut Scope<'_>) -> Result<Dynamic, ScriptError> {
    if text.len() > SCRIPT_TEXT_MAX {
        return Err(ScriptError::budget(&format!("the script has more than {SCRIPT_TEXT_MAX} bytes")));
    }
    engine::limited().eval_with_scope(scope, text).map_err(|error| explained(&error))
}

/// Returns the error of a script that was carried out.
fn explained(error: &EvalAltResult) -> ScriptError {
    let mut inner = error;
    while let EvalAltResult::ErrorInFunctionCall(_, _, next, _) = inner {
        inner = next;
    }
    let line = inner.position().line().map_or_else(String::new, |line| format!("line {line} of the script: "));
    let (kind, why) = match engine::limit_of(inner) {
        Some(limit) => (ScriptErrorKind::Budget, limit),
        None => (ScriptErrorKind::Failed, clause(&inner.to_string())),
    };
    ScriptError::new(kind, &format!("{line}{why}"))
}

/// Returns a message of the engine as a clause: without the position, and without a capital.
fn clause(message: &str) -> String {
    let message = message.split(" (line ").next().unwrap_or(message).trim_end_matches('.');
    let mut letters = message.chars();
    letters.next().map(|first| first.to_lowercase().chain(letters).collect()).unwrap_or_default()
}
