//! The events of all nodes that can be reached, as one stream; nodes that join later are included.
//!
//! A node sends its known events, then a mark that these were all, and then new events as they happen. If a stream
//! breaks off, the feed requests it again as soon as it finds the node. It skips events that it has already received:
//! each event has a number.

use super::signer::KeyPlace;
use super::{ANSWER_WITHIN, Answers, Client, Clients, unasked, words};
use crate::ConnectArgs;
use crate::absent::{self, ago};
use comms::io::clock;
use comms::logic::time::Time;
use node::console::Failure;
use node::io::run_dir;
use node::logic::protocol::{AbsentHost, Answer, Deployment, Event, Request};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::task::JoinSet;
use view::{Fleet, MissionId, RobotId};

/// How often the feed looks for nodes that it does not receive.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// The most messages that wait for the reader. When there are as many, senders wait.
const MESSAGES_MAX: usize = 64;

/// Whether a feed ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Mode {
    /// The feed ends with the events that are known.
    Snapshot,
    /// The feed continues as events happen, and as nodes come and go.
    Follow,
    /// Like `Follow`; the feed also says once a second which nodes each connection reaches.
    Live,
}

/// An item of a feed.
#[derive(Debug)]
pub(crate) enum FeedItem {
    /// An event, as the home of its deployment reports it.
    Event(RobotId, Box<Event>),
    /// All events that the nodes knew when the feed began have been sent, except the events of lost nodes.
    Current,
    /// A node has sent all of its events, and has ended.
    Left(RobotId),
    /// The connection to a node is lost, with the reason.
    Lost(RobotId, String),
    /// A node that was lost answers again.
    Back(RobotId),
    /// The nodes that a connection reaches, by its place in [`Feed::clients`].
    Reached(usize, BTreeSet<String>),
}

/// A node, by its connection and its name: the name alone is not enough, since nodes inside commands may share names.
type Place = (usize, String);

/// The state of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// The node was asked, and has not answered since.
    Asked {
        was_lost: bool,
    },
    Heard,
    Lost,
    Left,
}

/// A message from a task to the feed.
enum SourceMessage {
    Client(Arc<Client>),
    Found(usize, BTreeSet<String>),
    /// The nodes that a connection reaches. The list is complete, because the node of this machine gave it.
    Listed(usize, BTreeSet<String>),
    Events(Place, Vec<Event>),
    /// The node has sent its known events. The events of these hosts are missing among them.
    Behind(Place, Vec<String>),
    Ended(Place),
    Broken(Place, String),
    /// The wait for nodes that have not answered is over.
    Late,
}

/// The stream.
#[derive(Debug)]
pub(crate) struct Feed {
    mode: Mode,
    clients: Vec<Arc<Client>>,
    places: BTreeMap<Place, State>,
    /// The nodes whose earlier events have not all arrived. Nothing once all nodes have sent them.
    catching_up: Option<BTreeSet<Place>>,
    /// The number of the next event of each deployment.
    next: BTreeMap<(usize, MissionId), u64>,
    /// The next numbers that an earlier feed had, where this feed continues.
    before: BTreeMap<MissionId, u64>,
    ready: VecDeque<FeedItem>,
    messages: Receiver<SourceMessage>,
    sink: Sender<SourceMessage>,
    tasks: JoinSet<()>,
}

/// Returns every deployment of which some node has an event, including deployments that have ended.
pub(crate) async fn deployments(connect: &ConnectArgs) -> Result<BTreeSet<Deployment>, Failure> {
    let (mut feed, mut all) = (Feed::open(connect, Mode::Snapshot).await?, BTreeSet::new());
    loop {
        match feed.next().await {
            FeedItem::Event(_, event) => drop(all.insert(event.deployment)),
            FeedItem::Current => break,
            FeedItem::Left(_) | FeedItem::Lost(..) | FeedItem::Back(_) | FeedItem::Reached(..) => {}
        }
    }
    feed.close().await;
    Ok(all)
}

impl Feed {
    /// Begins to listen to every node that can be reached.
    pub(crate) async fn open(connect: &ConnectArgs, mode: Mode) -> Result<Self, Failure> {
        Self::resume(connect, mode, BTreeMap::new()).await
    }

