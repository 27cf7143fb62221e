//! Records that are written and read again, or cut short.

use super::*;
use crate::logic::mission::tests::{OPENING, door, event_table, seconds};
use crate::logic::mission::{Files, summary};
use crate::logic::record::{MissingValues, WireName};
use comms::logic::layout::{Field, Layout, Message};
use comms::logic::signals::{Signal, Signals};
use node::logic::protocol::{Ending, Report};
use serde_json::Value;
use std::collections::BTreeMap;

/// A folder that is removed when this is dropped.
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
    let output =
        |at, text: &str| Entry::Output { path: "main/sys/near".to_owned(), at: seconds(at), text: text.to_owned() };
    entries.push(output(22.0, "two lines:\nä \u{1b}[0m"));
    entries.push(Entry::Report(Report::Finished { ending, at: seconds(22.1), unconfirmed: Vec::new() }));
    entries
}

/// The arrival time of everything recorded here, since 1970.
const ARRIVED: Duration = Duration::from_secs(1_700_000_000);

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
    assert!(run.go.is_some_and(|go| go >= header().started.unwrap()), "{:?}", run.go);
    assert_eq!(run, Run { header: header(), go: run.go, entries: entries(), values: Vec::new(), damage: None });
    let text = summary(&run.mission(), &Files::default(), None);
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

/// The official reader refuses a file whose summary, footer or magic is damaged.
#[test]
fn a_record_without_its_end_says_so() {
    let folder = Folder::new("end");
    let (path, _) = record(&folder).finish().unwrap();
    let bytes = fs::read(&path).unwrap();
    let footer = bytes.len() - mcap::MAGIC.len() - 29;
    let start = u64::from_le_bytes(bytes[footer + 9..footer + 17].try_into().unwrap());
    let data_end = usize::try_from(start).unwrap();
    assert!(data_end > 0 && Run::from_bytes(&bytes).unwrap().damage.is_none());
    let expect_told = |bytes: &[u8], what: &str| {
        let run = Run::from_bytes(bytes).unwrap();
        let told = run.damage.is_some_and(|damage| damage.contains("all entries are intact, but the end of the file"));
        assert!(told && run.entries == entries(), "{what}");
    };
    for length in data_end..bytes.len() {
        expect_told(&bytes[..length], &format!("cut at byte {length} of {}", bytes.len()));
    }
    for at in data_end..bytes.len() {
        let mut damaged = bytes.clone();
        damaged[at] ^= 0x20;
        expect_told(&damaged, &format!("byte {at} of {} is another", bytes.len()));
    }
    // The recorder was killed. It had already ended the file, but without a summary.
    let killed = killed(&folder);
    assert!(Run::from_bytes(&killed).unwrap().damage.is_none());
    assert!(Run::from_bytes(&killed[..killed.len() - 1]).unwrap().damage.is_some());
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
        log.write(&entry, ARRIVED).unwrap();
    }
    // A killed process runs no destructor: the content of its buffers is gone.
    std::mem::forget(log);
    let run = read(&folder.0.join(FILE)).unwrap();
    assert_eq!(run.entries.len(), 0, "nothing is a second old");
}

/// Writes all entries a second apart and dies.
fn killed(folder: &Folder) -> Vec<u8> {
    fs::create_dir_all(&folder.0).unwrap();
    let path = folder.0.join(FILE);
    let mut log = Log::begin(File::create(&path).unwrap(), &header()).unwrap();
    for (second, entry) in (0..).zip(entries()) {
        log.write(&entry, ARRIVED + Duration::from_secs(second)).unwrap();
    }
    std::mem::forget(log);
    fs::read(path).unwrap()
}

#[test]
fn any_reader_opens_the_record_of_a_recorder_that_was_killed() {
    let bytes = killed(&Folder::new("opens"));
    assert!(bytes.ends_with(mcap::MAGIC), "it has an end");
    // The official reader refuses a file without an end.
    let messages: Vec<_> = mcap::MessageStream::new(&bytes).unwrap().map(|message| message.unwrap()).collect();
    assert_eq!(messages.len(), entries().len());
    assert!(mcap::read::Summary::read(&bytes).unwrap().is_none(), "it is read without a summary");
    let run = Run::from_bytes(&bytes).unwrap();
    assert_eq!((run.entries.len(), run.damage), (entries().len(), None));
}

