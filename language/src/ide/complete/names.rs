//! Completes the names that are known at the cursor.

use super::place::Cursor;
use super::{Completion, CompletionKind, inside, keywords};
use crate::check::spec::{Direction, Instance, Outcome, Param, Process, Shape, Target, ValueKind};
use crate::ide::Analysis;
use crate::ide::hover::interface;
use crate::ide::words::Place;
use crate::plan::Constant;
use crate::syntax::SyntaxKind::{self, Arrow, Equals, Number};
use crate::syntax::ast::{Name, Node};
use crate::unit;
use std::collections::{BTreeMap, BTreeSet};

impl Analysis {
    /// Returns the process around the cursor, if it could be read.
    fn process_at(&self, at: &Cursor) -> Option<&Process> {
        let title = at.inside(SyntaxKind::Process)?.title()?;
        self.model.processes.iter().find(|process| process.name.span == title.span)
    }

    /// Returns the instance with this name in the process around the cursor.
    fn instance_at(&self, at: &Cursor, name: &str) -> Option<&Instance> {
        let mut instances = self.process_at(at)?.instances.iter();
        instances.find(|instance| instance.name.text == name || self.text(instance.name.span) == name)
    }

    /// Returns the instances of the process around the cursor.
    pub(super) fn instances(&self, at: &Cursor) -> Vec<Completion> {
        self.process_at(at).map(|process| self.members_of(process)).unwrap_or_default()
    }

    /// Returns the instances of a process.
    pub(super) fn members_of(&self, process: &Process) -> Vec<Completion> {
        let mut seen = BTreeSet::new();
        let instances = process.instances.iter().filter(|instance| seen.insert(instance.name.span));
        let offers = instances.map(|instance| {
            let name = self.text(instance.name.span);
            let kind = instance.kind.as_ref().map_or("", |kind| kind.text.as_str());
            let mut offer = Completion::new(CompletionKind::Instance, name).detail(kind);
            if instance.name.text != name {
                offer.snippet = Some(format!("{name}[${{1:i}}]"));
            }
            offer.documentation(self.target_text(instance.target))
        });
        offers.collect()
    }

    fn target_text(&self, target: Target) -> String {
        match target {
            Target::Process(process) => self.process_text(process),
            Target::Module(module) => self.module_text(module),
            Target::Unknown => String::new(),
        }
    }

    /// Returns the types that an instance can have, without the process itself.
    pub(super) fn instance_types(&self, at: &Cursor) -> Vec<Completion> {
        let own = self.process_at(at).map(|process| process.name.span);
        let is_other = |process: &&Process| Some(process.name.span) != own && process.name.text != "main";
        let offer = |name: &str, params: Vec<String>, target, detail: &str| {
            let holes = params.iter().zip(1..).map(|(param, place)| format!("${{{place}:{param}}}"));
            let holes: Vec<String> = holes.collect();
            let mut offer = Completion::new(CompletionKind::Type, name).detail(detail);
            offer.snippet = Some(format!("{name}({})", holes.join(", ")));
            offer.documentation(self.target_text(target))
        };
        let needed = |params: &[Param]| -> Vec<String> {
            let needed = params.iter().filter(|param| param.default.is_none());
            needed.map(|param| param.name.text.clone()).collect()
        };
        let processes = self.model.processes.iter().enumerate().filter(|(_, process)| is_other(process));
        let processes = processes.map(|(index, process)| {
            offer(&process.name.text, needed(&process.params), Target::Process(index), "process")
        });
        let modules = self.model.modules.iter().enumerate().map(|(index, module)| {
            let params = needed(module.params.as_deref().unwrap_or_default());
            let params = std::iter::once("host".to_owned()).chain(params).collect();
            offer(&module.name.text, params, Target::Module(index), "module")
        });
        processes.chain(modules).collect()
    }

    /// Returns the message types of ports that no text declares.
    pub(super) fn message_types(&self) -> Vec<Completion> {
        let ports = self.model.modules.iter().flat_map(|module| &module.ports);
        let kinds = ports.filter_map(|port| port.kind.as_ref()).filter(|kind| kind.fields.is_none());
        let kinds = kinds.filter(|kind| !self.model.type_names.contains_key(&kind.text));
        let known: BTreeSet<&str> = kinds.map(|kind| kind.text.as_str()).collect();
        known.into_iter().map(|name| Completion::new(CompletionKind::Type, name)).collect()
    }

