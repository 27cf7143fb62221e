//! Reads a module that is an action of ROS 2: `action "/navigate_to_pose": ros.nav2.NavigateToPose;`
//!
//! The bridge's program starts such a module. The start value is the goal, and a stop cancels the goal. The result is the value of the
//! module. Feedback is the only output.

use crate::check::ros_name::{self, NameText};
use crate::check::spec::{Direction, Kind, Module, Param, Port};
use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::{BRIDGE_PROGRAM, LeafKind, ROS_VARIABLES};
use crate::source::Span;
use crate::syntax::SyntaxKind::{Exec, Python, RosAction, StopWithin, Text};
use crate::syntax::ast::{Name, Node};
use ros::logic::library;
use std::time::Duration;

/// The controller type of the bridge's program for an action.
const TYPE: &str = "RosAction";
/// The name of the output for feedback.
const FEEDBACK: &str = "Feedback";
/// How long a stop waits for the end of the goal, unless the module declares another time.
const STOP_WITHIN: Duration = Duration::from_secs(6);
/// How long the program may take after this time to report the result of the stop.
const LEAVE_WITHIN: Duration = Duration::from_secs(1);

/// Reads the action of a module, after the rest of the module is read.
pub(super) fn read(module: &mut Module, node: &Node, reader: &mut Reader<'_>) {
    let Some(item) = node.child(RosAction) else { return };
    // If a part is missing, the text is damaged, which was reported.
    let (Some(token), Some(kind)) = (item.token(Text), super::kind(&item, reader)) else { return };
    let mut refuse = |code, span: Span, message: String, help: Option<String>| {
        let found = Diagnostic::new(code, span, message);
        reader.diagnostics.push(help.into_iter().fold(found, |found, help| found.help(help)));
    };
    if node.child(Exec).is_some() || node.child(Python).is_some() || module.kind == LeafKind::Plain {
        let message = "a module that is an action of ROS 2 cannot have a program of its own";
        return refuse(Code::E0011, item.span(), message.to_owned(), None);
    }
    let name = NameText::of(&token);
    let is_used = |param: &Param| name.params().contains(&param.name.text.as_str());
    let has_params = module.params.as_ref().is_some_and(|params| !params.iter().all(is_used));
    if has_params || !module.ports.is_empty() || !module.outcomes.is_empty() || module.is_service {
        let message = format!(
            "an action of ROS 2 ends by itself; its only port is the output `{FEEDBACK}`, and its parameters are parts of its name"
        );
        return refuse(
            Code::E0309,
            item.span(),
            message,
            Some("remove the ports, `service`, `done(...)` and all parameters except the host".to_owned()),
        );
    }
    if !name.can_be(ros_name::is_node) {
        let message = format!("{:?} is not the name of an action of ROS 2", name.text);
        let help = "a name begins with `/` and has at most 200 bytes; its words have letters, digits and `_`, and do not begin with a digit";
        return refuse(Code::E0309, token.span(), message, Some(help.to_owned()));
    }
    let Some(of) = library::actions().find(|action| action.spec() == kind.text) else {
        let known: Vec<String> = library::actions().map(|action| format!("`{}`", action.spec())).collect();
        let message = format!("`{}` is not a known action of ROS 2", kind.text);
        return refuse(Code::E0309, kind.span, message, Some(format!("the known actions are {}", known.join(" and "))));
    };
    let has_limit = node.child(StopWithin).is_some();
    let wait = if has_limit { module.times.stop_within } else { STOP_WITHIN };
    module.times.stop_within = wait.saturating_add(LEAVE_WITHIN);
    let stop = wait.as_millis();
    // Quotes keep a name with parameters one word.
    module.exec = Some(match name.params().is_empty() {
        true => format!("{BRIDGE_PROGRAM} {TYPE} action={} type={of} stop_ms={stop}", name.text),
        false => format!("{BRIDGE_PROGRAM} {TYPE} 'action={}' type={of} stop_ms={stop}", name.text),
    });
    module.environment.inherited.extend(ROS_VARIABLES.map(str::to_owned));
    module.has_end = true;
    let feedback = Kind { text: of.with("_Feedback").spec(), span: kind.span, fields: None };
    let name = Name { text: FEEDBACK.to_owned(), span: item.span() };
    module.ports.push(Port { name, direction: Direction::Out, kind: Some(feedback), is_optional: true, call: None });
}

/// Returns whether the `exec` of a module is the program for an action.
pub(in crate::check) fn is_action(exec: &str) -> bool {
    exec.strip_prefix(BRIDGE_PROGRAM).is_some_and(|rest| rest.starts_with(&format!(" {TYPE} ")))
}

#[cfg(test)]
mod tests {
    use crate::source::Source;
    use crate::{Options, compile};

    #[test]
    fn a_stop_waits_as_long_as_the_module_says() {
        for (limit, wait, all) in
            [("stop within 3 s;", 3000, 4000), ("", 6000, 7000), ("stop within 200 ms;", 200, 1200)]
        {
            let text = format!(
                "module Plan(host) {{ exec \"plan\"; done; }}
                 module Fib(host) {{ action \"/fib\": ros.example.Fibonacci; {limit} }}
                 process main(){{ host{{c1}} instantiated_processes{{ plan instof Plan(c1); fib instof Fib(c1); }}
                 internal_event_actions{{ plan : fib }} }}"
            );
            let compiled = compile(&Source::new("a.dca", text), &[], &Options::named("a"));
            let leaf = compiled.plan.expect("it compiles").leaves.remove(1);
            let exec = leaf.exec.unwrap_or_default();
            assert!(exec.ends_with(&format!("stop_ms={wait}")), "{exec}");
            assert_eq!(leaf.stop_within.as_millis(), all);
        }
    }
}
