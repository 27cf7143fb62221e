//! Checks the parameters that an activity waits for: the instance must have them.

use crate::check::diagnostics::Diagnostics;
use crate::check::names::listed;
use crate::check::spec::{ExprKind, Param, Process, Spec, Target};
use crate::diagnostic::{Code, Diagnostic};
use crate::plan::Notice;

/// Reports triggers `parameter CHILD.NAME changed` whose parameter does not exist, or never changes.
pub(super) fn check(spec: &Spec, process: &Process, diagnostics: &mut Diagnostics) {
    let Some(ExprKind::Chart(model)) = process.actions.as_ref().map(|actions| &actions.kind) else { return };
    for (notice, &span) in model.chart.notices.iter().zip(&model.notices) {
        let Notice::ParameterChanged { member, parameter } = notice else { continue };
        let Some(instance) = process.instances.iter().find(|instance| instance.name.text == *member) else { continue };
        let params: Option<&[Param]> = match instance.target {
            Target::Module(module) => spec.modules[module].params.as_deref(),
            Target::Process(_) => {
                let message = format!("`{member}` is a group, and only the parameters of programs can change");
                diagnostics.push(Diagnostic::new(Code::E0903, span, message));
                None
            }
            Target::Unknown => None,
        };
        let Some(params) = params.filter(|params| params.iter().all(|param| param.name.text != *parameter)) else {
            continue;
        };
        let diagnostic = Diagnostic::new(Code::E0903, span, format!("`{member}` has no parameter `{parameter}`"));
        let names = params.iter().map(|param| param.name.text.as_str());
        diagnostics.push(match params.is_empty() {
            true => diagnostic,
            false => diagnostic.help(format!("its parameters are {}", listed(names))),
        });
    }
}
