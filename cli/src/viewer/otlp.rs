//! Sends the traces of missions to a collector of OpenTelemetry while the missions run.
//!
//! Spans wait until the collector can take them, up to a limit. A view never delays a robot, so spans beyond the limit are left out,
//! and their count is told.

use crate::logic::collector::{ANSWER_MAX, Answer, Collector};
use crate::logic::trace::live::{Batch, Traces};
use comms::io::clock;
use comms::logic::time::Time;
use node::console;
use node::logic::protocol::Event;
use std::io;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::TcpStream;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::task::JoinSet;
use tokio::time::timeout;
use view::{MissionId, RobotId};

/// How long a collector may take for a request.
const ANSWERED_WITHIN: Duration = Duration::from_secs(10);
/// The pause after a failed request.
const AGAIN_AFTER: Duration = Duration::from_secs(2);
/// How long the command waits for the collector when it ends.
const LEFT_WITHIN: Duration = Duration::from_secs(5);
/// The most spans that wait. A span has about 1 KiB.
const WAITING_MAX: usize = 20_000;

/// The traces, and the way to the collector.
pub(super) struct Otlp {
    traces: Traces,
    /// When this command began to listen.
    began: Time,
    waiting: Sender<Batch>,
    /// The task that sends.
    sender: JoinSet<()>,
    counts: Arc<Counts>,
    is_full: bool,
}

/// Numbers of spans.
#[derive(Debug, Default)]
struct Counts {
    /// Spans that the collector has taken.
    taken: AtomicUsize,
    /// Spans that the collector has refused, and spans beyond the limit.
    lost: AtomicUsize,
    /// Spans that wait.
    waiting: AtomicUsize,
}

impl Otlp {
    pub(super) fn new(collector: Collector) -> Self {
        console::say(&format!("traces go to {collector}"));
        let (waiting, batches) = mpsc::channel(WAITING_MAX);
        let counts = Arc::new(Counts::default());
        let mut sender = JoinSet::new();
        sender.spawn(send_all(collector, batches, Arc::clone(&counts)));
        Self { traces: Traces::default(), began: clock::now(), waiting, sender, counts, is_full: false }
    }

    /// Takes an event of a mission.
    pub(super) fn event(&mut self, home: &RobotId, event: &Event) {
        let id = MissionId { deployment: event.deployment.clone(), home: home.host.clone(), fleet: home.fleet };
        let of_the_past = event.ago > clock::now() - self.began;
        self.traces.take(&id, event, of_the_past);
    }

    /// Passes the spans that have ended on to the collector.
    pub(super) fn send(&mut self) {
        for batch in self.traces.ended() {
            let spans = batch.spans;
            let has_room = self.counts.waiting.load(Ordering::Relaxed) + spans <= WAITING_MAX;
            if has_room && self.waiting.try_send(batch).is_ok() {
                self.counts.waiting.fetch_add(spans, Ordering::Relaxed);
                self.is_full = false;
                continue;
            }
            self.counts.lost.fetch_add(spans, Ordering::Relaxed);
            if !std::mem::replace(&mut self.is_full, true) {
                console::note("warning: traces are left out until the collector answers again");
            }
        }
    }

    /// Sends the rest, and tells how much the collector has taken.
    pub(super) async fn close(mut self) {
        self.send();
        drop(self.waiting);
        if timeout(LEFT_WITHIN, self.sender.join_next()).await.is_err() {
            self.sender.shutdown().await;
        }
        let count = |count: &AtomicUsize| count.load(Ordering::Relaxed);
        let (taken, missing) = (count(&self.counts.taken), count(&self.counts.lost) + count(&self.counts.waiting));
        console::note(&format!("the collector has taken {taken} spans; {missing} were not delivered"));
    }
}

/// Sends each batch until the collector has taken or refused it.
async fn send_all(collector: Collector, mut batches: Receiver<Batch>, counts: Arc<Counts>) {
    let mut is_silent = false;
    while let Some(Batch { request, spans }) = batches.recv().await {
        let refused = loop {
            let (refused, why) = match post(&collector, &request).await {
                Answer::Taken => break 0,
                Answer::Partly { refused, why } => (refused.min(spans), why),
                Answer::Refused(why) => (spans, why),
                Answer::Later(why) => {
                    if !std::mem::replace(&mut is_silent, true) {
                        console::note(&format!(
                            "warning: the collector {collector} does not take traces; they wait: {why}"
                        ));
                    }
                    clock::sleep_until(clock::now() + AGAIN_AFTER).await;
                    continue;
                }
            };
            console::note(&format!("warning: the collector has refused {refused} spans: {why}"));
            break refused;
        };
        if std::mem::take(&mut is_silent) {
            console::note("the collector takes traces again");
        }
        counts.waiting.fetch_sub(spans, Ordering::Relaxed);
        counts.taken.fetch_add(spans - refused, Ordering::Relaxed);
        counts.lost.fetch_add(refused, Ordering::Relaxed);
    }
}

async fn post(collector: &Collector, request: &str) -> Answer {
    match timeout(ANSWERED_WITHIN, exchange(collector, request)).await {
        Ok(Ok(answer)) => Answer::read(&answer),
        Ok(Err(error)) => Answer::Later(error.to_string()),
        Err(_) => Answer::Later(format!("no answer within {} s", ANSWERED_WITHIN.as_secs())),
    }
}

async fn exchange(collector: &Collector, request: &str) -> io::Result<Vec<u8>> {
    let mut stream = TcpStream::connect((collector.host.as_str(), collector.port)).await?;
    stream.write_all(&collector.request(request)).await?;
    let mut answer = Vec::new();
    stream.take(ANSWER_MAX as u64).read_to_end(&mut answer).await?;
    Ok(answer)
}
