//! Splits the output of a mission's programs, which all hosts send, into lines for the record.

use crate::client::{Answers, Client, unasked, words};
use crate::logic::record::Lines;
use comms::io::clock;
use node::console::{self, Failure};
use node::logic::protocol::{Answer, Deployment, Ending, FailureCause, Report, Request};
use std::collections::BTreeSet;
use std::time::Duration;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::task::JoinSet;

/// The most pieces of output that wait. When there are as many, senders wait.
const PIECES_MAX: usize = 256;

/// Output of one program: the path of the program, and bytes or lines.
type OutputOf<T> = (String, T);

/// The streams of output, one from each host.
#[derive(Debug)]
pub(crate) struct Outputs {
    asked: BTreeSet<String>,
    readers: JoinSet<()>,
    sink: Sender<OutputOf<Vec<u8>>>,
    arriving: Receiver<OutputOf<Vec<u8>>>,
    lines: Lines,
}

impl Default for Outputs {
    fn default() -> Self {
        let (sink, arriving) = mpsc::channel(PIECES_MAX);
        let (asked, readers) = (BTreeSet::new(), JoinSet::new());
        Self { asked, readers, sink, arriving, lines: Lines::default() }
    }
}

impl Outputs {
    /// Begins to receive the output of a deployment's programs on a host, unless this has begun already.
    pub(crate) fn hear(&mut self, client: &Client, host: &str, deployment: &Deployment) {
        if !self.asked.insert(host.to_owned()) {
            return;
        }
        match client.ask_on(host, &Request::Output { deployment: deployment.clone() }) {
            Ok(answers) => drop(self.readers.spawn(hear(host.to_owned(), answers, self.sink.clone()))),
            Err(why) => console::note(&incomplete(host, &why)),
        }
    }

    /// Returns the next whole lines of a program. Waits for ever if no stream has any.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn next(&mut self) -> OutputOf<String> {
        loop {
            let Some((path, bytes)) = self.arriving.recv().await else { return std::future::pending().await };
            if let Some(lines) = self.lines.push(&path, &bytes) {
                return (path, lines);
            }
        }
    }

    /// Takes the remaining output until it ends, or until nothing has arrived for `pause_max`.
    pub(crate) async fn rest(mut self, pause_max: Duration, mut take: impl FnMut(String, String)) {
        drop(self.sink);
        loop {
            let deadline = clock::now() + pause_max;
            let piece = tokio::select! {
                biased;
                piece = self.arriving.recv() => piece,
                () = clock::sleep_until(deadline) => {
                    if !pause_max.is_zero() {
                        console::note("warning: some output of programs is not recorded: it did not arrive in time");
                    }
                    None
                }
            };
            let Some((path, bytes)) = piece else { break };
            if let Some(lines) = self.lines.push(&path, &bytes) {
                take(path, lines);
            }
        }
        self.lines.end().for_each(|(path, lines)| take(path, lines));
    }
}

async fn hear(host: String, mut answers: Answers, sink: Sender<OutputOf<Vec<u8>>>) {
    while let Some(answer) = answers.next().await {
        let why = match answer {
            Ok(Answer::Wrote { path, bytes }) => {
                if sink.send((path, bytes)).await.is_err() {
                    return;
                }
                continue;
            }
            // If a host never took part, it has no output.
            Ok(Answer::Refused(_)) => return,
            Ok(other) => unasked(&host, &other),
            Err(why) => why,
        };
        return console::note(&incomplete(&host, &why));
    }
}

fn incomplete(host: &str, why: &Failure) -> String {
    format!("warning: some output of programs of `{host}` is not recorded: {}", words(why))
}

/// Returns whether the failure comes from the spec itself, such as a deadline.
pub(crate) fn is_failed_on_purpose(report: &Report) -> bool {
    let Report::Finished { ending: Ending::Aborted(failure), .. } = report else { return false };
    matches!(failure.cause, FailureCause::Failed(_))
}
