//! `else match` chooses by the reason of a failure, also of one in a group on another host, on virtual time.

use super::losses::cut;
use super::world::World;
use node::logic::protocol::{Ending, FailureCause, Report};
use shim::protocol::ShimReport;
use std::time::Duration;

/// Each arm fails with its own word.
fn mission(work: &str, actions: &str) -> String {
    let arms = [
        "timeout",
        "\"no way\"",
        "reported",
        "crash",
        "host_lost",
        "busy",
        "stop_unconfirmed",
        "service_ended",
        "no_match",
        "else",
    ];
    let arms: Vec<String> = arms.iter().map(|arm| format!("{arm} => fail(\"{}\")", arm.replace('"', ""))).collect();
    format!(
        "process Inner(there) {{
            host {{ there }}
            instantiated_processes {{ work instof {work}; other instof Long(there); }}
            internal_event_actions {{ {actions} }}
        }}
        process Far(there) {{
            host {{ there }}
            instantiated_processes {{ inner instof Inner(there); }}
            internal_event_actions {{ inner }}
        }}
        process main() {{
            host {{ \"c1\" }}
            instantiated_processes {{ far instof Far(\"c2\"); }}
            internal_event_actions {{ far else match {{ {} }} }}
        }}",
        arms.join(", ")
    )
}

/// Runs the mission, lets something happen after a second, and returns the word of the arm that was taken.
fn arm(work: &str, actions: &str, happens: impl FnOnce(&mut World)) -> String {
    let mut world = World::new(&["c1", "c2"]);
    let call = world.deploy("c1", &mission(work, actions));
    world.run_for(Duration::from_secs(1));
    happens(&mut world);
    world.run_for(Duration::from_secs(12));
    let Report::Finished { ending: Ending::Aborted(failure), .. } = world.last_report(call) else {
        panic!("{:?}", world.last_report(call))
    };
    let FailureCause::Failed(word) = &failure.cause else { panic!("{failure}") };
    assert_eq!(failure.origin, "main", "the arm fails, and not the work");
    word.clone()
}

#[test]
fn each_failure_of_a_group_elsewhere_has_one_reason() {
    let kill = |world: &mut World| world.kill("c2", 0);
    assert_eq!(arm("Long(there)", "work", kill), "crash");
    assert_eq!(arm("Tuned(there, dies)", "work", |_| {}), "crash");
    assert_eq!(arm("Tuned(there, aborts)", "work", |_| {}), "reported");
    assert_eq!(arm("Tuned(there, ends)", "work", |_| {}), "service_ended");
    assert_eq!(arm("Long(there)", "work within 2 s", |_| {}), "timeout");
    assert_eq!(arm("Long(there)", "work else fail(\"no way\")", kill), "no way");
    assert_eq!(arm("Long(there)", "work else fail(\"no such way\")", kill), "else");
    assert_eq!(arm("Long(there)", "work", |world| cut(world, "c2")), "host_lost");
    // A plain program says with its exit code that it has failed.
    let plain = |how: ShimReport| {
        let ends = |world: &mut World| {
            while world.running.is_empty() {
                world.run_for(Duration::from_millis(10));
            }
            world.end("c2", 0, how);
        };
        arm("Script(there)", "wait(1500 ms) ; work", ends)
    };
    assert_eq!(plain(ShimReport::Exited { code: 3 }), "reported");
    assert_eq!(plain(ShimReport::Signalled { signal: 9 }), "crash");
}
