//! Tree to plan: names, types, ports, flow, and what is wrong with them.
//!
//! Each pass adds to one [`spec::Spec`] and to one list of diagnostics: `declare` (what is there; a group whose parameters
//! decide its shape once for each choice of values), `names` and
//! `expression` (inside one group), `types` (between groups), `ports`, `flow`, and at last `lower` makes the plan.

mod count;
mod declare;
mod expression;
mod flow;
mod handed;
mod index;
mod interface;
pub(crate) mod lower;
mod names;
mod ports;
mod range;
pub(crate) mod spec;
mod types;
pub(crate) mod unit;
mod uses;
mod value;

pub(crate) use interface::{messages, parameters};

use crate::diagnostic::{Code, Diagnostic, Severity, limit};
use crate::source::{Origin, Role, Source};
use crate::syntax::{Parse, ast, parse};
use crate::{Compiled, Options};

/// Checks a spec against the interfaces of the modules; returns its plan unless something is wrong, what the plan was made
/// from, and the root in it.
pub(crate) fn compile_with_model(
    spec: &Source,
    interfaces: &[Source],
    options: &Options,
) -> (Compiled, spec::Spec, Option<usize>) {
    let origins = (0..).map(Origin::Interface);
    let sources = std::iter::once((Origin::Spec, spec)).chain(origins.zip(interfaces));
    let mut model = spec::Spec::default();
    let (mut diagnostics, mut omitted) = (Vec::new(), 0);
    let mut trees = Vec::new();
    let files = uses::Files::new(spec, interfaces);
    for (origin, source) in sources {
        let Parse { root, diagnostics: found, omitted: more, mut damage } = parse(source, origin);
        omitted += more;
        damage.sort_unstable();
        let root = ast::Node::new(root, origin);
        declare::constants(&mut model, &root, &damage, &mut diagnostics);
        files.check(&root, &source.name, &mut diagnostics);
        trees.push((root, (origin, origin == Origin::Spec || source.role == Role::Part), damage));
        diagnostics.extend(found);
    }
    let own = trees.iter().filter(|(_, (_, is_part), _)| *is_part);
    let items: Vec<_> = own.flat_map(|(root, _, damage)| declare::items(root, damage)).collect();
    let templates = declare::Templates::new(&items, &model.consts);
    for (root, origin, damage) in &trees {
        declare::declare(&mut model, root, *origin, (damage, &templates), &mut diagnostics);
    }
    templates.expand(&mut model, &mut diagnostics);
    types::check(&mut model, &mut diagnostics);
    handed::take(&mut model, &mut diagnostics);
    let root = types::root(&model, &mut diagnostics);
    if types::is_finite(&model, root, &mut diagnostics) {
        ports::check(&model, &mut diagnostics);
        flow::check(&mut model, &mut diagnostics);
    }
    if options.deny_lenient_names {
        let lenient = diagnostics.iter_mut().filter(|found| is_lenient_name(found.code));
        lenient.for_each(|found| found.severity = Severity::Error);
    }
    let is_wrong = |diagnostics: &[Diagnostic]| diagnostics.iter().any(|found| found.severity == Severity::Error);
    let plan = match root {
        Some(root) if !is_wrong(&diagnostics) => {
            let quotes = lower::quote::Quotes::new(spec, interfaces);
            lower::lower(&model, root, &options.name, &quotes, &mut diagnostics)
        }
        Some(_) | None => None,
    };
    diagnostics.sort_by_key(|found| (found.primary.span, found.code));
    // What is wrong with a group is wrong with each of its readings.
    diagnostics.dedup();
    let plan = plan.filter(|_| !is_wrong(&diagnostics));
    omitted += limit(&mut diagnostics);
    (Compiled { plan, diagnostics, omitted }, model, root)
}

/// Whether a code is a name that was read leniently.
fn is_lenient_name(code: Code) -> bool {
    [Code::W0201, Code::W0202, Code::W0203, Code::W0204].contains(&code)
}
