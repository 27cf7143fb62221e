//! Reads how a Python program of a module is started, and takes over the interface that the program prints.
//!
//! `python "keep.py"; venv ".venv";` becomes an `exec` of the interpreter in the environment, with the program and the name of the module
//! as arguments. The interpreter finds its environment from its own path, so the path leads into the environment.

use super::module::STOP_WITHIN;
use crate::check::spec::Module;
use crate::check::value::Reader;
use crate::diagnostic::{Code, Diagnostic};
use crate::message::command_of;
use crate::plan::LeafKind;
use crate::source::Span;
use crate::syntax::SyntaxKind::{self, Exec, Python, Text, Venv};
use crate::syntax::ast::Node;

/// The interpreter of a module without an environment. `PATH` decides which program this is.
const INTERPRETER: &str = "python3";

/// Reads `python` and `venv` of a module, after the rest of the module is read.
pub(super) fn program(module: &mut Module, node: &Node, reader: &mut Reader<'_>) {
    let mut refuse = |span, message: &str| reader.diagnostics.push(Diagnostic::new(Code::E0011, span, message));
    let (script, venv) = (path(node, Python), path(node, Venv));
    let Some((script, span)) = script else {
        if let Some((_, span)) = venv {
            refuse(span, "`venv` needs a program in Python: add `python \"program.py\";`");
        }
        return;
    };
    if node.child(Exec).is_some() {
        return refuse(span, "a module is started by `exec` or by `python`, not by both");
    }
    let interpreter = match &venv {
        None => Some(INTERPRETER.to_owned()),
        Some((venv, _)) => word(&format!("{}/bin/python", venv.trim_end_matches('/'))).filter(|_| !venv.is_empty()),
    };
    let Some(interpreter) = interpreter else {
        let (_, span) = venv.unwrap_or((String::new(), span));
        return refuse(span, "the path of an environment cannot be empty or contain both kinds of quotes");
    };
    let Some(script) = word(&script).filter(|_| !script.is_empty()) else {
        return refuse(span, "the path of a program cannot be empty or contain both kinds of quotes");
    };
    let has_params = module.params.as_ref().is_some_and(|params| !params.is_empty());
    let says_nothing = module.ports.is_empty() && !has_params && !module.is_service && !module.has_end;
    let is_controller = module.kind == LeafKind::Controller;
    module.is_asked = is_controller && says_nothing;
    // The ports are not known until the program has listed them, so a missing port is not an error.
    module.is_damaged |= module.is_asked;
    let name = if is_controller { format!(" {}", module.name.text) } else { String::new() };
    module.exec = Some(format!("{interpreter} {script}{name}"));
}

fn path(node: &Node, kind: SyntaxKind) -> Option<(String, Span)> {
    let token = node.child(kind)?.token(Text)?;
    Some((token.content(), token.span()))
}

/// Returns a text as one word of an `exec`, in quotes. Returns none if the text has both kinds of quotes.
pub(super) fn word(text: &str) -> Option<String> {
    let quote = if text.contains('\'') { '"' } else { '\'' };
    (!text.contains(quote)).then(|| format!("{quote}{text}{quote}"))
}

impl Module {
    /// Returns whether the module's program is started by this command, followed by the name of the module.
    pub(super) fn is_run_by(&self, of: &str) -> bool {
        self.exec.as_ref().is_some_and(|exec| command_of(exec, &self.name.text) == of)
    }

    /// Takes over the interface that the program prints. Statements of the spec about the program stay.
    pub(super) fn take_interface(&mut self, told: Self) {
        let Self { params, host, start, ports, is_service, has_end, remembers, outcomes, times, is_damaged, .. } = told;
        (self.params, self.host, self.ports, self.outcomes) = (params, host, ports, outcomes);
        self.start = start;
        (self.is_service, self.has_end, self.remembers) = (is_service, has_end, self.remembers || remembers);
        if self.times.stop_within == STOP_WITHIN {
            self.times.stop_within = times.stop_within;
        }
        if self.doc.is_empty() {
            self.doc = told.doc;
        }
        (self.is_asked, self.is_damaged) = (false, is_damaged);
    }
}

#[cfg(test)]
mod tests {
    use crate::plan::Plan;
    use crate::source::{Role, Source};
    use crate::{AskedModule, Options, asked, compile};

