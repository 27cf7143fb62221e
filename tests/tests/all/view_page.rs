//! The page of `dca view --page`, over direct connections and in a real browser.

mod browser;

use dca_tests::cluster::{Cluster, Host, Program, SOON, Stream, wait_until};
use dca_tests::hit_detector;
use rustix::process::Signal;
use std::io::{Read as _, Write as _};
use std::net::TcpStream;

const SPEC: &str = "
    module Sleeper(host) { exec \"sleep 600\"; plain; done; }
    process main() {
        host{c1}
        instantiated_processes { one instof Sleeper(c1); }
        internal_event_actions { one }
    }";

/// A page and its link.
struct Page {
    view: Program,
    address: String,
    key: String,
}

impl Page {
    fn open(here: &Host) -> Self {
        let view = here.dca(&["view", "--page", "127.0.0.1:0"]);
        view.wait_for(Stream::Out, "?key=", SOON);
        view.wait_for(Stream::Err, "Ctrl-C", SOON);
        let link = view.text(Stream::Out);
        let (address, key) = link.trim().trim_start_matches("http://").split_once("/?key=").expect("it is a link");
        Self { address: address.to_owned(), key: key.to_owned(), view }
    }

    /// Sends a request with these header fields.
    fn request(&self, first: &str, fields: &str, body: &str) -> TcpStream {
        let mut stream = TcpStream::connect(&self.address).expect("the page is there");
        stream.set_read_timeout(Some(SOON)).expect("it is a time");
        let length = body.len();
        let request =
            format!("{first} HTTP/1.1\r\nHost: {}\r\nContent-Length: {length}\r\n{fields}\r\n{body}", self.address);
        stream.write_all(request.as_bytes()).expect("the page reads");
        stream
    }

    /// Returns the whole answer.
    fn ask(&self, first: &str, fields: &str, body: &str) -> String {
        let mut answer = String::new();
        self.request(first, fields, body).read_to_string(&mut answer).expect("the page answers");
        answer
    }

    /// Returns the secret in the page.
    fn token(&self) -> String {
        let html = self.ask("GET /", &self.cookie(), "");
        assert!(html.starts_with("HTTP/1.1 200"), "{html}");
        let (_, token) = html.split_once("name=\"dca-token\" content=\"").expect("the page has a token");
        token.split('"').next().unwrap_or_default().to_owned()
    }

    fn fields_of_orders(&self) -> String {
        format!("{}X-Dca-Token: {}\r\n", self.cookie(), self.token())
    }

    fn cookie(&self) -> String {
        let port = self.address.rsplit_once(':').expect("an address has a port").1;
        format!("Cookie: dca-view-{port}={}\r\n", self.key)
    }
}

/// Reads a stream until it contains a text.
fn read_until(stream: &mut TcpStream, wanted: &str) -> String {
    let (mut text, mut chunk) = (String::new(), [0; 4096]);
    while !text.contains(wanted) {
        let count = stream.read(&mut chunk).expect("the stream goes on");
        assert!(count > 0, "it has ended: {text}");
        text.push_str(&String::from_utf8_lossy(&chunk[..count]));
    }
    text
}

#[test]
fn only_the_link_opens_the_page_and_only_the_page_gives_orders() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("door.dca", SPEC)]);
    mission.wait_for(Stream::Err, "started in", SOON);
    let page = Page::open(&here);
    for strange in ["GET /", "GET /?key=00", "GET /events", "GET /page.js", "POST /estop"] {
        let refused = page.ask(strange, "", "");
        assert!(refused.starts_with("HTTP/1.1 403") && !refused.contains("c1"), "{strange}: {refused}");
    }
    let welcome = page.ask(&format!("GET /?key={}", page.key), "", "");
    assert!(welcome.starts_with("HTTP/1.1 303") && welcome.contains("HttpOnly; SameSite=Strict"), "{welcome}");
    let cookie = page.cookie();
    let token = page.token();
    assert!(!token.is_empty() && token != page.key, "{token}");
    // A stream resumes after the last received event.
    let mut stream = page.request("GET /events", &cookie, "");
    let first = read_until(&mut stream, "\"path\":\"main/one\"");
    let id = first.rsplit_once("\nid: ").or_else(|| first.rsplit_once("id: ")).expect("an event has an id").1;
    let id = id.lines().next().unwrap_or_default();
    drop(stream);
    // Both forms are possible: a page that becomes visible again gives its position in the query.
    let ways = [(String::new(), format!("{cookie}Last-Event-ID: {id}\r\n")), (format!("?after={id}"), cookie.clone())];
    let [_, mut stream] = ways.map(|(query, fields)| {
        let mut stream = page.request(&format!("GET /events{query}"), &fields, "");
        let resumed = read_until(&mut stream, "\"ages\"");
        assert!(!resumed.contains("\"whole\":true"), "{resumed}");
        stream
    });
    let refused = page.ask("POST /estop", &cookie, "{}");
    assert!(refused.starts_with("HTTP/1.1 403") && cluster.leaf("main/one").is_some(), "{refused}");
    let done = page.ask("POST /estop", &page.fields_of_orders(), "{}");
    assert!(done.contains("c1: stopped; no program runs"), "{done}");
    assert!(wait_until(SOON, || here.pids().is_empty()).is_some());
    read_until(&mut stream, "everything was stopped by");
    page.view.signal(Signal::TERM);
    assert_eq!(page.view.ended(SOON).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
}

