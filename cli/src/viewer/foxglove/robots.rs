//! The robots behind the server: which programs run, and the values that clients want.
//!
//! Without a client no robot is asked. A value is fetched only while some client has subscribed to
//! it, as `dca echo` does. The view receives the signals of a program until it knows their names.
//! The first sample has the names.

use crate::client::{Client, Clients};
use crate::io::observer::samples;
use crate::io::taps::Taps;
use crate::io::value_queue::SharedQueue;
use crate::live::Live;
use crate::logic::foxglove::{Arrival, Hub, ParameterValue, ProgramName, Source};
use crate::logic::value_queue::Queued;
use crate::object::exports_of;
use crate::outputs::Outputs as Written;
use crate::tapped::{locations, outputs_of};
use comms::io::clock;
use comms::logic::control::Dial;
use comms::logic::object::Exports;
use comms::logic::signals::Signals;
use comms::logic::tap::{Outputs, Tapped};
use comms::logic::time::Time;
use comms::logic::{codec, key};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::sync::{Semaphore, oneshot};
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::timeout;
use view::{Fleet, MissionId, Model, RobotId};

/// How often each host is asked for the programs of a deployment.
const LOCATE_EVERY: Duration = Duration::from_secs(1);
/// How long after a program was asked for its outputs without an answer it is asked again.
const DESCRIBE_AGAIN: Duration = Duration::from_secs(3);
/// How many programs are asked for their outputs at once: each takes a thread.
const DESCRIBED_MAX: usize = 8;
/// How often parameters are read while some client follows them.
const PARAMETERS_EVERY: Duration = Duration::from_secs(2);
/// How many news besides values wait; further senders wait.
const NEWS_MAX: usize = 1024;
/// How long programs may take to finish their orders when the user leaves the command.
const CLOSED_WITHIN: Duration = Duration::from_secs(5);

/// News of a robot.
pub(super) enum News {
    Opened { fleet: Fleet, taps: Option<Arc<Taps>> },
    Located { host: String, mission: MissionId, programs: Vec<(String, Dial)> },
    Described { program: ProgramName, session: String, forms: Option<Box<Forms>> },
    Value(Queued<Source, Arrived>),
    Wrote { program: ProgramName, text: String },
    Parameters(Vec<ParameterValue>),
}

/// A value of an output, or samples of the signals of a program, and when they arrived.
pub(super) struct Arrived {
    content: Content,
    at: Arrival,
}

enum Content {
    Value(Tapped),
    Signals(Vec<Signals>),
}

type Values = Arc<SharedQueue<Source, Arrived>>;

/// The outputs and exports of a program.
pub(super) struct Forms {
    outputs: Outputs,
    exports: Exports,
}

/// A program.
struct Program {
    host: String,
    session: String,
    is_described: bool,
    asked: Time,
}

/// A subscription.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Line {
    Source(Source),
    Log { host: String, mission: MissionId },
}

/// A line whose values are received until this is dropped.
struct Hearing {
    task: AbortHandle,
    _end: oneshot::Sender<()>,
}

/// A data session.
enum Session {
    Opening,
    Open(Arc<Taps>),
}

/// The robots.
pub(super) struct Robots {
    /// The data sessions, which are opened for the first client. Programs in two commands may have the same names, so each command
    /// has a session of its own.
    sessions: BTreeMap<Fleet, Session>,
    programs: BTreeMap<ProgramName, Program>,
    /// When each host was asked for the programs of a deployment.
    located: BTreeMap<(String, MissionId), Time>,
    hearing: BTreeMap<Line, Hearing>,
    parameters_read: Option<Time>,
    describing: Arc<Semaphore>,
    tasks: JoinSet<()>,
    sink: Sender<News>,
    news: Receiver<News>,
    values: Values,
}

impl Robots {
    pub(super) fn new() -> Self {
        let (sink, news) = mpsc::channel(NEWS_MAX);
        Self {
            sessions: BTreeMap::new(),
            programs: BTreeMap::new(),
            located: BTreeMap::new(),
            hearing: BTreeMap::new(),
            parameters_read: None,
            describing: Arc::new(Semaphore::new(DESCRIBED_MAX)),
            tasks: JoinSet::new(),
            sink,
            news,
            values: Arc::default(),
        }
    }

