//! The observer of a mission: a data session of the command line that subscribes to signals and ports of programs.

use crate::logic::record::Port;
use comms::io::clock;
use comms::io::data::{CallWay, DataError, DataSession, Subscription, Visitor};
use comms::logic::control::Dial;
use comms::logic::signals::{Peak, Peaks, Signals};
use comms::logic::time::Time;
use comms::logic::{codec, key};
use node::logic::protocol::Deployment;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use team::visitor::VisitorIdentity;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::task::JoinSet;

/// How long a program may take to be reached. After this time, the user is told that it is not seen yet.
const DIAL_WITHIN: Duration = Duration::from_secs(2);

/// The most moved programs that wait while others are dialled. Further programs are not observed.
const MORE_MAX: usize = 256;

/// The longest value of a port that is recorded, in bytes.
const VALUE_MAX: usize = 1 << 20;

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
    /// A value that went over a wire.
    Port {
        /// The output, as in [`Port`].
        from: String,
        /// The input, as in [`Port`].
        to: String,
        /// When the value arrived here.
        arrived: Time,
        /// The value.
        bytes: Vec<u8>,
    },
    /// A sentence for a person: one source cannot be seen, or none at all.
    Unseen(String),
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
    /// The values from an output to an input.
    Port(String, String),
}

impl EventKind {
    fn name(&self) -> String {
        match self {
            Self::Signals(path) => format!("signals of `{path}`"),
            Self::Port(from, _) => format!("the port `{from}`"),
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
    /// Opens an observer that watches nothing yet. Its events go to `sink`; when `sink` is full, samples are left out.
    /// In a team, `team` is the file with the credentials that the node of this machine gives its programs.
    pub fn open(team: Option<PathBuf>, sink: Sender<ObserverEvent>) -> Self {
        let (more, sources) = mpsc::channel(MORE_MAX);
        let mut opening = JoinSet::new();
        opening.spawn(look(sources, team, sink));
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
    /// that are too long are left out.
    pub fn ports(&self, deployment: &Deployment, ports: &[(Port, Dial)], is_team: bool) {
        let source = |(port, dial): &(Port, Dial)| {
            let what = EventKind::Port(port.from.clone(), port.to.clone());
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

async fn look(mut more: Receiver<Vec<Source>>, team: Option<PathBuf>, sink: Sender<ObserverEvent>) -> Option<Opened> {
    let unseen = async |what: String| drop(sink.send(ObserverEvent::Unseen(what)).await);
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
            let (session, sink) = (Arc::clone(&session), sink.clone());
            // If a key is already received, it is also received from the restarted program.
            let is_heard = heard.contains(&source.key);
            dialling.spawn_blocking(move || (source.key.clone(), reach(&session, source, sink, is_heard)));
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
    sink: Sender<ObserverEvent>,
    is_heard: bool,
) -> (Option<Subscription>, Option<String>) {
    let Source { key, dial, what } = source;
    let (name, dialled) = (what.name(), session.dial(&dial, DIAL_WITHIN));
    // A distant program may take longer, so the session continues to dial it.
    let is_kept = dialled.is_err() && !dial.locators.is_empty();
    let linked = if is_kept { session.keep(&dial) } else { dialled.clone() };
    let hears = linked.and_then(|()| (!is_heard).then(|| hear(session, &key, what, sink)).transpose());
    match (hears, dialled) {
        (Ok(subscription), Ok(())) => (subscription, None),
        (Ok(subscription), Err(error)) => (subscription, Some(format!("{name} cannot be seen yet: {error}"))),
        (Err(error), _) => (None, Some(format!("{name} cannot be seen: {error}"))),
    }
}

fn hear(
    session: &DataSession,
    key: &str,
    what: EventKind,
    sink: Sender<ObserverEvent>,
) -> Result<Subscription, DataError> {
    let path = match what {
        EventKind::Signals(path) => path,
        EventKind::Port(from, to) => {
            return session.on_sample(key, move |bytes| {
                if bytes.len() <= VALUE_MAX {
                    let (from, to, bytes) = (from.clone(), to.clone(), bytes.to_vec());
                    sink.try_send(ObserverEvent::Port { from, to, arrived: clock::now(), bytes }).unwrap_or_default();
                }
            });
        }
    };
    session.on_sample(key, move |bytes| {
        for sample in samples(&path, &bytes, clock::now()) {
            // The queue is full if the screen or the disk is slow. This must not slow down the robot.
            sink.try_send(ObserverEvent::Sample(sample)).unwrap_or_default();
        }
    })
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
        let observer = Observer::open(None, sink);
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
        let closing = tokio::task::spawn_blocking(move || {
            drop(publisher);
            program.close();
        });
        closing.await.unwrap();
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
        let observer = Observer::open(None, sink);
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
        let closing = tokio::task::spawn_blocking(move || {
            drop(publisher);
            program.close();
        });
        closing.await.unwrap();
        std::fs::remove_dir_all(&folder).unwrap();
    }

    /// A restarted program has another session, and the same key.
    #[tokio::test(flavor = "multi_thread")]
    async fn a_program_that_was_started_again_is_seen_once_more() {
        let folder = std::env::temp_dir().join(format!("dca-observer-again-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (sink, mut seen) = mpsc::channel(64);
        let observer = Observer::open(None, sink);
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
            let closing = tokio::task::spawn_blocking(move || {
                drop(publisher);
                program.close();
            });
            closing.await.unwrap();
        }
        assert!(seen.try_recv().is_err(), "each is seen once");
        observer.close().await;
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