/// Returns numbers that look random: the same ones for a seed.
fn random(seed: u64) -> impl FnMut() -> usize {
    let mut random = comms::logic::random::Random::new(seed);
    move || usize::try_from(random.next() >> 33).unwrap()
}

/// Returns whether `part` is `whole` with some entries left out.
fn is_part(part: &[Entry], whole: &[Entry]) -> bool {
    let mut rest = whole.iter();
    part.iter().all(|entry| rest.any(|one| one == entry))
}

/// Returns the entry as a reader gets it when the time of GO is unknown.
fn without_time(mut entry: Entry) -> Entry {
    if let Entry::Signals { at, .. } | Entry::Output { at, .. } = &mut entry {
        *at = Duration::ZERO;
    }
    entry
}

/// Changes one byte of a record at each place. Either the damage is reported, or the result is the same. No value is read wrongly.
#[test]
fn a_flipped_byte_is_told_or_changes_nothing() {
    let ended = Folder::new("flipped");
    let (path, _) = record(&ended).finish().unwrap();
    let (mut random, mut silent, mut wrong) = (random(9), Vec::new(), Vec::new());
    for (name, good) in [("ended", fs::read(path).unwrap()), ("killed", killed(&Folder::new("flipped-killed")))] {
        let expected = Run::from_bytes(&good).unwrap();
        assert_eq!(expected.damage, None, "{name}");
        let untimed: Vec<Entry> = expected.entries.iter().cloned().map(without_time).collect();
        for _ in 0..1000 {
            let (place, mask) = (random() % good.len(), u8::try_from(1 + random() % 255).unwrap());
            let mut bytes = good.clone();
            bytes[place] ^= mask;
            let Ok(run) = Run::from_bytes(&bytes) else { continue };
            if run.damage.is_none() && run != expected {
                silent.push((name, place, mask));
            }
            // If the damaged part has the only GO, the entries have no times, and the damage says so.
            let timeless = run.damage.as_ref().is_some_and(|damage| damage.contains("the time of GO is not known"));
            let expected_entries = if timeless { &untimed } else { &expected.entries };
            if run.header != expected.header || !is_part(&run.entries, expected_entries) {
                wrong.push((name, place, mask));
            }
        }
    }
    assert!(silent.is_empty() && wrong.is_empty(), "not told: {silent:?}; wrong: {wrong:?}");
}

/// About a second of the record is lost, but the later part is read.
#[test]
fn what_is_whole_is_read_behind_a_damaged_part() {
    let mut bytes = killed(&Folder::new("behind"));
    let place = bytes.windows(9).position(|window| window == b"two lines").unwrap();
    bytes[place] = b'T';
    let run = Run::from_bytes(&bytes).unwrap();
    let rest: Vec<Entry> = entries().into_iter().filter(|entry| !matches!(entry, Entry::Output { .. })).collect();
    assert_eq!(run.entries, rest);
    let damage = run.damage.unwrap();
    let said = damage.strip_prefix("bytes ").and_then(|said| said.split_once(" are damaged and left out"));
    let (from, to) = said.and_then(|(places, _)| places.split_once(" to ")).unwrap_or_else(|| panic!("{damage}"));
    assert!(from.parse::<usize>().unwrap() < place && place < to.parse().unwrap(), "{damage}");
}

