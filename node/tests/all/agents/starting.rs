//! Programs that do not come up, on virtual time.

use super::WRITES;
use super::world::World;
use node::logic::protocol::Report;
use std::time::Duration;

#[test]
fn a_program_that_fails_before_the_start_says_why() {
    let text = r#"
process main() { host { "c1" } instantiated_processes { s instof Script("c1"); } internal_event_actions { s } }
"#;
    let mut world = World::new(&["c1"]);
    world.output = WRITES.map(str::to_owned).to_vec();
    world.fails_at_start = true;
    let call = world.deploy("c1", &text.replace("Script", "Stubborn"));
    world.run_for(Duration::from_secs(3));
    let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
    let [reason] = &reasons[..] else { panic!("{reasons:?}") };
    assert!(reason.starts_with("`main/s` cannot take part on `c1`: left with exit code 1"), "{reason}");
    assert!(reason.ends_with(&format!("; the end of its output:\n{}\n{}", WRITES[0], WRITES[1])), "{reason}");
}

#[test]
fn a_program_that_hangs_at_its_start_shows_what_it_wrote() {
    let text = r#"
process main() { host { "c1" } instantiated_processes { s instof Step("c1"); } internal_event_actions { s } }
"#;
    let patient = text.replace("Step(\"c1\");", "Step(\"c1\") { ready within 60 s; }");
    for (text, output, immortal, within) in [
        (text, &WRITES[..], false, 15),
        (text, &[], false, 15),
        (text, &[], true, 15),
        (&patient, &[], false, 60),
        (&patient, &[], true, 60),
    ] {
        let mut world = World::new(&["c1"]);
        world.output = output.iter().map(|line| (*line).to_owned()).collect();
        (world.hangs_at_start, world.immortal) = (true, immortal);
        let call = world.deploy("c1", text);
        world.run_for(Duration::from_secs(30 + within));
        let Report::Refused { reasons } = world.last_report(call) else { panic!("not refused") };
        let mut expected = format!("`main/s` cannot take part on `c1`: it was not ready within {within} s");
        expected += "; if it is a program that does not use DCA, its module needs `plain;`";
        if !output.is_empty() {
            expected += &format!("; the end of its output:\n{}", output.join("\n"));
        }
        assert_eq!(reasons, &[expected]);
        assert_eq!(world.alive.len(), usize::from(immortal), "it is ended");
    }
}
