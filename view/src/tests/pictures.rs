//! Tests of plans, ends and changes of processes, which a view keeps for pictures.

use super::*;

#[test]
fn a_process_has_the_mark_of_its_last_end_until_it_runs_again() {
    let mut model = Model::new(1);
    let failure = Failure { origin: "main/a".into(), cause: FailureCause::Exit(1), at: Duration::ZERO };
    let aborted = || Change::Ended(Ending::Aborted(failure.clone()));
    let steps = [
        (None, "idle", Mark::Idle, "idle"),
        (Some(Change::Activated), "running", Mark::Running, "running"),
        (Some(Change::Ended(Ending::Done(Vec::new()))), "idle", Mark::Done, "done"),
        (Some(Change::Started { pid: 4 }), "idle", Mark::Done, "done"),
        (Some(Change::Activated), "running", Mark::Running, "running"),
        (Some(Change::Ended(Ending::Stopped)), "idle", Mark::Stopped, "stopped"),
        (Some(aborted()), "idle", Mark::Failed, "aborted: left with exit code 1 before it was done"),
        (Some(Change::Resumed), "restarting", Mark::Changing, "restarting"),
    ];
    for (number, (change, state, mark, text)) in (0..).zip(steps) {
        if let Some(change) = change {
            model.apply(at(number), event(number, 0, changed("main/a", change)));
        }
        model.apply(at(number), status("r1", &[("main/a", state)]));
        let process = only(&model);
        let health = process.health();
        assert_eq!((process.mark(health), process.mark_text(health).as_str()), (mark, text), "{number}");
    }
    let process = only(&model);
    assert_eq!((process.mark(Health::Unknown), process.mark_text(Health::Unknown)), (Mark::Lost, "unknown".to_owned()));
    // Its last end stays with the deployment when that is over.
    model.apply(at(20), event(20, 0, changed("main/a", aborted())));
    let report = Report::Finished { ending: Ending::Stopped, at: Duration::ZERO, unconfirmed: Vec::new() };
    model.apply(at(20), event(21, 0, report));
    model.apply(at(20), answered(node("r1", vec![])));
    let ends: Vec<_> = model.deployments().flat_map(|live| &live.ends).collect();
    assert!(matches!(ends.as_slice(), [(path, LastEnd { mark: Mark::Failed, .. })] if *path == "main/a"), "{ends:?}");
}

/// A view that begins now hears old events first.
#[test]
fn a_new_view_shows_when_a_mission_began_and_those_that_have_just_ended() {
    let mut model = Model::new(1);
    let go = || Report::Go { took: Duration::from_secs(1), signals: Vec::new() };
    model.apply(at(900_000), event(0, 60_000, go()));
    model.apply(at(900_000), status("r1", &[("main", "running")]));
    assert_eq!(model.deployments().map(|live| live.began).collect::<Vec<_>>(), [Some(at(840_000))]);
    let ended = |epoch: u64, ago: u64| {
        let failure = Failure { origin: "main".into(), cause: FailureCause::Exit(1), at: Duration::ZERO };
        let (ending, unconfirmed) = (Ending::Aborted(failure), Vec::new());
        let report = Report::Finished { ending, at: Duration::ZERO, unconfirmed };
        let Input::Event { home, mut event } = event(1, ago, report) else { panic!("it is an event") };
        event.deployment = Deployment { name: "gate".into(), epoch };
        Input::Event { home, event }
    };
    model.apply(at(900_000), ended(1, 700_000));
    model.apply(at(900_000), ended(2, 500_000));
    let is_failed = |live: &LiveDeployment| live.end.as_ref().is_some_and(|end| end.is_failed);
    let shown: Vec<(String, bool)> = model.deployments().map(|live| (live.id.to_string(), is_failed(live))).collect();
    assert_eq!(shown, [("door@1".to_owned(), false), ("gate@2".to_owned(), true)]);
    (3..40).for_each(|epoch| model.apply(at(900_000), ended(epoch, 1000 - epoch)));
    assert_eq!(model.deployments().count(), 21, "as many as are kept, and the one that runs");
}

#[test]
fn the_history_of_processes_has_a_limit_and_short_texts() {
    let mut model = Model::new(1);
    let long = Change::Says { text: "\x1b[2J".repeat(100_000), is_routine: true };
    model.apply(at(0), event(0, 0, changed("main/a", long)));
    let told: Vec<&PastChange> = model.history(&mission()).collect();
    let [PastChange { change: Change::Says { text, .. }, .. }] = told.as_slice() else { panic!("{told:?}") };
    assert!(text.chars().count() <= 400 && text.starts_with("\\x1b[2J"), "{text}");
    assert_eq!(model.history_left(), Time::ZERO);
    for number in 1..10_000 {
        model.apply(at(number), event(number, 0, changed("main/a", Change::Activated)));
    }
    assert_eq!(model.history(&mission()).count(), 8000);
    assert_eq!(model.history_left(), at(1999), "the changes up to this one have left");
    let other = MissionId { home: "r2".into(), ..mission() };
    assert_eq!(model.history(&other).count(), 0);
}

#[test]
fn a_plan_is_found_by_its_number_unless_it_is_too_large() {
    let mut model = Model::new(1);
    model.apply(at(0), status("r1", &[("main", "running")]));
    let spec = "module Work(host) { exec \"sleep 1\"; plain; done; }
        process main() { host { r1 } instantiated_processes { a instof Work(r1); } internal_event_actions { a } }";
    let compiled = language::compile(&language::Source::new("a.dca", spec), &[], &language::Options::named("a"));
    let plan = compiled.plan.expect("the spec is good");
    model.apply(at(1), Input::Plan { mission: mission(), plan: Box::new(plan.clone()) });
    let number = model.deployments().find_map(|live| Some(live.plan.as_ref()?.number)).expect("it has a plan");
    let found = model.planned(number).and_then(|live| live.plan.as_ref()?.plan.clone());
    assert_eq!(found.as_deref(), Some(&plan));
    assert!(model.planned(number + 1).is_none());
    // Another plan has another number.
    let mut large = plan;
    large.leaves = vec![large.leaves[0].clone(); 2000];
    model.apply(at(2), Input::Plan { mission: mission(), plan: Box::new(large) });
    assert!(model.planned(number).is_none());
    let known = model.deployments().find_map(|live| live.plan.as_ref()).expect("it has a plan");
    assert!(known.number > number && known.plan.is_none());
}
