//! Activities: their states, messages from people, and nodes that are killed while one runs.

use super::world::World;
use language::plan::Notice;
use node::logic::agent::Input;
use node::logic::protocol::{ActivityInput, Answer, Change, Delivery, Ending, Report, Request, Taken, TellRequest};
use std::time::Duration;

/// A robot that looks, waits for a word, and goes home. The activity runs on another host than the home of the deployment.
const MISSION: &str = r#"
activity Round(here: Host, there: Host) {
    host { there }
    in orders: Text;
    out say: Text;
    look instof Step(here);
    move instof Long(there);
    var rounds: 0..2 = 0;
    initial state looking {
        run look;
        on done when rounds < 2 -> looking { rounds += 1; log("round " + rounds); }
        on done -> waiting { say.send("ready"); }
    }
    state waiting { on message orders where text == "go" && priority >= 3 -> moving; on after 60 s -> abort("no order came"); }
    state moving { run move; on done -> done; }
    suspended state paused { on message orders where text == "on" -> resume; }
    on message orders where text == "halt" -> paused;
}
process main() {
    host { "c1" }
    instantiated_processes { round instof Round("c1", "c2"); }
    internal_event_actions { round }
}
"#;

/// The reports of the activity to people, in order.
fn said(world: &World, call: u64) -> Vec<String> {
    let text = |answer: &Answer| {
        let Answer::Report(Report::Process { path, change, .. }) = answer else { return None };
        match change {
            Change::Says { text, .. } if path == "main/round" => Some(text.clone()),
            Change::Entered { states } if path == "main/round" => Some(format!("is in {}", states.join(", "))),
            _ => None,
        }
    };
    world.answers.get(&call).into_iter().flatten().filter_map(text).collect()
}

fn tell(world: &mut World, process: &str, port: &str, text: &str, priority: u8) -> Result<String, String> {
    order(world, process, ActivityInput::Message { port: port.into(), text: text.into(), priority })
}

fn order(world: &mut World, process: &str, order: ActivityInput) -> Result<String, String> {
    let request = TellRequest { name: "test".into(), process: process.into(), order, by: "ann".into() };
    let call = world.ask("c1", Request::Tell(Box::new(request)));
    world.run_for(Duration::from_millis(100));
    match world.answers[&call].as_slice() {
        [Answer::Delivered(Delivery::Taken { path, .. })] => Ok(path.clone()),
        [Answer::Delivered(Delivery::Refused(why) | Delivery::Unconfirmed(why))] => Err(why.clone()),
        other => panic!("{other:?}"),
    }
}

/// The states of the activity, as `dca status` shows them.
fn status(world: &mut World) -> String {
    let call = world.ask("c2", Request::Status);
    world.run_for(Duration::from_millis(10));
    let [Answer::Status(status)] = world.answers[&call].as_slice() else { panic!("{:?}", world.answers[&call]) };
    let processes = status.deployments.iter().flat_map(|deployment| &deployment.processes);
    let states = processes.filter(|process| process.path == "main/round").map(|process| process.state.clone());
    states.collect()
}

fn wait_for(world: &mut World, call: u64, text: &str) {
    for _ in 0..200 {
        if said(world, call).iter().any(|said| said == text) {
            return;
        }
        world.run_for(Duration::from_millis(50));
    }
    panic!("{text:?} is not among {:?}", said(world, call));
}

#[test]
fn an_activity_runs_and_takes_messages() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", MISSION);
    wait_for(&mut world, call, "is in waiting");
    let expected = ["is in looking", "says: round 1", "says: round 2", "sends through `say`: ready", "is in waiting"];
    assert_eq!(said(&world, call), expected);
    assert_eq!(status(&mut world), "running; in waiting");
    assert_eq!(tell(&mut world, "round", "orders", "go", 2), Ok("main/round".to_owned()));
    assert_eq!(status(&mut world), "running; in waiting", "the priority is too low");
    assert_eq!(tell(&mut world, "round", "orders", "halt", 0), Ok("main/round".to_owned()));
    assert_eq!(status(&mut world), "running; in paused");
    assert_eq!(tell(&mut world, "main/round", "orders", "on", 0), Ok("main/round".to_owned()));
    assert_eq!(tell(&mut world, "round", "orders", "go", 3), Ok("main/round".to_owned()));
    assert_eq!(status(&mut world), "running; in moving");
    let no_port = tell(&mut world, "round", "order", "go", 3).unwrap_err();
    assert_eq!(no_port, "`main/round` has no input port `order`; it has `orders`");
    assert_eq!(tell(&mut world, "look", "orders", "go", 3).unwrap_err(), "`test` has no activity `look`");
    world.run_for(Duration::from_secs(30));
    assert_eq!(world.ending(call), &Ending::Done(Vec::new()));
}

