//! `dca estop`: stops everything on every host at once. Nothing begins there before `dca estop --release`.
//!
//! The command asks each node itself, so neither the home of a deployment nor all hosts have to answer. A host counts
//! as stopped only if it confirms that none of its programs runs. A host that does not answer is named, and the exit
//! code is 3.

use crate::ConnectArgs;
use crate::absent;
use crate::client::{ANSWER_WITHIN, Client, Clients, Statuses, unasked, words};
use crate::io::user;
use anyhow::anyhow;
use comms::io::clock;
use comms::logic::human::span;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Answer, Estop, Estopped, Request};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;
use view::{Fleet, RobotId};

/// How long programs may take to stop. After this time, their host counts as not answering.
const STOP_WITHIN: Duration = Duration::from_secs(30);

/// The arguments of `dca estop`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The reason, shown to every user
    #[arg(conflicts_with = "release")]
    reason: Option<String>,
    /// Let programs begin again
    #[arg(long)]
    release: bool,
    /// Print the result of each host as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// The result of a host.
pub(crate) enum Outcome {
    /// Nothing runs on the host, except for the named processes.
    Stopped(Estopped),
    /// Programs may begin on the host. The values say whether they were stopped before, and why the disk could not store the release.
    Released(bool, Option<String>),
    /// The host has refused the request.
    Refused(String),
    /// The state of the host is unknown.
    Unknown(String),
    /// The keys of the host are revoked: no node of the team links to it.
    Revoked,
}

/// The hosts that one connection reaches.
struct Reached {
    outcomes: BTreeMap<String, Outcome>,
    /// The states of the hosts, after they were asked.
    statuses: Result<Statuses, Failure>,
}

impl Outcome {
    /// Returns whether the host has confirmed all that it was asked for.
    pub(crate) fn is_confirmed(&self) -> bool {
        match self {
            Self::Stopped(there) => there.unended.is_empty() && there.unwritten.is_none(),
            Self::Released(_, unwritten) => unwritten.is_none(),
            Self::Refused(_) | Self::Unknown(_) | Self::Revoked => false,
        }
    }

    /// Returns why the disk of the host could not store the stop or the release; nothing if it could.
    fn unwritten(&self) -> Option<&str> {
        match self {
            Self::Stopped(there) => there.unwritten.as_deref(),
            Self::Released(_, unwritten) => unwritten.as_deref(),
            Self::Refused(_) | Self::Unknown(_) | Self::Revoked => None,
        }
    }
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let request = if arguments.release {
        Request::ReleaseEstop
    } else {
        Request::Estop(Estop { by: user::name_and_host(), reason: arguments.reason.clone().unwrap_or_default() })
    };
    let hosts = block_on(async {
        // An emergency stop reaches every group of nodes, even if the user has named a folder.
        let clients = Clients::open_all(&arguments.connect).await?;
        let hosts = everywhere(&clients, &request).await;
        clients.close().await;
        hosts
    })?;
    if arguments.json {
        let hosts: Vec<_> = hosts.iter().map(|(host, outcome)| in_json(host, outcome)).collect();
        console::answer(&json!({ "hosts": hosts }));
    } else {
        hosts.iter().for_each(|(host, outcome)| console::say(&format!("{host}: {}", in_words(outcome))));
    }
    if let Some(hanging) = named(&hosts, |outcome| matches!(outcome, Outcome::Unknown(_))) {
        let what = if arguments.release { "may begin" } else { "runs" };
        return Err(Failure::Unreachable(anyhow!("it is not known what {what} on {hanging}; repeat the same command")));
    }
    if let Some(refused) = named(&hosts, |outcome| matches!(outcome, Outcome::Refused(_))) {
        return Err(anyhow!("refused by {refused}").into());
    }
    if let Some(left) = named(&hosts, |outcome| matches!(outcome, Outcome::Stopped(there) if !there.unended.is_empty()))
    {
        return Err(anyhow!(
            "some processes could not be ended on {left}: end them there; `dca status` names the processes that still run"
        )
        .into());
    }
    if let Some(unwritten) = named(&hosts, |outcome| outcome.unwritten().is_some()) {
        let what = if arguments.release { "programs may begin" } else { "everything is stopped" };
        return Err(anyhow!(
            "the disk of {unwritten} could not store this: after a restart, the node would not know that {what}; make room on the disk, \
             then repeat the same command"
        )
        .into());
    }
    if !arguments.release && !arguments.json {
        console::note("no program starts on these hosts before `dca estop --release`");
    }
    Ok(())
}

