//! The page as a whole.

use super::*;
use crate::logic::mission::tests::{OPENING, door, event_table, seconds};
use crate::logic::record::{Entry, Header};
use expect_test::expect_file;
use node::logic::protocol::{Change, Deployment, Ending, Failure, FailureCause, Report};

fn run(end: Option<Ending>) -> Run {
    let text = "process main() {\n    // a < b\n}\n".to_owned();
    let header = Header { file: "door.dca".to_owned(), text, plan: door(), started: Some(seconds(1e9)) };
    let deployment = Deployment { name: "test".to_owned(), epoch: 3 };
    let mut entries = vec![
        Entry::Report(Report::Accepted { deployment }),
        Entry::Report(Report::Go { took: seconds(0.8), signals: Vec::new() }),
    ];
    entries.extend(event_table(OPENING));
    let report = |ending| Entry::Report(Report::Finished { ending, at: seconds(22.1), unconfirmed: Vec::new() });
    entries.extend(end.map(report));
    Run { header, go: Some(seconds(1e9 + 0.8)), entries, values: Vec::new(), damage: None }
}

#[test]
fn the_same_run_gives_the_same_page_and_needs_nothing_else() {
    let run = run(Some(Ending::Done(Vec::new())));
    let page = page(&run);
    assert_eq!(page, super::page(&run));
    for foreign in ["http:", "https:", "src=", "@import", "url("] {
        assert!(!page.contains(foreign), "{foreign}");
    }
    assert!(page.contains("// a &lt; b") && page.contains("test@3") && page.contains("2001-09-09 01:46:40 UTC"));
}

/// The lane of an activity has its states with their names. A round that is too short for its own point has no band.
#[test]
fn an_activity_shows_its_states_as_bands() {
    let mut run = run(Some(Ending::Done(Vec::new())));
    let path = run.header.plan.groups[1].path.clone();
    let report =
        |change: Change, at: f64| Entry::Report(Report::Process { path: path.clone(), change, at: seconds(at) });
    let entered = |names: &[&str]| Change::Entered { states: names.iter().map(|name| (*name).to_owned()).collect() };
    let of_activity = [
        report(entered(&["search"]), 1.0),
        report(entered(&["brief"]), 8.0),
        report(entered(&["left", "<right>"]), 8.001),
        report(Change::Ended(Ending::Stopped), 20.0),
    ];
    let end = run.entries.len() - 1;
    run.entries.splice(end..end, of_activity);
    let page = page(&run);
    for shown in
        [" in search, 1.0 s to 8.0 s</title>", " in left, &lt;right&gt;, 8.0 s to 20.0 s</title>", ">search</text>"]
    {
        assert!(page.contains(shown), "{shown}: {page}");
    }
    assert!(!page.contains("brief, "), "{page}");
}

#[test]
fn a_page_of_few_words() {
    let mut run = run(None);
    run.damage = Some("it ends before its end was written".to_owned());
    let page = page(&run);
    let body = &page[page.find("<main>").unwrap()..page.find("<script>").unwrap()];
    expect_file!["body.html"].assert_eq(body);
}

#[test]
fn a_refusal_shows_its_reasons_and_no_pictures() {
    let mut run = run(None);
    run.entries = vec![Entry::Report(Report::Refused { reasons: vec!["host `c3` could not be reached".to_owned()] })];
    let page = page(&run);
    assert!(page.contains("✕ refused") && page.contains("<p class=\"alarm\">host `c3` could not be reached</p>"));
    assert!(!page.contains("<figure>"));
}

/// On a telephone the pictures keep their drawn width, and scroll: shrunk to the screen, a letter would have three
/// pixels.
#[test]
fn a_narrow_screen_shrinks_no_letters() {
    let page = page(&run(None));
    let (_, narrow) = page.split_once("@media (max-width: 720px) {").expect("there is a rule for narrow screens");
    assert!(narrow.contains(&format!("svg.plot, svg.strip {{ width: {}px; }}", axis::WIDTH)));
    assert!(narrow.contains("#pictures { overflow-x: auto; }"));
}

#[test]
fn what_a_program_wrote_is_on_the_page_and_is_no_markup() {
    let mut run = run(None);
    let output =
        |text: &str| Entry::Output { path: "main/sys/near".to_owned(), at: seconds(1.0), text: text.to_owned() };
    run.entries.push(output("one\n<b>two"));
    run.entries.push(output("\u{1b}[31mthree\u{1b}[0m"));
    let cause = FailureCause::Exit(1).of_program(0, vec!["Traceback".to_owned(), "  x < 1".to_owned()]);
    let failure = Failure { origin: "main/sys/near".to_owned(), cause, at: seconds(2.0) };
    let ending = Ending::Aborted(failure);
    run.entries.push(Entry::Report(Report::Finished { ending, at: seconds(2.0), unconfirmed: Vec::new() }));
    let page = page(&run);
    assert!(
        page.contains("<summary>what main/sys/near wrote, 3 lines</summary>\n<pre>one\n&lt;b&gt;two\nthree</pre>"),
        "{page}"
    );
    assert!(page.contains("<p class=\"alarm\">the end of its output:\nTraceback\n  x &lt; 1</p>"), "{page}");
}