/// Returns whether no thread of a process runs. A signal is sent before it has reached all threads.
fn is_suspended(pid: u32) -> bool {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).expect("it is there").flatten();
    let states = threads.filter_map(|thread| std::fs::read_to_string(thread.path().join("stat")).ok());
    states.into_iter().all(|stat| stat.rsplit_once(')').is_some_and(|(_, rest)| rest.trim_start().starts_with('T')))
}

/// Idle connections of strangers do not use up a person's connections. An order is not carried out after its person has given
/// it up.
#[test]
fn strangers_and_late_orders_do_nothing() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("door.dca", SPEC)]);
    mission.wait_for(Stream::Err, "started in", SOON);
    let page = Page::open(&here);
    let fields = page.fields_of_orders();
    let idle: Vec<TcpStream> =
        (0..200).map(|_| TcpStream::connect(&page.address).expect("the page is there")).collect();
    page.view.signal(Signal::STOP);
    wait_until(SOON, || is_suspended(page.view.pid())).expect("all of its threads stop");
    drop(page.request("POST /estop", &fields, "{}"));
    page.view.signal(Signal::CONT);
    let refused = page.ask("POST /answer", &fields, "{}");
    assert!(refused.contains("no longer open"), "{refused}");
    assert!(cluster.leaf("main/one").is_some(), "the order that was given up is not carried out");
    let done = page.ask("POST /estop", &fields, "{}");
    assert!(done.contains("c1: stopped; no program runs"), "{done}");
    drop(idle);
}

#[test]
fn a_view_goes_on_through_another_node_of_its_machine() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (first, _second) = (here.node("c1", &[]), here.node("c2", &[]));
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("door.dca", &SPEC.replace("c1", "c2"))]);
    mission.wait_for(Stream::Err, "started in", SOON);
    let page = Page::open(&here);
    let (cookie, fields) = (page.cookie(), page.fields_of_orders());
    let mut stream = page.request("GET /events", &cookie, "");
    read_until(&mut stream, "\"host\":\"c1\"");
    first.signal(Signal::KILL);
    let done = page.ask("POST /estop", &fields, "{}");
    assert!(done.contains("c2: stopped; no program runs"), "{done}");
    let seen = read_until(&mut stream, "all data now comes through `c2`");
    assert!(!seen.contains("\"robot\":\"c2\""), "`c2` was never gone: {seen}");
    let done = page.ask("POST /release", &fields, "{}");
    assert!(done.contains("c2: "), "{done}");
}

#[test]
fn the_page_stays_on_its_machine() {
    let cluster = Cluster::new();
    for address in ["0.0.0.0:0", "192.0.2.1:7080", "[::]:7080"] {
        let refused = cluster.here().ask(&["view", "--page", address]);
        assert!(refused.code == Some(2) && refused.err.contains("open to the network"), "{refused}");
    }
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port is free");
    let port = taken.local_addr().expect("it listens").port();
    let _node = cluster.here().with_run_dir(cluster.folder().join("other")).node("c1", &[]);
    let other = cluster.here().with_run_dir(cluster.folder().join("other"));
    let refused = other.ask(&["view", "--page", &format!("127.0.0.1:{port}")]);
    let hint = "another program listens there, perhaps another view; `--page 127.0.0.1:0` takes a free port";
    assert!(refused.code == Some(1) && refused.err.contains(hint), "{refused}");
    let refused = other.ask(&["view", "--page", "7400"]);
    assert!(
        refused.code == Some(2) && refused.err.contains("an address has a host and a port: `127.0.0.1:7400`"),
        "{refused}"
    );
    let alone = cluster.here().ask(&["view", "--page"]);
    assert!(alone.code == Some(3) && alone.err.contains("no node runs on this machine"), "{alone}");
}