/// Asks each known host, over all connections at once. If a host is inside a command, its name is followed by the
/// command: hosts of several commands may have the same name.
pub(crate) async fn everywhere(clients: &Clients, request: &Request) -> Result<BTreeMap<String, Outcome>, Failure> {
    // If a command has ended, its nodes have ended as well, and run nothing.
    let present: Vec<Arc<Client>> = clients.shared().into_iter().filter(|client| !client.has_ended()).collect();
    let asked = present.iter().map(|client| {
        let (mut asked, request, client) = (JoinSet::new(), request.clone(), Arc::clone(client));
        asked.spawn(async move { over(&client, &request).await });
        asked
    });
    let (mut hosts, mut found, mut failed) = (BTreeMap::new(), Vec::new(), Vec::new());
    let asked: Vec<JoinSet<Reached>> = asked.collect();
    for (client, mut asked) in present.iter().map(|client| &**client).zip(asked) {
        let (outcomes, statuses) = match asked.join_next().await {
            Some(Ok(Reached { outcomes, statuses })) => (outcomes, statuses),
            Some(Err(panic)) => (BTreeMap::new(), Err(panic.into())),
            None => continue,
        };
        // A command ends with its mission, perhaps before its nodes have given their status.
        let has_answered = client.fleet() != Fleet::Standing && !outcomes.is_empty();
        let name = |host| RobotId { host, fleet: client.fleet() }.to_string();
        hosts.extend(outcomes.into_iter().map(|(host, outcome)| (name(host), outcome)));
        match statuses {
            Ok(statuses) => found.push((client, statuses)),
            Err(_) if has_answered => {}
            Err(failure) => failed.push((client, failure)),
        }
    }
    if found.is_empty()
        && let Some((_, failure)) = failed.pop()
    {
        return Err(failure);
    }
    for (client, failure) in failed {
        let host = client.local().unwrap_or("the network").to_owned();
        let name = RobotId { host, fleet: client.fleet() }.to_string();
        hosts.entry(name).or_insert_with(|| Outcome::Unknown(words(&failure)));
    }
    let away = absent::ask(&found).await;
    for host in away.hosts.iter().map(|one| &one.host).chain(&away.silent) {
        hosts.entry(host.clone()).or_insert_with(|| Outcome::Unknown("does not answer".to_owned()));
    }
    let answers = |outcome: &Outcome| !matches!(outcome, Outcome::Unknown(_));
    for host in away.revoked {
        if !hosts.get(&host).is_some_and(answers) {
            hosts.insert(host, Outcome::Revoked);
        }
    }
    if let Some(why) = clients.hanging() {
        hosts.insert("this machine".to_owned(), Outcome::Unknown(why));
    }
    if hosts.is_empty() {
        return Err(Failure::Unreachable(anyhow!("no node answers: nothing was stopped")));
    }
    Ok(hosts)
}

/// Asks each host that a connection reaches.
async fn over(client: &Client, request: &Request) -> Reached {
    // If this question fails, the statuses below name the hosts.
    let known = client.all().await.unwrap_or_default();
    let mut outcomes: BTreeMap<String, Outcome> = wave(client, &known, request).await.into_iter().collect();
    let statuses = client.statuses_noted(|_| {}).await;
    // The statuses may name further hosts, which have appeared in the meantime, or which only other hosts know.
    if let Ok(statuses) = &statuses {
        let named = statuses.nodes.iter().flat_map(|node| node.peers.iter().chain([&node.host])).cloned();
        let more: BTreeSet<String> = named.filter(|host| !outcomes.contains_key(host)).collect();
        outcomes.extend(wave(client, &more, request).await);
    }
    Reached { outcomes, statuses }
}

