//! A command line's connection to the nodes: through a node of this machine when there is one, else over the network.

mod failure;
pub(crate) mod feed;
mod revoked;
pub(crate) mod signer;
mod statuses;

use crate::ConnectArgs;
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

/// How long a node has to answer a question that it can answer at once: the longest way there and back is 3 s.
pub(crate) const ANSWER_WITHIN: Duration = Duration::from_secs(4);
/// How long until the node of this machine is asked again for the nodes it reaches.
const ASK_AGAIN: Duration = Duration::from_millis(200);
/// How long a node takes at most to find the others.
const KNOWS_AFTER: Duration = Duration::from_secs(2);
/// How long nodes are looked for on the network.
const FIND_WITHIN: Duration = Duration::from_millis(1500);
/// How long one node that was named is looked for: discovery on a busy network takes several rounds.
const FIND_NAMED_WITHIN: Duration = Duration::from_secs(5);
/// How long a command without a node waits for the word of a node that is named: each says once a second that it is there, and a way
/// takes up to 1.5 s.
const HEARD_WITHIN: Duration = Duration::from_secs(4);
/// How long after its link was last being made a node may take to show itself: a round trip takes up to 3 s.
const SHOWN_WITHIN: Duration = Duration::from_secs(4);
/// How long such a command waits at most: four round trips after the first word.
const LINKED_WITHIN: Duration = Duration::from_secs(20);
/// The verb of every request: the request itself has the action.
const VERB: &str = "request";

/// A connection to the nodes.
#[derive(Debug)]
pub(crate) struct Client {
    session: Session,
    /// The node of this machine that it goes through.
    local: Option<String>,
    /// Folder with the sockets of this machine's nodes.
    base: Option<PathBuf>,
    /// Signs requests to nodes in a team, which act only for a user.
    signing: Signing,
}

/// The answers of a node to one request, as they come.
#[derive(Debug)]
pub(crate) struct Answers {
    host: String,
    replies: Replies,
}

/// Connections to all nodes that can be reached: one to the permanent ones, and one to those inside each `dca run`.
/// These do not know of each other.
#[derive(Debug)]
pub(crate) struct Clients {
    clients: Vec<Arc<Client>>,
    /// Why nodes that run on this machine are not among them.
    hanging: Option<Failure>,
}