/// Each of two commands has its own node `c1` and its own deployment `door@1`.
#[test]
fn two_runs_of_one_spec_are_two_missions() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let file = cluster.file("door.dca", SPEC);
    let runs = [0, 1].map(|_| here.dca(&["run", "--no-record", &file]));
    runs.iter().for_each(|run| run.wait_for(Stream::Err, "started in", SOON));
    let page = Page::open(&here);
    let mut stream = page.request("GET /events", &page.cookie(), "");
    let mut seen = String::new();
    let mut see = |wanted: &str| {
        if !seen.contains(wanted) {
            seen += &read_until(&mut stream, wanted);
        }
    };
    for run in &runs {
        see(&format!("\"id\":\"door@1 c1 (command {})\"", run.pid()));
        see(&format!("\"mission\":\"door@1 c1 (command {})\",\"path\":\"main/one\"", run.pid()));
    }
    // The first command ends. Its robot disappears, and the robot of the second command stays.
    runs[0].signal(Signal::INT);
    see(&format!("{{\"robot\":\"c1 (command {})\"}}", runs[0].pid()));
    assert!(!seen.contains(&format!("{{\"robot\":\"c1 (command {})\"}}", runs[1].pid())), "{seen}");
    // The result of one command does not hide the result of another.
    let third = here.dca(&["run", "--no-record", &file]);
    third.wait_for(Stream::Err, "started in", SOON);
    let stopped = here.ask(&["estop"]);
    for run in [&runs[1], &third] {
        let line = format!("c1 (command {}): stopped; no program runs", run.pid());
        assert!(stopped.out.contains(&line), "{stopped}");
    }
    let again = page.ask("POST /estop", &page.fields_of_orders(), "{}");
    assert!(!again.contains(&runs[0].pid().to_string()), "a command that has ended is not asked: {again}");
}