/// Asks some hosts at once, and waits for all of them.
async fn wave(client: &Client, hosts: &BTreeSet<String>, request: &Request) -> Vec<(String, Outcome)> {
    let mut asked = Vec::new();
    for host in hosts {
        asked.push((host, client.order_on(host, request.clone(), 0).await));
    }
    let within = if *request == Request::ReleaseEstop { ANSWER_WITHIN } else { STOP_WITHIN };
    let deadline = clock::now() + within;
    let mut outcomes = Vec::new();
    for (host, answers) in asked {
        let answer = match answers {
            Ok(mut answers) => answers.next_by(deadline).await,
            Err(failure) => Some(Err(failure)),
        };
        let outcome = match answer {
            Some(Ok(Answer::Estopped(estopped))) => Outcome::Stopped(estopped),
            Some(Ok(Answer::Released { was_stopped, unwritten })) => Outcome::Released(was_stopped, unwritten),
            Some(Ok(other)) => Outcome::Refused(words(&unasked(host, &other))),
            Some(Err(failure @ Failure::Refused(_))) => Outcome::Refused(words(&failure)),
            Some(Err(failure)) => Outcome::Unknown(words(&failure)),
            None => Outcome::Unknown(format!("it has not confirmed within {} that no program runs", span(within))),
        };
        outcomes.push((host.clone(), outcome));
    }
    outcomes
}

/// Returns the hosts with a certain outcome, as in "`c1`, `c2`"; nothing if there are none.
fn named(hosts: &BTreeMap<String, Outcome>, is_so: impl Fn(&Outcome) -> bool) -> Option<String> {
    let named: Vec<String> =
        hosts.iter().filter(|(_, outcome)| is_so(outcome)).map(|(host, _)| format!("`{host}`")).collect();
    (!named.is_empty()).then(|| named.join(", "))
}

fn but_unwritten(why: Option<&str>) -> String {
    why.map_or_else(String::new, |why| format!("; its disk could not store this: {why}"))
}

/// Returns the result of a host in words that follow its name.
pub(crate) fn in_words(outcome: &Outcome) -> String {
    match outcome {
        Outcome::Stopped(there) => {
            let left = match &there.unended[..] {
                [] => "stopped; no program runs".to_owned(),
                left => format!("stopped, but these programs could not be ended: {}", left.join(", ")),
            };
            left + &but_unwritten(there.unwritten.as_deref())
        }
        Outcome::Released(was_stopped, unwritten) => {
            let words = if *was_stopped {
                "released: programs may begin again"
            } else {
                "was not stopped before: programs may begin"
            };
            words.to_owned() + &but_unwritten(unwritten.as_deref())
        }
        Outcome::Refused(why) | Outcome::Unknown(why) => why.clone(),
        Outcome::Revoked => "its keys are revoked: the host is not asked, and its programs are not known".to_owned(),
    }
}

/// Returns the result of a host as JSON.
pub(crate) fn in_json(host: &str, outcome: &Outcome) -> serde_json::Value {
    match outcome {
        Outcome::Stopped(Estopped { unended, unwritten }) => {
            json!({ "host": host, "stopped": true, "unended": unended, "unwritten": unwritten })
        }
        Outcome::Released(was_stopped, unwritten) => {
            json!({ "host": host, "released": true, "was_stopped": was_stopped, "unwritten": unwritten })
        }
        Outcome::Refused(why) => json!({ "host": host, "refused": why }),
        Outcome::Unknown(why) => json!({ "host": host, "unknown": why }),
        Outcome::Revoked => json!({ "host": host, "revoked": true }),
    }
}
