//! A record as a source of values: which processes of a plan it can replace, and which values each of them sends.

mod encode;
mod steps;

pub(crate) use encode::encode;
pub(crate) use steps::steps;

use crate::logic::tap::Wanted;
use comms::logic::replay::REPLAY;
use language::plan::{
    Argument, BRIDGE, Constant, Environment, Expression, Leaf, LeafKind, LeafPort, Plan, Policy, Transfer, Wire,
};
use node::logic::protocol::Deployment;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

/// How long the mission continues after the end of the record, so that the last values are processed.
pub(crate) const TAIL: Duration = Duration::from_secs(1);

/// A process that is replaced by values of the record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct StandIn {
    /// Index into `Plan::leaves`.
    pub(crate) leaf: u32,
    /// The connected outputs of the process. Outputs with recorded values come first.
    pub(crate) outputs: Vec<String>,
    /// How many of the outputs have values.
    pub(crate) recorded: usize,
}

/// The options for starting a stand-in.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Playing<'a> {
    /// The program that plays steps.
    pub(crate) program: &'a Path,
    /// The file with the steps.
    pub(crate) file: &'a Path,
    /// The speed of the replay, relative to the recording.
    pub(crate) rate: f64,
}

/// Chooses the processes that the record replaces. These are the processes of the outputs that the user names, or else
/// all processes that only send. `recorded` has the number of values of each output, by its path: `main/laser/Scan`.
///
/// # Errors
/// A sentence for a person.
pub(crate) fn choose(plan: &Plan, recorded: &BTreeMap<String, u64>, wanted: &[String]) -> Result<Vec<StandIn>, String> {
    let stand_ins: Vec<StandIn> =
        (0..).zip(&plan.leaves).map(|(index, leaf)| stand_in(plan, recorded, index, leaf)).collect();
    let has_values = |one: &&StandIn| one.recorded > 0;
    if wanted.is_empty() {
        let only_sends = |one: &&StandIn| is_source(plan, one.leaf);
        let chosen: Vec<StandIn> = stand_ins.iter().filter(has_values).filter(only_sends).cloned().collect();
        if chosen.is_empty() {
            return Err("the record has no values of a process that only sends; record with `--record all`, or name outputs with `--ports`, \
                        such as `--ports laser.Scan`"
                .to_owned());
        }
        return Ok(chosen);
    }
    let deployment = Deployment { name: plan.name.clone(), epoch: 0 };
    let mut chosen: Vec<StandIn> = Vec::new();
    for what in wanted {
        let output = Wanted::parse(what)?;
        let process = output.process().of_any_run();
        let is_meant = |one: &&StandIn| {
            let path = plan.leaves.get(one.leaf as usize).map_or("", |leaf| leaf.path.as_str());
            let names = one.outputs.iter().take(one.recorded);
            process.is_process(&deployment, path) && names.into_iter().any(|name| output.is_output(name))
        };
        let found: Vec<&StandIn> = stand_ins.iter().filter(has_values).filter(is_meant).collect();
        if found.is_empty() {
            return Err(format!("the record has no values of an output `{what}` of this spec"));
        }
        for one in found {
            if !chosen.contains(one) {
                chosen.push(one.clone());
            }
        }
    }
    Ok(chosen)
}

fn stand_in(plan: &Plan, recorded: &BTreeMap<String, u64>, index: u32, leaf: &Leaf) -> StandIn {
    let is_own = |wire: &&Wire| wire.from.leaf == index && wire.transfer != Transfer::Call;
    let outputs: BTreeSet<&str> = plan.wires.iter().filter(is_own).map(|wire| wire.from.port.as_str()).collect();
    let is_played =
        |output: &&str| leaf.external.is_none() && recorded.contains_key(&format!("{}/{output}", leaf.path));
    let (played, silent): (Vec<&str>, Vec<&str>) = outputs.into_iter().partition(is_played);
    let recorded = played.len();
    StandIn { leaf: index, outputs: played.into_iter().chain(silent).map(str::to_owned).collect(), recorded }
}

