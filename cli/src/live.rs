//! Feeds a live model: asks every node for its status, and listens to the events of all nodes.
//!
//! Each node has a separate task, so a silent node does not delay other nodes. A node is asked once a second, and soon
//! after an event. Without an open view, no node is asked.

mod measure;

use crate::client::feed::{Feed, FeedItem, Mode};
use crate::client::{ANSWER_WITHIN, Client, Clients, words};
use crate::logic::top::{Program, ProgramOutput};
use crate::{ConnectArgs, client};
use comms::io::clock;
use comms::logic::time::Time;
use measure::Measurement;
use node::console::Failure;
use node::logic::database::question::{Question, Reply};
use node::logic::protocol::{Answer, Event, NodeStatus, Report, Request};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::sync::watch;
use tokio::task::{AbortHandle, JoinSet};
use view::{Fleet, Input, MissionId, Model, RobotId};

/// How often each node is asked.
const ASK_EVERY: Duration = Duration::from_secs(1);
/// The shortest pause between two questions to a node after an event: many events often happen at once.
const AGAIN_AFTER: Duration = Duration::from_millis(100);
/// How often each database is asked.
const DATABASE_EVERY: Duration = Duration::from_secs(10);
/// The shortest pause between two questions for the same plan.
const PLAN_AGAIN: Duration = Duration::from_secs(3);
/// How long the node of this machine may be silent. After this time, another node of this machine is used.
const SILENT_MAX: Duration = Duration::from_secs(5);
/// The most inputs that wait to be shown. When there are as many, senders wait.
const INPUTS_MAX: usize = 256;

/// A node, by the number of its connection and its name.
type Place = (usize, String);

/// A message from a task.
enum Heard {
    Input(Input),
    /// The status of a node.
    Status(Place, Box<NodeStatus>),
    /// New connections, if there are nodes.
    Opened(Option<Box<Feed>>),
}

/// A node that is asked.
struct Watched {
    task: AbortHandle,
    /// Changes when something has happened on the node.
    nudge: watch::Sender<u64>,
    missing: BTreeSet<String>,
}

/// A connection to nodes.
struct Connection {
    client: Arc<Client>,
    /// When the connection's node on this machine last answered, or when the connection was opened.
    answered: Time,
}

/// The source of inputs.
pub(crate) struct Live {
    connect: ConnectArgs,
    feed: Feed,
    connections: Vec<Connection>,
    watched: BTreeMap<Place, Watched>,
    is_opening: bool,
    /// When the plan of each deployment was last asked for.
    plans: BTreeMap<MissionId, Time>,
    /// The process whose output is received, and the task that receives it.
    output: Option<(Program, AbortHandle)>,
    measurement: Option<Measurement>,
    tasks: JoinSet<()>,
    sink: Sender<Heard>,
    heard: Receiver<Heard>,
}

impl Live {
    /// Connects to every node that can be reached.
    pub(crate) async fn open(connect: &ConnectArgs) -> Result<Self, Failure> {
        let feed = Feed::open(connect, Mode::Live).await?;
        let (sink, heard) = mpsc::channel(INPUTS_MAX);
        let mut live = Self {
            connect: connect.clone(),
            feed,
            connections: Vec::new(),
            watched: BTreeMap::new(),
            is_opening: false,
            plans: BTreeMap::new(),
            output: None,
            measurement: None,
            tasks: JoinSet::new(),
            sink,
            heard,
        };
        live.take_clients();
        Ok(live)
    }

