//! Programs that come and go, and event actions that change, while a deployment runs; and many users at once.

use super::changes::{FEED, check, is_over, lives, outcome, revision, start};
use super::world::{Draw, World};
use node::logic::protocol::{Answer, Change, Ending, Report};
use std::collections::BTreeSet;
use std::ops::Range;
use std::time::Duration;

/// One more program, which hears the sensor.
fn with_extra(way: &str) -> String {
    FEED.replace(
        "task instof Long",
        &format!("extra instof Tuned(\"c2\", {way}) {{ watchdog 200 ms; }}; task instof Long"),
    )
    .replace(
        "internal_event_actions {",
        "internal_connections(extra, ear) { sensor, Out -> extra, In; }\n    internal_event_actions {",
    )
    .replace("# task }", "# extra[ear] # task }")
}

fn activated<'a>(world: &'a World, call: u64) -> Vec<&'a str> {
    let path = |answer: &'a Answer| match answer {
        Answer::Report(Report::Process { path, change: Change::Activated, .. }) => Some(path.as_str()),
        _ => None,
    };
    world.answers[&call].iter().filter_map(path).collect()
}

/// The same, without an end.
fn endless(text: &str) -> String {
    text.replace("# task }", "# (task ;; skip) }")
}

#[test]
fn a_program_is_added_runs_and_is_taken_away_and_all_others_stay() {
    let mut world = World::new(&["c1", "c2"]);
    let feed = endless(FEED);
    let call = world.deploy("c1", &feed);
    world.run_for(Duration::from_secs(1));
    let before = world.running.clone();
    let change = world.change("c1", &endless(&with_extra("better")), (1, 0), &[]);
    world.run_for(Duration::from_secs(5));
    let lines = outcome(&world, change).unwrap();
    let expected = [
        "add        main/extra: Tuned on `c2`",
        "act        main: its event actions",
        "connect    main/sensor, Out -> main/extra, In",
    ];
    assert_eq!(lines, expected);
    assert_eq!(lives(&world), [1, 1, 1, 1, 1]);
    check(&mut world);
    assert!(activated(&world, call).ends_with(&["main/extra"]), "{:?}", activated(&world, call));
    assert!(before.iter().all(|(process, activation)| world.running.get(process) == Some(activation)));
    // The same spec again changes nothing, and a change of the new one is one like any other.
    let again = world.change("c1", &endless(&with_extra("better")), (1, 1), &[]);
    world.run_for(Duration::from_secs(1));
    assert_eq!(outcome(&world, again), Ok(vec![]));
    let away = world.change("c1", &feed, (1, 1), &[]);
    world.run_for(Duration::from_secs(5));
    assert_eq!(outcome(&world, away).map(|lines| lines.len()), Ok(3));
    assert_eq!((lives(&world), world.alive.len()), (vec![1, 1, 1, 1, 1], 4), "it has left, and no other has");
    check(&mut world);
    // It comes back under the number that it had.
    let back = world.change("c1", &endless(&with_extra("better")), (1, 2), &[]);
    world.run_for(Duration::from_secs(5));
    assert!(outcome(&world, back).is_ok());
    assert_eq!(lives(&world), [1, 1, 1, 1, 2]);
    check(&mut world);
    world.stop("c1");
    world.run_for(Duration::from_secs(20));
    assert_eq!(world.ending(call), &Ending::Stopped);
    assert_eq!((&world.alive, &world.wires_open), (&BTreeSet::new(), &BTreeSet::new()));
}

/// The program does not confirm its stop before it has to leave. The user has ordered its end, so it does not count as an abort.
#[test]
fn a_program_that_is_removed_while_it_runs_was_stopped() {
    let mut world = World::new(&["c1", "c2"]);
    let feed = endless(FEED);
    let rock = feed.replace("task instof Long", "rock instof Stubborn(\"c2\"); task instof Long");
    let call = world.deploy("c1", &rock.replace("# (task", "# rock # (task"));
    world.run_for(Duration::from_secs(1));
    assert!(activated(&world, call).contains(&"main/rock"));
    let away = world.change("c1", &feed, (1, 0), &[]);
    world.run_for(Duration::from_secs(5));
    assert!(outcome(&world, away).is_ok());
    let ended = |answer: &Answer| match answer {
        Answer::Report(Report::Process { path, change: Change::Ended(ending), .. }) if path == "main/rock" => {
            Some(ending.clone())
        }
        _ => None,
    };
    assert_eq!(world.answers[&call].iter().filter_map(ended).collect::<Vec<_>>(), [Ending::Stopped]);
    assert!(!is_over(&world, call) && world.alive.len() == 4, "the others stay");
    check(&mut world);
}

#[test]
fn an_added_program_that_is_not_healthy_is_taken_away_and_the_mission_goes_on() {
    for way in ["dies", "aborts", "missing"] {
        let mut world = World::new(&["c1", "c2"]);
        let call = start(&mut world);
        let change = world.change("c1", &with_extra(way), (1, 0), &[]);
        world.run_for(Duration::from_secs(6));
        let reasons = outcome(&world, change).unwrap_err();
        let why =
            if way == "missing" { "cannot be started" } else { "the new program of `main/extra` was not healthy" };
        assert!(reasons[0].contains(why), "{way}: {reasons:?}");
        assert_eq!((world.alive.len(), revision(&mut world).revision), (4, 0), "{way}");
        check(&mut world);
        assert!(!is_over(&world, call), "{way}");
        world.run_for(Duration::from_secs(20));
        assert_eq!(world.ending(call), &Ending::Done(vec![]), "{way}");
    }
}