    /// Returns the ports of an instance that fit this side of the arrow.
    pub(super) fn ports_of(&self, at: &Cursor, name: &str) -> Vec<Completion> {
        let Some(instance) = self.instance_at(at, name) else { return Vec::new() };
        let wanted = direction(at);
        let fits = |direction: Option<Direction>| wanted.is_none() || direction.is_none() || direction == wanted;
        let offer = |name: &str, port: Option<&crate::check::spec::Port>| {
            let shown = interface::shown_port(name, port);
            let known = port.map(|port| port.direction);
            fits(known).then(|| Completion::new(CompletionKind::Port, name).detail(shown))
        };
        match instance.target {
            Target::Module(module) => {
                let ports = self.model.modules[module].ports.iter();
                ports.filter_map(|port| offer(&port.name.text, Some(port))).collect()
            }
            Target::Process(target) => {
                let process = &self.model.processes[target];
                let exports = process.exports.iter();
                let exports = exports.filter_map(|it| offer(&it.name.text, self.port_behind(process, &it.endpoint)));
                let messages = process.chart().into_iter().flat_map(|chart| &chart.ports);
                exports.chain(messages.filter_map(|port| offer(&port.name.text, Some(port)))).collect()
            }
            Target::Unknown => Vec::new(),
        }
    }

    /// Returns the labels of the instance before the bracket.
    pub(super) fn labels_of(&self, at: &Cursor) -> Vec<Completion> {
        let name = at.grand.as_ref().and_then(|run| run.names().next());
        let (Some(process), Some(name)) = (self.process_at(at), name) else { return Vec::new() };
        let Some(instance) = self.instance_at(at, &name.text) else { return Vec::new() };
        let is_own = |slot: usize| process.instances[slot].name.span == instance.name.span;
        let sets = process.sets.iter().filter(|set| set.owner.is_some_and(is_own));
        let labels: BTreeMap<&str, usize> =
            sets.filter_map(|set| Some((set.label.as_ref()?.text.as_str(), set.connections.len()))).collect();
        let counted =
            |count: usize| if count == 1 { "1 connection".to_owned() } else { format!("{count} connections") };
        let offers = labels.into_iter();
        offers.map(|(label, count)| Completion::new(CompletionKind::Label, label).detail(counted(count))).collect()
    }

    /// Returns the completions for a value: in an argument, a limit or a constant.
    pub(super) fn constants(&self, at: &Cursor) -> Vec<Completion> {
        if at.parent.token(Number).is_some() {
            return self.units(at);
        }
        if at.inside(SyntaxKind::Field).is_some() {
            return self.values(at, false);
        }
        let Some(arg) = at.inside(SyntaxKind::Arg) else {
            // A time in an event action may be a parameter of the group.
            let in_actions = at.inside(SyntaxKind::Actions).is_some();
            let results = if at.grand_is(SyntaxKind::StartValue) { results(at) } else { Vec::new() };
            let others = if in_actions { self.values(at, false) } else { self.consts() };
            return [results, others].concat();
        };
        let args = at.inside(SyntaxKind::Args);
        let place = args.map_or(0, |args| args.children().take_while(|other| other.span() != arg.span()).count());
        let is_named = arg.token(Equals).is_some();
        let mut found = if is_named { Vec::new() } else { self.argument_names(at) };
        found.extend(self.values(at, place == 0 && !is_named));
        found
    }

    /// Returns the units. Units that fit the parameter come first.
    fn units(&self, at: &Cursor) -> Vec<Completion> {
        let is_limit = at.inside(SyntaxKind::Arg).is_none() && at.inside(SyntaxKind::Actions).is_some();
        let kind = self.expected(at).and_then(|param| param.kind.as_ref()).map(|kind| self.model.shape(kind));
        let kind = match kind {
            Some(Shape::Plain(name) | Shape::List(name, _)) => Some(name),
            Some(Shape::Record(_)) | None => None,
        };
        let wanted = if is_limit { Some("Time") } else { kind };
        let wanted = wanted.and_then(unit::of_type).map(|(dimension, _)| dimension);
        let fits = |symbol: &&str| {
            let dimension = unit::unit(symbol, None).map(|(_, dimension)| dimension);
            wanted.is_none() || dimension == wanted
        };
        let mut found: Vec<Completion> =
            unit::symbols().filter(fits).map(|symbol| Completion::new(CompletionKind::Unit, symbol)).collect();
        if is_limit {
            found.extend(keywords(Place::Suffix));
        } else if at.grand.as_ref().is_some_and(|grand| grand.kind() == SyntaxKind::AnyOf) {
            found = inside("of");
        }
        found
    }