/// Returns whether a leaf only sends. The bridge to ROS 2 represents sensors and actuators, and is treated as a sensor. An
/// activity does not count: it decides again which values it sends.
fn is_source(plan: &Plan, index: u32) -> bool {
    let is_bridge = plan.leaves.get(index as usize).is_some_and(|leaf| leaf.module == BRIDGE);
    let hears = |wire: &Wire| wire.to.leaf == index && wire.transfer != Transfer::Call;
    is_bridge || !plan.has_ports(index) && !plan.wires.iter().any(hears)
}

/// Replaces a process in the plan by its stand-in.
pub(crate) fn replace(plan: &mut Plan, stand_in: &StandIn, playing: Playing<'_>) {
    let index = stand_in.leaf;
    let texts = [
        ("file", playing.file.display().to_string()),
        ("outputs", stand_in.outputs.join(" ")),
        ("inputs", ports(plan, index, false, |wire| &wire.to)),
        ("exports", ports(plan, index, true, |wire| &wire.to)),
        ("calls", ports(plan, index, true, |wire| &wire.from)),
    ];
    let argument = |name: &str, value| Argument { name: Some(name.to_owned()), value };
    let mut arguments = vec![argument("rate", Constant::Number(playing.rate))];
    arguments.extend(texts.map(|(name, text)| argument(name, Constant::Text(text))));
    let Some(leaf) = plan.leaves.get_mut(index as usize) else { return };
    leaf.arguments = arguments;
    leaf.exec = Some(format!("'{}' {REPLAY}", playing.program.display()));
    leaf.parameters = Some(Vec::new());
    leaf.environment = Environment::default();
    leaf.kind = LeafKind::Controller;
    leaf.policy = Policy::default();
    leaf.keys = Vec::new();
    plan.claims.retain(|claim| claim.leaf != index);
}

/// Returns whether stand-ins run in a plan: it is the plan of a replay.
pub(crate) fn is_replay(plan: &Plan) -> bool {
    let is_stand_in = |exec: &str| exec.ends_with(&format!("' {REPLAY}"));
    plan.leaves.iter().any(|leaf| leaf.exec.as_deref().is_some_and(is_stand_in))
}

/// Returns the ports of a leaf at one end of its wires, or of its calls.
fn ports(plan: &Plan, leaf: u32, is_call: bool, end: fn(&Wire) -> &LeafPort) -> String {
    let meant = plan.wires.iter().filter(|wire| (wire.transfer == Transfer::Call) == is_call);
    let own = meant.map(end).filter(|end| end.leaf == leaf).map(|end| end.port.as_str());
    own.collect::<BTreeSet<&str>>().into_iter().collect::<Vec<_>>().join(" ")
}