    /// Returns the next input.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn next(&mut self) -> Input {
        loop {
            tokio::select! {
                item = self.feed.next() => {
                    if let Some(input) = self.item(item) {
                        return input;
                    }
                }
                heard = self.heard.recv() => match heard {
                    Some(Heard::Input(input)) => return input,
                    Some(Heard::Status(place, status)) => {
                        self.missing(&place, &status);
                        return Input::Status { fleet: self.fleet(place.0), status };
                    }
                    Some(Heard::Opened(feed)) => {
                        self.is_opening = false;
                        if let Some(feed) = feed {
                            return self.go_on_with(*feed);
                        }
                    }
                    // This cannot happen: the source itself holds a sender.
                    None => std::future::pending().await,
                },
            }
        }
    }

    /// Asks for plans that the model lacks. Receives the output and measures the rate that a person looks at.
    pub(crate) fn follow(&mut self, model: &Model, heard: Option<&Program>, measured: Option<ProgramOutput>) {
        self.take_clients();
        let now = clock::now();
        self.open_again(now);
        for lacking in model.without_plan() {
            if self.plans.get(&lacking.id).is_some_and(|last| now.since(*last) < PLAN_AGAIN) {
                continue;
            }
            self.plans.insert(lacking.id.clone(), now);
            if let Some(client) = self.client_of(&lacking.id.robot(&lacking.id.home)) {
                self.tasks.spawn(ask_plan(client, lacking.id.clone(), self.sink.clone()));
            }
        }
        self.plans.retain(|_, last| now.since(*last) < PLAN_AGAIN);
        self.hear(heard);
        self.measure(measured);
        while let Some(ended) = self.tasks.try_join_next() {
            if let Err(error) = ended
                && error.is_panic()
            {
                std::panic::resume_unwind(error.into_panic());
            }
        }
    }

    /// Returns the connections, for orders.
    pub(crate) fn clients(&self) -> Clients {
        self.feed.clients()
    }

    /// Returns each connection that goes through a node of this machine, together with this node.
    pub(crate) fn locals(&self) -> Vec<(Arc<Client>, String)> {
        let local = |client: &Arc<Client>| Some((Arc::clone(client), client.local()?.to_owned()));
        self.connections.iter().map(|connection| &connection.client).filter_map(local).collect()
    }

    /// Returns the connection to a robot.
    pub(crate) fn client_of(&self, robot: &RobotId) -> Option<Arc<Client>> {
        let is_meant = |(number, host): &&Place| *host == robot.host && self.fleet(*number) == robot.fleet;
        let (number, _) = self.watched.keys().find(is_meant)?;
        self.client(*number).cloned()
    }

    /// Returns which fleet of nodes a connection reaches.
    fn fleet(&self, number: usize) -> Fleet {
        self.client(number).map_or(Fleet::Standing, |client| client.fleet())
    }

    fn client(&self, number: usize) -> Option<&Arc<Client>> {
        self.connections.get(number).map(|connection| &connection.client)
    }

    /// Returns the options for finding nodes, for orders when no node answers over the present connections.
    pub(crate) fn connect(&self) -> ConnectArgs {
        self.connect.clone()
    }

    /// Closes everything.
    pub(crate) async fn close(mut self) {
        if let Some(measurement) = self.measurement.take() {
            measurement.end();
        }
        self.watched.values().for_each(|watched| watched.task.abort());
        self.tasks.shutdown().await;
        self.connections.clear();
        self.feed.close().await;
    }

    /// Adds the connections that the feed has opened since.
    fn take_clients(&mut self) {
        let all = self.feed.clients().shared();
        let new = all.into_iter().skip(self.connections.len());
        self.connections.extend(new.map(|client| Connection { client, answered: clock::now() }));
    }

    fn item(&mut self, item: FeedItem) -> Option<Input> {
        let note = |robot: RobotId, text: String| Some(Input::Note { robot, text });
        match item {
            FeedItem::Event(home, event) => {
                self.nudge(home.fleet, &event);
                Some(Input::Event { home, event })
            }
            FeedItem::Current => None,
            FeedItem::Left(robot) => note(robot, "the node has left".to_owned()),
            FeedItem::Lost(robot, why) => note(robot, format!("no more events arrive: {why}")),
            FeedItem::Back(robot) => note(robot, "events arrive again".to_owned()),
            FeedItem::Reached(number, hosts) => Some(self.reached(number, &hosts)),
        }
    }

    /// Makes the tasks of the nodes that an event is about ask soon.
    fn nudge(&self, fleet: Fleet, event: &Event) {
        let is_of_one = matches!(event.report, Report::Process { .. });
        for ((number, host), watched) in &self.watched {
            if self.fleet(*number) == fleet && (!is_of_one || *host == event.host) {
                watched.nudge.send_modify(|count| *count += 1);
            }
        }
    }

    /// If the node of this machine behind a connection is silent, connects through another one.
    fn open_again(&mut self, now: Time) {
        let is_silent = |connection: &Connection| {
            let client = &connection.client;
            client.local().is_some() && now.since(connection.answered) >= SILENT_MAX && client.has_another()
        };
        let silent: BTreeSet<String> = self
            .connections
            .iter()
            .filter(|one| is_silent(one))
            .filter_map(|one| one.client.local())
            .map(str::to_owned)
            .collect();
        if self.is_opening || silent.is_empty() {
            return;
        }
        self.is_opening = true;
        let (heard, sink) = (self.feed.heard(), self.sink.clone());
        let connect = ConnectArgs { silent, ..self.connect.clone() };
        self.tasks.spawn(async move {
            let feed = Feed::resume(&connect, Mode::Live, heard).await.ok().map(Box::new);
            sink.send(Heard::Opened(feed)).await.unwrap_or_default();
        });
    }

    /// Replaces the present connections by the connections of a new feed.
    fn go_on_with(&mut self, feed: Feed) -> Input {
        self.tasks.abort_all();
        // The old queue may contain inputs about connections that are closed now.
        (self.sink, self.heard) = mpsc::channel(INPUTS_MAX);
        (self.output, self.measurement) = (None, None);
        self.watched.clear();
        self.plans.clear();
        for new in feed.clients().iter() {
            self.connections.iter().for_each(|old| new.take_keys(&old.client));
        }
        self.connections.clear();
        let old = std::mem::replace(&mut self.feed, feed);
        self.tasks.spawn(old.close());
        self.take_clients();
        let local = self.locals().into_iter().next();
        let robot = local.map(|(client, host)| RobotId { host, fleet: client.fleet() });
        let robot = robot.unwrap_or(RobotId { host: String::new(), fleet: Fleet::Standing });
        Input::Note { text: format!("all data now comes through `{robot}`"), robot }
    }

    fn missing(&mut self, place: &Place, status: &NodeStatus) {
        let (number, host) = place;
        if let Some(connection) = self.connections.get_mut(*number).filter(|one| one.client.local() == Some(host)) {
            connection.answered = clock::now();
        }
        if let Some(watched) = self.watched.get_mut(place) {
            watched.missing = status.missing.iter().cloned().collect();
        }
    }

    /// Begins to ask the nodes that a connection reaches, and stops asking the nodes that have left.
    fn reached(&mut self, number: usize, hosts: &BTreeSet<String>) -> Input {
        self.take_clients();
        for host in hosts {
            let place = (number, host.clone());
            if let Some(client) = self.client(number).filter(|_| !self.watched.contains_key(&place)) {
                let (nudge, nudged) = watch::channel(0);
                let is_local = client.local() == Some(host) || client.local().is_none();
                let asker =
                    Asker { client: Arc::clone(client), place: place.clone(), is_local, sink: self.sink.clone() };
                let task = self.tasks.spawn(asker.ask(nudged));
                self.watched.insert(place, Watched { task, nudge, missing: BTreeSet::new() });
            }
        }
        let of_connection = self.watched.iter().filter(|((of, host), _)| *of == number && hosts.contains(host));
        let missing = of_connection.flat_map(|(_, watched)| &watched.missing);
        let known: BTreeSet<String> = hosts.iter().chain(missing).cloned().collect();
        self.watched.retain(|(of, host), watched| {
            let stays = *of != number || known.contains(host);
            if !stays {
                watched.task.abort();
            }
            stays
        });
        Input::Known { fleet: self.fleet(number), hosts: known }
    }

    /// Receives the output of this process, and stops receiving the output of another process.
    fn hear(&mut self, program: Option<&Program>) {
        if self.output.as_ref().map(|(heard, _)| heard) == program {
            return;
        }
        if let Some((_, task)) = self.output.take() {
            task.abort();
        }
        if let Some(program) = program
            && let Some(client) = self.client_of(&program.mission.robot(&program.host))
        {
            let task = self.tasks.spawn(hear(client, program.clone(), self.sink.clone()));
            self.output = Some((program.clone(), task));
        }
    }

    /// Measures this output, and no longer another one. If the measurement has ended by itself, begins again.
    fn measure(&mut self, output: Option<ProgramOutput>) {
        let is_same = self.measurement.as_ref().map(Measurement::output) == output.as_ref();
        if is_same && !self.measurement.as_ref().is_some_and(Measurement::is_over) {
            return;
        }
        if let Some(measurement) = self.measurement.take() {
            measurement.end();
        }
        if let Some(output) = output
            && let Some(client) = self.client_of(&output.program.mission.robot(&output.program.host))
        {
            let sink = self.sink.clone();
            self.measurement = Some(Measurement::begin(client, output, sink, &mut self.tasks, is_same));
        }
    }
}

