//! Names of ROS 2 with parameters: in `"/{robot}/scan"` the value of the parameter `robot` is a part of the name.
//!
//! The name is checked twice. Where it is written, a word stands for each parameter. In the plan, the parameters have their values, and a
//! name that ROS 2 refuses is reported with them.

use super::spec::Param;
use crate::diagnostic::{Code, Diagnostic};
use crate::source::Span;
use crate::syntax::ast::Token;
use ros::logic::key::GraphName;

/// Values that stand for a parameter where a name is written: a part of a word, a whole name, and a whole prefix.
const SAMPLES: [&str; 3] = ["a", "/a", "a/"];
/// The longest full name of a node, in bytes. ROS 2 allows 255, and the names of its services are longer.
const NODE_MAX: usize = 200;

/// A name of ROS 2 as the spec has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct NameText {
    /// The text in the quotes.
    pub(crate) text: String,
    pub(crate) span: Span,
}

/// A part of a name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Part<'a> {
    Text(&'a str),
    Param(&'a str),
}

impl NameText {
    /// Returns the name in a text.
    pub(crate) fn of(token: &Token) -> Self {
        Self { text: token.content(), span: token.span() }
    }

    /// Returns the names of its parameters.
    pub(crate) fn params(&self) -> Vec<&str> {
        params(&self.text)
    }

    /// Returns whether some values of its parameters make a name that is fit.
    pub(crate) fn can_be(&self, is_fit: impl Fn(&str) -> bool) -> bool {
        SAMPLES.iter().any(|sample| is_fit(&filled(&self.text, |_| Some((*sample).to_owned()))))
    }

    /// Returns the mistake if it names a parameter that is not there. `of` is the owner of the parameters, for a person.
    pub(crate) fn misfit(&self, params: &[Param], of: &str) -> Option<Diagnostic> {
        let is_missing = |name: &&str| params.iter().all(|param| param.name.text != *name);
        let name = self.params().into_iter().find(is_missing)?;
        let found = Diagnostic::new(Code::E0309, self.span, format!("`{of}` has no parameter `{name}`"));
        Some(found.help(format!("declare the parameter, for example `{name}: Text`, or write the name without braces")))
    }

    /// Returns the name with the values of its parameters, or the mistake if it is not fit. `of` is the kind of the name, for a person.
    pub(crate) fn resolved(
        &self,
        value: impl Fn(&str) -> Option<String>,
        is_fit: impl Fn(&str) -> bool,
        of: &str,
    ) -> Result<String, Box<Diagnostic>> {
        let text = filled(&self.text, &value);
        if is_fit(&text) {
            return Ok(text);
        }
        let found = Diagnostic::new(Code::E0309, self.span, format!("{text:?} is not {of} of ROS 2"));
        Err(Box::new(found.help(values_of(&self.params(), value))))
    }
}

/// Returns a sentence with the values of parameters.
pub(crate) fn values_of(params: &[&str], value: impl Fn(&str) -> Option<String>) -> String {
    let one = |name: &&str| match value(name) {
        Some(text) => format!("`{name}` is `{}`", text.escape_debug()),
        None => format!("`{name}` is not a text"),
    };
    format!("here {}", params.iter().map(one).collect::<Vec<_>>().join(" and "))
}

/// Returns whether a text is the full name of a node or an action. Names of their services follow it.
pub(crate) fn is_node(text: &str) -> bool {
    is_topic(text) && text.len() <= NODE_MAX
}

/// Returns whether a text is the full name of a topic or a service.
pub(crate) fn is_topic(text: &str) -> bool {
    text.starts_with('/') && GraphName::parse(text).is_some()
}

/// Returns whether a text can be a name in a rule for another name: `/scan`, `scan`, `~/scan`.
pub(crate) fn is_remapped(text: &str) -> bool {
    !text.is_empty() && !text.starts_with("__") && text.chars().all(is_part)
}

/// Returns whether a name of ROS 2 can have this character.
pub(crate) fn is_part(c: char) -> bool {
    c.is_ascii_alphanumeric() || matches!(c, '_' | '/' | '~')
}

/// Returns the names of the parameters in a text.
pub(crate) fn params(text: &str) -> Vec<&str> {
    let param = |part| match part {
        Part::Text(_) => None,
        Part::Param(name) => Some(name),
    };
    parts(text).into_iter().filter_map(param).collect()
}

/// Returns a text with the values of its parameters. A parameter without a value keeps its braces.
pub(crate) fn filled(text: &str, value: impl Fn(&str) -> Option<String>) -> String {
    let one = |part| match part {
        Part::Text(text) => text.to_owned(),
        Part::Param(name) => value(name).unwrap_or_else(|| format!("{{{name}}}")),
    };
    parts(text).into_iter().map(one).collect()
}

/// Returns the parts of a name. A brace without its partner stays in the text, where no name of ROS 2 can have it.
fn parts(text: &str) -> Vec<Part<'_>> {
    let (mut parts, mut rest) = (Vec::new(), text);
    while let Some((before, (name, after))) =
        rest.split_once('{').and_then(|(before, behind)| Some((before, behind.split_once('}')?)))
    {
        if !before.is_empty() {
            parts.push(Part::Text(before));
        }
        parts.push(Part::Param(name));
        rest = after;
    }
    if !rest.is_empty() {
        parts.push(Part::Text(rest));
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_has_parameters_in_braces() {
        let span = Span { origin: crate::source::Origin::Spec, start: 0, end: 0 };
        let name = |text: &str| NameText { text: text.to_owned(), span };
        assert_eq!(name("/{robot}/arm_{side}").params(), ["robot", "side"]);
        assert_eq!(name("/{robot/{a}").params(), ["robot/{a"]);
        assert!(name("/scan}").params().is_empty() && name("").params().is_empty());
        let value = |name: &str| (name == "robot").then(|| "r7".to_owned());
        assert_eq!(filled("/{robot}/arm_{side}", value), "/r7/arm_{side}");
        assert_eq!(filled("{robot}/", value), "r7/");
        let is_name = |text: &str| text.starts_with('/') && !text.contains(['{', '}']);
        let [word, whole, open] = ["/{robot}/scan", "{scan}", "/{robot"].map(|text| name(text).can_be(is_name));
        assert!(word && whole && !open);
    }
}
