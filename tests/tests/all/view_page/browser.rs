//! The page of `dca view --page` in a real browser.

use super::{PICTURED, PUSHED, Page, SPEC};
use dca_tests::cluster::{Cluster, SOON, Stream, executable};
use rustix::process::Signal;
use std::io::{BufRead as _, BufReader, Write as _};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

/// A person at a browser.
struct Browser {
    child: Child,
    orders: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Browser {
    /// Opens the link in a browser if this machine has one. Pictures are stored in the folder `DCA_PICTURES`, or in that of the
    /// cluster.
    #[expect(clippy::print_stdout, reason = "a user who runs the tests has to know what was skipped")]
    fn open(page: &Page, cluster: &Cluster) -> Option<Self> {
        let python = std::env::var("DCA_TEST_PYTHON").unwrap_or_else(|_| "python3".to_owned());
        let asked = Command::new(&python).args(["-c", "import playwright"]).output();
        if !asked.is_ok_and(|asked| asked.status.success()) || !Path::new("/usr/bin/chromium").exists() {
            println!("skipped: needs /usr/bin/chromium, and Playwright in the Python of DCA_TEST_PYTHON");
            return None;
        }
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/all/view_page/browser.py");
        let link = format!("http://{}/?key={}", page.address, page.key);
        let pictures = std::env::var("DCA_PICTURES").map_or_else(|_| cluster.folder().to_owned(), PathBuf::from);
        let mut command = Command::new(python);
        command.arg(script).arg(link).arg(pictures).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().expect("Python was there");
        let orders = child.stdin.take().expect("the pipe was asked for");
        let answers = BufReader::new(child.stdout.take().expect("the pipe was asked for"));
        Some(Self { child, orders, answers })
    }

    #[track_caller]
    fn order(&mut self, order: &str) {
        writeln!(self.orders, "{order}").expect("the browser is there");
        let mut answer = String::new();
        self.answers.read_line(&mut answer).expect("the browser answers");
        assert_eq!(answer.trim(), "ok", "{order}");
    }

    /// Checks that no script has failed, and closes the browser.
    #[track_caller]
    fn end(mut self) {
        self.order("errors");
        self.order("end");
        assert!(self.child.wait().expect("it was started here").success());
    }
}

/// A mission from start to end, a lost stream, a stop, and words that look like markup.
#[test]
#[ignore = "long: a real browser"]
fn a_person_sees_a_mission_in_a_browser() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let page = Page::open(&here);
    let Some(mut browser) = Browser::open(&page, &cluster) else { return };
    browser.order("see nothing is deployed");
    browser.order("picture empty");
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("door.dca", SPEC)]);
    browser.order("see one: Sleeper");
    browser.order("see running");
    browser.order("picture running");
    browser.order("again 9");
    cluster.expect_leaf("main/one").signal(Signal::SEGV);
    browser.order("see finished: aborted");
    browser.order("picture crashed");
    assert_eq!(mission.ended(SOON).code, Some(1));
    // The stream of changes is cut, and then comes back.
    page.view.signal(Signal::STOP);
    browser.order("see not live since 3 s");
    browser.order("see data is");
    browser.order("picture stale");
    page.view.signal(Signal::CONT);
    browser.order("gone not live since");
    browser.order("press Stop everything");
    browser.order("press Yes");
    browser.order("see Everything is stopped on c1");
    browser.order("press Release");
    browser.order("press Yes");
    browser.order("gone Everything is stopped");
    let reason = "<img src=x onerror=alert(1)>";
    assert_eq!(here.ask(&["estop", reason]).code, Some(0));
    browser.order(&format!("see {reason}"));
    browser.order("picture stopped");
    browser.end();
}

