//! Stories of `dca verify` are kept as tests and played in the simulator. They disappear once the spec is repaired.

use dca_tests::cluster::Cluster;

const WRONG: &str = "
module Arm { done; }
process main(){
    host{c1}
    resource table, tool;
    instantiated_processes{ fetch instof Arm(c1); take instof Arm(c1); bring instof Arm(c1); put instof Arm(c1); }
    internal_event_actions{
        using(table) (fetch ; using(tool) take), using(tool) (bring ; using(table) put)
    }
    verify{ put only after take.done; }
}";

#[test]
fn a_mistake_is_kept_as_a_test_until_it_is_gone() {
    let cluster = Cluster::new();
    let here = cluster.here();
    cluster.file("cups.dca", WRONG);
    let found = here.ask(&["verify", "cups.dca", "--test", "kept"]);
    assert_eq!(found.code, Some(1), "{found}");
    let [stuck, order] = ["kept/cups-e0811-1.story", "kept/cups-e0817-2.story"];
    assert!(found.err.contains(&format!("written: {stuck}")) && found.err.contains(order), "{found}");

    // Before the repair.
    let failed = here.ask(&["test", "kept"]);
    assert!(failed.code == Some(1) && failed.out.contains("2 tests: 0 passed, 2 failed"), "{failed}");
    assert!(failed.out.contains("it happens again in the same way"), "{failed}");
    let same = here.ask(&["sim", "cups.dca", "--replay", stuck]);
    assert!(same.code == Some(0) && same.out.contains("the run ends as in the story"), "{same}");
    let report = here.ask(&["verify", "cups.dca", "--json"]);
    cluster.file("report.json", &report.out);
    let same = here.ask(&["sim", "cups.dca", "--replay", "report.json"]);
    assert!(same.code == Some(0) && same.out.contains("the run ends as in the story"), "{same}");

    // This repairs only half: the order of the cups is still wrong, and removing the sentence does not repair it.
    let half = WRONG
        .replace("using(table) (fetch ; using(tool) take)", "using(table, tool) (fetch ; take)")
        .replace("using(tool) (bring ; using(table) put)", "using(table, tool) (bring ; put)")
        .replace("verify{ put only after take.done; }", "");
    cluster.file("cups.dca", &half);
    let halved = here.ask(&["test", stuck, order]);
    assert!(halved.code == Some(1) && halved.out.contains(&format!("passed {stuck}")), "{halved}");
    assert!(halved.out.contains(&format!("FAILED {order}")) && halved.out.contains("1 failed"), "{halved}");
    let other = here.ask(&["sim", "cups.dca", "--replay", stuck]);
    assert!(other.code == Some(1) && other.err.contains("the story ends after step 2"), "{other}");

    // This repairs everything.
    let right = half.replace("(fetch ; take), using", "(fetch ; take) ; using");
    cluster.file("cups.dca", &right);
    let passed = here.ask(&["test", "kept"]);
    assert!(passed.code == Some(0) && passed.out.contains("2 tests: 2 passed, 0 failed"), "{passed}");

    // A process with a new name does not count as a repair.
    cluster.file("cups.dca", &right.replace("fetch", "grab"));
    let unfit = here.ask(&["test", stuck]);
    assert!(unfit.code == Some(1) && unfit.out.contains("there is no process `main/fetch` any more"), "{unfit}");
    let none = here.ask(&["test", "."]);
    assert!(none.code == Some(1) && none.err.contains("`dca verify SPEC --test FOLDER` writes such files"), "{none}");
    let broken = here.ask(&["test", "cups.dca"]);
    assert!(broken.code == Some(1) && broken.err.contains("is not a test: line 2"), "{broken}");
}