#[test]
fn a_stop_leaves_nothing_of_an_activity() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", MISSION);
    wait_for(&mut world, call, "is in looking");
    world.stop("c1");
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Stopped);
    assert!(world.running.is_empty() && world.alive.is_empty());
}

/// A node that is killed and started again goes on in the state in which the activity was, with the same counters.
#[test]
fn a_node_that_is_started_again_goes_on_in_the_same_state() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", MISSION);
    wait_for(&mut world, call, "says: round 1");
    world.crash("c2");
    world.run_for(Duration::from_secs(1));
    world.adopt("c2");
    wait_for(&mut world, call, "is in waiting");
    let said = said(&world, call);
    assert_eq!(said.iter().filter(|said| *said == "says: round 1").count(), 1, "{said:?}");
    assert_eq!(said.iter().filter(|said| *said == "says: round 2").count(), 1, "{said:?}");
    tell(&mut world, "round", "orders", "go", 9).unwrap();
    world.run_for(Duration::from_secs(30));
    assert_eq!(world.ending(call), &Ending::Done(Vec::new()));
}

/// Its robot `c2` may be lost, and people may suspend it.
const GUARD: &str = r#"
activity Guard(here: Host, far: Host) {
    host { here }
    walk instof Walker(far);
    look instof Long(here);
    initial state out {
        run walk;
        on done -> done;
        on link far lost { log("it is silent"); }
        on host far lost -> back { log("it is lost"); }
        on parameter walk.way changed { log("another way"); }
    }
    state back { run look; on done -> done; }
    suspended state paused { on resume -> resume; }
    on suspend -> paused;
}
process main() {
    host { "c1" }
    instantiated_processes { round instof Guard("c1", "c2"); }
    internal_event_actions { round }
}
"#;

#[test]
fn people_suspend_an_activity_and_let_it_go_on() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", GUARD);
    wait_for(&mut world, call, "is in out");
    assert_eq!(order(&mut world, "round", ActivityInput::Notice(Notice::Suspend)), Ok("main/round".to_owned()));
    wait_for(&mut world, call, "is in paused");
    assert!(world.running.is_empty(), "{:?}", world.running);
    assert_eq!(order(&mut world, "round", ActivityInput::Notice(Notice::Resume)), Ok("main/round".to_owned()));
    world.run_for(Duration::from_secs(30));
    let ordered = ["gets the order of ann: suspend", "gets the order of ann: resume"];
    assert_eq!(said(&world, call), ["is in out", ordered[0], "is in paused", ordered[1], "is in out"]);
    assert_eq!(world.ending(call), &Ending::Done(Vec::new()));
}

#[test]
fn an_activity_without_a_place_to_suspend_says_so() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", MISSION);
    wait_for(&mut world, call, "is in looking");
    let refused = order(&mut world, "round", ActivityInput::Notice(Notice::Suspend)).unwrap_err();
    assert_eq!(refused, "`main/round` has no transition `on suspend`");
    let refused = order(&mut world, "round", ActivityInput::Notice(Notice::HostLost("c2".into()))).unwrap_err();
    assert_eq!(refused, "people cannot tell an activity of `host c2 lost`");
}

/// The transition of the lost host is taken, although the run that it leaves is on that host.
#[test]
fn an_activity_leaves_what_runs_on_a_lost_host() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", GUARD);
    wait_for(&mut world, call, "is in out");
    world.cut.insert("c2".to_owned());
    wait_for(&mut world, call, "is in back");
    world.run_for(Duration::from_secs(30));
    assert_eq!(said(&world, call), ["is in out", "says: it is silent", "says: it is lost", "is in back"]);
    let Report::Finished { ending, unconfirmed, .. } = world.last_report(call) else {
        panic!("{:?}", world.last_report(call))
    };
    assert_eq!((ending, unconfirmed.as_slice()), (&Ending::Done(Vec::new()), &["c2".to_owned()][..]));
}

#[test]
fn an_activity_hears_of_a_parameter_of_its_instance() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", GUARD);
    wait_for(&mut world, call, "is in out");
    let running = world.running.keys().find(|(host, _)| host == "c2").map(|(_, process)| process.clone());
    let process = running.expect("it walks");
    for name in ["speed", "way"] {
        let parameters = vec![(name.to_owned(), Some("left".to_owned()))];
        world.give("c2", Input::Configured { process: process.clone(), parameters });
    }
    world.run_for(Duration::from_millis(100));
    assert_eq!(said(&world, call), ["is in out", "says: another way"]);
}

