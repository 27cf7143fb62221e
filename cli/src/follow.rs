//! Follows a mission from the request to its end, with its progress, record, report and summary.

mod hearing;
mod home;
mod record_folder;
mod recording;

use crate::client::{Answers, Client, unasked, words};
use crate::display::{Display, UPDATE_EVERY};
use crate::io::observer::{ObserverEvent, Sample, Sinks, WireValue, WireValues};
use crate::io::recorder::Recorder;
use crate::io::user;
use crate::logic::mission::{Mission, Outcome};
use crate::logic::record::{Entry, Messages, Port, WireName, messages, ports};
use crate::logic::value_queue::Queued;
use crate::output::Output;
use crate::outputs::{Outputs, is_failed_on_purpose};
use anyhow::{Context, anyhow};
use comms::io::clock;
use comms::io::entropy;
use comms::logic::human::span;
use comms::logic::time::Time;
use hearing::Hearing;
use home::{BACK_WITHIN, Home};
use language::Source;
use language::plan::Plan;
use node::console::{self, Failure};
use node::logic::protocol::{Answer, Deployment, Report, Request, StartMode, StopReply, is_unreached};
pub(crate) use record_folder::RUNS;
use record_folder::{Readers, start_record};
use recording::Recording;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::mpsc;

/// The most samples that wait to be shown and recorded. When there are as many, new samples are left out.
const OBSERVED_MAX: usize = 4096;
/// How often the command looks for the home node after the node was not found.
const LOOK_EVERY: Duration = Duration::from_millis(200);
/// The longest pause of the hosts while they send the rest of their programs' output after the end of the mission.
const OUTPUT_PAUSE_MAX: Duration = Duration::from_secs(3);
/// How a mission is watched.
#[derive(Clone, Debug, clap::Args)]
pub struct FollowArgs {
    /// Where the record and the report of the run go
    #[arg(long, value_name = "DIR", default_value = "runs")]
    runs: PathBuf,
    /// Make no record
    #[arg(long, conflicts_with = "ports")]
    no_record: bool,
    /// Also record the values of ports: `all`, or outputs such as `Out` or `force.Out`
    #[arg(long = "record", value_name = "all|PORT", value_delimiter = ',')]
    ports: Vec<String>,
}

/// The user has left before the end of a mission.
#[derive(Debug, thiserror::Error)]
#[error("this command ended while `{name}` was stopping")]
pub(crate) struct Left {
    name: String,
}

/// Returns whether the user has left before the end of the mission.
pub(crate) fn is_left(result: &Result<(), Failure>) -> bool {
    matches!(result, Err(Failure::Refused(why)) if why.is::<Left>())
}

/// A spec that is ready to run, with its text.
#[derive(Clone, Debug)]
pub(crate) struct Spec {
    /// The file.
    pub(crate) file: PathBuf,
    /// The text of the spec.
    pub(crate) text: String,
    /// The plan of the spec.
    pub(crate) plan: Plan,
    /// The texts of the modules that the spec may use. The text of the spec comes first.
    pub(crate) modules: Vec<Source>,
}

/// A mission that is being watched.
struct Watch {
    mission: Mission,
    display: Display,
    output: Output,
    recording: Recording,
    hearing: Hearing,
    /// The values of wires that have arrived.
    values: Arc<WireValues>,
    /// How many samples have arrived while too many others waited.
    dropped: Arc<AtomicU64>,
    /// The output of programs. Without a record, only the lines that may explain an end are requested.
    outputs: Outputs,
    go_at: Option<Time>,
    name: String,
    hosts: Vec<String>,
    home: Home,
}

/// Deploys a spec and stays until it has ended; Ctrl-C stops it everywhere.
pub(crate) async fn follow(
    client: &Client,
    spec: Spec,
    following: &FollowArgs,
    start: StartMode,
) -> Result<(), Failure> {
    let home = spec.plan.home().context("the plan names no host for `main`")?.to_owned();
    // The project file may name ports although no record is kept.
    let wanted = if following.no_record { &[][..] } else { &following.ports };
    let messages = if wanted.is_empty() { Messages::new() } else { messages(&spec.modules) };
    let ports = ports(&spec.plan, wanted, &messages).map_err(|why| anyhow!(why))?;
    let (request, plan, by) = (entropy::number()?, spec.plan.clone(), user::name_and_host());
    let request = Request::Deploy { request, plan, by, start };
    let request = client.signed(&home, request, 0).await?; // A user who cannot sign leaves no record.
    let recorder = if following.no_record {
        None
    } else {
        Some(start_record(&spec, &following.runs, Readers::of(client.team().is_some()))?)
    };
    let (mut watch, mut arriving) =
        Watch::new(&spec.plan, Home::new(home.clone(), None), recorder, ports, client.team());
    let answers = client.ask_on(&home, &request)?;
    let watched = watch.watch(client, &home, answers, &mut arriving).await;
    watch.finish(watched, arriving).await
}

