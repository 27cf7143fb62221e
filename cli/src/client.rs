//! A command line's connection to the nodes: through a node of this machine if there is one, else over the network.

mod failure;
pub(crate) mod feed;
mod revoked;
pub(crate) mod signer;
mod statuses;

use crate::{ConnectArgs, RunDir};
use anyhow::{Context, anyhow};
use comms::io::clock;
use comms::io::session::{OpenError, Presence, Replies, Session};
use comms::logic::time::Time;
use comms::logic::{codec, key};
use failure::call_failure;
use node::console::{self, Failure};
use node::io::run_dir;
use node::logic::protocol::{Answer, Request, SILENCE_MAX};
use signer::{KeyPlace, Signing};
pub(crate) use statuses::Statuses;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use team::visitor::VisitorIdentity;
use tokio::task::JoinSet;
use view::Fleet;

/// How long a node has for an answer that it can give at once. The longest way there and back takes 3 s.
pub(crate) const ANSWER_WITHIN: Duration = Duration::from_secs(4);
/// The pause before the node of this machine is asked again which nodes it reaches.
const ASK_AGAIN: Duration = Duration::from_millis(200);
/// How long a node takes at most to find the other nodes.
const KNOWS_AFTER: Duration = Duration::from_secs(2);
/// How long a command looks for nodes on the network.
const FIND_WITHIN: Duration = Duration::from_millis(1500);
/// How long a command looks for a node that the user has named: discovery on a busy network takes several rounds.
const FIND_NAMED_WITHIN: Duration = Duration::from_secs(5);
/// How long a command without a node waits for the first message of a named node. Each node announces itself once a
/// second, and a message takes up to 1.5 s.
const HEARD_WITHIN: Duration = Duration::from_secs(4);
/// How long a node may take to announce itself after the last attempt to link to it: a round trip takes up to 3 s.
const SHOWN_WITHIN: Duration = Duration::from_secs(4);
/// How long a command without a node looks for nodes at most: four round trips after the first message.
const LINKED_WITHIN: Duration = Duration::from_secs(20);
/// The verb in the key of every request. The action itself is in the request.
const VERB: &str = "request";

/// A connection to the nodes.
#[derive(Debug)]
pub(crate) struct Client {
    session: Session,
    /// The node of this machine that the connection goes through.
    local: Option<String>,
    /// Folder with the sockets of this machine's nodes.
    base: Option<PathBuf>,
    /// Signs requests. A node in a team acts only on signed requests of a user.
    signing: Signing,
}

/// The answers of a node to one request, as they come.
#[derive(Debug)]
pub(crate) struct Answers {
    host: String,
    replies: Replies,
}

/// Connections to all nodes that can be reached: one to the permanent nodes, and one to the nodes inside each `dca
/// run`. Nodes of different connections do not know of each other.
#[derive(Debug)]
pub(crate) struct Clients {
    clients: Vec<Arc<Client>>,
    /// The reason why some running nodes of this machine are missing in `clients`.
    hanging: Option<Failure>,
}

impl Clients {
    /// Connects through nodes of this machine. With `--lan`, if no permanent node runs on this machine, looks for nodes on the network.
    /// If the user has named a folder with `--run-dir` and nodes run in it, connects only to these nodes.
    pub(crate) async fn open(connect: &ConnectArgs) -> Result<Self, Failure> {
        Self::open_with(connect, connect.commands()).await
    }

    /// Connects like [`Clients::open`], and always to the nodes inside each `dca run` below the named folder as well.
    pub(crate) async fn open_all(connect: &ConnectArgs) -> Result<Self, Failure> {
        Self::open_with(connect, connect.all_commands()).await
    }

    async fn open_with(connect: &ConnectArgs, commands: Vec<PathBuf>) -> Result<Self, Failure> {
        let standing = Client::open(connect).await;
        let keys = connect.key_place();
        let (mut clients, mut hanging) = (Vec::new(), None);
        for folder in commands {
            match Client::through(&folder, &keys, &BTreeSet::new()).await {
                Ok(client) => clients.extend(client),
                // A command that has just begun or ended is left out. A command that does not answer is left out as
                // well if others answer.
                Err(failure) => hanging = Some(failure),
            }
        }
        match standing {
            Ok(client) => clients.insert(0, client),
            Err(failure) if clients.is_empty() => return Err(hanging.unwrap_or(failure)),
            Err(failure) if run_dir::running(&connect.base()).is_ok_and(|nodes| !nodes.is_empty()) => {
                hanging = Some(failure);
            }
            Err(_) => {}
        }
        Ok(Self { clients: clients.into_iter().map(Arc::new).collect(), hanging })
    }

