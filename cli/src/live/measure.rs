//! Measures how often an output sends values, while a person looks at it.

use super::Heard;
use crate::client::{Client, words};
use crate::io::taps::Taps;
use crate::io::value_queue::SharedQueue;
use crate::logic::tap::Rate;
use crate::logic::top::{Program, ProgramOutput};
use crate::tapped::{self, found_again, locations, outputs_of};
use anyhow::anyhow;
use comms::io::clock;
use comms::logic::time::Time;
use node::console::Failure;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::Sender;
use tokio::sync::oneshot;
use tokio::task::{AbortHandle, JoinSet};
use view::{Input, Measured};

/// How often the rate is sent to the view.
const TOLD_EVERY: Duration = Duration::from_secs(1);
/// How often a program that sends no values is searched for: it may have been restarted elsewhere.
const FIND_EVERY: Duration = Duration::from_secs(3);
/// How long after the start of a measurement it can start again, if it has ended by itself.
const AGAIN_AFTER: Duration = Duration::from_secs(3);

/// A measurement that continues until it is stopped.
pub(super) struct Measurement {
    output: ProgramOutput,
    end: oneshot::Sender<()>,
    task: AbortHandle,
    begun: Time,
}

impl Measurement {
    /// Begins to measure an output. If the output was measured before, a failure is not reported again.
    pub(super) fn begin(
        client: Arc<Client>,
        output: ProgramOutput,
        sink: Sender<Heard>,
        tasks: &mut JoinSet<()>,
        is_again: bool,
    ) -> Self {
        let (end, ended) = oneshot::channel();
        let measuring = run(client, output.clone(), sink.clone(), ended);
        let task = tasks.spawn(async move {
            if let Some(note) = measuring.await.filter(|_| !is_again) {
                sink.send(Heard::Input(note)).await.unwrap_or_default();
            }
        });
        Self { output, end, task, begun: clock::now() }
    }

    pub(super) fn output(&self) -> &ProgramOutput {
        &self.output
    }

    /// Returns whether the measurement has ended by itself and can begin again. For example, its program had no links yet.
    pub(super) fn is_over(&self) -> bool {
        self.task.is_finished() && clock::now().since(self.begun) >= AGAIN_AFTER
    }

    /// Stops the measurement. Then the program sends it no more values.
    pub(super) fn end(self) {
        // If the measurement has ended by itself, the message has no receiver.
        self.end.send(()).unwrap_or_default();
    }
}

/// Measures until `ended`; returns a note if the output cannot be measured.
async fn run(
    client: Arc<Client>,
    output: ProgramOutput,
    sink: Sender<Heard>,
    mut ended: oneshot::Receiver<()>,
) -> Option<Input> {
    let mut taps = Taps::open(client.team()).await.ok()?;
    let failed = tokio::select! {
        measured = measure(&client, &mut taps, &output, &sink) => measured.err(),
        _ = &mut ended => None,
    };
    taps.close().await;
    let text = format!("`{}` cannot be measured: {}", output.port, words(&failed?));
    let Program { mission, host, .. } = output.program;
    Some(Input::Note { robot: mission.robot(&host), text })
}

async fn measure(
    client: &Client,
    taps: &mut Taps,
    output: &ProgramOutput,
    sink: &Sender<Heard>,
) -> Result<(), Failure> {
    let ProgramOutput { program: Program { mission, host, path }, port } = output;
    let deployment = &mission.deployment;
    let located = locations(client, host, deployment).await?;
    let dial = located.into_iter().find(|(located, _)| located == path).map(|(_, dial)| dial);
    let dial = dial.ok_or_else(|| anyhow!("`{path}` has no links yet"))?;
    outputs_of(taps, deployment, path, dial.clone()).await?;
    let mut tapped = tapped::Program { path: path.clone(), host: host.clone(), dial };
    let values = Arc::new(SharedQueue::default());
    taps.hear(&deployment.name, path, port, 0, Arc::clone(&values)).await?;
    let (mut rate, begun) = (Rate::default(), clock::now());
    let (mut told_at, mut find_at) = (begun + TOLD_EVERY, begun + FIND_EVERY);
    loop {
        tokio::select! {
            queued = values.next() => rate.take(&queued.value),
            () = clock::sleep_until(told_at) => {
                if let Some(hertz) = rate.hertz() {
                    let (mission, path, port) = (mission.clone(), path.clone(), port.clone());
                    let measured = Measured { mission, path, port, hertz };
                    if sink.send(Heard::Input(Input::Measured(measured))).await.is_err() {
                        return Ok(());
                    }
                } else if clock::now() >= find_at {
                    // If this fails, the program is searched for again later.
                    drop(found_again(client, taps, deployment, &mut tapped).await);
                    find_at = clock::now() + FIND_EVERY;
                }
                (rate, told_at) = (rate.next(), clock::now() + TOLD_EVERY);
            }
        }
    }
}