/// Makes the mission end as done after the length of the record. Returns whether this is possible: an activity cannot be ended like this.
pub(crate) fn end_after(plan: &mut Plan, length: Duration) -> bool {
    let Some(main) = plan.groups.first_mut().filter(|main| !matches!(main.expression, Expression::Chart(_))) else {
        return false;
    };
    let own = std::mem::replace(&mut main.expression, Expression::Skip);
    main.expression = Expression::Disable(vec![Expression::Wait(length), own]);
    true
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::{Options, Source, compile};

    const SPEC: &str = "
        module Laser(host) { exec \"laser\"; out Scan: Scan; out Odd: Scan; proc Reset(Scan) -> Scan; service; }
        module Avoid(host) { exec \"avoid\"; in Scan: Scan; out Cmd: Cmd; calls Reset(Scan) -> Scan; service; }
        module Base(host) { exec \"base\"; in Cmd: Cmd; in Odd: Scan; claims base; service; }
        process main() {
            host { c1 }
            instantiated_processes { laser instof Laser(c1); avoid instof Avoid(c1); base instof Base(c1); }
            internal_connections {
                laser.Scan -> avoid.Scan; avoid.Cmd -> base.Cmd; laser.Odd -> base.Odd; avoid.Reset -> laser.Reset;
            }
            internal_event_actions { laser, avoid, base }
        }";

    fn plan() -> Plan {
        let compiled = compile(&Source::new("a.dca", SPEC), &[], &Options::named("a"));
        compiled.plan.unwrap_or_else(|| panic!("{:?}", compiled.diagnostics))
    }

    fn recorded(outputs: &[&str]) -> BTreeMap<String, u64> {
        outputs.iter().map(|output| ((*output).to_owned(), 3)).collect()
    }

    /// A leaf, its outputs, and how many of them are recorded.
    type Expected<'a> = (u32, &'a [&'a str], usize);

    #[test]
    fn a_record_stands_in_for_sensors_or_for_the_named_outputs() {
        let check = |outputs: &[&str], wanted: &[&str], expected: Result<&[Expected<'_>], &str>| {
            let wanted: Vec<String> = wanted.iter().map(|what| (*what).to_owned()).collect();
            let found = choose(&plan(), &recorded(outputs), &wanted);
            let expected = expected.map(|all| {
                let stand_in = |(leaf, outputs, recorded): &Expected<'_>| StandIn {
                    leaf: *leaf,
                    outputs: outputs.iter().map(|output| (*output).to_owned()).collect(),
                    recorded: *recorded,
                };
                all.iter().map(stand_in).collect::<Vec<_>>()
            });
            match (found, expected) {
                (Err(found), Err(expected)) => assert!(found.contains(expected), "{found}"),
                (found, expected) => assert_eq!(found, expected.map_err(str::to_owned), "{outputs:?} {wanted:?}"),
            }
        };
        let all = ["main/laser/Scan", "main/laser/Odd", "main/avoid/Cmd"];
        check(&all, &[], Ok(&[(0, &["Odd", "Scan"], 2)]));
        check(&all[..1], &[], Ok(&[(0, &["Scan", "Odd"], 1)]));
        check(&all[2..], &[], Err("no values of a process that only sends"));
        check(&all, &["avoid.Cmd"], Ok(&[(1, &["Cmd"], 1)]));
        check(&all, &["Cmd", "main/avoid.Cmd", "Scan"], Ok(&[(1, &["Cmd"], 1), (0, &["Odd", "Scan"], 2)]));
        check(&all[..1], &["laser.Odd"], Err("no values of an output `laser.Odd`"));
        check(&all, &["base.Cmd"], Err("no values of an output `base.Cmd`"));
        check(&["main/other/Out"], &[], Err("no values"));
    }

    #[test]
    fn a_stand_in_has_all_ports_of_its_process_and_nothing_else_of_it() {
        let mut plan = plan();
        let stand_in = choose(&plan, &recorded(&["main/laser/Scan"]), &[]).unwrap().remove(0);
        let playing = Playing { program: Path::new("/opt/my robot/player"), file: Path::new("/tmp/0"), rate: 2.0 };
        replace(&mut plan, &stand_in, playing);
        let leaf = &plan.leaves[0];
        assert_eq!((leaf.path.as_str(), leaf.module.as_str()), ("main/laser", "Laser"));
        assert_eq!(leaf.exec.as_deref(), Some("'/opt/my robot/player' Replay"));
        let arguments: Vec<String> = leaf
            .arguments
            .iter()
            .map(|one| format!("{}={}", one.name.as_deref().unwrap_or_default(), one.value.bare()))
            .collect();
        assert_eq!(arguments, ["rate=2", "file=/tmp/0", "outputs=Scan Odd", "inputs=", "exports=Reset", "calls="]);
        let base = StandIn { leaf: 2, outputs: Vec::new(), recorded: 0 };
        assert_eq!(plan.claims.len(), 1);
        replace(&mut plan, &base, playing);
        assert_eq!((plan.claims.len(), plan.leaves[2].arguments[3].value.bare().as_str()), (0, "Cmd Odd"));
        assert!(end_after(&mut plan, Duration::from_secs(3)));
        let Expression::Disable(of) = &plan.groups[0].expression else { panic!("{:?}", plan.groups[0].expression) };
        assert_eq!((of.len(), &of[0]), (2, &Expression::Wait(Duration::from_secs(3))));
        plan.validate().unwrap();
    }
}
