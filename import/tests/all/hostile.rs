//! Files that are wrong, huge or made to do harm: each is refused with a place and a reason, or becomes a spec.

use crate::random::Random;
use expect_test::{Expect, expect};
use import::{ImportError, Imported, RemarkKind, import};
use language::{Options, Source, compile};

fn imported(text: &str) -> Result<Imported, ImportError> {
    import(&Source::new("file.xml", text), &[])
}

fn tree(inside: &str) -> String {
    format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"T\">{inside}</BehaviorTree></root>")
}

fn refused(text: &str, expected: Expect) {
    let error = imported(text).expect_err("it is wrong");
    expected.assert_eq(&error.to_string());
}

#[test]
fn files_that_are_no_xml_are_refused_with_a_place() {
    refused("", expect!["cannot import `file.xml`, line 1, column 1: the document does not have a root node"]);
    refused(
        "<root>\n  <a></b></root>",
        expect!["cannot import `file.xml`, line 2, column 6: expected 'a' tag, not 'b' at 2:6"],
    );
    refused(
        "<html/>",
        expect![
            "cannot import `file.xml`, line 1, column 1: <html> is neither a chart (<scxml>), a behavior tree (<root>) nor a launch file (<launch>)"
        ],
    );
    refused(
        "<!DOCTYPE a [<!ENTITY x \"y\">]><root>&x;</root>",
        expect!["cannot import `file.xml`, line 1, column 1: XML with DTD detected"],
    );
    refused("<root><!-- no end", expect!["cannot import `file.xml`, line 1, column 18: expected '-->' at 1:18"]);
}

#[test]
fn trees_that_contradict_themselves_are_refused() {
    refused("<root/>", expect!["cannot import `file.xml`, line 1, column 1: the file has no <BehaviorTree>"]);
    refused(
        "<root main_tree_to_execute=\"x\">\n<BehaviorTree ID=\"y\"><A/></BehaviorTree></root>",
        expect!["cannot import `file.xml`, line 1, column 1: no tree has the ID `x`; the trees are `y`"],
    );
    refused(
        "<root><BehaviorTree ID=\"y\"><A/></BehaviorTree>\n<BehaviorTree ID=\"y\"><A/></BehaviorTree></root>",
        expect![
            "cannot import `file.xml`, line 2, column 1: a second tree has the ID `y`; give each tree an ID of its own"
        ],
    );
    refused(
        "<root main_tree_to_execute=\"x\"><BehaviorTree ID=\"x\"><SubTree ID=\"y\"/></BehaviorTree>\n<BehaviorTree ID=\"y\"><SubTree ID=\"x\"/></BehaviorTree></root>",
        expect![
            "cannot import `file.xml`, line 1, column 32: a tree contains itself: `x` contains `y` contains `x`; a spec has no recursion"
        ],
    );
    let wrong = [
        "",
        "<A/><B/>",
        "<SubTree ID=\"x\"/>",
        "<SubTree/>",
        "<Inverter/>",
        "<Inverter><A/><A/></Inverter>",
        "<Timeout msec=\"soon\"><A/></Timeout>",
        "<Timeout msec=\"-5\"><A/></Timeout>",
        "<Delay delay_msec=\"-5\"><A/></Delay>",
        "<Sleep msec=\"-5\"/>",
        "<RecoveryNode number_of_retries=\"-5\"><A/><B/></RecoveryNode>",
        "<Parallel success_count=\"3\"><A/><A/></Parallel>",
        "<IfThenElse><A/></IfThenElse>",
        "<Switch2 variable=\"{a}\"><A/></Switch2>",
        "<TryCatch><A/></TryCatch>",
        "<RecoveryNode><A/></RecoveryNode>",
        "<Repeat num_cycles=\"1000000000000\"><A/></Repeat>",
        "<Action/>",
    ];
    for inside in wrong {
        let error = imported(&tree(inside)).expect_err(inside);
        assert!(error.line == 1 && error.column > 1 && !error.why.is_empty(), "{inside}: {error}");
    }
}

