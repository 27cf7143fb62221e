//! A mission with changes to its spec while it runs, with real processes of two nodes.

use dca_tests::cluster::{Cluster, Host, Program, SOON, Stream, wait_until};
use dca_tests::hit_detector;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::time::Duration;

/// A visitor pushes the hand repeatedly with up to 60 N, until the push is noticed. A plain program waits beside it.
const SPEC: &str = concat!(
    r#"
module Beside(host, way: Text) { exec "sh -c 'eval ${0#way=}'"; plain; done; }

"#,
    hit_detector!("150 N"),
    r#"
process main(){
    host{c3}
    instantiated_processes{
        world instof DoorWorld(c3, push_at = 0 s, push = 60 N);
        hit instof HitDetector(c3);
        beside instof Beside(c2, "sleep 1000");
    }
    internal_event_actions{
        ((world # wait(4 s)) ;; skip) # hit # beside
    }
}
"#
);

/// Starts two nodes, and deploys the mission on them.
fn deploy(cluster: &Cluster) -> (Host, [Program; 2], Program, BTreeMap<String, u32>) {
    let here = cluster.here();
    let nodes = [here.node("c3", &[]), here.node("c2", &[])];
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("push.dca", SPEC)]);
    let paths = ["main/beside", "main/hit/force", "main/hit/threshold", "main/world"];
    let are_up = || here.pids().keys().map(String::as_str).eq(paths);
    assert!(wait_until(SOON, are_up).is_some(), "{:?} {}", here.pids(), mission.text(Stream::Err));
    let pids = here.pids();
    (here, nodes, mission, pids)
}

/// Returns the paths of programs with a different process. A program that was just put back may still be starting.
fn others(here: &Host, before: &BTreeMap<String, u32>) -> Vec<String> {
    let are_all_up = || here.pids().keys().eq(before.keys());
    assert!(wait_until(SOON, are_all_up).is_some(), "{:?}", here.pids());
    here.pids().into_iter().filter(|(path, pid)| before[path] != *pid).map(|(path, _)| path).collect()
}

#[test]
fn a_changed_spec_changes_what_differs_and_nothing_else() {
    let cluster = Cluster::new();
    let (here, _nodes, mission, before) = deploy(&cluster);
    let same = here.ask(&["deploy", &cluster.file("push.dca", &format!("// a remark\n{SPEC}"))]);
    assert!(same.code == Some(0) && same.out.contains("runs already as in this spec: nothing changes"), "{same}");

    let latched = SPEC.replace("force, Out -> threshold, In;", "force, Out -> threshold, In latch;");
    let file = cluster.file("push.dca", &latched);
    let plan = here.ask(&["plan", &file]);
    let lines = ["disconnect main/hit/force, Out", "connect    main/hit/force, Out -> main/hit/threshold, In latch"];
    assert!(plan.code == Some(0) && lines.iter().all(|line| plan.out.contains(line)), "{plan}");
    assert!(plan.out.contains("keep       4 programs"), "{plan}");
    let rewired = here.ask(&["deploy", &file]);
    assert!(rewired.code == Some(0) && rewired.out.contains("is changed (2 changes, revision 1)"), "{rewired}");
    assert_eq!(others(&here, &before), Vec::<String>::new());

    let replaced = here.ask(&["replace", "push", "hit/force", "--probation", "0.5"]);
    assert!(replaced.code == Some(0) && replaced.out.contains("revision 2"), "{replaced}");
    assert_eq!(others(&here, &before), ["main/hit/force"]);

    // With this threshold, the restarted program notices the push. It does so over the wire made during the run.
    assert!(mission.is_running());
    let felt = here.ask(&["deploy", "--probation", "0", &cluster.file("push.dca", &latched.replace("150 N", "5 N"))]);
    // A hand that is already pushing is noticed at once. In this case, everything may have ended before the hosts
    // have confirmed the change.
    let is_over = felt.code == Some(1) && felt.err.contains("the deployment ended before every host had confirmed");
    assert!((felt.code == Some(0) || is_over) && felt.err.contains("`threshold` is 5, was 150"), "{felt}");
    let ended = mission.ended(Duration::from_secs(60));
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(ended.out.contains("is replaced"), "{ended}");
    assert_eq!(here.pids(), BTreeMap::new());
}