/// Asks one node repeatedly.
struct Asker {
    client: Arc<Client>,
    place: Place,
    /// Whether the node is asked about the hosts that it misses. Only the node of this machine is asked this.
    is_local: bool,
    sink: Sender<Heard>,
}

impl Asker {
    /// Asks for the status and for the database at the same time, so that a slow database does not delay the status.
    async fn ask(self, nudged: watch::Receiver<u64>) {
        tokio::select! {
            () = self.statuses(nudged) => {}
            () = self.databases() => {}
        }
    }

    async fn statuses(&self, mut nudged: watch::Receiver<u64>) {
        loop {
            let asked = clock::now();
            nudged.mark_unchanged();
            if self.status().await.is_none() {
                return;
            }
            tokio::select! {
                () = clock::sleep_until(asked + ASK_EVERY) => {}
                Ok(()) = nudged.changed() => clock::sleep_until(asked + AGAIN_AFTER).await,
            }
        }
    }

    async fn databases(&self) {
        let (_, host) = &self.place;
        loop {
            let asked = clock::now();
            let answer = self.client.ask(host, &Request::Database(Question::Status), ANSWER_WITHIN).await;
            if let Ok(Answer::Database(Reply::Status(status))) = answer
                && self.tell(Heard::Input(Input::Database { fleet: self.client.fleet(), status })).await.is_none()
            {
                return;
            }
            clock::sleep_until(asked + DATABASE_EVERY).await;
        }
    }

