//! The output of programs, in any amount and with any reader. It arrives whole, and blocks nothing else.

use cli::io::recorder;
use dca_tests::cluster::{Cluster, SOON, Stream, executable, wait_until};
use rustix::process::Signal;
use std::process::Command;
use std::time::Duration;

/// How long a program with much output writes.
const WRITING: Duration = Duration::from_secs(60);

/// Returns a spec of a program on c2 that writes `count` times 50,000 bytes, each time with its number. Between them is
/// a tenth of a second, and then the program is done.
fn talker(count: u32) -> String {
    let line = "x".repeat(99);
    format!(
        "
module Talker(host) {{ exec \"sh -c 'i=0; while [ $i -lt {count} ]; do i=$((i+1)); echo piece $i;\
  yes {line} | head -n 500; sleep 0.1; done'\"; plain; }}
module Idle(host) {{ exec \"sleep 3600\"; plain; }}
process main() {{ host {{ c1 }}
  instantiated_processes {{ talker instof Talker(c2); idle instof Idle(c1); }}
  internal_event_actions {{ talker # idle }} }}
"
    )
}

/// A reader that takes no output for a while does not block the program, the mission or its record. A reader with a
/// pager continues after the pause, and a suspended reader is told of the gap.
#[test]
fn a_reader_of_much_output_that_pauses_ends_no_mission() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _nodes = ["c1", "c2"].map(|name| here.node(name, &[]));
    let file = cluster.file("talk.dca", &talker(150));
    let path = |name: &str| cluster.folder().join(name).display().to_string();
    let deploy = here.dca(&["deploy", &file, "--runs", &path("runs")]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    let suspended = [0, 1].map(|_| {
        let reader = here.dca(&["logs", "talker", "-f"]);
        reader.wait_for(Stream::Out, "piece 1\n", SOON);
        reader.signal(Signal::STOP);
        reader
    });
    let (dca, run_dir) = (executable("dca").display().to_string(), here.run_dir().display().to_string());
    let (go, out, code) = (path("go"), path("out"), path("code"));
    let pager = format!(
        "{{ {dca} logs talker -f --run-dir {run_dir}; echo $? > {code}; }} | \
         {{ until [ -e {go} ]; do sleep 0.1; done; cat > {out}; }}"
    );
    let mut pager = Command::new("sh").args(["-c", &pager]).spawn().expect("there is a shell");
    let deploy = deploy.ended(WRITING);
    assert!(deploy.code == Some(0) && !deploy.err.contains("warning"), "{deploy}");
    cluster.file("go", "");
    assert!(pager.wait().expect("it ends").success());
    let out = std::fs::read_to_string(out).expect("it was written");
    assert_eq!(std::fs::read_to_string(code).expect("it was written"), "0\n");
    let numbers: Vec<u32> = out.lines().filter_map(|line| line.strip_prefix("piece ")?.parse().ok()).collect();
    assert!(numbers.is_sorted() && numbers.last() == Some(&150), "{numbers:?}");
    // During the reader's absence, more may be written than is kept.
    assert!(numbers.len() == 150 || out.contains("output may be missing here"), "{numbers:?}");
    for reader in suspended {
        reader.signal(Signal::CONT);
        let read = reader.ended(SOON);
        assert!(read.code == Some(0) || read.code == Some(3) && read.err.contains("are not complete"), "{}", read.err);
    }
}

/// Output of more than a megabyte is printed and recorded whole, and so is the output of another program beside it. It
/// comes in two pieces that a shim holds, 1 MiB, even if the disk is slow.
#[test]
fn much_output_is_printed_and_recorded_whole() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _nodes = ["c1", "c2"].map(|name| here.node(name, &[]));
    let text = "
module Talker(host) { exec \"sh -c 'seq 1 150000; until [ -e MORE ]; do sleep 0.1; done; seq 150001 250000; sleep 3600'\"; plain; }
module Quiet(host) { exec \"sh -c 'echo first; until [ -e DONE ]; do sleep 0.1; done; echo last'\"; plain; }
process main() { host { c1 }
  instantiated_processes { talker instof Talker(c2); quiet instof Quiet(c2); }
  internal_event_actions { talker # quiet } }
";
    let [more, done] = ["more", "done"].map(|name| cluster.folder().join(name).display().to_string());
    let file = cluster.file("talk.dca", &text.replace("MORE", &more).replace("DONE", &done));
    let runs = cluster.folder().join("runs");
    let deploy = here.dca(&["deploy", &file, "--runs", &runs.display().to_string()]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    let mut expected = String::new();
    for (numbers, next) in [(1..=150_000, "more"), (150_001..=250_000, "read")] {
        expected.extend(numbers.map(|number| format!("{number}\n")));
        let mut out = String::new();
        let whole = wait_until(SOON, || {
            let logs = here.ask(&["logs", "talker"]);
            assert_eq!(logs.code, Some(0), "{}", logs.err);
            out = logs.out;
            out.len() >= expected.len()
        });
        assert!(whole.is_some() && out == expected, "{} of {} bytes", out.len(), expected.len());
        cluster.file(next, "");
    }
    cluster.file("done", "");
    let deploy = deploy.ended(SOON);
    assert!(deploy.code == Some(0) && !deploy.err.contains("warning"), "{deploy}");
    let run = std::fs::read_dir(&runs).expect("it has a record").flatten().next().expect("it has a record").path();
    let record = recorder::read(&run.join(recorder::FILE)).expect("it can be read");
    let recorded = record.outputs();
    let wrote = |name: &str| recorded[name].iter().map(|lines| format!("{lines}\n")).collect::<String>();
    assert_eq!(wrote("main/quiet"), "first\nlast\n");
    let talked = wrote("main/talker");
    assert!(talked == expected, "{} of {} bytes", talked.len(), expected.len());
}

/// A folder for sockets may be a relative path. An incomplete record is never used as a complete one.
#[test]
fn a_record_that_is_not_whole_is_told() {
    let cluster = Cluster::new();
    let here = cluster.here().with_run_dir("n");
    let text = "
module Once(host) { exec \"sh -c 'seq 1 20000'\"; plain; }
process main() { host { c1 } instantiated_processes { once instof Once(c1); } internal_event_actions { once } }
";
    let file = cluster.file("once.dca", text);
    let run = here.ask(&["run", &file, "--runs", "runs"]);
    assert_eq!(run.code, Some(0), "{run}");
    let whole = here.ask(&["logs", "once", "--runs", "runs"]);
    assert!(whole.code == Some(0) && whole.out.ends_with("\n20000\n"), "{whole}");
    let record = cluster.folder().join("runs/once-1").join(recorder::FILE);
    let bytes = std::fs::read(&record).expect("it is there");
    // This changes a digit in the program's output.
    let mut flipped = bytes.clone();
    let place = bytes.windows(7).position(|window| window == b"n12345\\").expect("it wrote that");
    flipped[place + 3] = b'9';
    std::fs::write(&record, &flipped).expect("a test can write in its own folder");
    let part = here.ask(&["logs", "once", "--runs", "runs"]);
    assert!(part.code == Some(1) && part.err.contains("are damaged and left out"), "{part}");
    assert!(!part.out.contains("12945"), "{part}");
    let report = here.ask(&["report", "runs/once-1"]);
    assert!(report.code == Some(1) && report.err.contains("are damaged and left out"), "{report}");
    std::fs::write(&record, &bytes[..bytes.len() / 2]).expect("a test can write in its own folder");
    let part = here.ask(&["logs", "once", "--runs", "runs"]);
    assert!(part.code == Some(1) && part.err.contains("is not whole"), "{part}");
    let report = here.ask(&["report", "runs/once-1"]);
    assert!(report.code == Some(1) && report.err.contains("is not whole"), "{report}");
}
