//! Transitions: the trigger and the target of each.

use super::{ActivityReader, TransitionText, formula, notice, outcome, question};
use crate::automaton::{StateKind, Target, Transition, Trigger};
use crate::check::expression::catch;
use crate::check::scripts::has_word;
use crate::check::spec::{Readable, ReadableValue};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::TIMER_LEAST;
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Constant, Text};
use crate::syntax::ast::{Name, Node};
use std::time::Duration;

/// A trigger that is neither `entry` nor `exit`.
struct Awaited {
    trigger: Trigger,
    /// The name of the value of the event.
    value: Option<Name>,
}

impl ActivityReader<'_, '_> {
    /// All transitions in document order, and the actions on entry and exit.
    pub(super) fn transitions(&mut self, root: &Node) {
        self.signal_names(root);
        self.transitions_of(root, 0);
    }

    /// The signals that transitions wait for.
    fn signal_names(&mut self, node: &Node) {
        for child in node.children().collect::<Vec<_>>() {
            if child.kind() == SyntaxKind::Trigger && child.names().next().is_some_and(|word| word.text == "signal") {
                let name = child.names().nth(1);
                let is_new = |name: &Name| self.heard.signals.iter().all(|(known, _)| known.text != name.text);
                self.heard.signals.extend(name.filter(is_new).map(|name| (name, false)));
            }
            if [SyntaxKind::State, SyntaxKind::Transition].contains(&child.kind()) {
                self.signal_names(&child);
            }
        }
    }

    /// The transitions of a state and of the states inside it, in the order of the text.
    fn transitions_of(&mut self, node: &Node, state: usize) {
        for child in node.children().collect::<Vec<_>>() {
            if child.kind() == SyntaxKind::Transition {
                self.transition(&child, state);
            } else if child.kind() == SyntaxKind::State {
                let span = child.span();
                if let Some(inner) = self.nodes.iter().position(|other| other.span() == span) {
                    self.transitions_of(&child, inner);
                }
            }
        }
    }

    fn transition(&mut self, node: &Node, state: usize) {
        let Some(trigger) = node.child(SyntaxKind::Trigger) else { return };
        let word = trigger.names().next().map_or_else(String::new, |word| word.text);
        if word == "entry" || word == "exit" {
            return self.at_the_border(node, state, word == "entry");
        }
        if self.chart.states[state].kind == StateKind::Final {
            let message = format!("`{}` is final and cannot have transitions", self.chart.states[state].name);
            return self.report(Diagnostic::new(Code::E0902, node.span(), message));
        }
        let Some(awaited) = self.awaited(node, &trigger, &word, state) else { return };
        let value = awaited.value.as_ref().map(|name| name.text.as_str());
        let guard = node.child(SyntaxKind::Guard).and_then(|guard| guard.child(SyntaxKind::Formula));
        let guard = match guard.map(|guard| self.condition(&guard)) {
            Some(None) => return,
            guard => guard.flatten(),
        };
        let asking = node.child(SyntaxKind::Asking);
        let target = match (&asking, node.child(SyntaxKind::Target)) {
            (Some(asking), _) => question::target(self, asking),
            (None, Some(target)) => self.target(&target, state, value),
            (None, None) => Some(Target::Stay),
        };
        let event = ReadableValue::Event { trigger: awaited.trigger.clone(), state };
        self.scripts.event = value.map(|name| Readable { name: name.to_owned(), value: event });
        let actions = self.actions(node, value);
        let Some(target) = target else { return };
        let Some(internal) = self.internal(node, &target, state) else { return };
        let parts = [Some(trigger.clone()), node.child(SyntaxKind::Guard)];
        let label: Vec<String> = parts.into_iter().flatten().map(|part| formula::text(&part)).collect();
        self.places.push(TransitionText { span: node.span(), label: label.join(" ") });
        let transition = Transition { guard, actions, internal, ..Transition::new(state, awaited.trigger, target) };
        self.chart.transitions.push(transition);
        if let Some(asking) = &asking {
            question::read(self, asking);
        }
    }