/// Watches a deployment that runs, from its beginning on, and stays until it has ended; Ctrl-C stops it everywhere.
pub(crate) async fn attach(client: &Client, plan: Plan, deployment: Deployment) -> Result<(), Failure> {
    let home = plan.home().context("the plan names no host for `main`")?.to_owned();
    let reports = Home::new(home.clone(), Some(deployment.clone()));
    let (mut watch, mut arriving) = Watch::new(&plan, reports, None, Vec::new(), client.team());
    let answers = client.ask_on(&home, &Request::Watch { deployment, seen: 0 })?;
    let watched = watch.watch(client, &home, answers, &mut arriving).await;
    watch.finish(watched, arriving).await
}

impl Watch {
    fn new(
        plan: &Plan,
        home: Home,
        recorder: Option<Recorder>,
        ports: Vec<Port>,
        team: Option<PathBuf>,
    ) -> (Self, mpsc::Receiver<ObserverEvent>) {
        let (observer_events, arriving) = mpsc::channel(OBSERVED_MAX);
        let (values, dropped) = (Arc::<WireValues>::default(), Arc::default());
        let sinks = Sinks { events: observer_events, dropped: Arc::clone(&dropped), values: Arc::clone(&values) };
        let watch = Self {
            mission: Mission::new(plan),
            display: Display::default(),
            output: Output::standard(),
            recording: Recording::new(recorder, Arc::clone(&values)),
            hearing: Hearing::new(&plan.name, team, ports, sinks),
            values,
            dropped,
            outputs: Outputs::default(),
            go_at: None,
            name: plan.name.clone(),
            hosts: plan.hosts.clone(),
            home,
        };
        (watch, arriving)
    }

    async fn watch(
        &mut self,
        client: &Client,
        home: &str,
        mut answers: Answers,
        observer_events: &mut mpsc::Receiver<ObserverEvent>,
    ) -> Result<(), Failure> {
        let (mut interrupt, mut terminate) = (signal(SignalKind::interrupt())?, signal(SignalKind::terminate())?);
        let mut refresh = tokio::time::interval(UPDATE_EVERY);
        let mut stopping = None;
        loop {
            tokio::select! {
                answer = answers.next() => match answer {
                    Some(Ok(answer)) => self.take(client, answer)?,
                    cut_off => {
                        let mut interrupts = 0;
                        let more = tokio::select! {
                            more = self.again(client, cut_off.and_then(Result::err)) => more?,
                            () = twice([&mut interrupt, &mut terminate], &mut interrupts) => None,
                        };
                        match more {
                            Some(more) => answers = more,
                            None if interrupts > 1 => return Err(self.lost()),
                            None => return Ok(()),
                        }
                        if interrupts > 0 {
                            self.stop(client, home, &mut stopping).await?;
                        }
                    }
                },
                Some(event) = observer_events.recv() => self.observed(event),
                value = self.values.queue.next() => self.value(value),
                (path, text) = self.outputs.next() => self.wrote(path, text),
                Some(answer) = next(&mut stopping) => self.stop_answered(answer),
                _ = refresh.tick() => {
                    self.recording.watch(&mut self.output);
                    self.recording.count_missing(self.since_go(clock::now()));
                    self.mission.tick(self.since_go(clock::now()));
                    self.display.update(&self.mission, &mut self.output);
                }
                _ = interrupt.recv() => self.stop(client, home, &mut stopping).await?,
                _ = terminate.recv() => self.stop(client, home, &mut stopping).await?,
            }
        }
    }

