//! Measures how often values leave one output, as long as a person looks at it.

use super::Heard;
use crate::client::{Client, words};
use crate::io::taps::Taps;
use crate::logic::tap::Rate;
use crate::logic::top::{Program, ProgramOutput};
use crate::tapped::{locations, outputs_of};
use anyhow::anyhow;
use comms::io::clock;
use node::console::Failure;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{self, Sender};
use tokio::sync::oneshot;
use tokio::task::JoinSet;
use view::{Input, Measured};

/// How often a rate is told.
const TOLD_EVERY: Duration = Duration::from_secs(1);
/// How many values wait to be counted; more are left out, and their numbers show it.
const VALUES_MAX: usize = 4096;

/// A measurement that goes on until it is ended.
pub(super) struct Measurement {
    output: ProgramOutput,
    end: oneshot::Sender<()>,
}

impl Measurement {
    /// Begins to measure an output.
    pub(super) fn begin(
        client: Arc<Client>,
        output: ProgramOutput,
        sink: Sender<Heard>,
        tasks: &mut JoinSet<()>,
    ) -> Self {
        let (end, ended) = oneshot::channel();
        tasks.spawn(run(client, output.clone(), sink, ended));
        Self { output, end }
    }

    pub(super) fn output(&self) -> &ProgramOutput {
        &self.output
    }

    /// Stops the measurement: then its program sends no values to it.
    pub(super) fn end(self) {
        // A measurement that has ended by itself needs no word.
        self.end.send(()).unwrap_or_default();
    }
}

async fn run(client: Arc<Client>, output: ProgramOutput, sink: Sender<Heard>, mut ended: oneshot::Receiver<()>) {
    let Ok(mut taps) = Taps::open(client.team()).await else { return };
    let failed = tokio::select! {
        measured = measure(&client, &mut taps, &output, &sink) => measured.err(),
        _ = &mut ended => None,
    };
    if let Some(failure) = failed {
        let (host, text) = (output.program.host, format!("`{}` cannot be measured: {}", output.port, words(&failure)));
        sink.send(Heard::Input(Input::Note { host, text })).await.unwrap_or_default();
    }
    taps.close().await;
}

async fn measure(
    client: &Client,
    taps: &mut Taps,
    output: &ProgramOutput,
    sink: &Sender<Heard>,
) -> Result<(), Failure> {
    let ProgramOutput { program: Program { deployment, host, path }, port } = output;
    let located = locations(client, host, deployment).await?;
    let dial = located.into_iter().find(|(located, _)| located == path).map(|(_, dial)| dial);
    let dial = dial.ok_or_else(|| anyhow!("`{path}` has no links yet"))?;
    outputs_of(taps, deployment, path, dial).await?;
    let (values_tx, mut values) = mpsc::channel(VALUES_MAX);
    taps.hear(&deployment.name, path, port, 0, values_tx).await?;
    let (mut rate, mut told_at) = (Rate::default(), clock::now() + TOLD_EVERY);
    loop {
        tokio::select! {
            value = values.recv() => match value {
                Some((_, tapped)) => rate.take(&tapped),
                None => return Ok(()),
            },
            () = clock::sleep_until(told_at) => {
                let hertz = rate.hertz().unwrap_or(0.0);
                let (deployment, path, port) = (deployment.clone(), path.clone(), port.clone());
                let measured = Measured { deployment, path, port, hertz };
                if sink.send(Heard::Input(Input::Measured(measured))).await.is_err() {
                    return Ok(());
                }
                (rate, told_at) = (rate.next(), told_at + TOLD_EVERY);
            }
        }
    }
}