    /// Returns the next news.
    ///
    /// # Cancellation
    /// Safe.
    pub(super) async fn next(&mut self) -> News {
        tokio::select! {
            // The robots themselves hold a sender.
            Some(news) = self.news.recv() => news,
            value = self.values.next() => News::Value(value),
        }
    }

    /// Returns the data session to the programs of these nodes.
    pub(super) fn taps(&self, fleet: Fleet) -> Option<Arc<Taps>> {
        if let Session::Open(taps) = self.sessions.get(&fleet)? { Some(Arc::clone(taps)) } else { None }
    }

    /// Takes news in.
    pub(super) fn take(&mut self, news: News, hub: &mut Hub) {
        match news {
            News::Opened { fleet, taps } => match taps {
                Some(taps) => drop(self.sessions.insert(fleet, Session::Open(taps))),
                // The next look tries it again.
                None => drop(self.sessions.remove(&fleet)),
            },
            News::Located { host, mission, programs } => {
                for (path, dial) in programs {
                    self.describe(&host, ProgramName { mission: mission.clone(), path }, dial);
                }
            }
            News::Described { program, session, forms } => {
                let known = self.programs.get_mut(&program).filter(|known| known.session == session);
                if let (Some(known), Some(forms)) = (known, forms) {
                    known.is_described = true;
                    hub.described(&program, &forms.outputs, forms.exports);
                }
            }
            News::Value(Queued { source, value: Arrived { content, at }, lost }) => match (content, source) {
                // The numbers of the values show how many values were left out.
                (Content::Value(tapped), source) => hub.value(&source, tapped, at),
                (Content::Signals(samples), Source::Signals(program)) => hub.signals(&program, samples, lost, at),
                (
                    Content::Signals(_),
                    Source::Events | Source::Log | Source::State(_) | Source::Output { .. } | Source::Recorded(_),
                ) => {}
            },
            News::Wrote { program, text } => hub.wrote(&program, text, clock::unix_time()),
            News::Parameters(values) => hub.parameters(values),
        }
    }

    /// Looks for programs, and receives the requests of clients. Without a client, the view sends no requests, and receives nothing.
    pub(super) fn follow(&mut self, live: &Live, model: &Model, hub: &mut Hub) {
        while let Some(ended) = self.tasks.try_join_next() {
            if let Err(error) = ended
                && error.is_panic()
            {
                std::panic::resume_unwind(error.into_panic());
            }
        }
        if hub.is_empty() {
            self.hearing.clear();
            return;
        }
        let now = clock::now();
        self.open(live, model);
        self.locate(live, model, hub, now);
        let is_there = |name: &ProgramName| {
            let mut lives = model.deployments().filter(|live| live.id == name.mission && live.end.is_none());
            lives.any(|live| live.processes.contains_key(&name.path))
        };
        self.programs.retain(|name, _| is_there(name));
        self.hear(live, model, hub);
        let is_due = self.parameters_read.is_none_or(|read| now.since(read) >= PARAMETERS_EVERY);
        if hub.follows_parameters() && is_due {
            self.parameters_read = Some(now);
            self.tasks.spawn(read_parameters(live.clients(), self.sink.clone()));
        }
    }

    /// Opens a session to the programs of each command, and of the nodes that stay. Sessions to ended commands are closed.
    fn open(&mut self, live: &Live, model: &Model) {
        let running = model.deployments().filter(|one| one.end.is_none());
        let present: BTreeSet<Fleet> = running.map(|one| one.id.fleet).chain([Fleet::Standing]).collect();
        let is_over = |fleet: &Fleet, session: &mut Session| {
            !present.contains(fleet) && matches!(session, Session::Open(taps) if Arc::strong_count(taps) == 1)
        };
        let over: Vec<Session> = self.sessions.extract_if(.., is_over).map(|(_, session)| session).collect();
        over.into_iter().for_each(|session| drop(self.tasks.spawn(close(session))));
        for fleet in present {
            if self.sessions.contains_key(&fleet) {
                continue;
            }
            self.sessions.insert(fleet, Session::Opening);
            let team = live.clients().iter().filter(|client| client.fleet() == fleet).find_map(Client::team);
            let sink = self.sink.clone();
            self.tasks.spawn(async move {
                let opened = Taps::open(team).await.inspect_err(|failure| {
                    tracing::warn!(why = %crate::client::words(failure), "cannot receive values");
                });
                let taps = opened.ok().map(Arc::new);
                sink.send(News::Opened { fleet, taps }).await.unwrap_or_default();
            });
        }
    }

