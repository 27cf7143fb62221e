//! Feeds a live model: asks every node how it is, and listens to their events.
//!
//! Each node has a task of its own, so a node that does not answer keeps no other from being shown. A node is asked
//! once a second, and soon after an event. A node without a viewer is not asked.

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
use node::logic::protocol::{Answer, Deployment, Event, NodeStatus, Report, Request};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::sync::watch;
use tokio::task::{AbortHandle, JoinSet};
use view::{Input, Model};

/// How often each node is asked.
const ASK_EVERY: Duration = Duration::from_secs(1);
/// How long after one question the next may come when something has happened: much often happens at once.
const AGAIN_AFTER: Duration = Duration::from_millis(100);
/// How often each database is asked.
const DATABASE_EVERY: Duration = Duration::from_secs(10);
/// How long after one question for a plan the next may come.
const PLAN_AGAIN: Duration = Duration::from_secs(3);
/// How long the node of this machine may be silent until another one on this machine is used.
const SILENT_MAX: Duration = Duration::from_secs(5);
/// How many inputs wait to be shown; further senders wait.
const INPUTS_MAX: usize = 256;

/// A node, by its connection and its name.
type Place = (usize, String);

/// A message of a task.
enum Heard {
    Input(Input),
    /// The status of a node.
    Status(Place, Box<NodeStatus>),
    /// The nodes that a connection reaches.
    Found(usize, BTreeSet<String>),
    /// New connections, if there are nodes.
    Opened(Option<Box<Feed>>),
}

/// A node that is asked.
struct Watched {
    task: AbortHandle,
    /// Changes when something has happened there.
    nudge: watch::Sender<u64>,
    missing: BTreeSet<String>,
}

/// A connection to nodes.
struct Connection {
    client: Arc<Client>,
    /// The nodes that it reaches.
    reached: BTreeSet<String>,
    /// When the node of this machine behind it has answered last, or when it was opened.
    answered: Time,
}

/// The source of inputs.
pub(crate) struct Live {
    connect: ConnectArgs,
    feed: Feed,
    connections: Vec<Connection>,
    watched: BTreeMap<Place, Watched>,
    is_opening: bool,
    /// When the plan of a deployment was asked for last.
    plans: BTreeMap<Deployment, Time>,
    /// The process whose output is heard, and the task.
    output: Option<(Program, AbortHandle)>,
    measurement: Option<Measurement>,
    tasks: JoinSet<()>,
    sink: Sender<Heard>,
    heard: Receiver<Heard>,
}