/// It asks before it goes on. Without an answer it stays.
const ASKING: &str = r#"
activity Asker(here: Host) {
    host { here }
    look instof Step(here);
    move instof Long(here);
    initial state out {
        run look;
        on done confirm operator "Go on?" options(yes -> moving, no -> out, wait -> patient) default no after 20 s;
    }
    state patient { on after 1 s confirm operator "And now?" options(yes -> moving, no -> abort("no")); }
    state moving { run move; on done -> done; }
    suspended state paused { on resume -> resume; }
    on suspend -> paused;
}
process main() {
    host { "c1" }
    instantiated_processes { round instof Asker("c2"); }
    internal_event_actions { round }
}
"#;

fn answer(world: &mut World, question: u64, option: &str) -> Result<String, String> {
    order(world, "round", ActivityInput::Answer { question, option: option.into() })
}

/// The open questions of the activity, as `dca ctl` shows them, and the orders that it waits for.
fn asked(world: &mut World) -> (Vec<(u64, String)>, Vec<String>) {
    let call = world.ask("c2", Request::Status);
    world.run_for(Duration::from_millis(10));
    let [Answer::Status(status)] = world.answers[&call].as_slice() else { panic!("{:?}", world.answers[&call]) };
    let mut processes = status.deployments.iter().flat_map(|deployment| &deployment.processes);
    let activity = processes.find_map(|process| process.activity.clone()).expect("it runs");
    let questions = activity.questions.into_iter().map(|question| (question.number, question.text)).collect();
    (questions, activity.orders)
}

/// The first of two answers counts. The second one, which was under way at the same time, is recorded as well.
#[test]
fn one_of_two_answers_counts_and_both_are_recorded() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", ASKING);
    wait_for(&mut world, call, "asks, as question 1: Go on? (yes, no, wait; no after 20 s)");
    let (questions, orders) = asked(&mut world);
    assert_eq!(questions, [(1, "Go on? (yes, no, wait; no after 20 s)".to_owned())]);
    assert_eq!(orders, ["suspend"]);
    let refused = answer(&mut world, 1, "maybe").unwrap_err();
    assert_eq!(refused, "no question of `main/round` has the answer `maybe`");
    let [_, second] = [("ann", "yes"), ("bob", "no")].map(|(by, option)| {
        let told = ActivityInput::Answer { question: 1, option: option.into() };
        let request = TellRequest { name: "test".into(), process: "round".into(), order: told, by: by.into() };
        world.ask("c1", Request::Tell(Box::new(request)))
    });
    world.run_for(Duration::from_secs(1));
    let [Answer::Delivered(Delivery::Refused(why))] = world.answers[&second].as_slice() else {
        panic!("{:?}", world.answers[&second])
    };
    assert_eq!(why, "question 1 of `main/round` is not open: the answer `yes` of ann was taken");
    let said = said(&world, call);
    let expected = [
        "is in out",
        "is in out?",
        "asks, as question 1: Go on? (yes, no, wait; no after 20 s)",
        "gets the answer `yes` of ann to question 1",
        "is in moving",
        "does not take the answer `no` of bob to question 1: it is not open",
    ];
    assert_eq!(said, expected);
    world.run_for(Duration::from_secs(30));
    assert_eq!(world.ending(call), &Ending::Done(Vec::new()));
}

#[test]
fn a_question_without_an_answer_gets_its_default_or_waits() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", ASKING);
    wait_for(&mut world, call, "asks, as question 1: Go on? (yes, no, wait; no after 20 s)");
    world.run_for(Duration::from_secs(25));
    assert!(said(&world, call).contains(&"closes question 1: no answer came in time, so it is `no`".to_owned()));
    wait_for(&mut world, call, "asks, as question 2: Go on? (yes, no, wait; no after 20 s)");
    // An answer to the first question is not one to the second.
    assert_eq!(answer(&mut world, 1, "yes").unwrap_err(), "question 1 of `main/round` is not open");
    assert_eq!(status(&mut world), "running; in out?");
    answer(&mut world, 2, "wait").unwrap();
    wait_for(&mut world, call, "asks, as question 3: And now? (yes, no)");
    world.run_for(Duration::from_secs(3600));
    assert_eq!(status(&mut world), "running; in patient?");
    order(&mut world, "round", ActivityInput::Notice(Notice::Suspend)).unwrap();
    wait_for(&mut world, call, "closes question 3: it is withdrawn");
    order(&mut world, "round", ActivityInput::Notice(Notice::Resume)).unwrap();
    wait_for(&mut world, call, "asks, as question 4: And now? (yes, no)");
    // A stop needs no answer.
    world.stop("c1");
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Stopped);
    assert_eq!(said(&world, call).last().map(String::as_str), Some("closes question 4: it is withdrawn"));
}

