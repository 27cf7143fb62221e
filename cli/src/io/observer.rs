//! The observer of a mission: a data session of the command line that subscribes to signals and ports of programs.

use crate::io::value_queue::SharedQueue;
use crate::logic::record::{Missing, Port, WireName};
use comms::io::clock;
use comms::io::data::{CallWay, DataError, DataSession, Subscription, Visitor};
use comms::logic::control::Dial;
use comms::logic::signals::{Peak, Peaks, Signals};
use comms::logic::switch::Arrival;
use comms::logic::time::Time;
use comms::logic::{codec, key};
use node::logic::protocol::Deployment;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use team::visitor::VisitorIdentity;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::task::JoinSet;

/// How long a program may take to be reached. After this time, the user is told that it is not seen yet.
const DIAL_WITHIN: Duration = Duration::from_secs(2);

/// The most moved programs that wait while others are dialled. Further programs are not observed.
const MORE_MAX: usize = 256;

/// The longest value of a port that is recorded, in bytes: the limit of a message.
const VALUE_MAX: usize = 16 << 20;
/// The most bytes of values that wait to be recorded: a second of several cameras, or 16,384 small values.
const VALUES_SIZE_MAX: usize = 64 << 20;

/// A sample of a program's signals.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Absolute path of the program.
    pub path: String,
    /// When the sample arrived here.
    pub arrived: Time,
    /// The signals.
    pub signals: Signals,
}

/// An event of an observed source.
#[derive(Clone, Debug, PartialEq)]
pub enum ObserverEvent {
    /// A sample.
    Sample(Sample),
    /// A sentence for a person: one source cannot be seen, or none at all.
    Unseen(String),
}

/// A value that went over a wire.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct WireValue {
    /// When the value arrived here.
    pub(crate) arrived: Time,
    /// The value.
    pub(crate) bytes: Vec<u8>,
}

/// The values of wires that have arrived and wait to be recorded, and the counts of the values that are missing.
#[derive(Debug)]
pub(crate) struct WireValues {
    pub(crate) queue: SharedQueue<WireName, WireValue>,
    missing: Mutex<Missing>,
}

impl WireValues {
    /// Returns the counts.
    pub(crate) fn missing(&self) -> MutexGuard<'_, Missing> {
        // No code panics while it holds the lock, so the counts are always consistent.
        self.missing.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Default for WireValues {
    fn default() -> Self {
        Self { queue: SharedQueue::with_size(VALUES_SIZE_MAX), missing: Mutex::default() }
    }
}

/// The receivers of samples and values.
#[derive(Clone, Debug)]
pub(crate) struct Sinks {
    /// Samples, and sentences for a person.
    pub(crate) events: Sender<ObserverEvent>,
    /// The number of samples that did not fit into `events`.
    pub(crate) dropped: Arc<AtomicU64>,
    /// Values of wires.
    pub(crate) values: Arc<WireValues>,
}

/// A source: its kind, its address, and its key.
#[derive(Debug)]
struct Source {
    key: String,
    dial: Dial,
    what: EventKind,
}

#[derive(Debug)]
enum EventKind {
    /// The signals of the program with this path.
    Signals(String),
    /// The values of a wire.
    Port(WireName),
}

impl EventKind {
    fn name(&self) -> String {
        match self {
            Self::Signals(path) => format!("signals of `{path}`"),
            Self::Port(wire) => format!("the port `{}`", wire.from),
        }
    }
}

/// A data session that is being opened or is open.
#[derive(Debug)]
pub struct Observer {
    opening: JoinSet<Option<Opened>>,
    /// Receives further programs to observe.
    more: Sender<Vec<Source>>,
}

#[derive(Debug)]
struct Opened {
    session: Arc<DataSession>,
    subscriptions: Vec<Subscription>,
}

impl Observer {
    /// Opens an observer that watches nothing yet. When a sink is full, samples and values are left out and counted.
    /// In a team, `team` is the file with the credentials that the node of this machine gives its programs.
    pub(crate) fn open(team: Option<PathBuf>, sinks: Sinks) -> Self {
        let (more, sources) = mpsc::channel(MORE_MAX);
        let mut opening = JoinSet::new();
        opening.spawn(look(sources, team, sinks));
        Self { opening, more }
    }