    /// Asks for the status once. Returns nothing if the view has ended.
    async fn status(&self) -> Option<()> {
        let (_, host) = &self.place;
        let status = match self.client.ask(host, &Request::Status, ANSWER_WITHIN).await {
            Ok(Answer::Status(status)) => status,
            Ok(other) => return self.silent(&client::unasked(host, &other)).await,
            Err(failure) => return self.silent(&failure).await,
        };
        let is_asked = self.is_local && !status.missing.is_empty();
        self.tell(Heard::Status(self.place.clone(), Box::new(status))).await?;
        if is_asked && let Ok(Answer::Absent(absent)) = self.client.ask(host, &Request::Absent, ANSWER_WITHIN).await {
            let (teller, absent) = (self.robot(), Box::new(absent));
            self.tell(Heard::Input(Input::Absent { teller, absent })).await?;
        }
        Some(())
    }

    async fn silent(&self, failure: &Failure) -> Option<()> {
        self.tell(Heard::Input(Input::Silent { robot: self.robot(), why: words(failure) })).await
    }

    fn robot(&self) -> RobotId {
        RobotId { host: self.place.1.clone(), fleet: self.client.fleet() }
    }

    /// Sends something to the view. Returns nothing if the view has ended.
    async fn tell(&self, heard: Heard) -> Option<()> {
        self.sink.send(heard).await.ok()
    }
}

async fn ask_plan(client: Arc<Client>, mission: MissionId, sink: Sender<Heard>) {
    let request = Request::Plan { deployment: mission.deployment.clone() };
    if let Ok(Answer::Plan(plan)) = client.ask(&mission.home, &request, ANSWER_WITHIN).await {
        sink.send(Heard::Input(Input::Plan { mission, plan })).await.unwrap_or_default();
    }
}

/// Receives the output of a process: first the earlier lines, then new ones.
async fn hear(client: Arc<Client>, program: Program, sink: Sender<Heard>) {
    let Program { mission, host, path } = program;
    let name = mission.deployment.name.clone();
    let request = Request::Logs { deployment: Some(name), process: path.clone(), follow: true };
    let Ok(mut answers) = client.ask_on(&host, &request) else { return };
    // The node sends the earlier lines again, even if the view has them already.
    let begins = Input::OutputBegins { mission: mission.clone(), path: path.clone() };
    if sink.send(Heard::Input(begins)).await.is_err() {
        return;
    }
    while let Some(Ok(Answer::Output(bytes))) = answers.next().await {
        let input = Input::Output { mission: mission.clone(), path: path.clone(), bytes };
        if sink.send(Heard::Input(input)).await.is_err() {
            return;
        }
    }
}
