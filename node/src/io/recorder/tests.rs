//! Records written, read back, and cut short.

use super::*;
use crate::logic::mission::tests::{OPENING, door, event_table, seconds};
use crate::logic::mission::{Files, summary};
use crate::logic::protocol::{Ending, Report};

/// A folder that is gone with its owner.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("dca-recorder-{name}-{}", std::process::id()));
        drop(fs::remove_dir_all(&folder));
        Self(folder)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        drop(fs::remove_dir_all(&self.0));
    }
}

fn header() -> Header {
    Header {
        file: "door.dca".to_owned(),
        text: "process main() {}".to_owned(),
        plan: door(),
        started: Some(seconds(1e9)),
    }
}

fn entries() -> Vec<Entry> {
    let mut entries = vec![Entry::Report(Report::Go { took: seconds(0.8), signals: Vec::new() })];
    entries.extend(event_table(OPENING));
    let ending = Ending::Done(vec![1, 2]);
    entries.push(Entry::Report(Report::Finished { ending, at: seconds(22.1), unconfirmed: Vec::new() }));
    entries
}

fn record(folder: &Folder) -> Recorder {
    let recorder = Recorder::create(&folder.0, &header()).unwrap();
    for entry in entries() {
        recorder.push(entry);
    }
    recorder
}

#[test]
fn a_record_is_read_back_as_it_was_written() {
    let folder = Folder::new("whole");
    let (path, dropped) = record(&folder).finish().unwrap();
    assert_eq!(dropped, 0);
    let run = read(&path).unwrap();
    assert_eq!(run, Run { header: header(), entries: entries(), damage: None });
    let text = summary(&run.mission(), &Files::default());
    assert!(text.starts_with("test: done after 22.1 s"), "{text}");
}

#[test]
fn a_record_cut_anywhere_is_read_as_far_as_it_goes() {
    let folder = Folder::new("cut");
    let (path, _) = record(&folder).finish().unwrap();
    let bytes = fs::read(&path).unwrap();
    let mut longest = 0;
    for length in (0..bytes.len()).step_by(7) {
        if let Ok(run) = Run::from_bytes(&bytes[..length]) {
            assert_eq!(run.entries[..], entries()[..run.entries.len()]);
            assert!(run.entries.len() >= longest && (run.damage.is_some() || run.entries.len() == entries().len()));
            longest = run.entries.len();
        }
    }
    assert_eq!(longest, entries().len());
}

#[test]
fn what_is_older_than_a_second_survives_a_kill() {
    let folder = Folder::new("killed");
    let mut log = Log::begin(
        File::create({
            fs::create_dir_all(&folder.0).unwrap();
            folder.0.join(FILE)
        })
        .unwrap(),
        &header(),
    )
    .unwrap();
    for entry in entries() {
        log.write(&entry).unwrap();
    }
    // A killed process runs no destructor: what is in its buffers is gone.
    std::mem::forget(log);
    let run = read(&folder.0.join(FILE)).unwrap();
    assert!(run.damage.is_some());
    assert!(run.entries.len() + 5 > entries().len(), "{} of {}", run.entries.len(), entries().len());
}

#[test]
fn a_full_queue_drops_samples_before_reports_and_counts_them() {
    let queue = Queue::default();
    let sample = || entries().into_iter().find(|entry| matches!(entry, Entry::Signals { .. })).unwrap();
    for _ in 0..queue::SAMPLES + 3 {
        queue.push(sample(), queue::SAMPLES);
    }
    queue.push(Entry::Report(Report::Go { took: seconds(0.8), signals: Vec::new() }), queue::REPORTS);
    assert_eq!(queue.dropped(), 3);
    queue.close();
    let mut left = 0;
    while let Popped::Entry(_) = queue.pop(Duration::ZERO) {
        left += 1;
    }
    assert_eq!(left, queue::SAMPLES + 1);
}

#[test]
fn other_files_are_refused_with_a_reason() {
    let folder = Folder::new("other");
    fs::create_dir_all(&folder.0).unwrap();
    let path = folder.0.join("x.mcap");
    let missing = read(&path).unwrap_err().to_string();
    assert!(missing.starts_with("reading the record `") && missing.contains("No such file"), "{missing}");
    for bytes in [&b""[..], b"hello", mcap::MAGIC] {
        fs::write(&path, bytes).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("not the record of a run: "), "{error}");
    }
}