/// The pictures of a mission: states in words and signs, a crash, a wire that loses values, and the keyboard.
#[test]
#[ignore = "long: a real browser"]
fn a_person_sees_the_graph_of_a_mission_in_a_browser() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let controller = executable("dca-controller").display().to_string();
    let _node = here.node("c1", &["--controllers", &controller]);
    let page = Page::open(&here);
    let Some(mut browser) = Browser::open(&page, &cluster) else { return };
    let wired = PICTURED
        .replace(
            "one instof Sleeper(c1);",
            "one instof Sleeper(c1); beat instof RateSource(c1); monitor instof RateMonitor(c1);",
        )
        .replace(
            "internal_event_actions { inner, guard, one? }",
            "internal_connections(beat, on) { beat, Out -> monitor, In; }
            internal_event_actions { inner, guard, one?, beat[on], monitor }",
        );
    let file = cluster.file("door.dca", &wired);
    let mission = here.dca(&["deploy", "--no-record", "--controllers", &controller, &file]);
    mission.wait_for(Stream::Err, "started in", SOON);
    browser.order("mark main/inner running");
    browser.order("mark main/guard running");
    browser.order("open States of main/guard");
    browser.order("mark watching running");
    browser.order("open Timeline");
    browser.order("see seconds since");
    browser.order("picture graph");
    cluster.expect_leaf("main/one").signal(Signal::SEGV);
    browser.order("mark main/one failed");
    browser.order("see ✕ aborted: SIGSEGV");
    browser.order("lose main/beat, Out -> main/monitor, In");
    browser.order("see ✕ 3.0/s lost");
    browser.order("picture graph-crashed");
    assert_eq!(here.ask(&["stop", "door"]).code, Some(0));
    browser.order("see finished: stopped");
    browser.order("mark main/one failed");
    browser.order("mark main/inner stopped");
    browser.order("picture graph-ended");
    // A page that is opened later shows the same.
    browser.order("reload");
    browser.order("see finished: stopped");
    browser.order("open Graph");
    browser.order("mark main/one failed");
    browser.end();
    drop(mission);
}

/// A person changes a parameter, reads what a program writes, and looks a key up.
#[test]
#[ignore = "long: a real browser"]
fn a_person_changes_a_parameter_in_a_browser() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let controller = executable("dca-controller").display().to_string();
    let _node = here.node("c1", &["--controllers", &controller]);
    let page = Page::open(&here);
    let Some(mut browser) = Browser::open(&page, &cluster) else { return };
    let writer = cluster.file("write.sh", "echo '<img src=x onerror=alert(1)>'; sleep 600");
    let spec = PUSHED
        .replace(
            "process main()",
            &format!("module Writer(host) {{ exec \"sh {writer}\"; plain; done; }} process main()"),
        )
        .replace("world instof", "writer instof Writer(c1); world instof")
        .replace("; skip) # hit", "; skip) # hit # writer");
    let mission = here.dca(&["deploy", "--no-record", "--controllers", &controller, &cluster.file("door.dca", &spec)]);
    mission.wait_for(Stream::Err, "started in", SOON);
    browser.order("open Show and change parameters");
    let name = "door:main/hit/threshold.threshold";
    browser.order(&format!("fill new value of {name} = 900 N"));
    browser.order(&format!("press set {name}"));
    browser.order("see expected a Force from");
    browser.order(&format!("fill new value of {name} = 0.1 kN"));
    browser.order(&format!("press set {name}"));
    browser.order("see it uses the value at once if");
    browser.order("see the spec has 150 N");
    assert_eq!(here.ask(&["param", "get", "hit/threshold", "threshold"]).out, "100.0\n");
    browser.order("open Show the output of a process");
    browser.order("choose Process = door@1: main/writer");
    browser.order("see <img src=x onerror=alert(1)>");
    browser.order("open Show the keys of a robot");
    browser.order("see robot/c1/params/door/hit/threshold/threshold");
    browser.order("picture parts");
    browser.order("press robot/c1/params/door/hit/threshold/threshold");
    browser.order("see set in a viewer");
    browser.order("picture key");
    browser.order(&format!("press undo the change of {name}"));
    browser.order("see has the value of the spec again");
    browser.end();
    drop(mission);
}
