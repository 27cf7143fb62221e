//! The events of an imported chart: where they come from, and the parts that use them.

use import::{Imported, import};
use language::Source;

fn chart(inside: &str) -> Imported {
    let text = format!("<scxml initial=\"a\">{inside}</scxml>");
    import(&Source::new("chart.scxml", text), &[]).unwrap_or_else(|error| panic!("{error}\n{inside}"))
}

#[track_caller]
fn has(imported: &Imported, lines: &[&str]) {
    for line in lines {
        assert!(imported.text.contains(line), "`{line}` is not in\n{}", imported.text);
    }
}

#[track_caller]
fn lacks(imported: &Imported, texts: &[&str]) {
    for text in texts {
        assert!(!imported.text.contains(text), "`{text}` is in\n{}", imported.text);
    }
}

const FOREIGN: &str = "cond=\"Math.max(1,2) == 2\"";

/// An event that only a part waits for that is left out is not raised, and not sent.
#[test]
fn an_event_for_a_part_that_is_left_out_is_left_out_as_well() {
    let raised = chart(&format!(
        "<state id=\"a\"><onentry><raise event=\"e1\"/></onentry><transition event=\"e1\" {FOREIGN} target=\"b\"/></state>\
         <state id=\"b\"/>"
    ));
    has(&raised, &["a transition is left out", "no transition waits for the event `e1`, so it is not raised"]);
    lacks(&raised, &["raise e1;"]);
    for send in
        ["<send event=\"e1\"/>", "<send event=\"e1\" delay=\"5s\"/>", "<send event=\"e1\" delay=\"5s\" id=\"x\"/>"]
    {
        let sent = chart(&format!(
            "<state id=\"a\"><onentry>{send}</onentry><onexit><cancel sendid=\"x\"/></onexit>\
             <transition event=\"e1\" {FOREIGN} target=\"b\"/></state><state id=\"b\"/>"
        ));
        has(&sent, &["no transition waits for the event `e1`"]);
        lacks(&sent, &["after 5 s", "raise e1;", "later_e1"]);
    }
    let completed = chart(&format!(
        "<state id=\"a\"><state id=\"c\"><transition event=\"go\" target=\"d\"/></state><final id=\"d\"/></state>\
         <state id=\"b\"><transition event=\"done.state.a\" {FOREIGN} target=\"a\"/></state>"
    ));
    lacks(&completed, &["raise done_state_a;"]);
    // Nothing here takes any event, since the transition that would is left out.
    let any = chart(&format!(
        "<state id=\"a\"><onentry><raise event=\"e1\"/></onentry><transition event=\"*\" {FOREIGN} target=\"b\"/></state>\
         <state id=\"b\"/>"
    ));
    lacks(&any, &["raise e1;", "in other"]);
}

/// An event that only a part raises that is left out comes from outside.
#[test]
fn an_event_that_only_a_left_out_part_raises_comes_from_outside() {
    for raises in [
        format!("<transition event=\"x\" {FOREIGN}><raise event=\"e1\"/></transition>"),
        "<transition event=\"x\"><if cond=\"f()\"><raise event=\"e1\"/></if></transition>".to_owned(),
        "<transition event=\"x\"><foreach array=\"f\" item=\"i\"><send event=\"e1\" delay=\"1s\"/></foreach></transition>"
            .to_owned(),
    ] {
        let imported = chart(&format!(
            "<state id=\"a\">{raises}<transition event=\"e1\" target=\"b\"/></state><state id=\"b\"/>"
        ));
        has(&imported, &["in e1: Text;", "on message e1 -> b;", "left out"]);
        lacks(&imported, &["signal e1", "raise e1"]);
    }
}

