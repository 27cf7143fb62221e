//! Traces of small records.

use super::*;
use crate::logic::record::Header;
use language::plan::Plan;
use language::{Options, Source, compile};
use node::logic::protocol::{Deployment, Failure, FailureCause};
use std::collections::BTreeSet;

const SPEC: &str = "module Step { done; }
    process Drive(){
        host{c2}
        instantiated_processes{ wheels instof Step(c2); }
        internal_event_actions{ wheels }
    }
    process main(){
        host{c1}
        instantiated_processes{ drive instof Drive(); look instof Step(c1); }
        internal_event_actions{ look ; drive }
    }";

fn plan() -> Plan {
    compile(&Source::new("test.dca", SPEC), &[], &Options::named("test")).plan.expect("it has a plan")
}

fn change(path: &str, at: u64, change: Change) -> Entry {
    Entry::Report(Report::Process { path: path.to_owned(), change, at: Duration::from_secs(at) })
}

fn trace(mut entries: Vec<Entry>) -> Vec<Value> {
    let deployment = Deployment { name: "test".to_owned(), epoch: 3 };
    entries.insert(0, Entry::Report(Report::Accepted { deployment }));
    let header = Header { file: "test.dca".to_owned(), text: SPEC.to_owned(), plan: plan(), started: None };
    let run = Run { header, go: None, entries, values: Vec::new(), damage: None };
    let lines = lines(&run, Duration::from_secs(1_000));
    let read = |line: &String| serde_json::from_str::<Value>(line).expect("a line is JSON");
    let spans =
        |line: Value| line["resourceSpans"][0]["scopeSpans"][0]["spans"].as_array().cloned().unwrap_or_default();
    lines.iter().map(read).flat_map(spans).collect()
}

fn named<'a>(spans: &'a [Value], name: &str) -> &'a Value {
    spans.iter().find(|span| span["name"] == name).unwrap_or_else(|| panic!("no span `{name}`: {spans:?}"))
}

/// The program `wheels` crashes, so its group and the mission abort. Both failures are linked to the crash.
#[test]
fn a_failure_is_linked_with_its_origin() {
    let failure = || Failure {
        origin: "main/drive/wheels".to_owned(),
        cause: FailureCause::Signal(11),
        at: Duration::from_secs(5),
    };
    let aborted = || Change::Ended(Ending::Aborted(failure()));
    let spans = trace(vec![
        change("main", 0, Change::Activated),
        change("main/look", 0, Change::Activated),
        change("main/look", 2, Change::Ended(Ending::Done(Vec::new()))),
        change("main/drive", 2, Change::Activated),
        change("main/drive/wheels", 2, Change::Activated),
        change("main/drive/wheels", 5, Change::Died(FailureCause::Signal(11))),
        change("main/drive/wheels", 5, aborted()),
        change("main/drive", 5, aborted()),
        change("main", 6, aborted()),
        Entry::Report(Report::Finished {
            ending: Ending::Aborted(failure()),
            at: Duration::from_secs(6),
            unconfirmed: Vec::new(),
        }),
    ]);
    let (mission, main, drive) = (named(&spans, "test@3"), named(&spans, "main"), named(&spans, "drive"));
    let (wheels, look) = (named(&spans, "wheels"), named(&spans, "look"));
    assert!(mission.get("parentSpanId").is_none(), "{mission}");
    assert_eq!(main["parentSpanId"], mission["spanId"]);
    assert_eq!(drive["parentSpanId"], main["spanId"]);
    assert_eq!(wheels["parentSpanId"], drive["spanId"]);
    assert_eq!(
        (&look["startTimeUnixNano"], &look["endTimeUnixNano"]),
        (&"1000000000000".into(), &"1002000000000".into())
    );
    assert_eq!((&look["status"]["code"], &wheels["status"]["code"]), (&1.into(), &2.into()));
    assert!(wheels["attributes"].as_array().unwrap().contains(&text("dca.host", "c2")), "{wheels}");
    assert!(wheels["events"][0]["name"].as_str().unwrap().contains("SIGSEGV"), "{wheels}");
    assert_eq!(wheels["links"], json!([]), "the origin itself");
    for failed in [drive, main, mission] {
        assert_eq!(failed["links"][0]["spanId"], wheels["spanId"], "{failed}");
    }
    let ids: BTreeSet<&str> = spans.iter().filter_map(|span| span["spanId"].as_str()).collect();
    assert!(ids.len() == 5 && ids.iter().all(|id| id.len() == 16), "{ids:?}");
    assert!(
        spans
            .iter()
            .all(|span| span["traceId"].as_str().map(str::len) == Some(32) && span["traceId"] == main["traceId"])
    );
}

/// A process that runs several times has a span for each activation. If the record has no end of it, the span is unfinished.
#[test]
fn each_activation_is_a_span_and_a_cut_record_has_unfinished_ones() {
    let rounds = 2_500;
    let mut entries = vec![change("main", 0, Change::Activated)];
    for at in 0..rounds {
        entries.push(change("main/look", at, Change::Activated));
        if at + 1 < rounds {
            entries.push(change("main/look", at + 1, Change::Ended(Ending::Stopped)));
        }
    }
    entries.extend(
        (0..200).map(|_| change("main", rounds, Change::Says { text: "says: <&>".to_owned(), is_routine: true })),
    );
    let spans = trace(entries);
    assert_eq!(spans.len(), 2_502);
    let last = &spans[2_501];
    assert_eq!((&last["name"], &last["endTimeUnixNano"]), (&"look".into(), &"3500000000000".into()));
    assert!(last["attributes"].to_string().contains("dca.unfinished") && last["status"] == json!({}), "{last}");
    let main = named(&spans, "main");
    assert_eq!((main["events"].as_array().map(Vec::len), &main["droppedEventsCount"]), (Some(128), &72.into()));
}
