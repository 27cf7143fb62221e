//! A command line's connection to the nodes: through a node of this machine when there is one, else over the network.

use crate::cli::{Failure, Reaching};
use crate::io::run_dir;
use crate::logic::protocol::{Answer, NodeStatus, Request};
use anyhow::{Context, anyhow};
use comms::io::clock;
use comms::io::session::{CallError, Presence, Replies, Session};
use comms::logic::{codec, key};
use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

/// How long a node has to answer a question that it can answer at once.
const ANSWER_WITHIN: Duration = Duration::from_secs(3);
/// How long nodes are looked for on the network.
const FIND_WITHIN: Duration = Duration::from_millis(1500);
/// The verb of every request: the request itself says what is asked.
const VERB: &str = "request";

/// A connection to the nodes.
#[derive(Debug)]
pub(crate) struct Client {
    session: Session,
}

/// The answers to one request, as they come.
#[derive(Debug)]
pub(crate) struct Answers {
    replies: Replies,
}

impl Client {
    /// Connects through a node of this machine, or by scouting when `--lan` is given.
    pub(crate) async fn open(reaching: &Reaching) -> Result<Self, Failure> {
        let base = reaching.run_dir.clone().unwrap_or_else(run_dir::default_base);
        let mut problem = None;
        for (name, socket) in run_dir::running(&base) {
            match Session::open_client(&socket).await {
                Ok(session) => return Ok(Self { session }),
                Err(error) => problem = Some(anyhow!(error).context(format!("connecting to the node `{name}`"))),
            }
        }
        if reaching.lan {
            let session = Session::open_scout().await.context("looking for nodes on the network");
            return Ok(Self { session: session.map_err(Failure::Unreachable)? });
        }
        let none = || {
            anyhow!("no node runs on this machine; start one with `dca-node --name NAME`, or look further with `--lan`")
        };
        Err(Failure::Unreachable(problem.unwrap_or_else(none)))
    }

    /// Connects to the node that has this socket.
    pub(crate) async fn to_socket(socket: PathBuf) -> Result<Self, Failure> {
        let session =
            Session::open_client(&socket).await.with_context(|| format!("connecting to {}", socket.display()));
        Ok(Self { session: session.map_err(Failure::Unreachable)? })
    }

    /// Returns the nodes that can be reached: at once when all of `wanted` are there, else after a while.
    pub(crate) async fn hosts(&self, wanted: &[String]) -> Result<BTreeSet<String>, Failure> {
        let mut watch = self.session.watch(&key::live_any()).map_err(unreachable)?;
        let mut hosts = BTreeSet::new();
        let deadline = clock::now() + FIND_WITHIN;
        loop {
            if !wanted.is_empty() && wanted.iter().all(|host| hosts.contains(host)) {
                return Ok(hosts);
            }
            let presence = tokio::select! {
                presence = watch.next() => presence,
                () = clock::sleep_until(deadline) => None,
            };
            match presence {
                Some(Presence::Appeared(key)) => hosts.extend(key::parse_live(&key).map(|(host, _)| host)),
                Some(Presence::Vanished(key)) => drop(key::parse_live(&key).map(|(host, _)| hosts.remove(&host))),
                None => return Ok(hosts),
            }
        }
    }

    /// Asks a node something that has one answer.
    pub(crate) async fn ask(&self, host: &str, request: &Request, within: Duration) -> Result<Answer, Failure> {
        let bytes = codec::encode(request)?;
        let reply = self.session.call(&key::rpc(host, VERB), bytes, within).await;
        let reply = reply.map_err(|error| call_failure(host, error))?;
        Ok(codec::decode(&reply)?)
    }

    /// Asks a node something that has a stream of answers.
    pub(crate) fn ask_on(&self, host: &str, request: &Request) -> Result<Answers, Failure> {
        let bytes = codec::encode(request)?;
        let replies = self.session.call_stream(&key::rpc(host, VERB), bytes);
        Ok(Answers { replies: replies.map_err(|error| call_failure(host, error))? })
    }

    /// Returns the state of every node that answers, in order of name.
    pub(crate) async fn statuses(&self) -> Result<Vec<NodeStatus>, Failure> {
        let mut statuses = Vec::new();
        for host in self.hosts(&[]).await? {
            let answer = self.ask(&host, &Request::Status, ANSWER_WITHIN).await?;
            let Answer::Status(status) = answer else { return Err(unasked(&host, &answer)) };
            statuses.push(status);
        }
        Ok(statuses)
    }

    /// Closes the connection.
    pub(crate) async fn close(self) {
        self.session.close().await;
    }
}

impl Answers {
    /// Returns the next answer; none when the node has said everything, or is gone.
    pub(crate) async fn next(&mut self) -> Option<anyhow::Result<Answer>> {
        let reply = self.replies.next().await?;
        Some(reply.map_err(anyhow::Error::from).and_then(|bytes| Ok(codec::decode(&bytes)?)))
    }
}

/// Says that a node answered something that was not asked; its own refusals are passed on as they are.
pub(crate) fn unasked(host: &str, answer: &Answer) -> Failure {
    if let Answer::Refused(why) = answer {
        return anyhow!("host `{host}`: {why}").into();
    }
    anyhow!("host `{host}` answered something that was not asked: {answer:?}").into()
}

fn call_failure(host: &str, error: CallError) -> Failure {
    Failure::Unreachable(anyhow!(error).context(format!("asking the node `{host}`")))
}

fn unreachable(error: impl Into<anyhow::Error>) -> Failure {
    Failure::Unreachable(error.into())
}

/// Runs a verb that talks to nodes.
pub(crate) fn block_on<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    let result = runtime.block_on(work);
    runtime.shutdown_timeout(Duration::from_secs(2));
    result
}