    /// Asks where the programs are. The answers of programs of a mission that the hub does not have yet would be lost.
    fn locate(&mut self, live: &Live, model: &Model, hub: &Hub, now: Time) {
        let heard = |fleet| matches!(self.sessions.get(&fleet), Some(Session::Open(_)));
        let running = model.deployments().filter(|one| one.end.is_none() && hub.has_mission(&one.id));
        for one in running.filter(|one| heard(one.id.fleet)) {
            for host in one.phases.keys() {
                let place = (host.clone(), one.id.clone());
                if self.located.get(&place).is_some_and(|asked| now.since(*asked) < LOCATE_EVERY) {
                    continue;
                }
                let Some(client) = live.client_of(&one.id.robot(host)) else { continue };
                self.located.insert(place, now);
                let (host, mission, sink) = (host.clone(), one.id.clone(), self.sink.clone());
                self.tasks.spawn(async move {
                    // A host that does not answer is asked again.
                    if let Ok(programs) = locations(&client, &host, &mission.deployment).await {
                        sink.send(News::Located { host, mission, programs }).await.unwrap_or_default();
                    }
                });
            }
        }
        self.located.retain(|_, asked| now.since(*asked) < LOCATE_EVERY);
    }

    /// Asks a program for its outputs and exports, unless it has already reported them.
    fn describe(&mut self, host: &str, name: ProgramName, dial: Dial) {
        let now = clock::now();
        let Some(taps) = self.taps(name.mission.fleet) else { return };
        if let Some(known) = self.programs.get(&name) {
            let is_known = known.is_described || now.since(known.asked) < DESCRIBE_AGAIN;
            if known.session == dial.session && is_known && known.host == host {
                return;
            }
            if known.session != dial.session {
                taps.forget(&known.session);
            }
        }
        let session = dial.session.clone();
        let program = Program { host: host.to_owned(), session: session.clone(), is_described: false, asked: now };
        self.programs.insert(name.clone(), program);
        let (describing, sink) = (Arc::clone(&self.describing), self.sink.clone());
        self.tasks.spawn(async move {
            let Ok(_permit) = describing.acquire().await else { return };
            let forms = forms(&taps, &name, dial).await.map(Box::new);
            sink.send(News::Described { program: name, session, forms }).await.unwrap_or_default();
        });
    }

    /// Begins the wanted subscriptions, and ends the subscriptions that are no longer wanted.
    fn hear(&mut self, live: &Live, model: &Model, hub: &mut Hub) {
        let wanted = hub.wanted();
        let mut lines: BTreeSet<Line> = BTreeSet::new();
        for source in wanted {
            match source {
                Source::Output { .. } | Source::Signals(_) => drop(lines.insert(Line::Source(source))),
                Source::Log => {
                    for one in model.deployments().filter(|one| one.end.is_none()) {
                        let line = |host: &String| Line::Log { host: host.clone(), mission: one.id.clone() };
                        lines.extend(one.phases.keys().map(line));
                    }
                }
                // The view receives these anyway.
                Source::Events | Source::State(_) | Source::Recorded(_) => {}
            }
        }
        let described = self.programs.iter().filter(|(_, program)| program.is_described);
        let unknown = described.map(|(name, _)| name).filter(|name| hub.lacks_signals(name));
        lines.extend(unknown.map(|name| Line::Source(Source::Signals(name.clone()))));
        // If a subscription to a line failed, it is tried again.
        self.hearing.retain(|line, hearing| lines.contains(line) && !hearing.task.is_finished());
        let is_log = |line: &Line| matches!(line, Line::Log { .. });
        if !self.hearing.keys().any(is_log) && lines.iter().any(is_log) {
            hub.log_begins();
        }
        for line in lines {
            if self.hearing.contains_key(&line) {
                continue;
            }
            if let Line::Source(source) = &line {
                hub.hears(source);
            }
            self.begin(line, live);
        }
    }

    fn begin(&mut self, line: Line, live: &Live) {
        let (end, ended) = oneshot::channel();
        let (sink, values) = (self.sink.clone(), Arc::clone(&self.values));
        let task = match &line {
            Line::Log { host, mission } => {
                let robot = mission.robot(host);
                let Some(client) = live.client_of(&robot) else { return };
                self.tasks.spawn(hear_log(client, robot, mission.clone(), sink, ended))
            }
            Line::Source(source) => {
                let fleet = source.program().map(|program| program.mission.fleet);
                let Some(taps) = fleet.and_then(|fleet| self.taps(fleet)) else { return };
                self.tasks.spawn(hear_source(taps, source.clone(), values, ended))
            }
        };
        self.hearing.insert(line, Hearing { task, _end: end });
    }

