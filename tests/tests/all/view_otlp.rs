//! `dca view --otlp`: the traces of missions that run, for a collector of OpenTelemetry.
//!
//! The collector in these tests reads its requests itself, so it shares no code with the view.

use dca_tests::cluster::{Cluster, Ended, Program, SOON, Stream, wait_until};
use rustix::process::Signal;
use serde_json::Value;
use std::io::{Read as _, Write as _};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::{Arc, Mutex};

/// The first process is done, and the second one ends when it is stopped.
const SPEC: &str = "
module Short { plain; exec \"'/bin/true'\"; }
module Long { plain; exec \"'/bin/sleep' 1000\"; }
process main() {
    host { c1 }
    instantiated_processes { short instof Short(c1); long instof Long(c1); }
    internal_event_actions { short ; long }
}
";

/// A collector that keeps the spans of each request, and answers with a text.
struct FakeCollector {
    address: SocketAddr,
    spans: Arc<Mutex<Vec<Value>>>,
}

impl FakeCollector {
    /// Listens. The request with a number, counted from 0, gets this answer.
    fn open(at: Option<SocketAddr>, answer: impl Fn(usize) -> &'static str + Send + 'static) -> Self {
        let listener = TcpListener::bind(at.unwrap_or((Ipv4Addr::LOCALHOST, 0).into())).expect("it listens");
        let address = listener.local_addr().expect("it has an address");
        let spans = Arc::new(Mutex::new(Vec::new()));
        let kept = Arc::clone(&spans);
        std::thread::spawn(move || {
            for (number, stream) in listener.incoming().flatten().enumerate() {
                let answer = answer(number);
                let mut new = request(stream, answer);
                if answer.contains(" 200 ") {
                    kept.lock().expect("no thread has panicked").append(&mut new);
                }
            }
        });
        Self { address, spans }
    }

    fn url(&self) -> String {
        format!("http://{}", self.address)
    }

    fn spans(&self) -> Vec<Value> {
        self.spans.lock().expect("no thread has panicked").clone()
    }