#[test]
fn charts_that_contradict_themselves_are_refused() {
    refused(
        "<scxml><state id=\"a\"/>\n<state id=\"a\"/></scxml>",
        expect![
            "cannot import `file.xml`, line 2, column 1: a second state has the id `a`; the first one is in line 1"
        ],
    );
    refused(
        "<scxml><state id=\"a\">\n<transition target=\"b\"/></state></scxml>",
        expect!["cannot import `file.xml`, line 2, column 1: no state has the id `b`"],
    );
    refused(
        "<scxml initial=\"b\"><state id=\"a\"/></scxml>",
        expect!["cannot import `file.xml`, line 1, column 1: no state has the id `b`"],
    );
    refused(
        "<scxml><parallel id=\"p\"><state id=\"x\"/><state id=\"r\">\n<history id=\"h\"><transition target=\"x\"/></history></state></parallel></scxml>",
        expect![
            "cannot import `file.xml`, line 2, column 1: a <history> needs a <state> beside it that it can lead to"
        ],
    );
    assert!(imported("<scxml/>").is_err());
    assert!(imported("<scxml><parallel><final id=\"a\"/></parallel></scxml>").is_err());
    assert!(imported("<scxml><state><history id=\"a\"/></state></scxml>").is_err());
}

#[test]
fn huge_files_are_refused() {
    let long = format!("<root>{}</root>", " ".repeat(9_000_000));
    assert!(imported(&long).expect_err("it is long").why.contains("bytes"));
    let deep = format!("{}{}", "<Inverter>".repeat(1_000_000), "</Inverter>".repeat(1_000_000));
    assert!(imported(&tree(&deep[..4_000_000])).expect_err("it is deep").why.contains("deep"));
    let hidden = format!("<a b='>'>{}", "<a>".repeat(100));
    assert!(imported(&hidden).expect_err("it is deep").why.contains("deep"));
    let many = format!("<Sequence>{}</Sequence>", "<A/>".repeat(250_000));
    assert!(imported(&tree(&many)).expect_err("it is long").why.contains("limit"));
}

#[test]
fn files_that_would_become_huge_are_refused() {
    let doubled =
        format!("{}<A/>{}", "<RecoveryNode number_of_retries=\"2\">".repeat(40), "<B/></RecoveryNode>".repeat(40));
    // Each task is a group of its own, so the text grows with the tree and does not double.
    assert!(imported(&tree(&doubled)).expect("it is nested 41 deep").text.len() < 40_000);
    let repeated = format!("{}<A/>{}", "<Repeat num_cycles=\"1000\">".repeat(10), "</Repeat>".repeat(10));
    assert!(imported(&tree(&repeated)).is_err());
    let chain: String = (0..40)
        .map(|number| {
            let next = format!("<SubTree ID=\"T{0}\" name=\"a\"/><SubTree ID=\"T{0}\" name=\"b\"/>", number + 1);
            format!("<BehaviorTree ID=\"T{number}\"><Sequence>{next}</Sequence></BehaviorTree>")
        })
        .collect();
    let chain = format!("<root main_tree_to_execute=\"T0\">{chain}<BehaviorTree ID=\"T40\"><A/></BehaviorTree></root>");
    assert!(imported(&chain).is_err());
    let wires: String = (0..300).map(|_| "<SetBlackboard output_key=\"k\" value=\"{k}\"/>").collect();
    assert!(
        imported(&tree(&format!("<Sequence>{wires}</Sequence>"))).expect_err("too many").why.contains("connections")
    );
}

#[test]
fn many_states_and_names_take_no_long_time() {
    let states: String = (0..3_000)
        .map(|number| format!("<state id=\"s{number}\"><transition event=\"e{number} *\" target=\"s0\"/></state>"))
        .collect();
    let refusal = imported(&format!("<scxml>{states}</scxml>")).expect_err("it has too many states").why;
    assert!(refusal.contains("states"), "{refusal}");
    let same = "<Action ID=\"a\"/>".repeat(3_000);
    assert!(imported(&tree(&format!("<Sequence>{same}</Sequence>"))).is_ok());
}

const CHART_TAGS: &str = "state parallel final history transition onentry onexit raise send assign log if script invoke \
                          initial datamodel data cancel scxml other";