impl Clients {
    /// Connects through nodes of this machine, or by scouting when `--lan` is given and no node stays on this machine.
    pub(crate) async fn open(connect: &ConnectArgs) -> Result<Self, Failure> {
        let standing = Client::open(connect).await;
        let keys = connect.key_place();
        let (mut clients, mut hanging) = (Vec::new(), None);
        for folder in run_dir::groups(&connect.base()).iter().filter(|folder| **folder != connect.base()) {
            match Client::through(folder, &keys, &BTreeSet::new()).await {
                Ok(client) => clients.extend(client),
                // A command that has just begun or ended is left out, and so is one that hangs while others answer.
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

    /// Returns why nodes that run on this machine cannot be asked, if there are such.
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

    /// Asks every node at once for its status; each answer is paired with its connection. Nodes that do not answer are
    /// noted.
    pub(crate) async fn statuses(&self) -> Result<Vec<(&Client, Statuses)>, Failure> {
        self.ask_all(console::note).await
    }

    /// As [`Clients::statuses`], without a word.
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

/// Returns the failure that this user has no node here; `other` is the user whose node the service manager has started.
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
    /// Connects through a node that stays on this machine, or by scouting when `--lan` is given.
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

    /// Connects through a node that stays on this machine.
    pub(crate) async fn here(run_dir: Option<&Path>) -> Result<Self, Failure> {
        Self::open(&ConnectArgs { run_dir: run_dir.map(Path::to_owned), ..ConnectArgs::default() }).await
    }

    /// Connects as [`Client::open`] does; where no node stays, to the only `dca run` that there is.
    pub(crate) async fn open_any(connect: &ConnectArgs) -> Result<Self, Failure> {
        let standing = Self::open(connect).await;
        let base = connect.base();
        let commands: Vec<PathBuf> = run_dir::groups(&base).into_iter().filter(|folder| *folder != base).collect();
        match (standing, &commands[..]) {
            (Ok(client), _) => Ok(client),
            (Err(failure), []) => Err(failure),
            (Err(failure), [folder]) => {
                Self::through(folder, &connect.key_place(), &BTreeSet::new()).await?.ok_or(failure)
            }
            (Err(_), several) => {
                let several: Vec<String> = several.iter().map(|folder| folder.display().to_string()).collect();
                let several = several.join("` or `");
                Err(anyhow!("several `dca run` commands are running; choose one with `--run-dir`: `{several}`").into())
            }
        }
    }

    /// Connects through a node that has its sockets in this folder; nothing if none runs. A silent node takes seconds to fail, so it comes
    /// last.
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
                // The socket accepts the connection and does not answer.
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

    /// Returns the node of this machine that it goes through, if it does.
    pub(crate) fn local(&self) -> Option<&str> {
        self.local.as_deref()
    }

    /// Returns the nodes that it reaches.
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

    /// Returns whether a node can be reached: at once if it is there, else after the time for discovery.
    pub(crate) async fn finds(&self, host: &str) -> Result<bool, Failure> {
        Ok(self.look(&[host.to_owned()], FIND_NAMED_WITHIN).await?.contains(host))
    }

    /// Returns the nodes that can be reached: at once when all of `wanted` are there, else after a while. Nodes that
    /// this machine's node has heard of also count: a token alone can be lost.
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
            // The node at the other end is there, even if it is too busy to answer in time.
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
                // A command without a node makes the links itself, which takes four round trips.
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

    /// Returns a sentence for each of these hosts that was heard and is not linked.
    pub(crate) fn unlinked(&self, hosts: &[&str]) -> Vec<String> {
        let missing = self.session.unlinked().into_iter().filter(|(who, _)| hosts.contains(&who.as_str()));
        missing.map(|(who, why)| format!("`{who}` was heard, but the link to it was not established: {why}")).collect()
    }

    /// Returns the node of this machine that it goes through, while the link to it holds.
    fn linked_node(&self) -> Option<String> {
        let local = self.local.as_ref()?;
        self.session.at_the_other_end(&key::rpc(local, VERB)).map(|_| local.clone())
    }

    /// Asks the node of this machine, at some time, for the nodes it reaches: none if it does not answer. Without such
    /// a node the future never ends.
    async fn heard_here(&self, at: Time) -> BTreeSet<String> {
        clock::sleep_until(at).await;
        let Some(local) = &self.local else { return std::future::pending().await };
        self.reached_by(local).await.map(|(hosts, _)| hosts).unwrap_or_default()
    }

    /// Asks a node for the nodes it reaches, including itself, and its uptime; none if it does not answer.
    async fn reached_by(&self, host: &str) -> Option<(BTreeSet<String>, Duration)> {
        let answer = self.ask(host, &Request::Status, ANSWER_WITHIN).await.ok()?;
        let Answer::Status(status) = answer else { return None };
        Some((status.peers.into_iter().chain([status.host]).collect(), status.up))
    }

    /// Returns the key of requests to a node. Where another one has the name of the node of this machine, this one is meant.
    fn rpc(&self, host: &str) -> String {
        let key = key::rpc(host, VERB);
        let here = (self.local() == Some(host)).then(|| self.session.at_the_other_end(&key)).flatten();
        here.unwrap_or(key)
    }

    /// Asks a node something that has one answer.
    pub(crate) async fn ask(&self, host: &str, request: &Request, within: Duration) -> Result<Answer, Failure> {
        let bytes = codec::encode(request)?;
        let reply = self.session.call(&self.rpc(host), bytes, within).await;
        read(host, &reply.map_err(|error| call_failure(host, error))?)
    }

    /// Asks a node something that has a stream of answers.
    pub(crate) fn ask_on(&self, host: &str, request: &Request) -> Result<Answers, Failure> {
        let bytes = codec::encode(request)?;
        let replies = self.session.call_stream(&self.rpc(host), bytes, SILENCE_MAX);
        Ok(Answers { host: host.to_owned(), replies: replies.map_err(|error| call_failure(host, error))? })
    }

    /// Returns every node that can be reached.
    pub(crate) async fn all(&self) -> Result<BTreeSet<String>, Failure> {
        match self.listed().await {
            Some(listed) => listed,
            None => self.hosts(&[]).await,
        }
    }

    /// Returns every node that can be reached: the node of this machine knows at once, unless it has just begun to
    /// look. Revoked nodes, which it lists until it counts them as lost, are left out. None if it does not answer.
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

    /// Returns whether it went through a node inside a command, and that command has ended.
    pub(crate) fn has_ended(&self) -> bool {
        let is_of_command = self.fleet() != Fleet::Standing;
        is_of_command
            && self.base.as_deref().is_some_and(|base| run_dir::running(base).is_ok_and(|nodes| nodes.is_empty()))
    }

    /// Returns whether another node than the one that it goes through runs on this machine.
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
    /// Returns the next answer; none after the last one. A node that is gone before that is an error.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn next(&mut self) -> Option<Result<Answer, Failure>> {
        let reply = self.replies.next().await?;
        Some(reply.map_err(|error| call_failure(&self.host, error)).and_then(|bytes| read(&self.host, &bytes)))
    }

    /// Returns the next answer like [`Answers::next`]; none if it has not come by the deadline. An answer that is
    /// already there counts, however late.
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

/// Returns until when nodes are looked for of which one was just being linked to.
fn extended(begun: Time, deadline: Time, now: Time) -> Time {
    deadline.max((now + SHOWN_WITHIN).min(begun + LINKED_WITHIN))
}

/// Checks the answers of nodes in a team with the credentials that the node with this socket gives to its machine.
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
        // A healthy node, one that refuses, and one that is announced and serves nothing.
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
