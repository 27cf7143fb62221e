//! A person's eyes: a data session of the command line's own that dials the programs which publish signals.

use comms::io::clock;
use comms::io::data::{DataSession, Hearing};
use comms::logic::control::Dial;
use comms::logic::signals::Signals;
use comms::logic::time::Time;
use comms::logic::{codec, key};
use std::time::Duration;
use tokio::sync::mpsc::Sender;

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

/// The open session.
#[derive(Debug)]
pub struct Observer {
    session: DataSession,
    hearing: Vec<Hearing>,
}

impl Observer {
    /// Dials every program of `sources` (instance path, where to dial); samples go to `sink`, or are left out when it is
    /// full.
    ///
    /// # Errors
    /// The session cannot be opened, or a program cannot be dialled.
    pub async fn open(robot: &str, sources: &[(String, Dial)], sink: Sender<Sample>) -> anyhow::Result<Self> {
        let (robot, sources) = (robot.to_owned(), sources.to_vec());
        // Zenoh's own calls block.
        tokio::task::spawn_blocking(move || {
            let (session, mut hearing) = (DataSession::open_observer()?, Vec::new());
            for (path, dial) in sources {
                session.dial(&dial, DIAL_WITHIN)?;
                let sink = sink.clone();
                let key = key::signals(&robot, &path);
                hearing.push(session.on_sample(&key, move |bytes| {
                    if let Ok(signals) = codec::decode::<Signals>(&bytes) {
                        let sample = Sample { path: path.clone(), arrived: clock::now(), signals };
                        // A full queue means that the screen or the disk is slow; the robot must not feel it.
                        sink.try_send(sample).unwrap_or_default();
                    }
                })?);
            }
            Ok(Self { session, hearing })
        })
        .await?
    }

    /// Closes the session.
    pub async fn close(self) {
        let closing = tokio::task::spawn_blocking(move || {
            drop(self.hearing);
            self.session.close();
        });
        if let Err(error) = closing.await {
            tracing::debug!(%error, "closing the observer");
        }
    }
}