    /// Whether a transition is written as `-> internal inner`; none if it cannot stay inside its state.
    fn internal(&mut self, node: &Node, target: &Target, state: usize) -> Option<bool> {
        let Some(word) = node.names().find(|name| name.text == "internal") else { return Some(false) };
        let chart = &self.chart;
        let name = &chart.states[state].name;
        let is_outside = |inner: &usize| !chart.upward(*inner).skip(1).any(|around| around == state);
        let why = match (target, &chart.states[state].kind) {
            (Target::States(_), StateKind::Parallel) => {
                format!("an internal transition cannot stay inside `{name}`, whose regions are all active")
            }
            (Target::States(inner), _) => match inner.iter().copied().find(is_outside) {
                Some(outside) => {
                    let outside = &chart.states[outside].name;
                    format!("an internal transition leads to states inside `{name}`, and `{outside}` is not inside it")
                }
                None => return Some(true),
            },
            (Target::Stay | Target::Resume | Target::Done(_) | Target::Abort(_), _) => {
                format!("an internal transition leads to states inside `{name}`")
            }
        };
        self.report(
            Diagnostic::new(Code::E0902, word.span, why)
                .help("leave out `internal`, so that this state is left and entered again"),
        );
        None
    }

    /// `on entry { ... }`, `on exit { ... }`
    fn at_the_border(&mut self, node: &Node, state: usize, is_entry: bool) {
        let parts = [SyntaxKind::Target, SyntaxKind::Guard, SyntaxKind::Asking];
        if let Some(extra) = parts.into_iter().find_map(|part| node.child(part)) {
            let message = "`on entry` and `on exit` can contain only actions";
            return self.report(Diagnostic::new(Code::E0902, extra.span(), message));
        }
        self.scripts.event = None;
        let actions = self.actions(node, None);
        let state = &mut self.chart.states[state];
        if is_entry { &mut state.entry } else { &mut state.exit }.extend(actions);
    }

    fn awaited(&mut self, node: &Node, trigger: &Node, word: &str, state: usize) -> Option<Awaited> {
        let plain = |trigger: Trigger| Some(Awaited { trigger, value: None });
        if notice::is_notice(trigger) {
            return notice::read(self, trigger).and_then(plain);
        }
        let (place, has_run) = (trigger.span(), self.chart.states[state].run.is_some());
        match word {
            "done" if !has_run => self.misfit(place, state, "has no `run`, so it is never done"),
            "done" => Some(self.done(node, trigger)),
            "aborted" => {
                let failure = match trigger.child(SyntaxKind::Pattern) {
                    Some(pattern) => match catch::failure(&pattern, self.group.diagnostics())? {
                        Ok(failure) => Some(failure),
                        Err(found) => {
                            self.report(found);
                            return None;
                        }
                    },
                    None => None,
                };
                plain(Trigger::Aborted(failure))
            }
            "message" => {
                let name = trigger.names().nth(1)?;
                let Some(port) = self.interface.inputs.iter().position(|port| port.name.text == name.text) else {
                    self.report_unknown_port(&name, "input");
                    return None;
                };
                let kind = self.interface.inputs[port].kind.as_ref();
                let kind = kind.map(|kind| kind.text.clone()).unwrap_or_default();
                let filter = trigger.child(SyntaxKind::Guard).and_then(|guard| guard.child(SyntaxKind::Formula));
                let filter = match filter {
                    Some(filter) => Some(self.filter(&filter, &kind)?),
                    None => None,
                };
                Some(Awaited { trigger: Trigger::Message { port, filter }, value: Some(name) })
            }
            "after" | "every" => {
                let time = self.timer(&trigger.child(Constant)?, word)?;
                plain(if word == "after" { Trigger::After(time) } else { Trigger::Every(time) })
            }
            "signal" => {
                let name = trigger.names().nth(1)?;
                let signal = self.heard.signals.iter().position(|(known, _)| known.text == name.text)?;
                plain(Trigger::Signal(signal))
            }
            "always" => plain(Trigger::Always),
            "any" => plain(Trigger::Any),
            "complete" if matches!(self.chart.states[state].kind, StateKind::Compound { .. } | StateKind::Parallel) => {
                plain(Trigger::Complete)
            }
            "complete" => self.misfit(place, state, "has no states inside, so it never completes"),
            _ => {
                self.is_sound = false;
                None
            }
        }
    }