    /// Returns why some running nodes of this machine cannot be asked; nothing if all can be asked.
    pub(crate) fn hanging(&self) -> Option<String> {
        self.hanging.as_ref().map(words)
    }

    /// Returns each connection, for tasks.
    pub(crate) fn shared(&self) -> Vec<Arc<Client>> {
        self.clients.clone()
    }

    /// Returns each connection.
    pub(crate) fn iter(&self) -> impl Iterator<Item = &Client> {
        self.clients.iter().map(|client| &**client)
    }

    /// Asks every node at once for its status, and pairs each answer with its connection. Prints a warning for each
    /// node that does not answer.
    pub(crate) async fn statuses(&self) -> Result<Vec<(&Client, Statuses)>, Failure> {
        self.ask_all(console::note).await
    }

    /// Does the same as [`Clients::statuses`], and prints no warnings.
    pub(crate) async fn look(&self) -> Result<Vec<(&Client, Statuses)>, Failure> {
        self.ask_all(|_| {}).await
    }

    async fn ask_all(&self, note: fn(&str)) -> Result<Vec<(&Client, Statuses)>, Failure> {
        let questions = self.clients.iter().map(|client| {
            let client = Arc::clone(client);
            let mut questions = JoinSet::new();
            questions.spawn(async move { client.statuses_noted(note).await });
            questions
        });
        let (mut found, mut failure) = (Vec::new(), None);
        for (client, mut answers) in self.iter().zip(questions.collect::<Vec<_>>()) {
            match answers.join_next().await {
                Some(Ok(Ok(statuses))) => found.push((client, statuses)),
                Some(Ok(Err(why))) => failure = Some(why),
                Some(Err(panic)) => failure = Some(panic.into()),
                None => {}
            }
        }
        if let Some(failure) = failure.filter(|_| found.is_empty()) {
            return Err(failure);
        }
        Ok(found)
    }

    /// Closes the connections.
    pub(crate) async fn close(self) {
        for client in self.clients.into_iter().filter_map(Arc::into_inner) {
            client.close().await;
        }
    }
}

/// Returns the failure that this user has no node on this machine. `other` is the user whose node the service manager has started.
fn no_node(other: Option<u32>) -> anyhow::Error {
    match other {
        Some(user) => anyhow!(
            "no node of this user runs on this machine; user {user} owns the folder of a node, `/run/dca`: act as that user, for example with \
             `sudo -u '#{user}' dca status`"
        ),
        None => {
            anyhow!(
                "no node runs on this machine; start one with `dca-node --name NAME`, or search the network with `--lan`"
            )
        }
    }
}

impl Client {
    /// Connects through a permanent node of this machine. If there is none and `--lan` is given, looks for nodes on the network.
    pub(crate) async fn open(connect: &ConnectArgs) -> Result<Self, Failure> {
        let problem = match Self::through(&connect.base(), &connect.key_place(), &connect.silent).await {
            Ok(Some(client)) => return Ok(client),
            Ok(None) => None,
            Err(Failure::Unreachable(problem)) => Some(problem),
            Err(refused) => return Err(refused),
        };
        if connect.lan {
            let session = Session::open_scout().await.context("looking for nodes on the network");
            return Ok(Self {
                session: session.map_err(Failure::Unreachable)?,
                local: None,
                base: Some(connect.base()),
                signing: Signing::of(connect.key_place()),
            });
        }
        let is_usual = connect.base() == run_dir::default_base();
        let none = || no_node(run_dir::user_of_service().filter(|_| is_usual));
        Err(Failure::Unreachable(problem.unwrap_or_else(none)))
    }

    /// Connects through a permanent node of this machine.
    pub(crate) async fn here(run_dir: Option<&Path>) -> Result<Self, Failure> {
        let run_dir = run_dir.map(|folder| RunDir { folder: folder.to_owned(), is_named: true });
        Self::open(&ConnectArgs { run_dir, ..ConnectArgs::default() }).await
    }