/// The running members must have a place in the new event actions; all misfits are reported.
#[test]
fn event_actions_change_where_what_runs_has_its_place() {
    let mut world = World::new(&["c1", "c2"]);
    let call = start(&mut world);
    let then = FEED.replace("# task }", "# (task ; (wait(1 s) # never)) }");
    let change = world.change("c1", &then, (1, 0), &[]);
    world.run_for(Duration::from_secs(1));
    assert_eq!(outcome(&world, change), Ok(vec!["act        main: its event actions".to_owned()]));
    let other = then.replace("sensor[feed] # filter[on]", "(sensor[feed] ; filter[on])");
    let change = world.change("c1", &other, (1, 1), &[]);
    world.run_for(Duration::from_secs(1));
    let why = "host `c1`: the event actions of `main` cannot change now: `main/filter` runs, and the new event actions have no place for \
               it there; wait until that has ended, or stop the deployment";
    assert_eq!(outcome(&world, change), Err(vec![why.to_owned()]));
    check(&mut world);
    world.run_for(Duration::from_secs(20));
    assert_eq!(world.ending(call), &Ending::Done(vec![]));
}

/// Programs are added and taken away, event actions change, and something is killed or lost: it is so everywhere or nowhere.
#[test]
fn what_comes_and_goes_does_so_everywhere_or_nowhere() {
    what_comes_and_goes_does_so_everywhere_or_nowhere_for(0..100);
}

#[test]
#[ignore = "long: 500 seeds"]
fn what_comes_and_goes_does_so_everywhere_or_nowhere_for_more_seeds() {
    what_comes_and_goes_does_so_everywhere_or_nowhere_for(100..600);
}

fn what_comes_and_goes_does_so_everywhere_or_nowhere_for(seeds: Range<u64>) {
    let count = seeds.end - seeds.start;
    let (mut made, mut undone) = (0, 0);
    for seed in seeds.clone() {
        let mut draw = Draw::new(seed);
        let mut world = World::new(&["c1", "c2"]);
        world.loses_by_chance = (seed % 3 > 0).then(|| (Draw::new(!seed), 4 + seed % 20));
        let call = start(&mut world);
        let ways = ["good", "better", "dies", "aborts"];
        let mut calls = Vec::new();
        for round in 0..3 {
            let text = match draw.below(4) {
                0 => FEED.to_owned(),
                1 => FEED.replace("# task }", "# (task ; skip) }"),
                _ => with_extra(ways[draw.index(4)]),
            };
            let seen = calls
                .iter()
                .filter(|call| {
                    world.answers.contains_key(*call) && outcome(&world, **call).is_ok_and(|lines| !lines.is_empty())
                })
                .count();
            calls.push(world.change("c1", &text, (1, u32::try_from(seen).expect("few are seen")), &[]));
            world.run_for(Duration::from_millis(draw.below(40)));
            if round == 1 {
                match draw.below(4) {
                    0 => world.kill_if_alive("c2", 1),
                    1 => world.kill_if_alive("c2", 4),
                    2 => drop(world.stop("c1")),
                    _ => {}
                }
            }
            world.run_for(Duration::from_secs(8));
            if world.answers.contains_key(&calls[round]) && !is_over(&world, call) {
                check(&mut world);
                let live = revision(&mut world).plan.live_leaves().len();
                assert!(world.alive.len() <= live, "seed {seed}: {:?}", world.alive);
            }
            match world.answers.contains_key(&calls[round]).then(|| outcome(&world, calls[round])) {
                Some(Ok(_)) => made += 1,
                Some(Err(_)) => undone += 1,
                None => {}
            }
        }
        world.run_for(Duration::from_secs(90));
        assert!(is_over(&world, call), "seed {seed}: {:?}", world.answers[&call]);
        assert_eq!((&world.alive, &world.wires_open), (&BTreeSet::new(), &BTreeSet::new()), "seed {seed}");
    }
    assert!(made * 2 > count && undone * 2 > count, "{made} made, {undone} not");
}

/// A hundred users deploy one name at the same time, again and again, from both hosts: one wins, the others are told
/// the winner.
#[test]
fn of_many_deploys_of_one_name_one_wins_and_nothing_is_mixed() {
    for seed in 0..20 {
        let mut draw = Draw::new(seed);
        let mut world = World::new(&["c1", "c2"]);
        world.run_for(Duration::from_millis(10));
        let texts = [FEED.to_owned(), with_extra("good"), FEED.replace("Tuned(\"c2\")", "Tuned(\"c2\", better)")];
        let mut calls = Vec::new();
        for _ in 0..100 {
            let which = draw.index(3);
            calls.push((world.deploy("c1", &texts[which]), which));
            world.run_for(Duration::from_millis(draw.below(3)));
        }
        world.run_for(Duration::from_secs(3));
        let is_refused = |call: &u64| matches!(world.last_report(*call), Report::Refused { .. });
        let winners: Vec<_> = calls.iter().filter(|(call, _)| !is_refused(call)).collect();
        assert_eq!(winners.len(), 1, "seed {seed}");
        for (call, _) in calls.iter().filter(|(call, _)| is_refused(call)) {
            let Report::Refused { reasons } = world.last_report(*call) else { unreachable!("it is refused") };
            assert!(reasons[0].starts_with("`test` is already deployed by ann"), "{reasons:?}");
        }
        let leaves = if winners[0].1 == 1 { 5 } else { 4 };
        assert_eq!((world.alive.len(), lives(&world)), (leaves, vec![1; leaves]), "seed {seed}");
        world.run_for(Duration::from_secs(20));
        assert_eq!(world.ending(winners[0].0), &Ending::Done(vec![]), "seed {seed}");
    }
}
