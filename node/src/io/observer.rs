//! A person's eyes: a data session of the command line's own that dials the programs which publish signals.

use comms::io::clock;
use comms::io::data::{DataError, DataSession, Hearing};
use comms::logic::control::Dial;
use comms::logic::signals::Signals;
use comms::logic::time::Time;
use comms::logic::{codec, key};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::Sender;
use tokio::task::JoinSet;

/// How long a program has to be reached.
const DIAL_WITHIN: Duration = Duration::from_secs(2);

/// A sample of a program's signals.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Absolute path of the program.
    pub path: String,
    /// When it arrived here.
    pub arrived: Time,
    /// What it says.
    pub signals: Signals,
}

/// What comes of the sources.
#[derive(Clone, Debug, PartialEq)]
pub enum Sight {
    /// A sample.
    Sample(Sample),
    /// A sentence for a person: one source, or none at all, can be seen.
    Unseen(String),
}

/// A session that opens, or is open.
#[derive(Debug)]
pub struct Observer {
    opening: JoinSet<Option<Opened>>,
}

#[derive(Debug)]
struct Opened {
    session: Arc<DataSession>,
    hearing: Vec<Hearing>,
}

impl Observer {
    /// Begins to dial every program of `sources` (instance path, where to dial), all at once. What comes of them goes to
    /// `sink`; samples are left out when it is full.
    pub fn open(robot: &str, sources: &[(String, Dial)], sink: Sender<Sight>) -> Self {
        let mut opening = JoinSet::new();
        opening.spawn(look(robot.to_owned(), sources.to_vec(), sink));
        Self { opening }
    }

    /// Closes the session; what is being dialled is waited for, which takes 2 s at the most.
    pub async fn close(mut self) {
        let Some(Ok(Some(Opened { session, hearing }))) = self.opening.join_next().await else { return };
        let closing = tokio::task::spawn_blocking(move || {
            drop(hearing);
            Arc::into_inner(session).into_iter().for_each(DataSession::close);
        });
        if let Err(error) = closing.await {
            tracing::debug!(%error, "closing the observer");
        }
    }
}

async fn look(robot: String, sources: Vec<(String, Dial)>, sink: Sender<Sight>) -> Option<Opened> {
    let unseen = async |what: String| drop(sink.send(Sight::Unseen(what)).await);
    // Zenoh's own calls block.
    let opened = tokio::task::spawn_blocking(DataSession::open_observer).await;
    let session = match opened.map_err(anyhow::Error::from).and_then(|opened| Ok(opened?)) {
        Ok(session) => Arc::new(session),
        Err(error) => {
            unseen(format!("signals cannot be seen: {error:#}")).await;
            return None;
        }
    };
    let mut dialling = JoinSet::new();
    for (path, dial) in sources {
        let (session, key, sink) = (Arc::clone(&session), key::signals(&robot, &path), sink.clone());
        dialling.spawn_blocking(move || {
            let heard = session.dial(&dial, DIAL_WITHIN).and_then(|()| hear(&session, &key, path.clone(), sink));
            heard.map_err(|error| format!("signals of `{path}` cannot be seen: {error}"))
        });
    }
    let mut hearing = Vec::new();
    while let Some(joined) = dialling.join_next().await {
        match joined.unwrap_or_else(|panic| Err(format!("signals cannot be seen: {panic}"))) {
            Ok(heard) => hearing.push(heard),
            Err(why) => unseen(why).await,
        }
    }
    Some(Opened { session, hearing })
}

fn hear(session: &DataSession, key: &str, path: String, sink: Sender<Sight>) -> Result<Hearing, DataError> {
    session.on_sample(key, move |bytes| {
        if let Ok(signals) = codec::decode::<Signals>(&bytes) {
            let sample = Sample { path: path.clone(), arrived: clock::now(), signals };
            // A full queue means that the screen or the disk is slow; the robot must not feel it.
            sink.try_send(Sight::Sample(sample)).unwrap_or_default();
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::io::data::Priority;
    use comms::io::session::Reach;

    #[tokio::test(flavor = "multi_thread")]
    async fn a_source_that_cannot_be_dialled_does_not_hide_the_others() {
        let folder = std::env::temp_dir().join(format!("dca-observer-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let socket = folder.join("s");
        let (program, publisher) = tokio::task::spawn_blocking(move || {
            let program = DataSession::open(&socket, Reach::Host).unwrap();
            let publisher = program.publisher(&key::signals("door", "main/hit"), Priority::Background).unwrap();
            (program, publisher)
        })
        .await
        .unwrap();
        let there = program.location();
        let sources = [
            ("main/gone".to_owned(), Dial { session: "1".to_owned(), locators: Vec::new() }),
            ("main/hit".to_owned(), Dial { session: there.session, locators: there.local }),
        ];
        let (sink, mut seen) = tokio::sync::mpsc::channel(16);
        let observer = Observer::open("door", &sources, sink);
        let Some(Sight::Unseen(why)) = seen.recv().await else { panic!("everything is seen") };
        assert!(why.starts_with("signals of `main/gone` cannot be seen: cannot reach session 1: it listens"), "{why}");
        let signals = Signals { stamp: clock::now(), values: Vec::new() };
        let bytes = codec::encode(&signals).unwrap();
        let publishing = tokio::task::spawn_blocking(move || {
            assert!(publisher.wait_heard(DIAL_WITHIN), "nobody listens");
            publisher.put(bytes).unwrap();
            publisher
        });
        let Some(Sight::Sample(sample)) = seen.recv().await else { panic!("no sample came") };
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
}