    /// Begins like [`Feed::open`], and leaves out the events that an earlier feed has received.
    pub(crate) async fn resume(
        connect: &ConnectArgs,
        mode: Mode,
        before: BTreeMap<MissionId, u64>,
    ) -> Result<Self, Failure> {
        let Clients { clients, hanging } = Clients::open(connect).await?;
        let mut feed = Self { before, ..Self::new(mode) };
        // A command on this machine that cannot be asked may have events as well.
        let hanging = hanging.map(|failure| FeedItem::Lost(standing("this machine"), words(&failure)));
        feed.ready.extend(hanging.filter(|_| mode == Mode::Snapshot));
        let known: Vec<PathBuf> = clients.iter().filter_map(|client| client.base.clone()).collect();
        for client in clients {
            let hosts = client.all().await.unwrap_or_default();
            feed.add(client);
            feed.found(feed.clients.len() - 1, hosts);
        }
        if mode == Mode::Snapshot {
            feed.ask_everybody().await;
        }
        let late = feed.sink.clone();
        feed.tasks.spawn(async move {
            clock::sleep_until(clock::now() + ANSWER_WITHIN).await;
            late.send(SourceMessage::Late).await.unwrap_or_default();
        });
        if mode != Mode::Snapshot && !connect.is_group() {
            feed.tasks.spawn(look_for_commands(connect.base(), known, feed.sink.clone()));
        }
        feed.caught_up();
        Ok(feed)
    }

    /// Asks the nodes that have come since the first question, and reports all other known hosts as lost. Only the home
    /// of a deployment knows its events. So a client has all events only if every known host was asked.
    async fn ask_everybody(&mut self) {
        let clients = self.clients();
        let found = match clients.look().await {
            Ok(found) => found,
            Err(failure) => {
                let why = format!("no host could name the other hosts: {}", words(&failure));
                let here = self.clients.iter().filter_map(|client| client.local()).next().unwrap_or("this machine");
                self.ready.push_back(FeedItem::Lost(standing(here), why));
                return;
            }
        };
        for (client, statuses) in &found {
            let Some(number) = self.clients.iter().position(|other| std::ptr::eq(Arc::as_ptr(other), *client)) else {
                continue;
            };
            let there = statuses.nodes.iter().map(|node| &node.host).chain(&statuses.silent);
            self.found(number, there.cloned().collect());
        }
        let away = absent::ask(&found).await;
        let heard =
            |one: &AbsentHost| (one.host.clone(), format!("it does not answer, and was last heard {}", ago(one.heard)));
        let mut lost: BTreeMap<String, String> = away.hosts.iter().map(heard).collect();
        for host in &away.back {
            lost.entry(host.clone()).or_insert_with(|| "it has just come back, and was not asked yet".to_owned());
        }
        let parts = found.iter().flat_map(|(_, statuses)| &statuses.nodes).flat_map(|node| &node.deployments);
        for part in parts.filter(|part| !away.revoked.contains(&part.home)) {
            let why = || format!("it is the home of `{}`, and no node that answers reaches it", part.deployment);
            lost.entry(part.home.clone()).or_insert_with(why);
        }
        for (host, why) in lost {
            // A node that was asked has its own reports.
            if self.places.keys().all(|(_, asked)| *asked != host) {
                self.ready.push_back(FeedItem::Lost(standing(&host), why));
            }
        }
    }

    fn new(mode: Mode) -> Self {
        let (sink, messages) = mpsc::channel(MESSAGES_MAX);
        Self {
            mode,
            clients: Vec::new(),
            places: BTreeMap::new(),
            catching_up: Some(BTreeSet::new()),
            next: BTreeMap::new(),
            before: BTreeMap::new(),
            ready: VecDeque::new(),
            messages,
            sink,
            tasks: JoinSet::new(),
        }
    }