/// A group, an activity, and a connection.
const PICTURED: &str = "
    module Sleeper(host) { exec \"sleep 600\"; plain; done; }
    activity Guard(here: Host) {
        host { here }
        look instof Sleeper(here);
        initial state watching { run look; on done -> alarmed; }
        state alarmed { on after 1 s -> watching; }
    }
    process Inner(here) {
        host { here }
        instantiated_processes { deep instof Sleeper(here); }
        internal_event_actions { deep }
    }
    process main() {
        host { c1 }
        instantiated_processes { inner instof Inner(c1); guard instof Guard(c1); one instof Sleeper(c1); }
        internal_event_actions { inner, guard, one? }
    }";

/// A program with parameters, whose threshold is never exceeded.
const PUSHED: &str = concat!(
    "\n",
    hit_detector!("150 N"),
    "
    process main() {
        host { c1 }
        instantiated_processes {
            world instof DoorWorld(c1, push_at = 0 s, push = 60 N);
            hit instof HitDetector(c1);
        }
        internal_event_actions { ((world # wait(4 s)) ;; skip) # hit }
    }"
);

/// Returns the number of the plan in the changes that a stream has sent.
fn plan_number(seen: &str) -> Option<u64> {
    let (_, rest) = seen.rsplit_once("\"plan\":")?;
    // It may not have come whole.
    rest.split_once(',')?.0.parse().ok()
}

#[test]
fn a_mission_has_pictures_and_a_timeline() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("door.dca", PICTURED)]);
    mission.wait_for(Stream::Err, "started in", SOON);
    let page = Page::open(&here);
    let cookie = page.cookie();
    let mut stream = page.request("GET /events", &cookie, "");
    let mut seen = String::new();
    while plan_number(&seen).is_none() {
        seen += &read_until(&mut stream, ",");
    }
    let number = plan_number(&seen).expect("it was found");
    let picture = page.ask(&format!("GET /picture?{number}"), &cookie, "");
    assert!(picture.starts_with("HTTP/1.1 200") && picture.contains("application/json"), "{picture}");
    for path in ["main", "main/inner", "main/inner/deep", "main/guard", "main/one"] {
        assert!(picture.contains(&format!("data-key=\\\"{path}\\\"")), "{path}: {picture}");
    }
    let (_, group) = picture.split_once("\"group\":").expect("it has an activity");
    let group: u64 = group.split(',').next().and_then(|group| group.parse().ok()).expect("it is a number");
    let states = page.ask(&format!("GET /picture?{number}-{group}"), &cookie, "");
    assert!(states.contains("data-key=\\\"watching\\\"") && states.contains("after 1 s"), "{states}");
    let timeline = page.ask(&format!("GET /timeline?{number}"), &cookie, "");
    assert!(timeline.contains("seconds since") && timeline.contains("inner running, "), "{timeline}");
    for (wrong, status) in [("picture?", 400), ("picture?x", 400), ("timeline?1-x", 400), ("timeline?999999999", 200)] {
        let answer = page.ask(&format!("GET /{wrong}"), &cookie, "");
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{wrong}: {answer}");
    }
    for secret in ["picture", "timeline"] {
        let refused = page.ask(&format!("GET /{secret}?{number}"), "", "");
        assert!(refused.starts_with("HTTP/1.1 403") && !refused.contains("svg"), "{refused}");
    }
    // A mission that is over keeps its pictures, and the marks of its ends.
    cluster.expect_leaf("main/one").signal(Signal::SEGV);
    read_until(&mut stream, "\"mark\":\"failed\"");
    assert_eq!(here.ask(&["stop", "door"]).code, Some(0));
    read_until(&mut stream, "\"ends\":{\"main");
    assert!(page.ask(&format!("GET /picture?{number}"), &cookie, "").contains("main/inner/deep"));
    let timeline = page.ask(&format!("GET /timeline?{number}"), &cookie, "");
    assert!(timeline.contains("mark bad") && timeline.contains("SIGSEGV"), "{timeline}");
}

/// A parameter is listed and changed as by `dca param`, and only by the page itself.
#[test]
fn a_parameter_is_changed_from_the_page() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let page = Page::open(&here);
    let fields = page.fields_of_orders();
    let list = || page.ask("POST /parameters", &fields, "{}");
    assert!(list().contains("\"parameters\":[]"), "nothing runs");
    let file = cluster.file("door.dca", PUSHED);
    let mission = here.dca(&["deploy", "--no-record", &file]);
    mission.wait_for(Stream::Err, "started in", SOON);
    wait_until(SOON, || list().contains("\"threshold\"")).expect("the program has parameters");
    let refused = page.ask("POST /parameters", &page.cookie(), "{}");
    assert!(refused.starts_with("HTTP/1.1 403"), "{refused}");
    let set = |name: &str, value: &str| {
        let body = format!("{{\"robot\": \"c1\", \"name\": \"{name}\", \"value\": {value}}}");
        page.ask("POST /parameter", &fields, &body)
    };
    let name = "door:main/hit/threshold.threshold";
    let get = || here.ask(&["param", "get", "hit/threshold", "threshold"]).out;
    for (name, value, why) in [
        (name, "\"900 N\"", "expected a Force from"),
        (name, "\"much\"", "expected a Force"),
        (name, "\"\"", "expected a Force"),
        (name, "[1]", "this order cannot be read"),
        ("door:main/hit/threshold.treshold", "\"5\"", "did you mean `threshold`?"),
        ("door:main/none.threshold", "\"5\"", "there is no such parameter"),
        ("<img src=x>", "\"5\"", "there is no such parameter"),
    ] {
        let answer = set(name, value);
        assert!(answer.contains("NOT DONE") && answer.contains(why), "{name} {value}: {answer}");
    }
    let answer = page.ask("POST /parameter", &fields, &format!("{{\"robot\": \"c9\", \"name\": \"{name}\"}}"));
    assert!(answer.contains("NOT DONE") && answer.contains("`c9` does not answer"), "{answer}");
    assert_eq!(get(), "150.0\n");
    let answer = set(name, "\"0.1 kN\"");
    assert!(answer.contains("is set to 0.1 kN") && answer.contains("it uses the value at once if"), "{answer}");
    assert_eq!(get(), "100.0\n");
    assert!(list().contains("\"value\":100.0"), "{}", list());
    let answer = set(name, "null");
    assert!(answer.contains("has the value of the spec again"), "{answer}");
    assert_eq!(get(), "150.0\n");
}