    fn named(&self, name: &str) -> Option<Value> {
        self.spans().into_iter().find(|span| span["name"] == name)
    }
}

/// Reads one request, answers it, and returns its spans.
fn request(mut stream: TcpStream, answer: &str) -> Vec<Value> {
    let mut bytes = Vec::new();
    let (head, length) = loop {
        let mut piece = [0; 4096];
        let count = stream.read(&mut piece).expect("a request arrives");
        assert!(count > 0, "the request breaks off");
        bytes.extend_from_slice(&piece[..count]);
        let text = String::from_utf8_lossy(&bytes);
        let Some(end) = text.find("\r\n\r\n") else { continue };
        assert!(text.starts_with("POST /v1/traces HTTP/1."), "{text}");
        let fields = text[..end].lines().filter_map(|line| line.split_once(": "));
        let field = |wanted: &str| fields.clone().find(|(name, _)| name.eq_ignore_ascii_case(wanted));
        assert_eq!(field("Content-Type").map(|(_, kind)| kind), Some("application/json"));
        let length: usize = field("Content-Length").and_then(|(_, value)| value.parse().ok()).expect("it has a length");
        break (end + 4, length);
    };
    let mut body = bytes.split_off(head);
    let begun = body.len();
    body.resize(length, 0);
    stream.read_exact(&mut body[begun..]).expect("the body arrives");
    stream.write_all(answer.as_bytes()).expect("the answer is taken");
    let body: Value = serde_json::from_slice(&body).expect("the body is JSON");
    let mut spans = body["resourceSpans"][0]["scopeSpans"][0]["spans"].as_array().cloned().unwrap_or_default();
    for span in &mut spans {
        span["service"] = body["resourceSpans"][0]["resource"]["attributes"][0]["value"]["stringValue"].clone();
    }
    spans
}

fn deploy(cluster: &Cluster) -> Program {
    let mission = cluster.here().dca(&["deploy", "--no-record", &cluster.file("walk.dca", SPEC)]);
    mission.wait_for(Stream::Err, "▸", SOON);
    mission
}

fn left(view: Program) -> Ended {
    view.signal(Signal::INT);
    view.ended(SOON)
}

const TAKEN: &str = "HTTP/1.0 200 OK\r\n\r\n{}";

/// A span comes once its process has ended, although the mission goes on. The mission itself comes last.
#[test]
fn a_span_comes_when_its_process_has_ended() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let collector = FakeCollector::open(None, |_| TAKEN);
    let view = here.dca(&["view", "--otlp", &collector.url()]);
    view.wait_for(Stream::Out, "traces go to http://127.0.0.1:", SOON);
    let mission = deploy(&cluster);
    let has_come = |name: &str| wait_until(SOON, || collector.named(name).is_some()).is_some();
    assert!(has_come("short"), "{:?}", collector.spans());
    assert!(collector.named("long").is_none(), "{:?}", collector.spans());
    assert_eq!(here.ask(&["stop", "walk"]).code, Some(0));
    assert_eq!(mission.ended(SOON).code, Some(1));
    assert!(has_come("walk@1"), "{:?}", collector.spans());
    let named = |name: &str| collector.named(name).unwrap_or_else(|| panic!("no `{name}`: {:?}", collector.spans()));
    let (walk, main, short, long) = (named("walk@1"), named("main"), named("short"), named("long"));
    assert!(walk.get("parentSpanId").is_none(), "{walk}");
    assert_eq!((&main["parentSpanId"], &main["service"]), (&walk["spanId"], &"walk@1".into()));
    let nanos = |span: &Value, end: &str| span[end].as_str().and_then(|text| text.parse::<u64>().ok()).expect("a time");
    for (span, code) in [(&short, 1), (&long, 1)] {
        assert_eq!((&span["parentSpanId"], &span["traceId"]), (&main["spanId"], &walk["traceId"]), "{span}");
        assert_eq!(span["status"]["code"], code, "{span}");
        assert!(nanos(span, "startTimeUnixNano") >= nanos(&main, "startTimeUnixNano"), "{span} {main}");
        assert!(nanos(span, "endTimeUnixNano") <= nanos(&walk, "endTimeUnixNano"), "{span} {walk}");
    }
    assert!(nanos(&short, "endTimeUnixNano") <= nanos(&long, "startTimeUnixNano"), "{short} {long}");
    let left = left(view);
    assert!(left.code == Some(0) && left.err.contains("has taken 4 spans; 0 were not delivered"), "{left}");
    // A later view repeats nothing of the past.
    let view = here.dca(&["view", "--otlp", &collector.url()]);
    view.wait_for(Stream::Out, "traces go to", SOON);
    let mission = deploy(&cluster);
    let is_short = |span: &Value| span["name"] == "short" && span["service"] == "walk@2";
    assert!(wait_until(SOON, || collector.spans().iter().any(is_short)).is_some(), "{:?}", collector.spans());
    assert_eq!(collector.spans().len(), 5, "{:?}", collector.spans());
    here.ask(&["stop", "walk"]);
    mission.ended(SOON);
}

/// Spans wait for a collector that is not there or busy. A refusal is told.
#[test]
fn spans_wait_for_the_collector() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _node = here.node("c1", &[]);
    let address = TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr()).expect("a port is free");
    let view = here.dca(&["view", "--otlp", &format!("http://{address}")]);
    view.wait_for(Stream::Out, "traces go to", SOON);
    let mission = deploy(&cluster);
    view.wait_for(Stream::Err, "does not take traces; they wait: ", SOON);
    let partly = "HTTP/1.0 200 OK\r\n\r\n{\"partialSuccess\":{\"rejectedSpans\":\"1\",\"errorMessage\":\"too old\"}}";
    let collector = FakeCollector::open(Some(address), move |number| match number {
        0 => "HTTP/1.0 503 Busy\r\n\r\nlater",
        1 => TAKEN,
        2 => partly,
        _ => "HTTP/1.0 400 Bad Request\r\n\r\nno",
    });
    assert!(wait_until(SOON, || collector.named("short").is_some()).is_some(), "it is sent again");
    view.wait_for(Stream::Err, "the collector takes traces again", SOON);
    assert_eq!(here.ask(&["stop", "walk"]).code, Some(0));
    mission.ended(SOON);
    view.wait_for(Stream::Err, "the collector has refused 1 spans: too old", SOON);
    let second = deploy(&cluster);
    view.wait_for(Stream::Err, "it answers 400: no", SOON);
    here.ask(&["stop", "walk"]);
    second.ended(SOON);
    let left = left(view);
    assert!(left.code == Some(0) && left.err.contains("were not delivered"), "{left}");
}

#[test]
fn what_is_no_collector_is_refused() {
    let cluster = Cluster::new();
    let here = cluster.here();
    for (url, words) in [("https://a", "without TLS"), ("localhost:4318", "http://localhost:4318")] {
        let refused = here.ask(&["view", "--otlp", url]);
        assert!(refused.code == Some(2) && refused.err.contains(words), "{refused}");
    }
}