    /// Ends everything.
    pub(super) async fn close(mut self) {
        self.hearing.clear();
        self.news.close();
        let ended = async { while self.tasks.join_next().await.is_some() {} };
        timeout(CLOSED_WITHIN, ended).await.unwrap_or_default();
        self.tasks.shutdown().await;
        while self.news.try_recv().is_ok() {}
        for session in self.sessions.into_values() {
            close(session).await;
        }
    }
}

async fn close(session: Session) {
    if let Session::Open(taps) = session
        && let Some(taps) = Arc::into_inner(taps)
    {
        taps.close().await;
    }
}

async fn forms(taps: &Taps, name: &ProgramName, dial: Dial) -> Option<Forms> {
    let ProgramName { mission, path } = name;
    let deployment = &mission.deployment;
    let outputs = outputs_of(taps, deployment, path, dial.clone()).await;
    let exports = exports_of(taps, deployment, path, dial).await;
    match (outputs, exports) {
        (Ok(outputs), Ok(exports)) => Some(Forms { outputs, exports }),
        (Err(failure), _) | (_, Err(failure)) => {
            tracing::debug!(path, why = %crate::client::words(&failure), "cannot get the outputs of a program");
            None
        }
    }
}

/// Hears the values of an output or the signals of a program.
async fn hear_source(taps: Arc<Taps>, source: Source, values: Values, ended: oneshot::Receiver<()>) {
    match source {
        Source::Output { ref program, ref output } => {
            let key = key::tap(&program.mission.deployment.name, &program.path, output);
            let take = move |bytes: Cow<'_, [u8]>| {
                if let Ok(tapped) = codec::decode(&bytes) {
                    values.push(&source, bytes.len(), Arrived { content: Content::Value(tapped), at: arrival() });
                }
            };
            hold(&taps, key, take, ended).await;
        }
        Source::Signals(ref program) => {
            let key = key::signals(&program.mission.deployment.name, &program.path);
            let path = program.path.clone();
            let take = move |bytes: Cow<'_, [u8]>| {
                let samples = samples(&path, &bytes, clock::now()).into_iter().map(|sample| sample.signals);
                let content = Content::Signals(samples.collect());
                values.push(&source, bytes.len(), Arrived { content, at: arrival() });
            };
            hold(&taps, key, take, ended).await;
        }
        Source::Events | Source::Log | Source::State(_) | Source::Recorded(_) => {}
    }
}

/// Returns the present moment.
pub(super) fn arrival() -> Arrival {
    Arrival { time: clock::now(), since_1970: clock::unix_time() }
}

/// Hears a key until the other end of `ended` is dropped.
async fn hold(
    taps: &Taps,
    key: String,
    take: impl FnMut(Cow<'_, [u8]>) + Send + Sync + 'static,
    ended: oneshot::Receiver<()>,
) {
    match taps.listen(key, take).await {
        Ok(subscription) => {
            // The other end sends nothing.
            ended.await.unwrap_or_default();
            tokio::task::spawn_blocking(move || drop(subscription)).await.unwrap_or_default();
        }
        Err(failure) => {
            tracing::debug!(why = %crate::client::words(&failure), "cannot receive the values of an output");
        }
    }
}

/// Hears the lines that the programs of a deployment on a host write.
async fn hear_log(
    client: Arc<Client>,
    robot: RobotId,
    mission: MissionId,
    sink: Sender<News>,
    mut ended: oneshot::Receiver<()>,
) {
    let mut written = Written::default();
    written.hear(&client, &robot.host, &mission.deployment);
    loop {
        tokio::select! {
            (path, text) = written.next() => {
                let program = ProgramName { mission: mission.clone(), path };
                if sink.send(News::Wrote { program, text }).await.is_err() {
                    return;
                }
            }
            _ = &mut ended => return,
        }
    }
}

async fn read_parameters(clients: Clients, sink: Sender<News>) {
    let read = super::orders::parameters(&clients).await;
    sink.send(News::Parameters(read.values)).await.unwrap_or_default();
}