    /// Connects like [`Client::open`]. If no permanent node can be used, connects to the only running `dca run`.
    pub(crate) async fn open_any(connect: &ConnectArgs) -> Result<Self, Failure> {
        let standing = Self::open(connect).await;
        let commands = connect.commands();
        match (standing, &commands[..]) {
            (Ok(client), []) => Ok(client),
            (Ok(client), several) => {
                let (base, several) = (connect.base(), options(several.iter().map(PathBuf::as_path)));
                console::note(&format!(
                    "note: this asks only the nodes in `{}`; others run: {several}",
                    base.display()
                ));
                Ok(client)
            }
            (Err(failure), []) => Err(failure),
            (Err(failure), [folder]) => {
                Self::through(folder, &connect.key_place(), &BTreeSet::new()).await?.ok_or(failure)
            }
            (Err(_), several) => {
                let several = options(several.iter().map(PathBuf::as_path));
                Err(anyhow!("several `dca run` commands are running; choose one: {several}").into())
            }
        }
    }

    /// Connects through a node whose socket is in this folder; returns nothing if no node runs. Silent nodes are tried
    /// last, because a connection to them takes seconds to fail.
    async fn through(folder: &Path, keys: &KeyPlace, silent: &BTreeSet<String>) -> Result<Option<Self>, Failure> {
        let (mut problem, mut outlawed) = (None, None);
        let mut running = run_dir::running(folder)?;
        running.sort_by_key(|(name, _)| silent.contains(name));
        let has_others = running.len() > 1;
        for (name, socket) in running {
            match Session::open_client(&socket).await {
                Ok(session) => {
                    let session = authenticated(session, &socket)?;
                    let signing = Signing::of(keys.clone());
                    let client = Self { session, local: Some(name), base: Some(folder.to_owned()), signing };
                    // A node whose keys are revoked has no links to others.
                    if has_others && client.is_outlawed().await {
                        outlawed.get_or_insert(client);
                        continue;
                    }
                    return Ok(Some(client));
                }
                Err(error @ OpenError::NoNode { .. }) => {
                    problem = Some(anyhow!(error).context(format!("connecting to the node `{name}`")));
                }
                // The socket accepts the connection, but the node does not answer.
                Err(_) => {
                    problem = Some(anyhow!(
                        "the node `{name}` runs on this machine and does not answer: it may be suspended, or short of processor time"
                    ));
                }
            }
        }
        match (outlawed, problem) {
            (Some(client), _) => Ok(Some(client)),
            (None, Some(problem)) => Err(Failure::Unreachable(problem)),
            (None, None) => Ok(None),
        }
    }

    /// Connects to the node that has this socket.
    pub(crate) async fn to_socket(socket: PathBuf) -> Result<Self, Failure> {
        let session =
            Session::open_client(&socket).await.with_context(|| format!("connecting to {}", socket.display()));
        let session = authenticated(session.map_err(Failure::Unreachable)?, &socket)?;
        Ok(Self { session, local: None, base: None, signing: Signing::default() })
    }

    /// Returns the node of this machine through which the connection goes. None if there is no such node.
    pub(crate) fn local(&self) -> Option<&str> {
        self.local.as_deref()
    }

    /// Returns the folder with the socket of the node that the connection goes through. Returns nothing if the
    /// connection goes through no node of this machine.
    pub(crate) fn folder(&self) -> Option<&Path> {
        self.base.as_deref().filter(|_| self.local.is_some())
    }