    /// Returns the next item.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn next(&mut self) -> FeedItem {
        loop {
            if let Some(said) = self.ready.pop_front() {
                return said;
            }
            match self.messages.recv().await {
                Some(message) => self.take(message),
                // This cannot happen: the feed itself holds a sender.
                None => std::future::pending().await,
            }
        }
    }

    /// Returns the number of the next event of each deployment, for a feed that continues after this feed.
    pub(crate) fn heard(&self) -> BTreeMap<MissionId, u64> {
        let mut heard = self.before.clone();
        for ((_, mission), next) in &self.next {
            let known = heard.entry(mission.clone()).or_default();
            *known = (*known).max(*next);
        }
        heard
    }

    /// Returns the present connections.
    pub(crate) fn clients(&self) -> Clients {
        Clients { clients: self.clients.clone(), hanging: None }
    }

    /// Closes every connection.
    pub(crate) async fn close(mut self) {
        self.tasks.abort_all();
        while self.tasks.join_next().await.is_some() {}
        drop(self.messages);
        for client in self.clients.into_iter().filter_map(Arc::into_inner) {
            client.close().await;
        }
    }

    fn add(&mut self, client: Arc<Client>) {
        if self.mode != Mode::Snapshot {
            self.tasks.spawn(look_for_nodes(self.clients.len(), Arc::clone(&client), self.sink.clone()));
        }
        self.clients.push(client);
    }

    fn take(&mut self, message: SourceMessage) {
        match message {
            SourceMessage::Client(client) => self.add(client),
            SourceMessage::Found(client, hosts) => self.found(client, hosts),
            SourceMessage::Listed(client, hosts) => {
                if self.mode == Mode::Live {
                    self.ready.push_back(FeedItem::Reached(client, hosts.clone()));
                }
                self.found(client, hosts);
            }
            SourceMessage::Events(place, events) => self.events(place, events),
            SourceMessage::Behind(place, hosts) => self.behind(&place, hosts),
            SourceMessage::Ended(place) if self.is_behind(&place) => {
                self.lost(&place, "it ended before it had sent all its reports".to_owned());
                self.silent(place, State::Lost);
            }
            SourceMessage::Ended(place) => {
                if self.mode != Mode::Snapshot {
                    self.ready.push_back(FeedItem::Left(self.robot(&place)));
                }
                self.silent(place, State::Left);
            }
            SourceMessage::Broken(place, why) => {
                self.lost(&place, why);
                self.silent(place, State::Lost);
            }
            SourceMessage::Late => {
                for place in self.catching_up.iter_mut().flat_map(std::mem::take).collect::<Vec<_>>() {
                    self.lost(&place, "it has not answered in time".to_owned());
                    // The node may still answer, and then counts as back.
                    self.places.insert(place, State::Asked { was_lost: true });
                }
                self.caught_up();
            }
        }
    }

    /// Reports that a node is lost, unless that was already reported.
    fn lost(&mut self, place: &Place, why: String) {
        if self.places.get(place) != Some(&State::Asked { was_lost: true }) {
            self.ready.push_back(FeedItem::Lost(self.robot(place), why));
        }
    }

    /// Asks the nodes among these whose events the feed does not receive yet.
    fn found(&mut self, client: usize, hosts: BTreeSet<String>) {
        let Some(asked) = self.clients.get(client) else { return };
        let request = Request::Events { follow: self.mode != Mode::Snapshot };
        for host in hosts {
            let place = (client, host);
            let was_lost = match self.places.get(&place) {
                Some(State::Asked { .. } | State::Heard) => continue,
                Some(State::Lost | State::Left) => true,
                None => false,
            };
            match asked.ask_on(&place.1, &request) {
                Ok(answers) => {
                    self.tasks.spawn(read(place.clone(), answers, self.sink.clone()));
                    if let Some(waiting) = &mut self.catching_up {
                        waiting.insert(place.clone());
                    }
                    self.places.insert(place, State::Asked { was_lost });
                }
                Err(failure) if !was_lost => {
                    self.ready.push_back(FeedItem::Lost(self.robot(&place), words(&failure)));
                    self.places.insert(place, State::Lost);
                }
                Err(_) => {}
            }
        }
    }

    fn events(&mut self, place: Place, events: Vec<Event>) {
        if self.places.insert(place.clone(), State::Heard) == Some(State::Asked { was_lost: true }) {
            self.ready.push_back(FeedItem::Back(self.robot(&place)));
        }
        // A message without events is the mark that all known events were sent.
        if events.is_empty() {
            self.told(&place);
        }
        for event in events {
            let home = self.robot(&place);
            // A home reports only the events of its own deployments.
            let (deployment, RobotId { host, fleet }) = (event.deployment.clone(), home.clone());
            let mission = MissionId { deployment, home: host, fleet };
            let before = || self.before.get(&mission).copied().unwrap_or_default();
            let next = self.next.entry((place.0, mission.clone())).or_insert_with(before);
            if event.number >= *next {
                *next = event.number + 1;
                self.ready.push_back(FeedItem::Event(home, Box::new(event)));
            }
        }
    }

    /// Reports that a home has no reports of some hosts, or of some programs that its node has adopted.
    fn behind(&mut self, home: &Place, hosts: Vec<String>) {
        for host in hosts {
            let why = if host == home.1 {
                "its node was killed, and does not have reports of all of its programs yet".to_owned()
            } else {
                format!("`{}` has not received all reports of this host", home.1)
            };
            self.ready.push_back(FeedItem::Lost(RobotId { host, fleet: self.robot(home).fleet }, why));
        }
        self.told(home);
    }

    /// Returns the robot that this node belongs to.
    fn robot(&self, place: &Place) -> RobotId {
        let (client, host) = place;
        let fleet = self.clients.get(*client).map_or(Fleet::Standing, |client| client.fleet());
        RobotId { host: host.clone(), fleet }
    }

    fn silent(&mut self, place: Place, state: State) {
        self.told(&place);
        self.places.insert(place, state);
    }

    /// Returns whether some earlier events of a node have not arrived yet.
    fn is_behind(&self, place: &Place) -> bool {
        self.catching_up.as_ref().is_some_and(|waiting| waiting.contains(place))
    }

    /// Notes that no more earlier events will come from a node.
    fn told(&mut self, place: &Place) {
        if let Some(waiting) = &mut self.catching_up {
            waiting.remove(place);
        }
        self.caught_up();
    }

    fn caught_up(&mut self) {
        if self.catching_up.as_ref().is_some_and(BTreeSet::is_empty) {
            self.catching_up = None;
            self.ready.push_back(FeedItem::Current);
        }
    }
}

