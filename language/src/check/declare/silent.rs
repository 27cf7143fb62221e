//! Reports Python programs that were asked for their interfaces and failed. Each instance of their modules gets a
//! report.

use crate::check::diagnostics::Diagnostics;
use crate::check::spec::{Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::source::{Role, Source};

/// Reports the failures of programs in `interfaces`. A failure is a source with [`Role::Missing`], whose name is the
/// `exec` of a module.
pub(crate) fn check(spec: &Spec, interfaces: &[Source], diagnostics: &mut Diagnostics) {
    let failed = |command: &str| {
        interfaces.iter().find_map(|source| match &source.role {
            Role::Missing(why) if source.name == command => Some(why.as_str()),
            Role::Whole | Role::Python | Role::Part | Role::Folder(_) | Role::Missing(_) => None,
        })
    };
    for instance in spec.processes.iter().flat_map(|process| &process.instances) {
        let Target::Module(module) = instance.target else { continue };
        let module = &spec.modules[module];
        let Some(why) = module.exec.as_deref().filter(|_| module.is_asked).and_then(failed) else { continue };
        let span = instance.kind.as_ref().map_or(instance.name.span, |kind| kind.span);
        let (message, rest) = why.split_once('\n').unwrap_or((why, ""));
        let found = Diagnostic::new(Code::E0011, span, message.trim_end_matches(':'));
        let found = found.reason(module.name.span, format!("`{}` is a program in Python", module.name.text));
        diagnostics.push(rest.lines().fold(found, |found, line| found.help(line.trim_end())));
    }
}

#[cfg(test)]
mod tests {
    use crate::diagnostic::Code;
    use crate::source::{Role, Source};
    use crate::{Options, compile};

    #[test]
    fn a_program_that_fails_is_reported_at_each_instance() {
        let text = "module Keep { python \"keep.py\"; }
            process main(){ host{c1} instantiated_processes{ a instof Keep(c1); b instof Keep(c1); }
            internal_event_actions{ a, b } }";
        let why = "`Keep` did not print its interface: it failed:\nTraceback\nNameError: no door";
        let failed =
            Source { name: "python3 'keep.py' Keep".into(), text: String::new(), role: Role::Missing(why.into()) };
        let found = |others: &[Source]| compile(&Source::new("a.dca", text), others, &Options::named("a"));
        let compiled = found(&[failed]);
        assert!(compiled.plan.is_none());
        let at = |one: usize| &text[compiled.diagnostics[one].primary.span.start as usize - 9..][..13];
        assert_eq!((at(0), at(1), compiled.diagnostics.len()), ("a instof Keep", "b instof Keep", 2));
        let first = &compiled.diagnostics[0];
        assert_eq!((first.code, &*first.message), (Code::E0011, "`Keep` did not print its interface: it failed"));
        assert_eq!(first.help, ["Traceback", "NameError: no door"]);
        // If the program was not asked, nothing is reported here.
        assert!(found(&[]).diagnostics.iter().all(|found| found.code != Code::E0011));
    }
}