    /// Returns how a user chooses between things of the same name: with `--run-dir`, because their nodes do not know of
    /// each other. `clients` has the connection to each of them. Returns nothing if all names differ.
    pub(crate) fn choice<'a>(clients: impl Iterator<Item = &'a Self>, names: &[String]) -> Option<String> {
        let folders: BTreeSet<Option<&Path>> = clients.map(Self::folder).collect();
        let are_same = names.iter().collect::<BTreeSet<_>>().len() < names.len();
        (are_same && folders.len() > 1)
            .then(|| format!("each has nodes of its own; choose one: {}", options(folders.into_iter().flatten())))
    }

    /// Returns which fleet of nodes the connection reaches.
    pub(crate) fn fleet(&self) -> Fleet {
        self.base.as_deref().and_then(run_dir::command).map_or(Fleet::Standing, Fleet::Command)
    }

    /// Returns the file with the credentials that clients on this machine show to programs on other hosts of the team,
    /// if there is a team.
    pub(crate) fn team(&self) -> Option<PathBuf> {
        run_dir::visitors_identity(self.base.as_deref()?, self.local.as_deref()?)
    }

    /// Returns the proof for the node `host`, if this command runs it on its machine.
    pub(crate) fn proof(&self, host: &str) -> Option<String> {
        run_dir::proof(self.base.as_deref()?, host)
    }

    /// Returns whether a node can be reached: at once if the node is present, else after the time for discovery.
    pub(crate) async fn finds(&self, host: &str) -> Result<bool, Failure> {
        Ok(self.look(&[host.to_owned()], FIND_NAMED_WITHIN).await?.contains(host))
    }

    /// Returns the nodes that can be reached: at once if all of `wanted` are present, else after a
    /// while. A node is also included if only the node of this machine knows it, because its own
    /// announcement may have been lost.
    pub(crate) async fn hosts(&self, wanted: &[String]) -> Result<BTreeSet<String>, Failure> {
        self.look(wanted, FIND_WITHIN).await
    }

    async fn look(&self, wanted: &[String], within: Duration) -> Result<BTreeSet<String>, Failure> {
        let mut watch = self.session.watch(&key::live_any()).map_err(|error| Failure::Unreachable(error.into()))?;
        let (mut tokens, mut heard) = (BTreeSet::new(), BTreeSet::new());
        let begun = clock::now();
        let mut deadline =
            begun + if self.local.is_none() && !wanted.is_empty() { within.max(HEARD_WITHIN) } else { within };
        let mut hosts_heard = Box::pin(self.heard_here(clock::now()));
        loop {
            // The node at the other end of the link is present, even if it is too busy to answer in time.
            heard.extend(self.linked_node());
            if !wanted.is_empty() && wanted.iter().all(|host| tokens.contains(host) || heard.contains(host)) {
                return Ok(&tokens | &heard);
            }
            let presence = tokio::select! {
                presence = watch.next() => presence,
                hosts = &mut hosts_heard => {
                    heard = hosts;
                    hosts_heard = Box::pin(self.heard_here(clock::now() + ASK_AGAIN));
                    continue;
                }
                () = clock::sleep_until(deadline) => None,
                // A command without a node makes its links itself. Each link takes four round trips.
                () = clock::sleep_until(clock::now() + ASK_AGAIN), if self.local.is_none() => {
                    let is_wanted = !wanted.is_empty() || tokens.is_empty();
                    if is_wanted && !self.session.unlinked().is_empty() {
                        deadline = extended(begun, deadline, clock::now());
                    }
                    continue;
                }
            };
            match presence {
                Some(Presence::Appeared(key)) => tokens.extend(key::parse_live(&key).map(|(host, _)| host)),
                Some(Presence::Vanished(key)) => drop(key::parse_live(&key).map(|(host, _)| tokens.remove(&host))),
                None => return Ok(&tokens | &heard),
            }
        }
    }

    /// Returns a sentence for each of these hosts that has announced itself to the session, but has no link to it.
    pub(crate) fn unlinked(&self, hosts: &[&str]) -> Vec<String> {
        let missing = self.session.unlinked().into_iter().filter(|(who, _)| hosts.contains(&who.as_str()));
        missing
            .map(|(who, why)| format!("`{who}` has announced itself, but the link to it was not established: {why}"))
            .collect()
    }

    /// Returns the node of this machine that the connection goes through, while the link to this node holds.
    fn linked_node(&self) -> Option<String> {
        let local = self.local.as_ref()?;
        self.session.at_the_other_end(&key::rpc(local, VERB)).map(|_| local.clone())
    }

    /// Waits until `at`, then asks the node of this machine which nodes it reaches. Returns no nodes if it does not
    /// answer. Never ends if the connection goes through no node.
    async fn heard_here(&self, at: Time) -> BTreeSet<String> {
        clock::sleep_until(at).await;
        let Some(local) = &self.local else { return std::future::pending().await };
        self.reached_by(local).await.map(|(hosts, _)| hosts).unwrap_or_default()
    }

    /// Asks a node for its uptime and for the nodes it reaches, including itself. Returns nothing if it does not answer.
    async fn reached_by(&self, host: &str) -> Option<(BTreeSet<String>, Duration)> {
        let answer = self.ask(host, &Request::Status, ANSWER_WITHIN).await.ok()?;
        let Answer::Status(status) = answer else { return None };
        Some((status.peers.into_iter().chain([status.host]).collect(), status.up))
    }

    /// Returns the key of requests to a node. If another host has a node of the same name, the key leads to the node of this machine.
    fn rpc(&self, host: &str) -> String {
        let key = key::rpc(host, VERB);
        let here = (self.local() == Some(host)).then(|| self.session.at_the_other_end(&key)).flatten();
        here.unwrap_or(key)
    }

    /// Asks a node a question that has one answer.
    pub(crate) async fn ask(&self, host: &str, request: &Request, within: Duration) -> Result<Answer, Failure> {
        let bytes = codec::encode(request)?;
        let reply = self.session.call(&self.rpc(host), bytes, within).await;
        read(host, &reply.map_err(|error| call_failure(host, error))?)
    }

    /// Asks a node a question that has a stream of answers.
    pub(crate) fn ask_on(&self, host: &str, request: &Request) -> Result<Answers, Failure> {
        let bytes = codec::encode(request)?;
        let replies = self.session.call_stream(&self.rpc(host), bytes, SILENCE_MAX);
        Ok(Answers { host: host.to_owned(), replies: replies.map_err(|error| call_failure(host, error))? })
    }

    /// Asks every node for its status. Prints a warning for each node that does not answer.
    pub(crate) async fn statuses(&self) -> Result<Statuses, Failure> {
        self.statuses_noted(console::note).await
    }

    /// Does the same as [`Client::statuses`]; `note` receives the warnings.
    pub(crate) async fn statuses_noted(&self, note: fn(&str)) -> Result<Statuses, Failure> {
        Statuses::ask(self, note).await
    }

    /// Returns every node that can be reached.
    pub(crate) async fn all(&self) -> Result<BTreeSet<String>, Failure> {
        match self.listed().await {
            Some(listed) => listed,
            None => self.hosts(&[]).await,
        }
    }

    /// Returns every node that can be reached. The node of this machine knows them at once, unless it has just started.
    /// Revoked nodes are left out: it lists them until it counts them as lost. Returns nothing if it does not answer.
    pub(crate) async fn listed(&self) -> Option<Result<BTreeSet<String>, Failure>> {
        let Some(local) = &self.local else { return Some(self.hosts(&[]).await) };
        let (hosts, up) = self.reached_by(local).await?;
        Some(match KNOWS_AFTER.checked_sub(up) {
            Some(left) => self.look(&[], left.min(FIND_WITHIN)).await,
            None => {
                let revoked = self.revoked(std::iter::once(local.as_str())).await;
                Ok(hosts.into_iter().filter(|host| host == local || !revoked.contains(host)).collect())
            }
        })
    }

    /// Returns whether the connection went through a node inside a command that has ended.
    pub(crate) fn has_ended(&self) -> bool {
        let is_of_command = self.fleet() != Fleet::Standing;
        is_of_command
            && self.base.as_deref().is_some_and(|base| run_dir::running(base).is_ok_and(|nodes| nodes.is_empty()))
    }

    /// Returns whether other nodes run on this machine, besides the node that the connection goes through.
    pub(crate) fn has_another(&self) -> bool {
        let (Some(base), Some(local)) = (&self.base, &self.local) else { return false };
        run_dir::running(base).is_ok_and(|nodes| nodes.iter().any(|(name, _)| name != local))
    }

    /// Closes the connection.
    pub(crate) async fn close(self) {
        self.session.close().await;
    }
}

