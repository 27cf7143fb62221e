//! Each attribute of a node of a tree is read, or has a remark.

use import::{Imported, import};
use language::Source;

fn tree(inside: &str) -> Imported {
    let text = format!(
        "<root BTCPP_format=\"4\" main_tree_to_execute=\"T\"><BehaviorTree ID=\"T\">{inside}</BehaviorTree>\
         <BehaviorTree ID=\"S\"><Action ID=\"Z\"/></BehaviorTree></root>"
    );
    import(&Source::new("tree.xml", text), &[]).unwrap_or_else(|error| panic!("{error}\n{inside}"))
}

fn has_remark(imported: &Imported, text: &str) -> bool {
    imported.remarks.iter().any(|remark| remark.text.contains(text)) && imported.text.contains(text)
}

/// All nodes of BehaviorTree.CPP and Nav2 that the import knows, each with the count of its children.
const NODES: &str = "Sequence:2 AsyncSequence:2 SequenceWithMemory:2 SequenceStar:2 ReactiveSequence:2 Fallback:2 \
                     AsyncFallback:2 ReactiveFallback:2 Parallel:2 ParallelAll:2 IfThenElse:3 WhileDoElse:3 Switch2:3 \
                     TryCatch:2 Inverter:1 ForceSuccess:1 ForceFailure:1 RetryUntilSuccessful:1 Repeat:1 \
                     KeepRunningUntilFailure:1 Timeout:1 Delay:1 RunOnce:1 Precondition:1 AlwaysSuccess:0 AlwaysFailure:0 \
                     Script:0 ScriptCondition:0 PipelineSequence:2 RoundRobin:2 PersistentSequence:2 \
                     NonblockingSequence:2 RecoveryNode:2 RateController:1";

#[test]
fn an_attribute_that_is_not_read_has_a_remark() {
    for node in NODES.split_whitespace() {
        let (name, count) = node.split_once(':').expect("it has a count");
        let children = "<Action ID=\"A\"/>".repeat(count.parse().expect("a number"));
        let imported = tree(&format!("<{name} surprise=\"7\" name=\"n\">{children}</{name}>"));
        assert!(
            has_remark(&imported, &format!("the attribute `surprise` of <{name}> is not read")),
            "{}",
            imported.text
        );
        let sort = if count == "1" { "Decorator" } else { "Control" };
        if count != "0" {
            let imported = tree(&format!("<{sort} ID=\"{name}\" surprise=\"7\">{children}</{sort}>"));
            assert!(has_remark(&imported, "the attribute `surprise`"), "{}", imported.text);
        }
        let imported = tree(&format!("<{name} _surprise=\"7\">{children}</{name}>"));
        assert!(has_remark(&imported, "the attribute `_surprise` is not known"), "{}", imported.text);
    }
    let rate = "<RateController hz=\"1\" surprise=\"7\"><A/></RateController>";
    let imported = tree(&format!("<PipelineSequence>{rate}<Action ID=\"B\"/></PipelineSequence>"));
    assert!(has_remark(&imported, "the attribute `surprise` of <RateController> is not read"), "{}", imported.text);
    let switch = tree("<Switch2 variable=\"{x}\" case_1=\"a\" case_2=\"b\" case_3=\"c\"><A/><B/><C/></Switch2>");
    assert!(has_remark(&switch, "the attribute `case_3` of <Switch2> is not read"), "{}", switch.text);
    assert!(!has_remark(&switch, "`case_2` of"), "{}", switch.text);
    // The attributes of an action are its ports, and those of a subtree its names of the blackboard.
    assert!(tree("<Action ID=\"A\" speed=\"7\"/>").text.contains("speed = 7"));
    assert!(has_remark(&tree("<SubTree ID=\"S\" speed=\"7\"/>"), "the subtree `S` gets `7` as `speed`"));
}

/// The engine ticks the last child once if it halts the node. No operator of a spec runs after a stop and a failure only.
#[test]
fn a_catch_after_a_halt_has_a_remark() {
    let children = "<Action ID=\"A\"/><Action ID=\"B\"/><Action ID=\"C\"/>";
    for (value, is_noted) in [("true", true), ("1", true), ("{halts}", true), ("false", false), ("0", false)] {
        let imported = tree(&format!("<TryCatch catch_on_halt=\"{value}\">{children}</TryCatch>"));
        assert_eq!(has_remark(&imported, "`catch_on_halt` has no counterpart"), is_noted, "{}", imported.text);
    }
}

#[test]
fn a_node_that_runs_once_says_what_later_ticks_return() {
    for (attribute, later) in [
        ("", "later ticks are skipped"),
        ("then_skip=\"true\"", "later ticks are skipped"),
        ("then_skip=\"false\"", "later ticks return its first result"),
        ("then_skip=\"{x}\"", "later ticks are skipped, or return its first result"),
    ] {
        let imported = tree(&format!("<RunOnce {attribute}><A/></RunOnce>"));
        assert!(has_remark(&imported, &format!("it runs once, and {later}")), "{}", imported.text);
    }
}