/// The keys of a robot are shown with their history, and hostile values stay text.
#[test]
fn the_database_of_a_robot_is_read_from_the_page() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let page = Page::open(&here);
    let fields = page.fields_of_orders();
    let ask = |key: &str| page.ask("POST /database", &fields, &format!("{{\"robot\": \"c1\", \"key\": \"{key}\"}}"));
    wait_until(SOON, || ask("").contains("\"keys\"")).expect("the robot is known");
    for (key, value) in [("robot/c1/gain", "1.5"), ("robot/c1/gain", "2.5"), ("robot/c1/gain2", "\"<img src=x>\"")] {
        let put = here.ask(&["db", "put", key, value, "-m", &format!("it was set to {value}")]);
        assert_eq!(put.code, Some(0), "{put}");
    }
    let listed = ask("robot/c1/");
    assert!(listed.contains("{\"key\":\"robot/c1/gain\",\"value\":\"2.5\",\"writes\":1}"), "{listed}");
    assert!(listed.contains("application/json") && listed.contains("<img src=x>"), "{listed}");
    let one = ask("robot/c1/gain");
    for part in ["\"value\":\"2.5\"", "it was set to 1.5", "it was set to 2.5", "\"conflicts\":null"] {
        assert!(one.contains(part), "{part}: {one}");
    }
    assert!(!one.contains("<img"), "another key is not part of it: {one}");
    assert!(ask("robot/c1/none").contains("\"value\":null"));
    for (body, why) in [
        ("{\"robot\": \"c9\", \"key\": \"\"}", "this view does not show the robot `c9`"),
        ("{\"robot\": \"c1\", \"key\": \"//\"}", "\"why\""),
        ("{\"robot\": 5}", "this view does not show the robot"),
        ("no JSON", "400"),
    ] {
        let answer = page.ask("POST /database", &fields, body);
        assert!(answer.contains(why), "{body}: {answer}");
    }
    for fields in [String::new(), page.cookie()] {
        let refused = page.ask("POST /database", &fields, "{\"robot\": \"c1\", \"key\": \"\"}");
        assert!(refused.starts_with("HTTP/1.1 403"), "{refused}");
    }
}

/// The output of a process comes with the stream of a window that shows it, and with no other.
#[test]
fn the_output_of_a_process_is_sent_while_it_is_shown() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let writer = cluster.file("write.sh", "echo '<script>'; while :; do echo again; sleep 0.1; done");
    let spec = SPEC.replace("sleep 600", &format!("sh {writer}"));
    let mission = here.dca(&["deploy", "--no-record", &cluster.file("door.dca", &spec)]);
    mission.wait_for(Stream::Err, "started in", SOON);
    let page = Page::open(&here);
    let cookie = page.cookie();
    let mut silent = page.request("GET /events", &cookie, "");
    let mut seen = String::new();
    while plan_number(&seen).is_none() {
        seen += &read_until(&mut silent, ",");
    }
    let number = plan_number(&seen).expect("it was found");
    let mut stream = page.request(&format!("GET /events?after=&output={number}-main/one"), &cookie, "");
    let shown = read_until(&mut stream, "\"again\"");
    assert!(shown.contains("\"begins\":true") && shown.contains("\"<script>\""), "{shown}");
    // Further lines follow.
    read_until(&mut stream, "\"begins\":false");
    seen += &read_until(&mut silent, "\"ages\"");
    assert!(!seen.contains("\"output\""), "{seen}");
    for wrong in ["", "x", "17"] {
        let mut stream = page.request(&format!("GET /events?after=&output={wrong}"), &cookie, "");
        let shown = read_until(&mut stream, "\"ages\"");
        assert!(!shown.contains("\"output\""), "{wrong}: {shown}");
    }
    for gone in ["999999-main/one", &format!("{number}-main/none")] {
        let mut stream = page.request(&format!("GET /events?after=&output={gone}"), &cookie, "");
        read_until(&mut stream, "this process is no longer shown");
    }
}