/// By the standard, an event that the chart raises is the same as an event of this name from outside.
#[test]
fn an_event_that_the_chart_raises_can_come_from_outside_as_well() {
    for raise in [
        "<raise event=\"emergency\"/>",
        "<send event=\"emergency\"/>",
        "<send event=\"emergency\" target=\"#_internal\"/>",
    ] {
        let imported = chart(&format!(
            "<state id=\"a\"><transition event=\"bump\">{raise}</transition>\
             <transition event=\"emergency\" target=\"halt\"/></state><state id=\"halt\"/>"
        ));
        has(
            &imported,
            &[
                "in emergency: Text;",
                "on message emergency -> halt;",
                "on signal emergency -> halt;",
                "raise emergency;",
            ],
        );
        assert_eq!(imported.ports.get("emergency").map(String::as_str), Some("emergency"));
    }
    // The region of a timer raises a signal. The timer of a state is none, and says so.
    let clock = chart(
        "<state id=\"a\"><transition event=\"go\"><send event=\"late\" delay=\"5s\"/></transition>\
         <transition event=\"late\" target=\"b\"/></state><state id=\"b\"><transition event=\"late\" target=\"a\"/></state>",
    );
    has(&clock, &["on message late -> b;", "on signal late -> b;"]);
    let timer = chart(
        "<state id=\"a\"><onentry><send event=\"late\" delay=\"5s\"/></onentry>\
         <transition event=\"late\" target=\"b\"/></state><state id=\"b\"/>",
    );
    has(&timer, &["on after 5 s -> b;"]);
    assert!(
        timer.remarks.iter().any(|remark| remark.text.contains("it cannot come from outside here")),
        "{:?}",
        timer.remarks
    );
    // Events of the platform do not come from outside.
    let platform = chart(
        "<state id=\"a\"><state id=\"c\"><transition event=\"go\" target=\"d\"/></state><final id=\"d\"/>\
         <transition event=\"error.own\"><raise event=\"error.own\"/></transition></state>\
         <state id=\"b\"><transition event=\"done.state.a\" target=\"a\"/></state>",
    );
    lacks(&platform, &["in done_state_a", "in error_own"]);
}

/// A state that invokes something takes the errors that the chart raises as well as the failure of its process.
#[test]
fn a_state_that_invokes_takes_raised_errors() {
    let imported = chart(
        "<state id=\"a\"><invoke src=\"drive\"/><onentry><raise event=\"error.own\"/></onentry>\
         <transition event=\"error\" target=\"b\"/></state><state id=\"b\"/>",
    );
    has(&imported, &["on aborted -> b;", "on signal error_own -> b;", "raise error_own;"]);
}

/// A transition takes all names that begin with its name, but only the names in the chart have ports.
#[test]
fn a_chart_with_events_from_outside_says_once_where_longer_names_go() {
    let longer = |imported: &Imported| {
        imported.remarks.iter().filter(|remark| remark.text.contains("also takes longer names")).count()
    };
    let several = chart(
        "<state id=\"a\"><transition event=\"foo bar\" target=\"b\"/></state><state id=\"b\"><transition event=\"foo.x\" target=\"a\"/></state>",
    );
    assert_eq!(longer(&several), 1, "{:?}", several.remarks);
    has(&several, &["such as `bar.x`; here, send such an event to the port `bar`"]);
    let none = chart("<state id=\"a\"><transition event=\"*\" target=\"b\"/></state><state id=\"b\"/>");
    assert_eq!(longer(&none), 0, "{:?}", none.remarks);
}

/// The end of an invoked process has the id of its `<invoke>`, and the other parts of an `<invoke>` have remarks.
#[test]
fn the_end_of_another_invocation_is_not_the_end_of_this_one() {
    let imported = chart(
        "<state id=\"a\"><invoke id=\"i\" src=\"x\" autoforward=\"true\"><finalize/></invoke>\
         <transition event=\"done.invoke.j\" target=\"c\"/><transition event=\"done.invoke.i\" target=\"b\"/></state>\
         <state id=\"b\"/><state id=\"c\"/>",
    );
    has(&imported, &["on done -> b;", "nothing here sends the event `done.invoke.j`"]);
    lacks(&imported, &["on done -> c;"]);
    has(&imported, &["`autoforward` has no counterpart", "<finalize> has no counterpart"]);
    for id in ["", "id=\"i\""] {
        let imported = chart(&format!(
            "<state id=\"a\"><invoke {id} src=\"x\"/><transition event=\"done.invoke\" target=\"b\"/></state><state id=\"b\"/>"
        ));
        has(&imported, &["on done -> b;"]);
    }
}

/// A processor does not look into an element that it does not know.
#[test]
fn a_state_in_an_unknown_element_is_none() {
    let text =
        "<scxml><state id=\"a\"><transition event=\"go\" target=\"z\"/></state><foo><state id=\"z\"/></foo></scxml>";
    let error = import(&Source::new("chart.scxml", text), &[]).expect_err("it has no state `z`");
    assert_eq!(error.why, "no state has the id `z`");
    let imported = chart("<state id=\"a\"/><foo><transition event=\"go\"/><state id=\"a\"/></foo>");
    lacks(&imported, &["in go"]);
    has(&imported, &["<foo> has no counterpart"]);
}