const TREE_TAGS: &str = "Sequence Fallback Parallel ParallelAll ReactiveSequence ReactiveFallback Inverter ForceSuccess \
                         RetryUntilSuccessful Repeat Timeout Delay IfThenElse WhileDoElse Switch2 Script ScriptCondition \
                         SubTree Condition Action Leaf RecoveryNode PipelineSequence RateController RoundRobin TryCatch \
                         SetBlackboard Precondition KeepRunningUntilFailure RunOnce AlwaysSuccess AlwaysFailure";
const ATTRIBUTES: &str = "id target event cond type initial delay expr location label sendid ID name msec num_attempts \
                          num_cycles hz code _skipIf _while _onFailure _post _successIf value output_key variable case_1 \
                          case_2 if else a.b success_count _autoremap delay_msec catch_on_halt then_skip src";
/// With `|` between them.
const VALUES: &str = "a|b|f(n) == 1|error|s|T|{a}|{=}|{@a}|1|-1|3|0|true|1s|5ms|a b|a.b|*|deep|internal|n + 1|n == 'x'|'x'|In('a')|!(a)|\
                      x := 1; y += x|skip|über|日本|\\|//|*/|&quot;|done.state.a|error|done.invoke.a|RUNNING|\u{202e}x|nan|1e400";

/// Returns the opening tag of an element with fewer than `count` attributes, each of another name.
pub(crate) fn opening<'a>(
    random: &mut Random,
    tag: &str,
    count: usize,
    values: &[&str],
    name: impl Fn(&mut Random) -> &'a str,
) -> String {
    let mut text = format!("<{tag}");
    let mut used = Vec::new();
    for _ in 0..random.below(count) {
        let name = name(random);
        if !used.contains(&name) {
            used.push(name);
            text += &format!(" {name}=\"{}\"", random.pick(values));
        }
    }
    text + ">"
}

/// Pieces of charts and trees, put together without a plan.
fn nonsense(random: &mut Random, depth: usize, is_chart: bool) -> String {
    let words = |text: &'static str| text.split_whitespace().collect::<Vec<_>>();
    let (tags, names) = (words(if is_chart { CHART_TAGS } else { TREE_TAGS }), words(ATTRIBUTES));
    let values: Vec<&str> = VALUES.split('|').collect();
    let tag = random.pick(&tags);
    let mut text = opening(random, tag, 5, &values, |random| random.pick(&names));
    if depth > 0 {
        for _ in 0..random.below(4) {
            text += &nonsense(random, depth - 1, is_chart);
        }
    }
    if random.one_in(6) {
        text += random.pick(&["<!-- a // */ -->", "n = n + 1;", "n++", "&amp;"]);
    }
    text + &format!("</{tag}>")
}

fn nonsense_is_imported_or_refused(seed: u64) -> bool {
    let mut random = Random(seed);
    let is_chart = random.one_in(2);
    let inside: String = (0..1 + random.below(3)).map(|_| nonsense(&mut random, 4, is_chart)).collect();
    let text = match is_chart {
        true => format!("<scxml><datamodel><data id=\"n\" expr=\"1\"/></datamodel><state id=\"s\"/>{inside}</scxml>"),
        false => tree(&format!("<Sequence>{inside}</Sequence>")),
    };
    let Ok(imported) = imported(&text) else { return false };
    // A bug of the writer would be a refusal with this word.
    let compiled = compile(&Source::new("nonsense.dca", imported.text.as_str()), &[], &Options::named("nonsense"));
    assert!(compiled.plan.is_some(), "seed {seed}: {text}\n{}", imported.text);
    let again = language::format(&Source::new("nonsense.dca", imported.text.as_str()));
    assert_eq!(again.as_deref(), Ok(imported.text.as_str()), "seed {seed}: the text is formatted");
    for remark in imported.remarks.iter().filter(|remark| remark.kind == RemarkKind::Missing) {
        assert!(imported.text.contains(&remark.text), "seed {seed}: `{}` is in the text", remark.text);
    }
    true
}

#[test]
fn nonsense_is_refused_or_becomes_a_spec() {
    let good = (0..400).filter(|seed| nonsense_is_imported_or_refused(*seed)).count();
    assert!(good > 20, "{good} of 400 were imported");
}