    /// The time of a timer, which is at least the shortest time of a supervisor.
    pub(super) fn timer(&mut self, constant: &Node, word: &str) -> Option<Duration> {
        let time = self.group.reader().duration(constant)?;
        let diagnostic = match time {
            Duration::ZERO if word == "after" => {
                Diagnostic::new(Code::E0009, constant.span(), "the time of this timer is zero")
                    .help("write `on always`")
            }
            _ if time < TIMER_LEAST => {
                let message = "a timer cannot be shorter than 10 ms";
                let word = if word == "every" { word } else { "after" };
                Diagnostic::new(Code::E0904, constant.span(), message).help(format!("write `{word} 10 ms`"))
            }
            _ => return Some(time),
        };
        self.report(diagnostic);
        None
    }

    fn misfit(&mut self, place: Span, state: usize, why: &str) -> Option<Awaited> {
        let message = format!("`{}` {why}", self.chart.states[state].name);
        self.report(Diagnostic::new(Code::E0902, place, message));
        None
    }

    pub(super) fn report_unknown_port(&mut self, name: &Name, what: &str) {
        let ports = if what == "input" { &self.interface.inputs } else { &self.interface.outputs };
        let known: Vec<String> = ports.iter().map(|port| port.name.text.clone()).collect();
        let message = format!("this activity has no {what} port `{}`", name.text);
        let diagnostic = Diagnostic::new(Code::E0903, name.span, message);
        let near = self.group.diagnostics().near(&name.text, known.iter().map(String::as_str));
        let diagnostic = match &near {
            Some(near) => diagnostic.rename(name.span, near),
            None if what == "input" => diagnostic.help(format!("declare it: `in {}: Text;`", name.text)),
            None => diagnostic.help(format!("declare it: `out {}: Text;`", name.text)),
        };
        self.report(diagnostic);
    }

    /// `done`, `done(found)`, `done(found p)`, `done(p)`: a single name is the value if the transition uses it, else the tag.
    fn done(&mut self, node: &Node, trigger: &Node) -> Awaited {
        let pattern = trigger.child(SyntaxKind::Pattern);
        let names: Vec<Name> = pattern.map(|pattern| pattern.names().collect()).unwrap_or_default();
        let (tag, value) = match names.as_slice() {
            [] => (None, None),
            [one] if is_used(node, &one.text) => (None, Some(one.clone())),
            [one] => (Some(one.text.clone()), None),
            [tag, value, ..] => (Some(tag.text.clone()), Some(value.clone())),
        };
        Awaited { trigger: Trigger::Done(tag), value }
    }

    pub(super) fn target(&mut self, node: &Node, state: usize, value: Option<&str>) -> Option<Target> {
        let names: Vec<Name> = node.names().collect();
        let first = names.first()?;
        match first.text.as_str() {
            "resume" if self.names.contains_key("resume") => {}
            "resume" if self.chart.states[state].kind != StateKind::Suspended => {
                let message = format!(
                    "only a `suspended state` can resume, and `{}` is not a suspended state",
                    self.chart.states[state].name
                );
                self.report(Diagnostic::new(Code::E0902, first.span, message));
                return None;
            }
            "resume" => return Some(Target::Resume),
            "done" if !self.names.contains_key("done") => {
                return outcome::target(self, node, value);
            }
            "abort" => return node.token(Text).map(|text| Target::Abort(text.content())),
            _ => {}
        }
        let states: Vec<Option<usize>> = names.iter().map(|name| self.state_named(name)).collect();
        Some(Target::States(states.into_iter().collect::<Option<Vec<_>>>()?))
    }
}

/// Whether the target or an action of a transition has this name.
fn is_used(node: &Node, name: &str) -> bool {
    let parts = node.children().filter(|part| [SyntaxKind::Target, SyntaxKind::Block].contains(&part.kind()));
    parts.into_iter().any(|part| {
        let tokens = part.syntax().descendants_with_tokens().filter_map(rowan::NodeOrToken::into_token);
        let is_name = |token: &rowan::SyntaxToken<_>| token.kind() == SyntaxKind::Ident && token.text() == name;
        let is_in_script =
            |token: &rowan::SyntaxToken<_>| token.kind() == SyntaxKind::Script && has_word(token.text(), name);
        tokens.into_iter().any(|token| is_name(&token) || is_in_script(&token))
    })
}