/// It asks the same question again as soon as an answer was taken, or its time is over.
const DRILLING: &str = r#"
activity Driller(here: Host) {
    host { here }
    var holes: 0..9 = 0;
    initial state ready { on always confirm operator "Drill?" options(yes -> drilled, no -> ready) default no after 20 s; }
    state drilled { on entry { holes += 1; log("hole " + holes); } on always when holes < 3 -> ready; on always -> done; }
}
process main() {
    host { "c1" }
    instantiated_processes { round instof Driller("c2"); }
    internal_event_actions { round }
}
"#;

/// A late answer is none to the question that follows at once, even if both read the same.
#[test]
fn a_question_that_is_asked_again_at_once_has_a_new_number() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", DRILLING);
    let number = |world: &mut World| asked(world).0.iter().map(|(number, _)| *number).collect::<Vec<_>>();
    wait_for(&mut world, call, "asks, as question 1: Drill? (yes, no; no after 20 s)");
    answer(&mut world, 1, "yes").unwrap();
    wait_for(&mut world, call, "asks, as question 2: Drill? (yes, no; no after 20 s)");
    let refused = answer(&mut world, 1, "yes").unwrap_err();
    assert_eq!(refused, "question 1 of `main/round` is not open: the answer `yes` of ann was taken");
    assert_eq!(number(&mut world), [2]);
    world.run_for(Duration::from_secs(25));
    assert_eq!(number(&mut world), [3], "{:?}", said(&world, call));
    assert!(said(&world, call).contains(&"closes question 2: no answer came in time, so it is `no`".to_owned()));
    answer(&mut world, 3, "no").unwrap();
    for question in 4..=5 {
        assert_eq!(number(&mut world), [question]);
        answer(&mut world, question, "yes").unwrap();
    }
    world.run_for(Duration::from_secs(1));
    assert_eq!(world.ending(call), &Ending::Done(Vec::new()));
    let holes: Vec<String> = said(&world, call).into_iter().filter(|said| said.contains("hole")).collect();
    assert_eq!(holes, ["says: hole 1", "says: hole 2", "says: hole 3"]);
}

/// The question is still open after the node of the activity was killed, and has the same number.
#[test]
fn a_node_that_is_started_again_still_waits_for_the_answer() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", ASKING);
    wait_for(&mut world, call, "asks, as question 1: Go on? (yes, no, wait; no after 20 s)");
    world.crash("c2");
    world.run_for(Duration::from_secs(1));
    world.adopt("c2");
    world.run_for(Duration::from_secs(1));
    answer(&mut world, 1, "yes").unwrap();
    wait_for(&mut world, call, "is in moving");
    assert_eq!(said(&world, call).iter().filter(|said| said.starts_with("asks")).count(), 1);
}

/// An answer to the question before the change is no answer to the question after it.
#[test]
fn a_question_that_changes_is_asked_under_a_new_number() {
    let mut world = World::new(&["c1", "c2"]);
    let asking = ASKING.replace(" default no after 20 s", "");
    let call = world.deploy("c1", &asking);
    wait_for(&mut world, call, "asks, as question 1: Go on? (yes, no, wait)");
    // Another question with a place before it, and the same one.
    let more = "state before { on after 1 s confirm operator \"First?\" options(yes -> moving, no -> out); }\n    initial state out";
    let same = asking.replace("initial state out", more);
    world.change("c1", &same, (1, 0), &[]);
    world.run_for(Duration::from_secs(5));
    assert_eq!(asked(&mut world).0, [(1, "Go on? (yes, no, wait)".to_owned())]);
    world.change("c1", &same.replace("Go on?", "Really?"), (1, 1), &[]);
    wait_for(&mut world, call, "closes question 1: the activity has changed");
    wait_for(&mut world, call, "asks, as question 2: Really? (yes, no, wait)");
    world.run_for(Duration::from_secs(5));
    assert_eq!(answer(&mut world, 1, "yes").unwrap_err(), "question 1 of `main/round` is not open");
    answer(&mut world, 2, "yes").unwrap();
    wait_for(&mut world, call, "is in moving");
}

/// Two activities, the second after the first. The stop of the program of the first takes 3 s.
const CONFIRMING: &str = r#"
activity First(here: Host) {
    host { here }
    in m: Text queue 2;
    move instof Stubborn(here);
    look instof Long(here);
    var n: 0..9 = 0;
    initial state out {
        run move;
        on message m where text == "next" -> next;
        on message m where text == "end" -> done;
        on message m where text == "hello" { log("hello"); }
    }
    state next { run look; on message m where text == "count" { n += 1; } on message m where text == "end" -> done; }
}
process main() {
    host { "c1" }
    instantiated_processes { round instof First("c2"); after instof First("c2"); }
    internal_event_actions { round ; after }
}
"#;

