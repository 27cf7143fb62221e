//! Every file of `specs/` and every good file of the corpus runs in simulation, with and without faults.

use language::{Content, Ending, Options, RandomRun, Simulation, Source, Transition, compile, gather};
use std::path::{Path, PathBuf};
use std::time::Duration;

/// As many things may happen in one run.
const STEPS_MAX: usize = 500;

fn files(folder: &str) -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join(folder);
    let entries = std::fs::read_dir(folder).expect("a folder of specs");
    let mut files: Vec<PathBuf> = entries.filter_map(|entry| Some(entry.ok()?.path())).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "dca"));
    files.sort();
    files
}

/// Reads a file or a folder that a spec uses.
fn content(path: &str) -> Result<Content, String> {
    let told = |error: std::io::Error| error.to_string();
    if !Path::new(path).is_dir() {
        return std::fs::read_to_string(path).map(Content::File).map_err(told);
    }
    let names = std::fs::read_dir(path).map_err(told)?;
    let names = names.map(|entry| Ok(entry.map_err(told)?.file_name().to_string_lossy().into_owned()));
    names.collect::<Result<Vec<_>, String>>().map(Content::Folder)
}

/// Runs a spec by chance; returns its outcome, if it can be run and has ended.
fn run(path: &Path, seed: u64, faults: u64) -> Option<Option<Transition>> {
    let read =
        |path: &Path| Source::new(path.to_string_lossy(), std::fs::read_to_string(path).expect("a spec is text"));
    let interface = path.with_extension("interface");
    let mut others = gather(&read(path), &content);
    others.extend(interface.exists().then(|| read(&interface)));
    let plan = compile(&read(path), &others, &Options::named("sim")).plan?;
    let mut simulation = Simulation::start(&plan);
    let mut chance = RandomRun::new(&plan, seed, faults);
    for _ in 0..STEPS_MAX {
        if simulation.outcome().is_some() || !chance.step(&mut simulation) {
            break;
        }
    }
    if simulation.outcome().is_some() {
        assert_eq!(simulation.running(), Vec::<&str>::new(), "{} leaves something behind", path.display());
    }
    Some(simulation.outcome().cloned())
}

#[test]
fn every_spec_comes_to_its_end() {
    for path in files("../specs") {
        for seed in 0..20 {
            let ended = run(&path, seed, 0).flatten();
            // By chance a program takes longer than its deadline allows.
            let is_late = matches!(&ended, Some(Transition::Aborted(why)) if why.ends_with(": timeout"));
            assert!(is_late || ended == Some(Transition::Done), "{} with seed {seed}: {ended:?}", path.display());
            assert!(run(&path, seed, 30).flatten().is_some(), "{} with seed {seed} and faults", path.display());
        }
    }
}

#[test]
fn nothing_of_the_corpus_is_left_behind() {
    let ended = files("tests/corpus").iter().filter_map(|path| run(path, 7, 10)).count();
    assert!(ended > 5, "{ended}");
}

/// Two groups on two hosts share one resource: whichever starts, the other waits until all of the first has ended.
#[test]
fn groups_that_share_a_resource_run_one_after_the_other() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus/resource_handed.dca");
    let spec = Source::new("a.dca", std::fs::read_to_string(path).expect("a spec is text"));
    let plan = compile(&spec, &[], &Options::named("sim")).plan.expect("the spec is good");
    let mut orders = std::collections::BTreeSet::new();
    for seed in 0..50 {
        let mut simulation = Simulation::start(&plan);
        let mut chance = RandomRun::new(&plan, seed, 20);
        let mut order = Vec::new();
        while simulation.outcome().is_none() && chance.step(&mut simulation) {
            let running = simulation.running();
            // A leaf of any group: `main/left/look`, `main/right/one/move`.
            let groups: std::collections::BTreeSet<&str> =
                running.iter().filter_map(|path| path.rsplit_once('/')).map(|(group, _)| group).collect();
            assert!(groups.len() < 2, "seed {seed}: {running:?}");
            order.extend(running.iter().map(|path| (*path).to_owned()));
        }
        orders.insert(order);
    }
    assert!(orders.len() > 1, "{orders:?}");
}

/// Stopping takes no time here, so a loop may take none that would take some in a deployment.
#[test]
fn a_loop_that_takes_no_time_ends_the_run() {
    for actions in ["(s, skip) ;; skip", "(s within 0 s)? ;; skip"] {
        let text = format!(
            "module S {{ service; }} process main() {{ host{{c1}} instantiated_processes {{ s instof S(c1); }}
            internal_event_actions {{ {actions} }} }}"
        );
        let plan = compile(&Source::new("loop.dca", text), &[], &Options::named("loop")).plan.expect(actions);
        let mut simulation = Simulation::start(&plan);
        simulation.pass(Duration::ZERO);
        let Some(Transition::Aborted(why)) = simulation.outcome() else { panic!("`{actions}` goes on") };
        assert_eq!(why, "more than 100000 events at one instant: a loop takes no time");
        assert_eq!(simulation.running(), Vec::<&str>::new());
    }
}

/// `on aborted("TEXT")` takes the failure of an activity and of a group inside that end with this text, however deep.
#[test]
fn the_text_of_a_failure_inside_chooses_the_transition() {
    let text = "module Work(host) { done; }
        activity Inner(h: Host){
            w instof Work(h);
            initial state s { run w; on done -> done; on after 2 s -> abort(\"told\"); }
        }
        process group(h){
            host{h}
            instantiated_processes{ w instof Work(h); }
            internal_event_actions{ w ; fail(\"no way\") }
        }
        process around(h){
            host{h}
            instantiated_processes{ g instof group(h); }
            internal_event_actions{ g }
        }
        activity A(h: Host){
            a instof Inner(h);
            g instof around(h);
            b instof Work(h);
            initial state one { run a; on aborted(\"no way\") -> abort(\"wrong\"); on aborted(\"told\") -> two; on aborted -> abort(\"other\"); }
            state two { run g; on aborted(\"no way\") -> three; on aborted -> abort(\"other\"); }
            state three { run b; on aborted(\"told\") -> abort(\"wrong\"); on aborted -> done; }
        }
        process main(){
            host{\"c1\"}
            instantiated_processes{ x instof A(\"c1\"); }
            internal_event_actions{ x }
        }";
    let plan = compile(&Source::new("a.dca", text), &[], &Options::named("a")).plan.expect("it compiles");
    let mut simulation = Simulation::start(&plan);
    simulation.pass(Duration::from_secs(3));
    simulation.end("x/g/g/w", Ending::Done).expect("it runs");
    // The report of a program is not such a text.
    simulation.end("x/b", Ending::Aborted("told".to_owned())).expect("it runs");
    let happenings = simulation.take_happenings();
    assert_eq!(simulation.outcome(), Some(&Transition::Done), "{happenings:?}");
}

/// A line for people has the names of values.
#[test]
fn a_line_of_an_activity_names_values() {
    let text = include_str!("../corpus/log_of_names.dca");
    let plan = compile(&Source::new("a.dca", text), &[], &Options::named("a")).plan.expect("it compiles");
    let mut simulation = Simulation::start(&plan);
    simulation.end("x/w", Ending::Done).expect("it runs");
    let says = Transition::Says("says: mode=fast near=true n=2 sum=3".to_owned());
    let happenings = simulation.take_happenings();
    assert!(happenings.iter().any(|happening| happening.transition == says), "{happenings:?}");
}
