//! The conditions of reactive nodes and of `PipelineSequence` watch each child that runs behind them.

use import::{Imported, import};
use language::Source;

fn tree(inside: &str) -> Imported {
    let text = format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"T\">{inside}</BehaviorTree></root>");
    import(&Source::new("tree.xml", text), &[]).unwrap_or_else(|error| panic!("{error}\n{inside}"))
}

/// The event actions of the last group in one line, without comments.
fn actions(imported: &Imported) -> String {
    let (_, actions) = imported.text.rsplit_once("internal_event_actions{").expect("a group has event actions");
    let lines = actions.lines().map(str::trim).filter(|line| !line.starts_with("//"));
    let text = lines.collect::<Vec<_>>().join(" ");
    text.trim().trim_end_matches([' ', '}']).replace("( ", "(").replace(" )", ")")
}

#[track_caller]
fn becomes(inside: &str, expected: &str, remarks: &[&str]) {
    let imported = tree(inside);
    assert_eq!(actions(&imported), expected, "{inside}\n{}", imported.text);
    let found: Vec<&str> = imported.remarks.iter().map(|remark| remark.text.as_str()).collect();
    assert_eq!(found.len(), remarks.len(), "{found:#?}");
    for (found, expected) in found.iter().zip(remarks) {
        assert!(found.starts_with(expected), "{found}, not {expected}");
    }
}

#[test]
fn each_child_of_a_reactive_node_is_guarded_by_the_conditions_before_it() {
    becomes(
        "<ReactiveSequence><Condition ID=\"BatteryOK\"/><Action ID=\"Fetch\"/><Action ID=\"Report\"/></ReactiveSequence>",
        "battery_ok ; (fetch # while_battery_ok) ; (report # while_battery_ok)",
        &["<Action> runs once here; in the tree, it starts again at each tick of a later node"],
    );
    becomes(
        "<ReactiveFallback><Condition ID=\"AtGoal\"/><Action ID=\"Fly\"/><Action ID=\"Drive\"/></ReactiveFallback>",
        "at_goal else (fly # until_at_goal) else (drive # until_at_goal)",
        &["<Action> runs once here; in the tree, it starts again at each tick of a later node"],
    );
    becomes(
        "<ReactiveSequence><Condition ID=\"A\"/><Action ID=\"X\"/><Inverter><Condition ID=\"B\"/></Inverter>\
         <Sequence><Action ID=\"Y\"/><Action ID=\"Z\"/></Sequence></ReactiveSequence>",
        "a ; (x # while_a) ; ((b as yes else skip as no) : match { yes => fail(\"B has succeeded\"), no => skip }) ; \
         ((y ; z) # while_a # (until_b ; fail(\"B has succeeded\")))",
        &["<Action> runs once here"],
    );
}

/// Leaves whose sort no file says are read as conditions. They are guarded like actions, since they may be actions.
#[test]
fn a_leaf_that_may_be_an_action_is_guarded_and_noted() {
    becomes(
        "<ReactiveSequence><Condition ID=\"BatteryOK\"/><Sequence><Fetch/><Carry/></Sequence><Drop/></ReactiveSequence>",
        "battery_ok ; ((fetch ; carry) # while_battery_ok) ; (drop # while_battery_ok # (while_fetch # while_carry))",
        &[
            "no file says whether <Fetch> is a condition; it is read as a condition",
            "no file says whether <Carry> is a condition; it is read as a condition",
        ],
    );
    let imported = tree("<WhileDoElse><Sequence><Fetch/><Carry/></Sequence><Drop/></WhileDoElse>");
    assert!(
        imported.remarks.iter().any(|remark| remark.text.contains("<Fetch>") || remark.text.contains("chosen once"))
    );
    let imported = tree("<WhileDoElse><IsOpen/><Go/><Stop/></WhileDoElse>");
    assert!(imported.remarks.iter().any(|remark| remark.text.contains("<IsOpen> is a condition")));
}

#[test]
fn a_subtree_inside_a_reactive_node_is_guarded() {
    let text = "<root BTCPP_format=\"4\" main_tree_to_execute=\"T\"><BehaviorTree ID=\"T\"><ReactiveSequence>\
                <Condition ID=\"Ok\"/><SubTree ID=\"S\"/><ReactiveSequence><Condition ID=\"C\"/><Action ID=\"X\"/>\
                </ReactiveSequence><Action ID=\"Y\"/></ReactiveSequence></BehaviorTree>\
                <BehaviorTree ID=\"S\"><Action ID=\"Z\"/></BehaviorTree></root>";
    let imported = import(&Source::new("tree.xml", text), &[]).expect("a good tree");
    assert_eq!(
        actions(&imported),
        "ok ; (s # while_ok) ; ((c ; (x # while_c)) # while_ok) ; (y # while_ok)",
        "{}",
        imported.text
    );
    assert_eq!(imported.remarks.len(), 2, "{:?}", imported.remarks);
}

/// The watcher of a condition knows nothing of the condition of its node: without a remark it would watch a skipped node.
#[test]
fn a_condition_with_a_condition_of_its_own_is_not_watched() {
    becomes(
        "<ReactiveSequence><Condition ID=\"A\"/><Condition ID=\"B\" _onSuccess=\"n := 1\"/><Action ID=\"X\"/></ReactiveSequence>",
        "a ; ((b ; script) # while_a) ; (x # while_a)",
        &["<Condition> runs once here", "`Script` is a program that you have to write"],
    );
}

#[test]
fn the_rate_of_a_pipeline_is_kept_while_each_later_child_runs() {
    becomes(
        "<PipelineSequence><RateController hz=\"1\"><Action ID=\"A\"/></RateController><Action ID=\"B\"/>\
         <Action ID=\"C\"/></PipelineSequence>",
        "a ; ((b ; c) # (wait(1 s) ;; a))",
        &["<Action> runs once here; in the tree, it starts again at each tick of a later node"],
    );
    becomes(
        "<PipelineSequence><RateController hz=\"1\"><Action ID=\"A\"/></RateController>\
         <RateController hz=\"2\"><Action ID=\"B\"/></RateController><Action ID=\"C\"/></PipelineSequence>",
        "a ; ((b ; (c # (wait(500 ms) ;; b))) # (wait(1 s) ;; a))",
        &[],
    );
    becomes(
        "<PipelineSequence><Condition ID=\"Ok\"/><Action ID=\"B\"/></PipelineSequence>",
        "ok ; (b # while_ok)",
        &[],
    );
    let text = "<PipelineSequence><RateController hz=\"1\" _skipIf=\"x > 1\"><Action ID=\"A\"/></RateController>\
                <Action ID=\"B\"/></PipelineSequence>";
    assert!(tree(text).text.contains("x > 1"), "the condition of the RateController is not lost");
}

/// Each watcher stands behind each later child: the text must not grow without a limit before it is refused.
#[test]
fn a_long_reactive_row_is_refused_while_it_grows() {
    let pairs: String = (0..10_000).map(|n| format!("<Condition ID=\"C{n}\"/><Action ID=\"A{n}\"/>")).collect();
    let text = format!(
        "<root BTCPP_format=\"4\"><BehaviorTree ID=\"T\"><ReactiveSequence>{pairs}</ReactiveSequence></BehaviorTree></root>"
    );
    let error = import(&Source::new("tree.xml", text), &[]).expect_err("it is too long");
    assert!(error.why.contains("event actions are longer than"), "{error}");
}