#[test]
fn a_viewer_finds_what_it_expects() {
    let folder = Folder::new("viewer");
    let (path, _) = record(&folder).finish().unwrap();
    let bytes = fs::read(path).unwrap();
    let summary = mcap::read::Summary::read(&bytes).unwrap().expect("an ended record has a summary");
    assert_eq!(summary.stats.unwrap().message_count, entries().len() as u64);
    let (mut schemas, mut topics) = (BTreeMap::new(), BTreeMap::new());
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let (channel, schema) = (&message.channel, message.channel.schema.as_ref().expect("every channel has one"));
        assert_eq!((channel.message_encoding.as_str(), schema.encoding.as_str()), ("json", "jsonschema"));
        assert!(message.log_time > 1_500_000_000_000_000_000, "{} is not a time since 1970", message.log_time);
        assert_eq!(message.log_time, message.publish_time);
        // One name stands for one schema, and one topic has one schema.
        assert_eq!(*schemas.entry(schema.name.clone()).or_insert(schema.data.clone()), schema.data, "{}", schema.name);
        assert_eq!(*topics.entry(channel.topic.clone()).or_insert(schema.id), schema.id, "{}", channel.topic);
        let plain = |name: &str| name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_');
        assert!(channel.topic[1..].split('/').all(plain), "{}", channel.topic);
        let (schema, data) =
            (serde_json::from_slice(&schema.data).unwrap(), serde_json::from_slice(&message.data).unwrap());
        let mut wrong = Vec::new();
        conforms(&schema, &data, &mut wrong);
        assert!(wrong.is_empty(), "{}: {wrong:?} {data}", channel.topic);
    }
    let names: Vec<&str> = topics.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        ["/events", "/log", "/signals/main/sys/motion", "/signals/main/sys/motion_2", "/signals/main/sys/pull"]
    );
}

/// Collects the parts of `data` that do not match `schema`. The rules are those of viewers: only objects whose properties have types.
fn conforms(schema: &Value, data: &Value, wrong: &mut Vec<String>) {
    let Some(properties) = schema["properties"].as_object().filter(|_| schema["type"] == "object") else {
        return wrong.push(format!("no object: {schema}"));
    };
    for (name, value) in data.as_object().expect("a message is an object") {
        match (properties.get(name).map(|property| property["type"].as_str().unwrap_or("none")), value) {
            (Some("number"), Value::Number(_)) | (Some("string"), Value::String(_)) => {}
            (Some("integer"), Value::Number(number)) if number.is_i64() || number.is_u64() => {}
            (Some("object"), Value::Object(_)) => conforms(&properties[name], value, wrong),
            (Some("boolean"), Value::Bool(_)) => {}
            (Some("array"), Value::Array(elements)) => {
                let kind = &properties[name]["items"]["type"];
                wrong.extend(elements.iter().filter(|one| *kind != "number" || !one.is_number()).map(Value::to_string));
            }
            (kind, value) => wrong.push(format!("{name} is {kind:?}, not {value}")),
        }
        assert!(name.chars().all(|c| c.is_ascii_alphanumeric() || c == '_'), "{name}");
    }
}