#[test]
fn a_program_that_fails_is_put_back_and_the_mission_goes_on() {
    let cluster = Cluster::new();
    let (here, _nodes, mission, before) = deploy(&cluster);
    let bad = SPEC.replace("sleep 1000", "echo I cannot; exit 3").replace("150 N", "140 N");
    let refused = here.ask(&["deploy", &cluster.file("push.dca", &bad)]);
    let why = ["is not changed: the new program of `main/beside` was not healthy", "exit code 3"];
    assert!(refused.code == Some(1) && why.iter().all(|why| refused.err.contains(why)), "{refused}");
    assert_eq!(others(&here, &before), ["main/beside", "main/hit/threshold"], "both are as before, and started again");
    assert!(mission.is_running());
    let plan = here.ask(&["plan", &cluster.file("push.dca", SPEC)]);
    assert!(plan.code == Some(0) && plan.out.contains("revision 0:\n  keep       4 programs"), "{plan}");

    // A program that cannot be started is found before another makes place for it.
    let pids_before = here.pids();
    for (exec, why) in
        [("/no/such/program", "there is no program"), ("/tmp", "is a folder"), ("/dev/null", "is not a regular file")]
    {
        let missing = SPEC.replace("exec \"sh -c", &format!("exec \"{exec} -c"));
        let refused = here.ask(&["deploy", &cluster.file("push.dca", &missing)]);
        assert!(refused.code == Some(1) && refused.err.contains(why), "{refused}");
        assert_eq!(others(&here, &pids_before), Vec::<String>::new());
    }

    // If supervisors cannot take over a change, nothing changes.
    let other = SPEC.replace("# hit # beside", "# (hit , beside)");
    let planned = here.ask(&["plan", &cluster.file("push.dca", &other)]);
    assert!(planned.code == Some(0) && planned.out.contains("act        main: its event actions"), "{planned}");
    let refused = here.ask(&["deploy", &cluster.file("push.dca", &other)]);
    let why = "the event actions of `main` cannot change now: `main/beside` runs, and the new event actions have no place for it there";
    assert!(refused.code == Some(1) && refused.err.contains(why), "{refused}");
    for (arguments, code, why) in [
        (["replace", "push", "hit/forse"], 1, "`push` has no program `hit/forse`"),
        (["replace", "pull", "hit/force"], 1, "pull"),
        (["replace", "push", "--probation=700"], 2, "0 to 600"),
    ] {
        let refused = here.ask(&arguments);
        assert!(refused.code == Some(code) && refused.err.contains(why), "{arguments:?}: {refused}");
    }
    let stopped = here.ask(&["stop", "push"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    assert_eq!(mission.ended(SOON).code, Some(1));
    assert_eq!(here.pids(), BTreeMap::new());
}

#[test]
fn what_is_planned_before_anything_runs_is_a_start() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let file = cluster.file("push.dca", SPEC);
    let alone = here.ask(&["plan", &file]);
    assert_eq!(alone.code, Some(3), "{alone}");
    let _node = here.node("c3", &[]);
    let plan = here.ask(&["plan", &file]);
    let start = "`push` is not running: 4 programs would start on `c3`, `c2`";
    assert!(plan.code == Some(0) && plan.out.contains(start), "{plan}");
    let json = here.ask(&["plan", "--json", &file]);
    let told: serde_json::Value = serde_json::from_str(&json.out).expect("it is JSON");
    assert_eq!((json.code, &told["start"]), (Some(0), &serde_json::json!(4)), "{json}");
}

/// A program is added, runs beside the others with its wire, and is removed again. The other programs stay untouched,
/// and the mission continues.
#[test]
fn a_program_is_added_to_a_mission_that_runs_and_taken_away_again() {
    let cluster = Cluster::new();
    let (here, _nodes, mission, before) = deploy(&cluster);
    let unknown = here.ask(&["add", "push", "ear instof NoSuchType(c3)"]);
    assert!(unknown.code == Some(1) && unknown.err.contains("NoSuchType"), "{unknown}");
    let elsewhere = here.ask(&["add", "push", "--in", "main/hit", "ear instof ForceThreshold(c9)"]);
    assert!(
        elsewhere.code == Some(1) && elsewhere.err.contains("has no part in the running deployment"),
        "{elsewhere}"
    );

    let wire = "force, Out -> ear, In";
    let add = ["add", "push", "--in", "main/hit", "--optional", "--probation", "0.5", "--connect", wire];
    let added = here.ask(&[&add[..], &["ear instof ForceThreshold(c3, threshold = 150 N)"]].concat());
    assert!(added.code == Some(0) && added.out.contains("is changed (3 changes, revision 1)"), "{added}");
    let now = here.pids();
    assert!(now.contains_key("main/hit/ear") && before.iter().all(|(path, pid)| now[path] == *pid), "{now:?}");
    let taken = here.ask(&[&add[..], &["ear instof ForceThreshold(c3, threshold = 150 N)"]].concat());
    assert!(taken.code == Some(1) && taken.err.contains("`main/hit/ear` runs already"), "{taken}");

    let needed = here.ask(&["remove", "push", "main/world"]);
    assert!(needed.code == Some(1) && needed.err.contains("the event actions of `main` need `main/world`"), "{needed}");
    let removed = here.ask(&["remove", "push", "hit/ear"]);
    assert!(removed.code == Some(0) && removed.out.contains("revision 2"), "{removed}");
    assert!(wait_until(SOON, || here.pids() == before).is_some(), "{:?} {before:?}", here.pids());

    // The types of the spec are known together with the spec.
    let another = ["add", "push", "--optional", "--probation", "0.5", "more instof Beside(c2, \"sleep 1000\")"];
    let unknown = here.ask(&another);
    let told = ["`Beside`", "`--spec FILE` adds the types that a spec declares"];
    assert!(unknown.code == Some(1) && told.iter().all(|told| unknown.err.contains(told)), "{unknown}");
    let file = cluster.file("push.dca", SPEC);
    let added = here.ask(&[&another[..], &["--spec", &file]].concat());
    assert!(added.code == Some(0) && added.out.contains("revision 3"), "{added}");
    assert!(here.pids().contains_key("main/more"), "{:?}", here.pids());
    assert!(mission.is_running());
    let stop = here.ask(&["stop", "push"]);
    assert_eq!(stop.code, Some(0), "{stop}");
    assert_eq!(here.pids(), BTreeMap::new());
}

/// One host changes first. If the others cannot follow, it returns to its earlier state.
#[test]
fn a_canary_goes_first_and_back_if_the_rest_cannot_follow() {
    let cluster = Cluster::new();
    let (here, _nodes, mission, before) = deploy(&cluster);
    let deploy = |text: &str, host: &str| {
        here.ask(&["deploy", "--probation", "0.3", "--canary", host, &cluster.file("push.dca", text)])
    };
    let new = SPEC.replace("sleep 1000", "sleep 2000");
    let nowhere = deploy(&new, "c3");
    let why = "this spec changes no program of `push` on `c3`";
    assert!(nowhere.code == Some(1) && nowhere.err.contains(why), "{nowhere}");
    assert_eq!(others(&here, &before), Vec::<String>::new());

    let bad = deploy(&new.replace("# hit # beside", "# (hit , beside)"), "c2");
    let why = [
        "on `c2` first",
        "so the change of the host `c2` is taken back",
        "the new event actions have no place for it there",
    ];
    assert!(bad.code == Some(1) && why.iter().all(|why| bad.err.contains(why)), "{bad}");
    assert_eq!(others(&here, &before), ["main/beside"], "it was changed, and changed back");
    let plan = here.ask(&["plan", &cluster.file("push.dca", SPEC)]);
    assert!(plan.code == Some(0) && plan.out.contains("revision 2:\n  keep       4 programs"), "{plan}");

    let good = deploy(&new.replace("# hit # beside", "# hit # beside # wait(1 h)"), "c2");
    assert!(good.code == Some(0) && good.out.contains("revision 4"), "{good}");
    assert!(mission.is_running());
    let stop = here.ask(&["stop", "push"]);
    assert_eq!(stop.code, Some(0), "{stop}");
}

/// A caller that does not wait for the end of a change is told that the change continues.
#[test]
fn who_leaves_a_change_is_told_that_it_goes_on() {
    let cluster = Cluster::new();
    let (here, _nodes, mission, before) = deploy(&cluster);
    let file = cluster.file("push.dca", &SPEC.replace("sleep 1000", "sleep 2000"));
    let change = here.dca(&["deploy", "--probation", "600", &file]);
    let is_another = || here.pids().get("main/beside").is_some_and(|pid| *pid != before["main/beside"]);
    assert!(wait_until(SOON, is_another).is_some(), "{:?}", here.pids());
    // In the meantime, `dca plan` shows the plan in its probation, and says so.
    let probed = here.ask(&["plan", &file]);
    let told = "`push@1`, revision 1 by ";
    let stage = "in probation; revision 0 is current until the probation ends:\n  keep       4 programs";
    assert!(probed.code == Some(0) && probed.out.starts_with(told) && probed.out.contains(stage), "{probed}");
    let json = here.ask(&["plan", "--json", &file]);
    let json: serde_json::Value = serde_json::from_str(&json.out).expect("it is JSON");
    assert_eq!((&json["change"]["revision"], &json["change"]["stage"]), (&1.into(), &"probation".into()), "{json}");
    let same = here.ask(&["deploy", &file]);
    assert!(same.code == Some(0) && same.err.contains(stage.split(';').next().unwrap_or_default()), "{same}");
    change.signal(Signal::INT);
    let left = change.ended(SOON);
    assert!(left.code == Some(1) && left.err.contains("the change of `push` continues"), "{left}");
    assert!(mission.is_running());
    assert_eq!(others(&here, &before), ["main/beside"], "the new program is still there");
}