/// Returns the robot of a permanent node.
fn standing(host: &str) -> RobotId {
    RobotId { host: host.to_owned(), fleet: Fleet::Standing }
}

async fn read(place: Place, mut answers: Answers, sink: Sender<SourceMessage>) {
    loop {
        let message = match answers.next().await {
            Some(Ok(Answer::Events(events))) => SourceMessage::Events(place.clone(), events),
            Some(Ok(Answer::Behind(hosts))) => SourceMessage::Behind(place.clone(), hosts),
            Some(Ok(other)) => SourceMessage::Broken(place.clone(), words(&unasked(&place.1, &other))),
            Some(Err(failure)) => SourceMessage::Broken(place.clone(), words(&failure)),
            None => SourceMessage::Ended(place.clone()),
        };
        let is_last = !matches!(message, SourceMessage::Events(..) | SourceMessage::Behind(..));
        if sink.send(message).await.is_err() || is_last {
            return;
        }
    }
}

async fn look_for_nodes(number: usize, client: Arc<Client>, sink: Sender<SourceMessage>) {
    loop {
        let looked = clock::now();
        let message = match client.listed().await {
            Some(Ok(hosts)) => Some(SourceMessage::Listed(number, hosts)),
            Some(Err(_)) => None,
            // The nodes inside a command end together with it.
            None if client.has_ended() => {
                sink.send(SourceMessage::Listed(number, BTreeSet::new())).await.unwrap_or_default();
                return;
            }
            // If a node of this machine does not answer, this does not mean that other nodes have left.
            None => client.hosts(&[]).await.ok().map(|hosts| SourceMessage::Found(number, hosts)),
        };
        if let Some(message) = message
            && sink.send(message).await.is_err()
        {
            return;
        }
        next_look(looked).await;
    }
}

/// Finds nodes inside commands that begin later.
async fn look_for_commands(base: PathBuf, known: Vec<PathBuf>, sink: Sender<SourceMessage>) {
    let mut known = BTreeSet::from_iter(known);
    loop {
        let looked = clock::now();
        let groups = run_dir::groups(&base);
        known.retain(|folder| groups.contains(folder));
        for folder in groups {
            if !known.contains(&folder)
                && let Ok(Some(client)) = Client::through(&folder, &KeyPlace::default(), &BTreeSet::new()).await
            {
                known.insert(folder);
                if sink.send(SourceMessage::Client(Arc::new(client))).await.is_err() {
                    return;
                }
            }
        }
        next_look(looked).await;
    }
}