#[test]
fn a_value_that_is_no_number_is_left_out() {
    let signal = |name: &str, value| Signal { name: name.to_owned(), unit: String::new(), value, headline: false };
    let values = vec![signal("door angle", f64::NAN), signal("door_angle", 2.0), signal("stamp", f64::INFINITY)];
    let sample = Signals { stamp: Time::from_nanos(1_234_567_891), values };
    let entry = Entry::Signals { path: "main/a[1]".to_owned(), at: Duration::ZERO, sample };
    let mut rows = Rows::default();
    let row = rows.row(&entry, ARRIVED);
    assert_eq!(String::from_utf8_lossy(&row.data), r#"{"door_angle_2":2.0,"stamp":1.234567891}"#);
    assert_eq!(rows.topics()[0].name, "/signals/main/a_1");
    let folder = Folder::new("nan");
    let recorder = Recorder::create(&folder.0, &header()).unwrap();
    recorder.push(entry);
    let (path, _) = recorder.finish().unwrap();
    let [Entry::Signals { path, sample, .. }] = &read(&path).unwrap().entries[..] else { panic!("one sample") };
    let read: Vec<_> = sample.values.iter().map(|signal| (signal.name.as_str(), signal.value.is_nan())).collect();
    assert_eq!((path.as_str(), sample.stamp.nanos()), ("main/a[1]", 1_234_567_891));
    assert_eq!(read, [("door_angle", false)]);
}

#[test]
fn a_full_queue_drops_samples_before_reports_and_counts_them() {
    let queue = Queue::default();
    let sample = || entries().into_iter().find(|entry| matches!(entry, Entry::Signals { .. })).unwrap();
    for _ in 0..queue::SAMPLES + 3 {
        queue.push(sample(), ARRIVED);
    }
    let go = Entry::Report(Report::Go { took: seconds(0.8), signals: Vec::new() });
    assert!(queue.push(go, ARRIVED));
    assert_eq!(queue.dropped(), 3);
    queue.close();
    let mut left = 0;
    while let Work::Entry(..) = queue.pop(Duration::ZERO) {
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
    for (bytes, expected) in [
        (&b"hello"[..], "not the record of a run: "),
        (&b""[..], "the record does not name its spec: "),
        (&mcap::MAGIC[..5], "the record does not name its spec: "),
        (mcap::MAGIC, "the record does not name its spec: "),
    ] {
        fs::write(&path, bytes).unwrap();
        let error = read(&path).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
        assert_eq!(error.is_of_a_record(), expected.starts_with("the record"), "{error}");
    }
}

#[test]
fn what_goes_over_ports_is_on_topics_of_their_own() {
    let number = || Layout::Number { of: "Force".to_owned() };
    let list = |of, count| Layout::List { of: Box::new(of), count };
    let message = |fields: &[(&str, Layout)]| {
        let fields = fields.iter().map(|(name, of)| Field { name: (*name).to_owned(), layout: of.clone() }).collect();
        Some(Arc::new(Message { name: "Wrench".to_owned(), layout: Layout::Record(fields) }))
    };
    let wrench = message(&[("force", list(number(), Some(2))), ("at peak", Layout::Truth)]);
    let another = message(&[("force", number())]);
    let port = |to: &str, bytes: Vec<u8>, message: &Option<Arc<Message>>| {
        let (from, to, message) = ("main/force/Out".to_owned(), to.to_owned(), message.clone());
        Entry::Port { from, to, at: seconds(1.0), bytes, message }
    };
    let wrench_of = |force: [f64; 2]| postcard::to_stdvec(&(force, true)).unwrap();
    let folder = Folder::new("ports");
    let recorder = Recorder::create(&folder.0, &header()).unwrap();
    for entry in [
        port("main/a/In", b"foo".to_vec(), &None),
        port("main/b/In", b"\xff".to_vec(), &None),
        port("main/c/In", wrench_of([1.5, -2.0]), &wrench),
        port("main/c/In", wrench_of([f64::NAN, 0.0]), &wrench),
        port("main/c/In", b"bar".to_vec(), &wrench),
        port("main/d/In", postcard::to_stdvec(&3.0).unwrap(), &another),
        port("main/e/In", wrench_of([0.0, 0.0]), &wrench),
    ] {
        recorder.push(entry);
    }
    let (path, dropped) = recorder.finish().unwrap();
    assert_eq!(dropped, 0);
    let bytes = fs::read(path).unwrap();
    let mut schemas: BTreeMap<String, Vec<u8>> = BTreeMap::new();
    let mut seen = Vec::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap();
        assert_eq!((schema.encoding.as_str(), message.channel.message_encoding.as_str()), ("jsonschema", "json"));
        assert!(message.log_time > 1_500_000_000_000_000_000, "{} is not a time since 1970", message.log_time);
        let known = schemas.entry(schema.name.clone()).or_insert_with(|| schema.data.to_vec());
        assert_eq!(*known, schema.data.to_vec(), "one name, one schema: {}", schema.name);
        let (layout, data): (Value, Value) =
            (serde_json::from_slice(&schema.data).unwrap(), serde_json::from_slice(&message.data).unwrap());
        assert!(!String::from_utf8_lossy(&schema.data).contains("$ref") && layout["title"] == schema.name.as_str());
        let mut wrong = Vec::new();
        conforms(&layout, &data, &mut wrong);
        assert!(wrong.is_empty(), "{wrong:?}");
        let to = message.channel.metadata["dca.to"].clone();
        seen.push((
            message.channel.topic.clone(),
            to,
            schema.name.clone(),
            String::from_utf8(message.data.to_vec()).unwrap(),
        ));
    }
    let row = |topic: &str, to: &str, schema: &str, data: &str| {
        let topic = format!("/ports/main/force/Out{topic}");
        (topic, format!("main/{to}/In"), schema.to_owned(), data.to_owned())
    };
    let (typed, other) = ("dca.types.Wrench", "dca.types.Wrench_2");
    assert_eq!(
        seen,
        [
            row("", "a", "dca.Encoded", r#"{"bytes":"Zm9v","size":3}"#),
            row("_2", "b", "dca.Encoded", r#"{"bytes":"/w==","size":1}"#),
            row("_3", "c", typed, r#"{"at_peak":true,"force":[1.5,-2.0]}"#),
            row("_3", "c", typed, r#"{"at_peak":true}"#),
            row("_4", "c", "dca.Encoded", r#"{"bytes":"YmFy","size":3}"#),
            row("_5", "d", other, r#"{"force":3.0}"#),
            row("_6", "e", typed, r#"{"at_peak":true,"force":[0.0,0.0]}"#),
        ]
    );
    // These messages are for other tools. A report does not use them.
    assert_eq!(Run::from_bytes(&bytes).map(|run| (run.entries, run.damage)).unwrap(), (Vec::new(), None));
}

fn value(bytes: usize) -> Entry {
    let (from, to) = ("main/camera/Out".to_owned(), "main/detector/In".to_owned());
    Entry::Port { from, to, at: Duration::ZERO, bytes: vec![7; bytes], message: None }
}

/// Values of wires wait up to a limit of bytes. Neither many nor large values displace reports, or samples.
#[test]
fn values_have_a_limit_of_their_own() {
    let queue = Queue::default();
    let large = queue::VALUES_SIZE_MAX / 4;
    let pushed: Vec<bool> = [large, large, large, large, 1].map(|size| queue.push(value(size), ARRIVED)).to_vec();
    assert_eq!(pushed, [true, true, true, true, false]);
    assert!(queue.push(entries().remove(0), ARRIVED));
    assert!(matches!(queue.pop(Duration::ZERO), Work::Entry(..)));
    // A second of a producer at 10 kHz.
    assert!((0..8_000).all(|_| queue.push(value(100), ARRIVED)));
    assert!(queue.push(entries().remove(0), ARRIVED));
    assert_eq!(queue.dropped(), 0);
    // A value above the limit can be recorded alone.
    let queue = Queue::default();
    assert!(queue.push(value(queue::VALUES_SIZE_MAX + 1), ARRIVED) && !queue.push(value(1), ARRIVED));
}

/// The record has the number of the values that it lacks, and a report says it.
#[test]
fn missing_values_are_counted_in_the_record() {
    let wire = |input: &str| WireName { from: "main/camera/Out".to_owned(), to: format!("main/{input}/In") };
    let missing = |input, at, early, lost, breaks| Entry::Missing {
        wire: wire(input),
        at: seconds(at),
        count: MissingValues { early, lost, breaks },
    };
    let folder = Folder::new("missing");
    let recorder = Recorder::create(&folder.0, &header()).unwrap();
    let counts = [missing("a", 1.0, 2, 0, 0), missing("b", 1.0, 0, 1, 1), missing("a", 2.0, 0, 650, 0)];
    for entry in entries()[..1].iter().chain(&counts) {
        assert!(recorder.push(entry.clone()));
    }
    let (path, _) = recorder.finish().unwrap();
    let run = read(&path).unwrap();
    assert_eq!((&run.entries[1..], run.damage.clone()), (&counts[..], None));
    assert_eq!(
        run.missing(),
        [
            "650 values of main/camera.Out to main/a.In are not in the record, and neither are the first 2: the recorder was not linked yet",
            "1 value of main/camera.Out to main/b.In is not in the record. The last ones may be missing too: the program was killed, or the link to it broke",
        ]
    );
    assert!(
        crate::logic::page::page(&run).contains("650 values of main/camera.Out to main/a.In are not in the record")
    );
    let files = Files { record: Some("run.mcap".to_owned()), missing: run.missing(), ..Files::default() };
    let text = summary(&run.mission(), &files, None);
    assert!(text.contains("  record  run.mcap\n          650 values of main/camera.Out"), "{text}");
    // A viewer gets the counts as messages of a topic.
    let mut seen = 0;
    for message in mcap::MessageStream::new(&fs::read(path).unwrap()).unwrap() {
        let message = message.unwrap();
        if message.channel.topic == "/missing" {
            let schema = serde_json::from_slice(&message.channel.schema.as_ref().unwrap().data).unwrap();
            let (data, mut wrong) = (serde_json::from_slice(&message.data).unwrap(), Vec::new());
            conforms(&schema, &data, &mut wrong);
            assert!(wrong.is_empty(), "{wrong:?} {data}");
            seen += 1;
        }
    }
    assert_eq!(seen, 3);
}

/// Messages of ROS 2 are recorded unchanged, with their definitions. To a viewer, the record looks like one of ROS 2.
#[test]
fn messages_of_ros_are_cdr() {
    use ros::typed::Message as _;
    use ros::typed::geometry_msgs::Twist;

    let of = |of: &str| {
        let layout = Layout::Piece { of: of.to_owned() };
        Some(Arc::new(Message { name: of.to_owned(), layout }))
    };
    let mut twist = Twist::default();
    twist.linear.x = 0.5;
    let port = |bytes: Vec<u8>, of_name: &str| Entry::Port {
        from: "main/base/Cmd".to_owned(),
        to: "main/wheels/In".to_owned(),
        at: Duration::from_secs(1),
        bytes,
        message: of(of_name),
    };
    let folder = Folder::new("ros");
    let recorder = Recorder::create(&folder.0, &header()).unwrap();
    for entry in [
        port(postcard::to_stdvec(&twist).unwrap(), "ros.geometry.Twist"),
        port(vec![3, 0, 1, 0], "ros.geometry.Twist"),
        port(postcard::to_stdvec(&twist).unwrap(), "ros.geometry.Twirl"),
    ] {
        recorder.push(entry);
    }
    let (path, _) = recorder.finish().unwrap();
    let bytes = fs::read(path).unwrap();
    let mut seen = Vec::new();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap();
        let encodings = (message.channel.message_encoding.clone(), schema.encoding.clone());
        seen.push((message.channel.topic.clone(), schema.name.clone(), encodings));
        if schema.encoding == "ros2msg" {
            let text = String::from_utf8(schema.data.to_vec()).unwrap();
            let separator = "=".repeat(80);
            let vector = format!("{separator}\nMSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n");
            assert_eq!(text, format!("geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n{vector}"));
            assert_eq!(message.data.as_ref(), twist.to_cdr().unwrap());
        }
    }
    let json = || ("json".to_owned(), "jsonschema".to_owned());
    let row =
        |topic: &str, schema: &str, encodings| (format!("/ports/main/base/Cmd{topic}"), schema.to_owned(), encodings);
    assert_eq!(
        seen,
        [
            row("", "geometry_msgs/msg/Twist", ("cdr".to_owned(), "ros2msg".to_owned())),
            row("_2", "dca.Encoded", json()),
            row("_2", "dca.Encoded", json()),
        ]
    );
}

/// If the disk was full, a record ends properly, but earlier than its deployment.
#[test]
fn a_record_without_the_end_of_its_deployment_says_so() {
    let whole = Run { header: header(), go: None, entries: entries(), values: Vec::new(), damage: None };
    assert_eq!(whole.lacks(), None);
    let cut = Run { entries: entries()[..3].to_vec(), ..whole };
    assert!(cut.lacks().unwrap().starts_with("it stops before the deployment ended"), "{:?}", cut.lacks());
}