    /// Continues to watch after the answers have broken off, unless the mission has ended. The home node may have been
    /// out of reach for a moment only, which does not end the mission.
    async fn again(&mut self, client: &Client, why: Option<Failure>) -> Result<Option<Answers>, Failure> {
        if self.mission.verdict().is_some() {
            return Ok(None);
        }
        let Some(deployment) = self.home.deployment().cloned() else {
            let (home, name) = (self.home.host(), &self.name);
            let gone = || Failure::Unreachable(anyhow!("the node `{home}` went away before it accepted `{name}`"));
            return Err(why.unwrap_or_else(gone));
        };
        let now = clock::now();
        let (deadline, home) = (self.home.cut(now), self.home.host().to_owned());
        // A question gets lost while the session is losing its link. The command would wait for its answer without success.
        clock::sleep_until(now + LOOK_EVERY).await;
        while clock::now() < deadline {
            tokio::select! {
                hosts = client.hosts(std::slice::from_ref(&home)) => match hosts {
                    Ok(hosts) if hosts.contains(&home) => {
                        let request = self.home.resume(clock::now(), deployment);
                        return client.ask_on(&home, &request).map(Some);
                    }
                    // The session may end together with the node of this machine, and this may be the home node.
                    Ok(_) | Err(_) => clock::sleep_until(clock::now() + LOOK_EVERY).await,
                },
                () = clock::sleep_until(deadline) => {}
            }
        }
        Err(self.lost())
    }

    /// Returns the failure for an unreachable home node. Such a node also cannot be asked to end the mission.
    fn lost(&self) -> Failure {
        let (home, name, within) = (self.home.host(), &self.name, span(BACK_WITHIN));
        Failure::Unreachable(anyhow!(
            "the mission on `{home}` is lost: its node is gone, or was out of reach for {within}; what runs of `{name}` on \
             other hosts stops by its own rules (`dca status` shows it); if it still runs, `dca attach {name}` watches it"
        ))
    }

    /// Asks once for the end of the mission. The reports of the mission say when it has ended. If the user asks again,
    /// the command leaves without waiting.
    async fn stop(&mut self, client: &Client, home: &str, asked: &mut Option<Answers>) -> Result<(), Failure> {
        if asked.is_some() {
            return Err(anyhow!(Left { name: self.name.clone() }).into());
        }
        self.output.note("stopping everything; press Ctrl-C again to leave without waiting");
        *asked = Some(client.stop_on(home, &self.name, self.home.deployment()).await?);
        Ok(())
    }

    /// Prints a warning if the stop is refused. Otherwise the reports of the mission say how it ends.
    fn stop_answered(&mut self, answer: Result<Answer, Failure>) {
        let why = match answer {
            Ok(Answer::Stop(StopReply::Stopped | StopReply::Unknown)) => return,
            Ok(other) => unasked(self.home.host(), &other),
            Err(why) => why,
        };
        self.output.note(&format!("warning: it cannot be stopped: {}; press Ctrl-C again to leave", words(&why)));
    }

    fn take(&mut self, client: &Client, answer: Answer) -> Result<(), Failure> {
        let Answer::Report(report) = answer else {
            // If the node was restarted, it does not know the deployment.
            let is_lost = self.home.is_cut_off() && matches!(answer, Answer::Refused(_));
            return Err(if is_lost { self.lost() } else { unasked(self.home.host(), &answer) });
        };
        self.home.take(&report);
        if let Report::Go { signals, .. } = &report {
            self.go_at = Some(clock::now());
            self.hearing.signals(signals);
        }
        if let (Report::Process { at, .. }, Some(go)) = (&report, self.go_at) {
            // GO is reported later to a command that attaches later. The time since GO in this report shows when GO was.
            let begun = clock::now().since(Time::ZERO).saturating_sub(*at);
            self.go_at = Some(go.min(Time::ZERO + begun));
        }
        if let Report::Programs { at } = &report {
            self.hearing.programs(self.home.deployment(), at);
            return Ok(());
        }
        self.hear_outputs(client, &report);
        if let (Report::Changed { .. } | Report::Unchanged { .. }, Some(go)) = (&report, self.go_at) {
            // These reports have no time.
            self.mission.tick(clock::now() - go);
        }
        self.mission.report(&report);
        self.display.update(&self.mission, &mut self.output);
        self.recording.push(Entry::Report(report));
        Ok(())
    }

    fn observed(&mut self, event: ObserverEvent) {
        match event {
            ObserverEvent::Sample(sample) => self.sample(sample),
            ObserverEvent::Unseen(why) => self.output.note(&format!("warning: {why}")),
        }
    }

    fn sample(&mut self, sample: Sample) {
        let Some(go) = self.go_at else { return };
        let Sample { path, arrived, signals } = sample;
        let at = arrived - go;
        self.mission.signals(&path, at, &signals);
        self.recording.push(Entry::Signals { path, at, sample: signals });
    }