/// Gives a message to an activity. Returns the answer, once there is one.
fn delivered(world: &mut World, process: &str, text: &str) -> Delivery {
    let order = ActivityInput::Message { port: "m".into(), text: text.into(), priority: 0 };
    let request = TellRequest { name: "test".into(), process: process.into(), order, by: "ann".into() };
    let call = world.ask("c1", Request::Tell(Box::new(request)));
    for _ in 0..1000 {
        world.run_for(Duration::from_millis(10));
        if let Some([Answer::Delivered(told)]) = world.answers.get(&call).map(Vec::as_slice) {
            return told.clone();
        }
    }
    panic!("no answer: {:?}", world.answers.get(&call));
}

fn taken(path: &str, taken: Taken) -> Delivery {
    Delivery::Taken { path: path.into(), taken }
}

#[test]
fn an_activity_confirms_what_it_does_with_a_message() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", CONFIRMING);
    wait_for(&mut world, call, "is in out");
    let idle = |path: &str| Delivery::Refused(format!("`{path}` is not active"));
    assert_eq!(delivered(&mut world, "after", "next"), idle("main/after"));
    assert_eq!(delivered(&mut world, "round", "what"), taken("main/round", Taken::Ignored));
    assert_eq!(delivered(&mut world, "round", "hello"), taken("main/round", Taken::Reacted));
    world.suspended = true;
    assert_eq!(delivered(&mut world, "round", "next"), taken("main/round", Taken::Reacted));
    // Its transition waits for a stop that no shim carries out.
    assert_eq!(delivered(&mut world, "round", "count"), taken("main/round", Taken::Waits));
    assert_eq!(delivered(&mut world, "round", "count"), taken("main/round", Taken::Waits));
    assert_eq!(status(&mut world), "running; between two states");
    let full = Delivery::Refused("too many messages wait at `m` of `main/round`".to_owned());
    assert_eq!(delivered(&mut world, "round", "count"), full);
}

#[test]
fn an_activity_that_has_ended_takes_no_message() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", CONFIRMING);
    wait_for(&mut world, call, "is in out");
    assert_eq!(delivered(&mut world, "round", "end"), taken("main/round", Taken::Reacted));
    world.run_for(Duration::from_secs(1));
    assert_eq!(delivered(&mut world, "round", "end"), Delivery::Refused("`main/round` is not active".to_owned()));
    // The answer to the order that ends the deployment comes before its end.
    assert_eq!(delivered(&mut world, "after", "end"), taken("main/after", Taken::Reacted));
    world.run_for(Duration::from_secs(5));
    assert_eq!(world.ending(call), &Ending::Done(Vec::new()));
}

#[test]
fn a_message_to_a_host_that_is_cut_off_is_not_confirmed() {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", CONFIRMING);
    wait_for(&mut world, call, "is in out");
    world.cut.insert("c2".to_owned());
    let why =
        "the order was sent to host `c2`, and `main/round` has not confirmed it within 3 s; the order may still arrive";
    assert_eq!(delivered(&mut world, "round", "next"), Delivery::Unconfirmed(why.to_owned()));
}

/// It counts ticks, and fails unless there were 20 of them before another timer.
const TICKING: &str = r#"
activity Ticker(here: Host) {
    host { here }
    look instof Long(here);
    var n: 0..100 = 0;
    initial state counting {
        run look;
        on every 100 ms { n += 1; }
        on after 2050 ms when n == 20 -> done;
        on after 2050 ms -> abort("other");
    }
}
process main() {
    host { "c1" }
    instantiated_processes { round instof Ticker("c2"); }
    internal_event_actions { round }
}
"#;

/// Ticks of the time in which the node was away come before a timer that is due after them.
#[test]
fn an_activity_makes_up_for_ticks_that_its_node_has_missed() {
    for away in [0, 700, 1900] {
        let mut world = World::new(&["c1", "c2"]);
        let call = world.deploy("c1", TICKING);
        wait_for(&mut world, call, "is in counting");
        world.run_for(Duration::from_millis(330));
        if away > 0 {
            world.crash("c2");
            world.run_for(Duration::from_millis(away));
            world.adopt("c2");
        }
        world.run_for(Duration::from_secs(20));
        assert_eq!(world.ending(call), &Ending::Done(Vec::new()), "away for {away} ms");
    }
}