    /// Returns the parameter for the argument around the cursor.
    pub(super) fn param_at(&self, at: &Cursor) -> Option<&Param> {
        let (arg, args) = (at.inside(SyntaxKind::Arg)?, at.inside(SyntaxKind::Args)?);
        let (params, is_module) = self.params_at(at)?;
        if arg.token(Equals).is_some() {
            let name = arg.names().next()?;
            return params.iter().find(|param| param.name.text == name.text);
        }
        let place = args.children().take_while(|other| other.span() != arg.span()).count();
        params.get(place.checked_sub(usize::from(is_module))?)
    }

    /// Returns the parameters of the instance around the cursor, and whether a host comes before them.
    fn params_at(&self, at: &Cursor) -> Option<(&[Param], bool)> {
        let node: &Node = at.inside(SyntaxKind::Instance)?;
        let mut instances = self.process_at(at)?.instances.iter();
        let instance = instances.find(|instance| node.names().any(|name| name.span == instance.name.span))?;
        match instance.target {
            Target::Process(process) => Some((&self.model.processes[process].params, false)),
            Target::Module(module) => Some((self.model.modules[module].params.as_deref()?, true)),
            Target::Unknown => None,
        }
    }

    /// Returns the names of arguments that are missing: `force = `.
    fn argument_names(&self, at: &Cursor) -> Vec<Completion> {
        let (Some((params, _)), Some(args)) = (self.params_at(at), at.inside(SyntaxKind::Args)) else {
            return Vec::new();
        };
        let given: BTreeSet<String> = args
            .children()
            .filter(|arg| arg.token(Equals).is_some())
            .filter_map(|arg| arg.names().next())
            .map(|name| name.text)
            .collect();
        let open = params.iter().filter(|param| !given.contains(&param.name.text));
        let offer = |param: &Param| {
            let mut offer = Completion::new(CompletionKind::Parameter, format!("{} = ", param.name.text));
            offer.detail = param.to_string();
            offer
        };
        open.map(offer).collect()
    }

    /// Returns the parameters of the process around the cursor, named constants, and hosts if they are possible.
    pub(super) fn values(&self, at: &Cursor, with_hosts: bool) -> Vec<Completion> {
        let params = self.process_at(at).map_or(&[][..], |process| &process.params);
        let mut found: Vec<Completion> = params
            .iter()
            .map(|param| Completion::new(CompletionKind::Parameter, &param.name.text).detail(param.to_string()))
            .collect();
        if with_hosts {
            let hosts = self.hosts();
            found.extend(hosts.into_iter().map(|host| Completion::new(CompletionKind::Host, host).detail("host")));
        }
        found.extend(self.consts());
        found
    }

    /// Returns the words that name a host anywhere: in `host{}`, or as the first argument of an instance.
    pub(super) fn hosts(&self) -> BTreeSet<&str> {
        let places = self.model.processes.iter().flat_map(|process| {
            let first = process.instances.iter().filter_map(|instance| instance.args.first());
            process.host.iter().chain(first.filter(|arg| arg.name.is_none()).map(|arg| &arg.value))
        });
        let hosts = places.filter_map(|value| match &value.kind {
            ValueKind::Constant(Constant::Text(host)) => Some(host.as_str()),
            ValueKind::Constant(Constant::Number(_) | Constant::Truth(_) | Constant::Secret(_))
            | ValueKind::Record(_)
            | ValueKind::List(_)
            | ValueKind::Param(_)
            | ValueKind::Broken => None,
        });
        hosts.collect()
    }

    /// Returns the resources that the process around the cursor can take.
    pub(super) fn resources(&self, at: &Cursor) -> Vec<Completion> {
        let resources = self.process_at(at).map_or(&[][..], |process| &process.resources);
        resources.iter().map(|name| Completion::new(CompletionKind::Parameter, &name.text).detail("resource")).collect()
    }