    /// Dials all programs of `sources` (instance path, address) at once, and receives their signals. If a program is
    /// named again, it was restarted elsewhere.
    pub fn signals(&self, robot: &str, sources: &[(String, Dial)]) {
        let source = |(path, dial): &(String, Dial)| Source {
            key: key::signals(robot, path),
            dial: dial.clone(),
            what: EventKind::Signals(path.clone()),
        };
        self.also(sources.iter().map(source).collect());
    }

    /// Dials the producers of some wires and receives their values, as [`Observer::signals`] does for signals. Values
    /// that are too long are counted as missing.
    pub fn ports(&self, deployment: &Deployment, ports: &[(Port, Dial)], is_team: bool) {
        let source = |(port, dial): &(Port, Dial)| {
            let what = EventKind::Port(port.name.clone());
            let wire = port.key(deployment);
            let key = if is_team { key::wire_seen(&wire) } else { wire };
            Source { key, dial: dial.clone(), what }
        };
        self.also(ports.iter().map(source).collect());
    }

    fn also(&self, sources: Vec<Source>) {
        if !sources.is_empty() && self.more.try_send(sources).is_err() {
            tracing::debug!("too many programs were started again at once");
        }
    }

    /// Closes the session. Waits for programs that are being dialled, for at most 2 s.
    pub async fn close(self) {
        let Self { mut opening, more } = self;
        drop(more);
        let Some(Ok(Some(Opened { session, subscriptions }))) = opening.join_next().await else { return };
        let closing = tokio::task::spawn_blocking(move || {
            drop(subscriptions);
            Arc::into_inner(session).into_iter().for_each(DataSession::close);
        });
        if let Err(error) = closing.await {
            tracing::debug!(%error, "closing the observer");
        }
    }
}

/// Opens a data session that dials but does not listen, and returns how it makes calls. In a team, `team` is the file
/// with the credentials that the node of this machine gives to visitors.
pub(crate) fn open(team: Option<&Path>) -> anyhow::Result<(DataSession, CallWay)> {
    let Some(file) = team else { return Ok((DataSession::open_observer(None)?, CallWay::Open)) };
    let identity = Arc::new(VisitorIdentity::open(file)?);
    let signs = Arc::clone(&identity);
    let way = CallWay::Signed(Visitor(Arc::new(move |digest| Some(signs.sign_visit(digest)))));
    // This is the folder of the node, which only this user can enter.
    let folder = file.parent().unwrap_or(Path::new("/")).to_owned();
    Ok((DataSession::open_observer(Some((identity, folder)))?, way))
}

async fn look(mut more: Receiver<Vec<Source>>, team: Option<PathBuf>, sinks: Sinks) -> Option<Opened> {
    let unseen = async |what: String| drop(sinks.events.send(ObserverEvent::Unseen(what)).await);
    let mut sources = more.recv().await?;
    // Zenoh's calls block the thread.
    let opened = tokio::task::spawn_blocking(move || open(team.as_deref())).await;
    let session = match opened.map_err(anyhow::Error::from).flatten() {
        Ok((session, _)) => Arc::new(session),
        Err(error) => {
            unseen(format!("signals cannot be seen: {error:#}")).await;
            return None;
        }
    };
    let (mut subscriptions, mut heard) = (Vec::new(), BTreeSet::new());
    loop {
        let mut dialling = JoinSet::new();
        for source in sources {
            let (session, sinks) = (Arc::clone(&session), sinks.clone());
            // If a key is already received, it is also received from the restarted program.
            let is_heard = heard.contains(&source.key);
            dialling.spawn_blocking(move || (source.key.clone(), reach(&session, source, sinks, is_heard)));
        }
        while let Some(joined) = dialling.join_next().await {
            let (subscription, why) = match joined {
                Ok((key, (subscription, why))) => {
                    if subscription.is_some() {
                        heard.insert(key);
                    }
                    (subscription, why)
                }
                Err(panic) => (None, Some(format!("signals cannot be seen: {panic}"))),
            };
            subscriptions.extend(subscription);
            if let Some(why) = why {
                unseen(why).await;
            }
        }
        match more.recv().await {
            Some(next) => sources = next,
            None => return Some(Opened { session, subscriptions }),
        }
    }
}

/// Receives a source, if necessary once it can be reached. Returns why this failed, or why it has to wait. If the
/// source is already received, only dials it.
fn reach(
    session: &DataSession,
    source: Source,
    sinks: Sinks,
    is_heard: bool,
) -> (Option<Subscription>, Option<String>) {
    let Source { key, dial, what } = source;
    let (name, dialled) = (what.name(), session.dial(&dial, DIAL_WITHIN));
    // A distant program may take longer, so the session continues to dial it.
    let is_kept = dialled.is_err() && !dial.locators.is_empty();
    let linked = if is_kept { session.keep(&dial) } else { dialled.clone() };
    let hears = linked.and_then(|()| (!is_heard).then(|| hear(session, &key, what, sinks)).transpose());
    match (hears, dialled) {
        (Ok(subscription), Ok(())) => (subscription, None),
        (Ok(subscription), Err(error)) => (subscription, Some(format!("{name} cannot be seen yet: {error}"))),
        (Err(error), _) => (None, Some(format!("{name} cannot be seen: {error}"))),
    }
}

fn hear(session: &DataSession, key: &str, what: EventKind, sinks: Sinks) -> Result<Subscription, DataError> {
    let Sinks { events, dropped, values } = sinks;
    match what {
        EventKind::Port(wire) => session.on_wire(key, move |arrival, sequence| match arrival {
            Arrival::Value(bytes) => {
                values.missing().value(&wire, sequence);
                if bytes.len() <= VALUE_MAX {
                    let value = WireValue { arrived: clock::now(), bytes: bytes.into_owned() };
                    values.queue.push(&wire, value.bytes.len(), value);
                } else {
                    values.missing().lose(&wire, 1);
                }
            }
            Arrival::Boundary(boundary) => values.missing().boundary(&wire, sequence, &boundary),
        }),
        EventKind::Signals(path) => session.on_sample(key, move |bytes| {
            for sample in samples(&path, &bytes, clock::now()) {
                // The queue is full if the screen or the disk is slow. This must not slow down the robot.
                if events.try_send(ObserverEvent::Sample(sample)).is_err() {
                    dropped.fetch_add(1, Ordering::Relaxed);
                }
            }
        }),
    }
}

/// Returns the samples in a message: the message is one sample, or it has one sample for each peak between two samples, with its time.
pub(crate) fn samples(path: &str, bytes: &[u8], now: Time) -> Vec<Sample> {
    let path = path.to_owned();
    if let Ok(signals) = codec::decode::<Signals>(bytes) {
        return vec![Sample { path, arrived: now, signals }];
    }
    let Ok(Peaks { stamp, values }) = codec::decode(bytes) else { return Vec::new() };
    let sample = |Peak { signal, age }| {
        let signals = Signals { stamp: stamp.before(age), values: vec![signal] };
        Sample { path: path.clone(), arrived: now.before(age), signals }
    };
    values.into_iter().map(sample).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::io::data::{Priority, Publisher};
    use comms::io::session::Reach;
    use comms::logic::signals::Signal;
    use comms::logic::switch::Boundary;
    use std::path::PathBuf;

    #[test]
    fn a_peak_is_a_sample_of_when_it_was() {
        let signal = |value| Signal { name: "force".into(), unit: "N".into(), value, headline: true };
        let at = Time::from_nanos;
        let peak = Peak { signal: signal(28.8), age: Duration::from_nanos(30) };
        let peaks = Peaks { stamp: at(100), values: vec![peak] };
        let signals = Signals { stamp: at(70), values: vec![signal(28.8)] };
        let expected = Sample { path: "main/hit".into(), arrived: at(970), signals };
        assert_eq!(samples("main/hit", &codec::encode(&peaks).unwrap(), at(1000)), [expected]);
        assert_eq!(samples("main/hit", b"nonsense", at(1000)), []);
    }

    fn sinks(events: Sender<ObserverEvent>) -> Sinks {
        Sinks { events, dropped: Arc::default(), values: Arc::default() }
    }

    /// Ends a program and its publisher, which may wait for their threads.
    async fn close(program: DataSession, publisher: impl Send + 'static) {
        let closing = tokio::task::spawn_blocking(move || {
            drop(publisher);
            program.close();
        });
        closing.await.unwrap();
    }

    /// A program that shows the signals of `main/hit`.
    async fn program(socket: PathBuf) -> (DataSession, Publisher) {
        let opening = tokio::task::spawn_blocking(move || {
            let program = DataSession::open(&socket, Reach::Host).unwrap();
            let publisher = program.publisher(&key::signals("door", "main/hit"), Priority::Background).unwrap();
            (program, publisher)
        });
        opening.await.unwrap()
    }

    /// A source may not be reached in time, for example over a slow link. It is reported, and received once it is reached.
    #[tokio::test(flavor = "multi_thread")]
    async fn a_source_that_is_reached_late_is_seen_from_then_on() {
        let folder = std::env::temp_dir().join(format!("dca-observer-late-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (program, publisher) = program(folder.join("s")).await;
        let locators = vec![format!("unixsock-stream/{}", folder.join("late").display())];
        let sources = [("main/hit".to_owned(), Dial { session: program.location().session, locators })];
        let (sink, mut seen) = mpsc::channel(16);
        let observer = Observer::open(None, sinks(sink));
        observer.signals("door", &sources);
        let Some(ObserverEvent::Unseen(why)) = seen.recv().await else { panic!("it is not there yet") };
        assert!(why.starts_with("signals of `main/hit` cannot be seen yet: cannot reach session "), "{why}");
        std::os::unix::fs::symlink(folder.join("s"), folder.join("late")).unwrap();
        let bytes = codec::encode(&Signals { stamp: clock::now(), values: Vec::new() }).unwrap();
        let publishing = tokio::task::spawn_blocking(move || {
            assert!(publisher.wait_heard(Duration::from_secs(20)), "nobody listens");
            publisher.put(bytes).unwrap();
            publisher
        });
        let publisher = publishing.await.unwrap();
        assert!(matches!(seen.recv().await, Some(ObserverEvent::Sample(_))));
        observer.close().await;
        close(program, publisher).await;
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_source_that_cannot_be_dialled_does_not_hide_the_others() {
        let folder = std::env::temp_dir().join(format!("dca-observer-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (program, publisher) = program(folder.join("s")).await;
        let there = program.location();
        let sources = [
            ("main/gone".to_owned(), Dial { session: "1".to_owned(), locators: Vec::new() }),
            ("main/hit".to_owned(), Dial { session: there.session, locators: there.local }),
        ];
        let (sink, mut seen) = mpsc::channel(16);
        let observer = Observer::open(None, sinks(sink));
        observer.signals("door", &sources);
        let Some(ObserverEvent::Unseen(why)) = seen.recv().await else { panic!("everything is seen") };
        assert!(
            why.starts_with("signals of `main/gone` cannot be seen: cannot reach session 1: it does not listen"),
            "{why}"
        );
        let signals = Signals { stamp: clock::now(), values: Vec::new() };
        let bytes = codec::encode(&signals).unwrap();
        let publishing = tokio::task::spawn_blocking(move || {
            assert!(publisher.wait_heard(DIAL_WITHIN), "nobody listens");
            publisher.put(bytes).unwrap();
            publisher
        });
        let Some(ObserverEvent::Sample(sample)) = seen.recv().await else { panic!("no sample came") };
        assert_eq!((sample.path.as_str(), sample.signals), ("main/hit", signals));
        observer.close().await;
        let publisher = publishing.await.unwrap();
        close(program, publisher).await;
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// A restarted program has another session, and the same key.
    #[tokio::test(flavor = "multi_thread")]
    async fn a_program_that_was_started_again_is_seen_once_more() {
        let folder = std::env::temp_dir().join(format!("dca-observer-again-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (sink, mut seen) = mpsc::channel(64);
        let observer = Observer::open(None, sinks(sink));
        for (value, life) in [(1.0, "first"), (2.0, "second")] {
            let (program, publisher) = program(folder.join(life)).await;
            let there = program.location();
            let dial = Dial { session: there.session, locators: there.local };
            observer.signals("door", &[("main/hit".to_owned(), dial)]);
            let signal = Signal { name: "force".into(), unit: "N".into(), value, headline: false };
            let bytes = codec::encode(&Signals { stamp: clock::now(), values: vec![signal] }).unwrap();
            let publishing = tokio::task::spawn_blocking(move || {
                assert!(publisher.wait_heard(Duration::from_secs(20)), "nobody listens");
                publisher.put(bytes).unwrap();
                (program, publisher)
            });
            let (program, publisher) = publishing.await.unwrap();
            let Some(ObserverEvent::Sample(sample)) = seen.recv().await else { panic!("no sample of the {life} came") };
            assert_eq!(sample.signals.values.first().map(|signal| signal.value), Some(value));
            close(program, publisher).await;
        }
        assert!(seen.try_recv().is_err(), "each is seen once");
        observer.close().await;
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// Sends values of these sizes to an observer, beginning with a number. Returns the next number once the observer
    /// knows of all of them.
    async fn send(publisher: &Arc<Publisher>, values: &WireValues, sizes: Vec<usize>, first: u32) -> u32 {
        let (theirs, next) = (Arc::clone(publisher), first + u32::try_from(sizes.len()).unwrap());
        let sending = move || {
            for (number, size) in (first..).zip(sizes) {
                theirs.put_numbered(vec![7; size], number).unwrap();
            }
        };
        tokio::task::spawn_blocking(sending).await.unwrap();
        // The link keeps the order. A boundary that is lost on the way is repeated.
        while values.missing().last(&wire()) != Some(next - 1) {
            let theirs = Arc::clone(publisher);
            let closed = Boundary::Closed { generation: 0, sent: 0 };
            tokio::task::spawn_blocking(move || theirs.mark(&closed, next - 1).unwrap()).await.unwrap();
        }
        next
    }

    fn wire() -> WireName {
        WireName { from: "main/camera/Out".to_owned(), to: "main/detector/In".to_owned() }
    }

    /// Nothing takes values out of the queue while they arrive. Each value is received or counted: those from before the
    /// link, a burst, values of the largest size, and larger ones.
    #[tokio::test(flavor = "multi_thread")]
    async fn each_value_is_received_or_counted() {
        let folder = std::env::temp_dir().join(format!("dca-observer-burst-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (deployment, port) = (Deployment { name: "door".into(), epoch: 1 }, Port::of(wire()));
        let (key, socket) = (port.key(&deployment), folder.join("s"));
        let opening = tokio::task::spawn_blocking(move || {
            let program = DataSession::open(&socket, Reach::Host).unwrap();
            let publisher = Arc::new(program.publisher(&key, Priority::Wire).unwrap());
            (program, publisher)
        });
        let (program, publisher) = opening.await.unwrap();
        let there = program.location();
        let (sink, _seen) = mpsc::channel(16);
        let sinks = sinks(sink);
        let values = Arc::clone(&sinks.values);
        let observer = Observer::open(None, sinks);
        observer.ports(&deployment, &[(port, Dial { session: there.session, locators: there.local })], false);
        let waiting = Arc::clone(&publisher);
        let heard = tokio::task::spawn_blocking(move || waiting.wait_heard(Duration::from_secs(20))).await.unwrap();
        assert!(heard, "nobody listens");
        // Two values were sent earlier. A large value may be lost on a busy machine, so it is repeated. If the first one
        // is lost, it counts as early.
        let (mut number, mut received, mut largest) = (3, 0, 0);
        while largest < VALUE_MAX {
            number = send(&publisher, &values, vec![VALUE_MAX], number).await;
            while let Some(queued) = values.queue.pop() {
                (received, largest) = (received + 1, largest.max(queued.value.bytes.len()));
            }
        }
        number = send(&publisher, &values, vec![VALUE_MAX + 1], number).await;
        assert_eq!(values.queue.pop(), None);
        number = send(&publisher, &values, vec![10; 3000], number + 1).await;
        let mut burst = 0;
        while let Some(queued) = values.queue.pop() {
            assert_eq!(queued.lost, 0);
            burst += 1;
        }
        let pending = values.missing().pending();
        let [(_, count)] = &pending[..] else { panic!("{pending:?}") };
        assert!(count.early >= 2, "{pending:?}");
        assert_eq!(count.early + received + burst + count.lost, u64::from(number) - 1, "{pending:?}");
        // A fast sender loses values on the way to a busy machine, but the queue has lost none.
        assert!(burst > 64, "{burst} of 3000 values");
        observer.close().await;
        close(program, publisher).await;
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