    /// Receives the output of programs. It is requested from each host as soon as the programs there are prepared, or
    /// at the end if they never started. Without a record, it is requested only at the end, and only if a deadline may
    /// have ended programs.
    fn hear_outputs(&mut self, client: &Client, report: &Report) {
        let is_wanted = self.recording.is_kept() || is_failed_on_purpose(report);
        let Some(deployment) = self.home.deployment().filter(|_| is_wanted) else { return };
        match report {
            Report::Prepared { host, .. } => self.outputs.hear(client, host, deployment),
            Report::Refused { .. } | Report::Finished { .. } => {
                self.hosts.iter().for_each(|host| self.outputs.hear(client, host, deployment));
            }
            Report::Accepted { .. }
            | Report::Connected { .. }
            | Report::Go { .. }
            | Report::Process { .. }
            | Report::Programs { .. }
            | Report::Changed { .. }
            | Report::Stepped { .. }
            | Report::Unchanged { .. }
            | Report::Replanned { .. }
            | Report::Aligned { .. }
            | Report::BeganLate { .. }
            | Report::Omitted { .. } => {}
        }
    }

    fn value(&mut self, queued: Queued<WireName, WireValue>) {
        let at = self.since_go(queued.value.arrived);
        let port = self.hearing.port(&queued.source);
        self.recording.value(queued, at, port);
    }

    /// Returns the time since GO; zero before GO.
    fn since_go(&self, now: Time) -> Duration {
        self.go_at.map_or(Duration::ZERO, |go| now - go)
    }

    fn wrote(&mut self, path: String, text: String) {
        self.recording.watch_output(&path, &text, &mut self.output);
        let at = self.since_go(clock::now());
        self.mission.wrote(&path, &text);
        self.recording.push(Entry::Output { path, at, text });
    }

    async fn finish(
        mut self,
        watched: Result<(), Failure>,
        mut arriving: mpsc::Receiver<ObserverEvent>,
    ) -> Result<(), Failure> {
        self.hearing.close().await;
        // These are the last samples of programs that have ended. They count the values that were lost.
        while let Ok(event) = arriving.try_recv() {
            self.observed(event);
        }
        while let Some(value) = self.values.queue.pop() {
            self.value(value);
        }
        if watched.is_ok() {
            self.values.missing().end();
        }
        self.recording.count_missing(self.since_go(clock::now()));
        // If the user leaves early, the command does not wait for output.
        let outputs = std::mem::take(&mut self.outputs);
        let pause_max = if watched.is_ok() { OUTPUT_PAUSE_MAX } else { Duration::ZERO };
        outputs.rest(pause_max, |path, text| self.wrote(path, text)).await;
        // If no host has accepted it, there is nothing to keep.
        let has_begun = watched.is_ok() || self.home.deployment().is_some();
        let (mut files, kept) = self.recording.finish(has_begun, &mut self.output);
        if files.record.is_some() {
            files.dropped += self.dropped.load(Ordering::Relaxed);
        }
        self.output.clear();
        if let Err(why) = watched {
            // The user still wants to see the part that was observed.
            if self.go_at.is_some() {
                self.display.finish(&self.mission, &files, &mut self.output)?;
            }
            return Err(why);
        }
        self.display.finish(&self.mission, &files, &mut self.output)?;
        match self.mission.verdict().map(|verdict| &verdict.outcome) {
            Some(Outcome::Done) => {
                kept.map_err(|why| why.context("the mission is done, but its record or report is not complete").into())
            }
            Some(Outcome::Refused(reasons)) if is_unreached(reasons) => Err(Failure::ReportedUnreachable),
            _ => Err(Failure::Reported),
        }
    }
}

/// Waits for two signals. The first one is counted, and kept until the command can ask for a stop.
///
/// # Cancellation
/// Safe.
async fn twice([one, other]: [&mut Signal; 2], count: &mut u32) {
    while *count < 2 {
        tokio::select! {
            _ = one.recv() => {}
            _ = other.recv() => {}
        }
        *count += 1;
        if *count == 1 {
            console::note(
                "the mission will be stopped as soon as its home answers again; press Ctrl-C again to leave without waiting",
            );
        }
    }
}

/// Returns the next answer to the request, if there is a request.
///
/// # Cancellation
/// Safe.
async fn next(asked: &mut Option<Answers>) -> Option<Result<Answer, Failure>> {
    asked.as_mut()?.next().await
}