    /// Returns the outcomes that have no arm yet. They are the outcomes of the expression before the `match`, if it is
    /// known.
    pub(super) fn outcomes(&self, at: &Cursor) -> Vec<Completion> {
        let Some(node) = at.inside(SyntaxKind::Match) else { return Vec::new() };
        let given: BTreeSet<String> =
            node.children_of(SyntaxKind::Arm).filter_map(|arm| arm.names().next()).map(|name| name.text).collect();
        let before = at.inside(SyntaxKind::Chain).and_then(|chain| {
            let parts = chain.children().take_while(|part| part.span() != node.span());
            parts.last()?.names().next()
        });
        let mut offers = self.outcomes_named(at, before.as_ref());
        offers.retain(|offer| !given.contains(&offer.label));
        offers.iter_mut().for_each(|offer| offer.snippet = Some(format!("{} => $0", offer.label)));
        offers
    }

    /// Returns the outcomes that could be added to the `until` of a `repeat`.
    pub(super) fn ends_of_repeat(&self, at: &Cursor) -> Vec<Completion> {
        let given: BTreeSet<String> = at.parent.names().skip(1).map(|name| name.text).collect();
        let repeated = at.inside(SyntaxKind::Repeat).and_then(|repeat| repeat.children().next()?.names().next());
        let mut offers = self.outcomes_named(at, repeated.as_ref());
        offers.retain(|offer| !given.contains(&offer.label));
        offers
    }

    /// Returns the outcomes of the process with this name. If it is unknown, returns the outcomes of all modules.
    fn outcomes_named(&self, at: &Cursor, process: Option<&Name>) -> Vec<Completion> {
        let source = process.and_then(|name| self.instance_at(at, &name.text)).map(|instance| instance.target);
        let declared = source.map(|source| self.model.outcomes_of(source)).unwrap_or_default();
        let is_meant =
            |outcome: &Outcome| declared.is_empty() || declared.iter().any(|it| it.name.span == outcome.name.span);
        let all = self.model.outcomes();
        let tags: BTreeMap<&str, &str> = all
            .flat_map(|(owner, outcomes)| {
                let meant = outcomes.iter().filter(|outcome| is_meant(outcome));
                meant.map(|it| (it.name.text.as_str(), owner.text.as_str()))
            })
            .collect();
        let offer = |(tag, owner): (&str, &str)| {
            Completion::new(CompletionKind::Outcome, tag).detail(format!("outcome of {owner}"))
        };
        tags.into_iter().map(offer).collect()
    }

    /// Returns the named constants.
    pub(super) fn consts(&self) -> Vec<Completion> {
        self.model
            .consts
            .iter()
            .map(|(name, constant)| {
                let mut offer = Completion::new(CompletionKind::Constant, name).detail("constant");
                if constant.is_list {
                    offer.snippet = Some(format!("{name}[${{1:0}}]"));
                }
                offer
            })
            .collect()
    }

    /// Returns the devices that modules claim.
    pub(super) fn claims(&self) -> Vec<Completion> {
        let claims = self.model.modules.iter().flat_map(|module| &module.claims);
        let known: BTreeSet<&str> = claims.map(|claim| claim.name.text.as_str()).collect();
        known.into_iter().map(|name| Completion::new(CompletionKind::Parameter, name).detail("device")).collect()
    }
}

/// Returns the direction that a port at the cursor must have: data goes from an output to an input.
fn direction(at: &Cursor) -> Option<Direction> {
    let connection = at.grand.as_ref().filter(|grand| grand.kind() == SyntaxKind::Connection)?;
    let is_first = connection.children().next()?.span() == at.parent.span();
    let arrow = connection.tokens().find(|token| [Arrow, SyntaxKind::BackArrow].contains(&token.kind()));
    let is_forward = arrow.is_none_or(|arrow| arrow.kind() == Arrow);
    Some(if is_first == is_forward { Direction::Out } else { Direction::In })
}

/// Returns the names of the results around the cursor, the innermost first.
fn results(at: &Cursor) -> Vec<Completion> {
    let name = |node: &Node| match node.kind() {
        SyntaxKind::Named => node.names().next(),
        SyntaxKind::Arm => node.names().nth(1),
        _ => None,
    };
    let names = at.around.iter().filter_map(name);
    names.map(|name| Completion::new(CompletionKind::Parameter, name.text).detail("result")).collect()
}