    const INTERFACE: &str = "type Range = { distance: Length };
        /// Keeps a distance.
        module Keep(host: Host, reach: Length in 0.1 m..2 m = 0.5 m) { in In: Range optional; service; stop within 300 ms; }";

    fn compiled(module: &str, interface: &str) -> (Option<Plan>, Vec<String>) {
        let text = format!(
            "{module}\nprocess main(){{ host{{c1}} instantiated_processes{{ keep instof Keep(c1, reach = 40 cm); }}
             internal_event_actions{{ keep }} }}"
        );
        let controllers = Source::new("dca-controller", "module Keep(host: Host, other: Number) { done; }");
        let python = |name: &str, text: &str| Source { role: Role::Python, ..Source::new(name, text) };
        let other =
            python("python3 'other.py'", "module Keep(host: Host) { done; } module Other(host: Host) { done; }");
        let command = asked(&[Source::new("a.dca", text.clone())]).first().map(|keep| keep.command().to_owned());
        let own = python(&command.unwrap_or_default(), interface);
        let compiled = compile(&Source::new("a.dca", text), &[controllers, other, own], &Options::named("a"));
        (compiled.plan, compiled.diagnostics.iter().map(|found| format!("{}: {}", found.code, found.message)).collect())
    }

    /// Other programs may have a type with the same name.
    #[test]
    fn a_program_in_python_says_what_its_interface_is() {
        let (plan, found) = compiled("module Keep { python \"keep.py\"; venv \"my robot/.venv/\"; }", INTERFACE);
        let leaf = &plan.expect("it compiles").leaves[0];
        assert_eq!(leaf.exec.as_deref(), Some("'my robot/.venv/bin/python' 'keep.py' Keep"));
        assert_eq!((leaf.stop_within.as_millis(), found), (300, vec![]));
        // The node does not ask this program for its parameters, so the list decides which of them `dca param set` may set.
        let parameters = leaf.parameters.iter().flatten().map(|one| format!("{}: {}", one.name, one.accepts));
        assert_eq!(parameters.collect::<Vec<_>>(), ["reach: Length in 0.1 m..2 m"]);
        // The interface that the program prints is checked.
        let (_, found) = compiled("module Keep { python \"keep.py\"; }", &INTERFACE.replace("reach", "speed"));
        assert!(found.iter().any(|found| found.contains("reach")), "{found:?}");
        // Statements of the spec have precedence.
        let (plan, _) = compiled("module Keep { python \"keep.py\"; stop within 1 s; directory \"/opt\"; }", INTERFACE);
        let leaf = &plan.expect("it compiles").leaves[0];
        assert_eq!((leaf.stop_within.as_millis(), leaf.environment.directory.as_deref()), (1000, Some("/opt")));
    }

    #[test]
    fn only_who_says_nothing_else_is_asked() {
        let all = |text: &str| asked(&[Source::new("a.dca", text)]);
        let environment = crate::plan::Environment::default();
        let keep = AskedModule { name: "Keep".to_owned(), exec: "python3 'keep.py' Keep".to_owned(), environment };
        assert_eq!(all("module Keep(host: Host) { python \"keep.py\"; } process main(){}"), [keep]);
        for text in ["python \"keep.py\"; plain;", "python \"keep.py\"; done;", "python \"keep.py\"; in In;", "done;"] {
            assert_eq!(all(&format!("module Keep {{ {text} }}")), [], "{text}");
        }
        let (plan, _) = compiled("module Keep(reach) { python \"keep.py\"; plain; done; }", "");
        assert_eq!(plan.expect("it compiles").leaves[0].exec.as_deref(), Some("python3 'keep.py'"));
    }

    #[test]
    fn what_starts_nothing_is_refused() {
        for (items, why) in [
            ("venv \".venv\"; done;", "`venv` needs a program in Python"),
            ("python \"a.py\"; exec \"a\"; done;", "a module is started by `exec` or by `python`, not by both"),
            ("python \"\"; done;", "the path of a program cannot be empty"),
            ("python \"a'b\\\"c.py\"; done;", "the path of a program cannot be empty"),
            ("python \"a.py\"; venv \"\"; done;", "the path of an environment cannot be empty"),
        ] {
            let (plan, found) = compiled(&format!("module Keep(reach) {{ {items} }}"), "");
            assert!(
                plan.is_none() && found.iter().any(|one| one.starts_with("E0011: ") && one.contains(why)),
                "{items}: {found:?}"
            );
        }
    }
}