impl Answers {
    /// Returns the next answer; nothing after the last one. If the node vanishes before its last answer, this is an error.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn next(&mut self) -> Option<Result<Answer, Failure>> {
        let reply = self.replies.next().await?;
        Some(reply.map_err(|error| call_failure(&self.host, error)).and_then(|bytes| read(&self.host, &bytes)))
    }

    /// Returns the next answer like [`Answers::next`]; nothing if no answer has come by the deadline. An answer that
    /// has already arrived is returned even after the deadline.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn next_by(&mut self, deadline: Time) -> Option<Result<Answer, Failure>> {
        tokio::select! {
            biased;
            answer = self.next() => answer,
            () = clock::sleep_until(deadline) => None,
        }
    }
}

/// Returns the options that choose one of these folders, for a message.
fn options<'a>(folders: impl Iterator<Item = &'a Path>) -> String {
    let options: Vec<String> = folders.map(|folder| format!("`--run-dir {}`", folder.display())).collect();
    options.join(" or ")
}

/// Extends the deadline of a search: the link to one of the nodes was still being made at `now`.
fn extended(begun: Time, deadline: Time, now: Time) -> Time {
    deadline.max((now + SHOWN_WITHIN).min(begun + LINKED_WITHIN))
}

/// Makes the session check that the answers come from nodes of the team. The check uses the
/// credentials that the node of this socket gives to programs of its machine.
fn authenticated(session: Session, socket: &Path) -> anyhow::Result<Session> {
    let file = socket.with_file_name(run_dir::VISITORS);
    if !file.is_file() {
        return Ok(session);
    }
    let identity = VisitorIdentity::open(&file).context("reading the credentials of the team")?;
    Ok(session.authenticated_by(Arc::new(identity)))
}