impl Live {
    /// Connects to every node that can be reached.
    pub(crate) async fn open(connect: &ConnectArgs) -> Result<Self, Failure> {
        let feed = Feed::open(connect, Mode::Follow).await?;
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
                        return Input::Status(status);
                    }
                    Some(Heard::Found(number, hosts)) => return self.found(number, hosts),
                    Some(Heard::Opened(feed)) => {
                        self.is_opening = false;
                        if let Some(feed) = feed {
                            return self.go_on_with(*feed);
                        }
                    }
                    // The source itself holds a sender.
                    None => std::future::pending().await,
                },
            }
        }
    }

    /// Asks for plans that the model lacks, and hears the output and the rate that a person looks at.
    pub(crate) fn follow(&mut self, model: &Model, heard: Option<&Program>, measured: Option<ProgramOutput>) {
        self.take_clients();
        let now = clock::now();
        self.open_again(now);
        for lacking in model.without_plan() {
            if self.plans.get(&lacking.id).is_some_and(|last| now.since(*last) < PLAN_AGAIN) {
                continue;
            }
            self.plans.insert(lacking.id.clone(), now);
            if let Some(client) = self.client_of(&lacking.home) {
                self.tasks.spawn(ask_plan(client, lacking.home.clone(), lacking.id.clone(), self.sink.clone()));
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

    /// Returns each connection through a node of this machine, and that node.
    pub(crate) fn locals(&self) -> Vec<(Arc<Client>, String)> {
        let local = |client: &Arc<Client>| Some((Arc::clone(client), client.local()?.to_owned()));
        self.connections.iter().map(|connection| &connection.client).filter_map(local).collect()
    }

    /// Returns the connection to a host.
    pub(crate) fn client_of(&self, host: &str) -> Option<Arc<Client>> {
        let (number, _) = self.watched.keys().find(|(_, name)| name == host)?;
        self.client(*number).cloned()
    }

    fn client(&self, number: usize) -> Option<&Arc<Client>> {
        self.connections.get(number).map(|connection| &connection.client)
    }

    /// Returns where its nodes are, for orders when none of them answers.
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

    /// Begins to look for nodes over connections that are new.
    fn take_clients(&mut self) {
        let all = self.feed.clients().shared();
        for client in all.into_iter().skip(self.connections.len()) {
            let (number, sink) = (self.connections.len(), self.sink.clone());
            self.tasks.spawn(find(number, Arc::clone(&client), sink));
            self.connections.push(Connection { client, reached: BTreeSet::new(), answered: clock::now() });
        }
    }

    fn item(&mut self, item: FeedItem) -> Option<Input> {
        let note = |host: String, text: String| Some(Input::Note { host, text });
        match item {
            FeedItem::Event(event) => {
                self.nudge(&event);
                Some(Input::Event(event))
            }
            FeedItem::Current => None,
            FeedItem::Left(host) => note(host, "the node has left".to_owned()),
            FeedItem::Lost(host, why) => note(host, format!("events are not heard any more: {why}")),
            FeedItem::Back(host) => note(host, "events are heard again".to_owned()),
        }
    }

    /// Has the nodes that an event is about asked soon.
    fn nudge(&self, event: &Event) {
        let is_of_one = matches!(event.report, Report::Process { .. });
        for ((_, host), watched) in &self.watched {
            if !is_of_one || *host == event.host {
                watched.nudge.send_modify(|count| *count += 1);
            }
        }
    }

    /// Connects through another node of this machine once the one behind a connection is silent.
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
            let feed = Feed::resume(&connect, Mode::Follow, heard).await.ok().map(Box::new);
            sink.send(Heard::Opened(feed)).await.unwrap_or_default();
        });
    }

    /// Asks and listens over new connections instead of the present ones.
    fn go_on_with(&mut self, feed: Feed) -> Input {
        self.tasks.abort_all();
        // The old tasks have sent inputs about connections that are closed.
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
        let host = self.locals().into_iter().map(|(_, host)| host).next().unwrap_or_default();
        Input::Note { text: format!("everything is heard through `{host}` now"), host }
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

    /// Asks the nodes that a connection reaches, and asks those no more that have left.
    fn found(&mut self, number: usize, hosts: BTreeSet<String>) -> Input {
        for host in &hosts {
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
        if let Some(connection) = self.connections.get_mut(number) {
            connection.reached = hosts;
        }
        let missing = self.watched.values().flat_map(|watched| &watched.missing);
        let reached = self.connections.iter().flat_map(|connection| &connection.reached);
        let known: BTreeSet<String> = reached.chain(missing).cloned().collect();
        self.watched.retain(|(_, host), watched| {
            let is_known = known.contains(host);
            if !is_known {
                watched.task.abort();
            }
            is_known
        });
        Input::Known(known)
    }

    /// Hears the output of a process instead of that of another.
    fn hear(&mut self, program: Option<&Program>) {
        if self.output.as_ref().map(|(heard, _)| heard) == program {
            return;
        }
        if let Some((_, task)) = self.output.take() {
            task.abort();
        }
        if let Some(program) = program
            && let Some(client) = self.client_of(&program.host)
        {
            let task = self.tasks.spawn(hear(client, program.clone(), self.sink.clone()));
            self.output = Some((program.clone(), task));
        }
    }

    /// Measures an output instead of another, or again if its measurement has ended by itself.
    fn measure(&mut self, output: Option<ProgramOutput>) {
        let is_same = self.measurement.as_ref().map(Measurement::output) == output.as_ref();
        if is_same && !self.measurement.as_ref().is_some_and(Measurement::is_over) {
            return;
        }
        if let Some(measurement) = self.measurement.take() {
            measurement.end();
        }
        if let Some(output) = output
            && let Some(client) = self.client_of(&output.program.host)
        {
            let sink = self.sink.clone();
            self.measurement = Some(Measurement::begin(client, output, sink, &mut self.tasks, is_same));
        }
    }
}

/// Looks for the nodes that a connection reaches. That a node of this machine does not answer does not mean that others have left.
async fn find(number: usize, client: Arc<Client>, sink: Sender<Heard>) {
    loop {
        let looked = clock::now();
        if let Some(Ok(hosts)) = client.listed().await
            && sink.send(Heard::Found(number, hosts)).await.is_err()
        {
            return;
        }
        clock::sleep_until(looked + ASK_EVERY).await;
    }
}

/// Asks one node, again and again.
struct Asker {
    client: Arc<Client>,
    place: Place,
    /// Whether it is asked about the hosts that it misses: the node of this machine is.
    is_local: bool,
    sink: Sender<Heard>,
}

impl Asker {
    /// Each answer is told at once. A slow database delays no status.
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
                && self.tell(Heard::Input(Input::Database(status))).await.is_none()
            {
                return;
            }
            clock::sleep_until(asked + DATABASE_EVERY).await;
        }
    }

    /// Asks once; returns nothing if the view has ended.
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
            self.tell(Heard::Input(Input::Absent(Box::new(absent)))).await?;
        }
        Some(())
    }

    async fn silent(&self, failure: &Failure) -> Option<()> {
        let (_, host) = &self.place;
        self.tell(Heard::Input(Input::Silent { host: host.clone(), why: words(failure) })).await
    }

    /// Tells the view something; returns nothing if the view has ended.
    async fn tell(&self, heard: Heard) -> Option<()> {
        self.sink.send(heard).await.ok()
    }
}

async fn ask_plan(client: Arc<Client>, home: String, deployment: Deployment, sink: Sender<Heard>) {
    let request = Request::Plan { deployment: deployment.clone() };
    if let Ok(Answer::Plan(plan)) = client.ask(&home, &request, ANSWER_WITHIN).await {
        sink.send(Heard::Input(Input::Plan { deployment, plan })).await.unwrap_or_default();
    }
}

/// Hears the output of a process: first the earlier lines, then new ones.
async fn hear(client: Arc<Client>, program: Program, sink: Sender<Heard>) {
    let Program { deployment, host, path } = program;
    let request = Request::Logs { deployment: Some(deployment.name.clone()), process: path.clone(), follow: true };
    let Ok(mut answers) = client.ask_on(&host, &request) else { return };
    // The earlier lines come again if they were heard before.
    let begins = Input::OutputBegins { deployment: deployment.clone(), path: path.clone() };
    if sink.send(Heard::Input(begins)).await.is_err() {
        return;
    }
    while let Some(Ok(Answer::Output(bytes))) = answers.next().await {
        let input = Input::Output { deployment: deployment.clone(), path: path.clone(), bytes };
        if sink.send(Heard::Input(input)).await.is_err() {
            return;
        }
    }
}
