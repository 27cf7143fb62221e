//! Questions to people. Each question is a state of its own, in which the activity waits for an answer.

use super::{ActivityReader, TransitionText};
use crate::automaton::{ChartState, StateKind, Target, Transition, Trigger};
use crate::check::names::twice;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{DefaultAnswer, Notice, Question};
use crate::syntax::SyntaxKind::{self, Constant, Text};
use crate::syntax::ast::{Name, Node};

/// Adds the states of the questions that the transitions of a state ask. They are siblings of that state, after all states inside it.
pub(super) fn add_states(reader: &mut ActivityReader<'_, '_>, node: &Node, source: usize) {
    let state = &reader.chart.states[source];
    let (parent, source) = (state.parent.unwrap_or(source), state.name.clone());
    let transitions = node.children_of(SyntaxKind::Transition);
    let asking: Vec<Node> = transitions.filter_map(|transition| transition.child(SyntaxKind::Asking)).collect();
    for (place, asking) in asking.iter().enumerate() {
        let name = if place == 0 { format!("{source}?") } else { format!("{source}?{}", place + 1) };
        reader.add_state(asking, ChartState::atomic(&name, parent));
    }
}

/// Returns the state of the question that a transition asks.
pub(super) fn target(reader: &mut ActivityReader<'_, '_>, asking: &Node) -> Option<Target> {
    let state = state_of(reader, asking)?;
    let parent = reader.chart.states[state].parent.unwrap_or(0);
    if reader.chart.states[parent].kind == StateKind::Parallel {
        let message = "a question cannot stand directly in a `parallel state`, whose states are all active together";
        let diagnostic = Diagnostic::new(Code::E0902, asking.span(), message);
        reader.report(diagnostic.help("move the question to a state inside this state"));
        return None;
    }
    Some(Target::States(vec![state]))
}

/// Reads the answers of a question. Each answer is a transition, and so is the deadline.
pub(super) fn read(reader: &mut ActivityReader<'_, '_>, asking: &Node) {
    let (Some(state), Some(text)) = (state_of(reader, asking), asking.token(Text)) else { return };
    let number = reader.heard.questions.len();
    let mut answers: Vec<(Name, Target)> = Vec::new();
    for choice in asking.children_of(SyntaxKind::Choice).collect::<Vec<_>>() {
        let (Some(name), Some(target)) = (choice.names().next(), choice.child(SyntaxKind::Target)) else { continue };
        if let Some((first, _)) = answers.iter().find(|(known, _)| known.text == name.text) {
            let diagnostic = twice("answer", &name.text, name.span, first.span);
            reader.report(diagnostic);
            continue;
        }
        let Some(target) = reader.target(&target, state, None) else { continue };
        let notice = Notice::Answer { question: small(number), option: name.text.clone() };
        reader.heard.notices.push((notice, name.span));
        let trigger = Trigger::Notice(reader.heard.notices.len() - 1);
        let written = TransitionText { span: choice.span(), label: name.text.clone() };
        add(reader, written, Transition::new(state, trigger, target.clone()));
        answers.push((name, target));
    }
    let default = default(reader, asking, &answers);
    if let Some((answer, target)) = &default {
        let written = TransitionText { span: asking.span(), label: format!("after {} s", answer.after.as_secs_f64()) };
        add(reader, written, Transition::new(state, Trigger::After(answer.after), target.clone()));
    }
    let options = answers.into_iter().map(|(name, _)| name.text).collect();
    let default = default.map(|(answer, _)| answer);
    reader.heard.questions.push(Question { state: small(state), text: text.content(), options, default });
}

/// Reads the answer that is taken if no person answers in time. Returns it with its target.
fn default(
    reader: &mut ActivityReader<'_, '_>,
    asking: &Node,
    answers: &[(Name, Target)],
) -> Option<(DefaultAnswer, Target)> {
    let names: Vec<Name> = asking.names().collect();
    let word = names.iter().position(|name| name.text == "default")?;
    let (name, constant) = (names.get(word + 1)?, asking.child(Constant)?);
    let after = reader.timer(&constant, "default")?;
    let Some((_, target)) = answers.iter().find(|(answer, _)| answer.text == name.text) else {
        let message = format!("`{}` is not an answer to this question", name.text);
        let diagnostic = Diagnostic::new(Code::E0903, name.span, message);
        let known = answers.iter().map(|(answer, _)| answer.text.as_str());
        let near = reader.group.diagnostics().near(&name.text, known);
        reader.report(match &near {
            Some(near) => diagnostic.rename(name.span, near),
            None => diagnostic,
        });
        return None;
    };
    Some((DefaultAnswer { option: name.text.clone(), after }, target.clone()))
}

fn add(reader: &mut ActivityReader<'_, '_>, written: TransitionText, transition: Transition) {
    reader.places.push(written);
    reader.chart.transitions.push(transition);
}

fn state_of(reader: &ActivityReader<'_, '_>, asking: &Node) -> Option<usize> {
    reader.nodes.iter().position(|node| node.kind() == SyntaxKind::Asking && node.span() == asking.span())
}

fn small(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}