fn read(host: &str, bytes: &[u8]) -> Result<Answer, Failure> {
    Ok(codec::decode(bytes).with_context(|| format!("reading an answer of the node `{host}`"))?)
}

/// Returns the failure for an unexpected answer of a node; its own refusals are passed on unchanged.
pub(crate) fn unasked(host: &str, answer: &Answer) -> Failure {
    if let Answer::Refused(why) = answer {
        return anyhow!("host `{host}`: {why}").into();
    }
    anyhow!("unexpected answer from host `{host}`").into()
}

/// Returns the text of a failure.
pub(crate) fn words(failure: &Failure) -> String {
    match failure {
        Failure::Refused(error) | Failure::Usage(error) | Failure::Unreachable(error) => format!("{error:#}"),
        Failure::Reported | Failure::ReportedUnreachable | Failure::Limited => String::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::io::session::{NodeOptions, Reach};
    use comms::logic::key::HostName;
    use node::logic::protocol::{Containment, Network, NodeStatus};

    #[test]
    fn a_link_that_is_being_made_is_waited_for_and_not_for_ever() {
        let at = |seconds| Time::ZERO + Duration::from_secs(seconds);
        let deadline = [4, 8, 16, 19].into_iter().fold(at(4), |deadline, now| extended(at(0), deadline, at(now)));
        assert_eq!(deadline, at(20));
        assert_eq!(extended(at(0), at(4), at(3)), at(7));
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_node_that_does_not_answer_does_not_hide_the_others() {
        let folder = std::env::temp_dir().join(format!("dca-client-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let socket = folder.join("s");
        let name = HostName::parse("c1").unwrap();
        let options = NodeOptions { name, socket: socket.clone(), reach: Reach::Host, port: 0, peers: Vec::new() };
        let nodes = Session::open_node(options).await.unwrap();
        // A healthy node, a node that refuses, and a node that announces itself but serves nothing.
        let announced = ["c1", "c2", "c3"].map(|host| nodes.announce(&key::live(host, 1)).unwrap());
        let mut well = nodes.serve(&key::rpc_any("c1")).unwrap();
        let mut full = nodes.serve(&key::rpc_any("c2")).unwrap();
        let serving = async {
            let (one, other) = tokio::join!(well.next(), full.next());
            assert!(one.unwrap().reply(codec::encode(&Answer::Status(idle("c1"))).unwrap()).await);
            other.unwrap().refuse("it is full");
        };
        let client = Client::to_socket(socket).await.unwrap_or_else(|why| panic!("{}", words(&why)));
        let (statuses, ()) = tokio::join!(client.statuses(), serving);
        let Statuses { nodes: seen, silent, missed } = statuses.unwrap_or_else(|why| panic!("{}", words(&why)));
        assert_eq!((seen, silent), (vec![idle("c1")], vec!["c2".to_owned(), "c3".to_owned()]));
        assert_eq!(missed, ["c4".to_owned()].into());
        client.close().await;
        drop((announced, well, full));
        nodes.close().await;
        std::fs::remove_dir_all(&folder).unwrap();
    }

    fn idle(host: &str) -> NodeStatus {
        let (peers, deployments) = (Vec::new(), Vec::new());
        NodeStatus {
            host: host.into(),
            pid: 1,
            version: "0".into(),
            up: Duration::ZERO,
            peers,
            deployments,
            containment: Containment::default(),
            network: Network::default(),
            estop: None,
            policy: None,
            missing: vec!["c3".into(), "c4".into()],
            waiting: vec![],
        }
    }
}