#[test]
#[ignore = "long: 50,000 files"]
fn much_nonsense_is_refused_or_becomes_a_spec() {
    (0..50_000).for_each(|seed| {
        nonsense_is_imported_or_refused(seed);
    });
}

/// Checks that no spec of nonsense is refused for its own text.
fn check_refusals(seeds: std::ops::Range<u64>) {
    let mut refusals = std::collections::BTreeMap::new();
    for seed in seeds {
        let mut random = Random(seed);
        let is_chart = seed % 2 == 0;
        let inside: String = (0..1 + random.below(3)).map(|_| nonsense(&mut random, 3, is_chart)).collect();
        let text = match is_chart {
            true => format!("<scxml><state id=\"s\"/>{inside}</scxml>"),
            false => tree(&format!("<Sequence>{inside}</Sequence>")),
        };
        if let Err(error) = imported(&text)
            && error.why.contains("the resulting spec is refused")
        {
            refusals.entry(error.why).or_insert(seed);
        }
    }
    assert!(refusals.is_empty(), "{refusals:#?}");
}

#[test]
fn the_spec_is_never_refused_for_its_own_text() {
    check_refusals(0..2_000);
}

#[test]
#[ignore = "long: 50,000 files"]
fn many_specs_are_never_refused_for_their_own_text() {
    check_refusals(2_000..52_000);
}

/// A number that a spec cannot have is changed, and a remark says so.
#[test]
fn changed_numbers_have_remarks() {
    let remarks = |text: &str| {
        let imported = imported(text).expect("it has a counterpart");
        imported.remarks.into_iter().map(|remark| remark.text).collect::<Vec<_>>()
    };
    let recovery = tree("<RecoveryNode number_of_retries=\"500\"><A/><B/></RecoveryNode>");
    let told = remarks(&recovery);
    assert!(told.iter().any(|text| text.contains("recovers 500 times")), "{told:?}");
    let chart = "<scxml initial=\"a\"><state id=\"a\"><onentry><send event=\"t\" delay=\"3ms\"/></onentry>\
                 <transition event=\"t\" target=\"b\"/></state><state id=\"b\"/></scxml>";
    let told = remarks(chart);
    assert!(told.iter().any(|text| text.contains("after 10 ms here, in the chart after 3 ms")), "{told:?}");
}

/// Only -1 means for ever; a smaller number of rounds or attempts is none, as in BehaviorTree.CPP.
#[test]
fn negative_counts_are_none_but_for_one() {
    let text = |inside: &str| imported(&tree(inside)).expect("it has a counterpart").text;
    assert!(text("<Repeat num_cycles=\"-1\"><A/></Repeat>").contains("a ;; wait(10 ms)"));
    assert!(text("<Repeat num_cycles=\"-5\"><A/></Repeat>").contains("skip"));
    assert!(text("<RetryUntilSuccessful num_attempts=\"-5\"><A/></RetryUntilSuccessful>").contains("fail("));
    let chart = "<scxml><state id=\"a\"><onentry><send event=\"t\" delay=\"-5s\"/></onentry>\
                 <transition event=\"t\" target=\"b\"/></state><state id=\"b\"/></scxml>";
    assert!(imported(chart).expect("t comes from outside").text.contains("its delay `-5s` is not a time"));
}

/// A row of skipped children is skipped as well: either the next child of a fallback follows, or a remark says otherwise.
#[test]
fn a_skipped_row_is_skipped_or_has_a_remark() {
    let alone = "<Fallback><Sequence><Action ID=\"A\" _skipIf=\"1\"/></Sequence><Action ID=\"B\"/></Fallback>";
    let alone = imported(&tree(alone)).expect("a good tree");
    assert!(alone.text.contains("fail(\"skipped\")"), "{}", alone.text);
    let two = "<Fallback><Sequence><Action ID=\"A\" _skipIf=\"1\"/><Action ID=\"C\" _skipIf=\"2\"/></Sequence>\
               <Action ID=\"B\"/></Fallback>";
    let two = imported(&tree(two)).expect("a good tree");
    assert!(two.remarks.iter().any(|remark| remark.text.contains("all children of this <Sequence>")), "{two:?}");
}