async fn next_look(last: Time) {
    clock::sleep_until(last + LOOK_EVERY).await;
}

#[cfg(test)]
mod tests {
    use super::*;
    use node::logic::protocol::Report;

    /// Returns the waiting items, in words.
    fn said(feed: &Feed) -> Vec<String> {
        let words = |item: &FeedItem| match item {
            FeedItem::Event(home, event) => format!("{home}: {} {}", event.deployment.name, event.number),
            FeedItem::Current => "current".to_owned(),
            FeedItem::Left(robot) => format!("left {robot}"),
            FeedItem::Lost(robot, why) => format!("lost {robot}: {why}"),
            FeedItem::Back(robot) => format!("back {robot}"),
            FeedItem::Reached(_, hosts) => format!("reached {hosts:?}"),
        };
        feed.ready.iter().map(words).collect()
    }

    #[test]
    fn a_node_that_answers_late_is_back() {
        let places = ["c2", "c3"].map(|host| (0, host.to_owned()));
        let mut feed = Feed::new(Mode::Follow);
        feed.places = places.clone().map(|place| (place, State::Asked { was_lost: false })).into();
        feed.catching_up = Some(places.clone().into());
        let [c2, c3] = places;
        feed.take(SourceMessage::Late);
        feed.take(SourceMessage::Events(c2, Vec::new()));
        feed.take(SourceMessage::Broken(c3, "it went away".to_owned()));
        let why = "it has not answered in time";
        let expected =
            [format!("lost c2: {why}"), format!("lost c3: {why}"), "current".to_owned(), "back c2".to_owned()];
        assert_eq!(said(&feed), expected);
    }

    #[test]
    fn a_feed_that_goes_on_after_another_leaves_out_what_that_has_heard() {
        let event = |name: &str, number| {
            let (deployment, report) =
                (Deployment { name: name.to_owned(), epoch: 1 }, Report::Refused { reasons: Vec::new() });
            Event { deployment, number, host: "c1".into(), ago: Duration::ZERO, report, time: Duration::ZERO }
        };
        let mut first = Feed::new(Mode::Follow);
        first.take(SourceMessage::Events((0, "c1".to_owned()), vec![event("door", 0), event("door", 1)]));
        let mut feed = Feed { before: first.heard(), ..Feed::new(Mode::Follow) };
        let again = [("door", 0), ("door", 1), ("door", 2), ("arm", 0)].map(|(name, number)| event(name, number));
        feed.take(SourceMessage::Events((0, "c2".to_owned()), again.into()));
        // The other home has a deployment of the same name, and none of its events has come.
        let expected = ["c2: door 0", "c2: door 1", "c2: door 2", "c2: arm 0"];
        assert_eq!(said(&feed), expected);
        let again = [("door", 0), ("door", 1), ("door", 2)].map(|(name, number)| event(name, number));
        feed.take(SourceMessage::Events((0, "c1".to_owned()), again.into()));
        assert_eq!(said(&feed)[4..], ["c1: door 2"]);
    }

    #[test]
    fn a_home_that_has_not_heard_everything_says_so() {
        let c1 = (0, "c1".to_owned());
        let mut feed = Feed::new(Mode::Snapshot);
        feed.catching_up = Some([c1.clone()].into());
        feed.take(SourceMessage::Behind(c1.clone(), vec!["c2".to_owned(), "c1".to_owned()]));
        feed.take(SourceMessage::Ended(c1));
        let expected = [
            "lost c2: `c1` has not received all reports of this host",
            "lost c1: its node was killed, and does not have reports of all of its programs yet",
            "current",
        ];
        assert_eq!(said(&feed), expected);
    }

    #[test]
    fn a_node_that_ends_before_it_has_told_everything_is_lost() {
        let [c2, c3] = ["c2", "c3"].map(|host| (0, host.to_owned()));
        let mut feed = Feed::new(Mode::Snapshot);
        feed.catching_up = Some([c2.clone(), c3.clone()].into());
        feed.take(SourceMessage::Events(c2.clone(), Vec::new()));
        feed.take(SourceMessage::Ended(c2));
        feed.take(SourceMessage::Ended(c3));
        assert_eq!(said(&feed), ["lost c3: it ended before it had sent all its reports", "current"]);
    }
}
