//! Checks a tree and makes a plan from it. The checks concern names, types, ports and flow.
//!
//! Each pass adds to one [`spec::Spec`] and to one [`Diagnostics`]. `declare` collects the declarations. If the parameters of a group
//! decide its shape, `declare` reads the group once for each choice of values. `names` and `expression` check the inside of one group, and
//! `types` checks between groups. Then come `ports` and `flow`, and at last `lower` makes the plan.

mod activity;
mod count;
mod declare;
mod diagnostics;
mod expression;
mod flow;
mod hosts;
mod index;
mod interface;
pub(crate) mod lower;
mod names;
mod ports;
mod quantity;
mod range;
mod resource_args;
mod ros_name;
mod scripts;
mod sentences;
mod sites;
pub(crate) mod spec;
mod types;
mod uses;
mod value;

pub(crate) use activity::is_activity;
pub(crate) use sentences::{EVENTS, STATES, Word, is_ordinal_suffix, is_word as is_sentence_word, words_of};

pub(crate) use interface::{asked, exports, messages, parameters, port_types, record_types};

use crate::diagnostic::{Code, limit};
use crate::sites::{Property, Sites};
use crate::source::{Origin, Role, Source};
use crate::syntax::{Parse, ast, parse};
use crate::{Compiled, Options};
use declare::{ItemCollector, Templates, Tree};
use diagnostics::Diagnostics;

/// Checks a spec against the interfaces of the modules. Returns its plan unless there are errors, the model that the plan was made from,
/// and the number of the root in the model.
pub(crate) fn compile_with_model(
    spec: &Source,
    interfaces: &[Source],
    options: &Options,
) -> (Compiled, spec::Spec, Option<usize>) {
    let (compiled, model, root, _) = compile_all(spec, interfaces, options);
    (compiled, model, root)
}

/// Checks a spec like [`compile_with_model`], and returns the sites that a verifier needs.
pub(crate) fn compile_with_sites(spec: &Source, interfaces: &[Source], options: &Options) -> (Compiled, Option<Sites>) {
    let (compiled, model, root, properties) = compile_all(spec, interfaces, options);
    let sites = compiled.plan.as_ref().zip(root).map(|(plan, root)| sites::sites(&model, root, plan, properties));
    (compiled, sites)
}

fn compile_all(
    spec: &Source,
    interfaces: &[Source],
    options: &Options,
) -> (Compiled, spec::Spec, Option<usize>, Vec<Property>) {
    let mut model = spec::Spec::default();
    let mut diagnostics = Diagnostics::default();
    let (trees, mut omitted) =
        read(spec, interfaces, &mut ItemCollector { spec: &mut model, diagnostics: &mut diagnostics });
    let stated = sentences::read(&trees, &model, &mut diagnostics);
    types::check(&mut model, &mut diagnostics);
    resource_args::take(&mut model, &mut diagnostics);
    hosts::check(&model, &mut diagnostics);
    declare::silent::check(&model, interfaces, &mut diagnostics);
    let root = types::root(&model, &mut diagnostics);
    if types::is_finite(&model, root, &mut diagnostics) {
        types::check_starts(&mut model, &mut diagnostics);
        types::check_results(&model, &mut diagnostics);
        types::check_kept(&model, &mut diagnostics);
        scripts::check(&mut model, &mut diagnostics);
        ports::check(&mut model, &mut diagnostics);
        flow::check(&mut model, &mut diagnostics);
    }
    if options.deny_lenient_names {
        diagnostics.deny(is_lenient_name);
    }
    let plan = root.filter(|_| !diagnostics.has_errors()).and_then(|root| {
        let quotes = lower::quote::Quotes::new(spec, interfaces);
        lower::lower(&model, root, &options.name, &quotes, &mut diagnostics)
    });
    let properties = plan.as_ref().map(|plan| sentences::resolve(&stated, plan, &mut diagnostics)).unwrap_or_default();
    let plan = plan.filter(|_| !diagnostics.has_errors());
    let mut diagnostics = diagnostics.into_vec();
    diagnostics.sort_by_key(|found| (found.primary.span, found.code));
    // A group with several readings has the same mistake in each of them.
    diagnostics.dedup();
    omitted += limit(&mut diagnostics);
    (Compiled { plan, diagnostics, omitted }, model, root, properties)
}

/// Reads the declarations of all texts. Returns their trees, and the number of diagnostics of damaged texts that are left out.
fn read(spec: &Source, interfaces: &[Source], declare: &mut ItemCollector<'_>) -> (Vec<Tree>, usize) {
    let files = uses::Files::new(spec, interfaces);
    let origins = (0..).map(Origin::Interface);
    let sources = std::iter::once((Origin::Spec, spec)).chain(origins.zip(interfaces));
    let (mut trees, mut omitted) = (Vec::new(), 0);
    for (origin, source) in sources {
        let Parse { root, diagnostics, omitted: more, mut damage } = parse(source, origin);
        omitted += more;
        damage.sort_unstable();
        let is_part = origin == Origin::Spec || source.role == Role::Part;
        let python = source.python();
        let tree = Tree { root: ast::Node::new(root, origin), origin, is_part, python, damage };
        declare.constants(&tree);
        files.check(&tree.root, &source.name, declare.diagnostics);
        declare.diagnostics.extend(diagnostics);
        trees.push(tree);
    }
    let items = trees.iter().filter(|tree| tree.is_part).flat_map(Tree::items).collect();
    let templates = Templates::new(items, &declare.spec.consts);
    for tree in &trees {
        declare.items(tree, &templates);
    }
    templates.expand(declare);
    (trees, omitted)
}

/// Returns whether a code is for a name that was read leniently.
fn is_lenient_name(code: Code) -> bool {
    [Code::W0201, Code::W0202, Code::W0203, Code::W0204].contains(&code)
}
