//! Asks the database for the programs of this node, in parallel to the node's loop. There is a task for each request
//! and each watch of a program.
//!
//! When the channel of a program is closed, its tasks end. A transaction that the database already has is still carried out completely.

use crate::io::caller;
use crate::io::database::Handle;
use crate::io::secrets::Secrets;
use crate::logic::database::program::{self, Access};
use crate::logic::database::question::{Question, Reply};
use crate::logic::effect::{SecretArgument, SpawnOrder};
use crate::logic::protocol::{Answer, Deployment};
use comms::io::clock;
use comms::io::control::ControlSender;
use comms::logic::bytes::SecretBytes;
use comms::logic::control::{KeyPort, Order};
use comms::logic::database::{DatabaseAnswer, DatabaseRefusal, DatabaseRequest, REQUESTS_MAX, WATCHES_MAX, WINDOW};
use language::plan::KeyBinding;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::Semaphore;
use tokio::task::{AbortHandle, JoinSet};

/// The pause before a watch begins again that the database has ended, because the disk has failed or there are too many watches.
const AGAIN_AFTER: Duration = Duration::from_millis(500);
/// The first number of calls for programs. Calls of command lines have lower numbers, and calls of the node itself have higher ones.
const FIRST_CALL: u64 = 1 << 63;

/// Gives programs access to the database of their node.
#[derive(Clone, Debug)]
pub(crate) struct ProgramDatabase {
    database: Handle,
    access: Arc<Access>,
    next: Arc<AtomicU64>,
    secrets: Arc<Secrets>,
    connected: Arc<Mutex<BTreeMap<Deployment, BTreeMap<String, Connected>>>>,
}

/// The keys of the database that a program uses by its ports and secrets.
#[derive(Clone, Debug, Default)]
struct Connected {
    ports: Arc<[KeyPort]>,
    secrets: Arc<[SecretParameter]>,
}

/// A parameter of a program whose value is a secret.
#[derive(Clone, Debug)]
struct SecretParameter {
    name: String,
    key: String,
}

impl Connected {
    fn of(order: &SpawnOrder) -> Self {
        let port =
            |keys: &KeyBinding| KeyPort { port: keys.port.clone(), keys: keys.keys.clone(), is_write: keys.is_write };
        let parameter = |secret: &SecretArgument| {
            // This word is `password=`. The path of the file with the secret is added to it.
            let name = order.command.get(secret.word as usize)?.strip_suffix('=')?.to_owned();
            Some(SecretParameter { name, key: secret.key.clone() })
        };
        let secrets = order.secrets.iter().filter_map(parameter).collect();
        Self { ports: order.keys.iter().map(port).collect(), secrets }
    }
}

/// The open requests of one program.
#[derive(Debug)]
pub(crate) struct ProgramRequests {
    way: ProgramDatabase,
    connected: Connected,
    sender: ControlSender,
    /// The tasks of the requests.
    requests: JoinSet<()>,
    watches: BTreeMap<u64, Watching>,
    /// The tasks of the watches.
    followers: JoinSet<()>,
}

#[derive(Debug)]
struct Watching {
    /// How many more parts of the watch the program accepts now.
    room: Arc<Semaphore>,
    task: AbortHandle,
}

impl Drop for Watching {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl ProgramDatabase {
    pub(crate) fn new(database: Handle, access: Access, secrets: Arc<Secrets>) -> Self {
        let next = Arc::new(AtomicU64::new(FIRST_CALL));
        Self { database, access: Arc::new(access), next, secrets, connected: Arc::default() }
    }

    /// Notes the keys that a program uses, before the program is started or reconnects.
    pub(crate) fn connect(&self, order: &SpawnOrder) {
        let mut all = self.connected.lock().unwrap_or_else(PoisonError::into_inner);
        let of_deployment = all.entry(order.process.deployment.clone()).or_default();
        of_deployment.insert(order.path.clone(), Connected::of(order));
    }

    /// Forgets the programs of a deployment.
    pub(crate) fn forget(&self, deployment: &Deployment) {
        self.connected.lock().unwrap_or_else(PoisonError::into_inner).remove(deployment);
    }

    /// Opens the access of one program.
    pub(crate) fn open(&self, deployment: &Deployment, instance: &str, sender: ControlSender) -> ProgramRequests {
        let all = self.connected.lock().unwrap_or_else(PoisonError::into_inner);
        let connected = all.get(deployment).and_then(|programs| programs.get(instance)).cloned().unwrap_or_default();
        drop(all);
        let (requests, watches, followers) = (JoinSet::new(), BTreeMap::new(), JoinSet::new());
        ProgramRequests { way: self.clone(), connected, sender, requests, watches, followers }
    }

    fn ask(&self, question: Question) -> caller::Answers {
        let (caller, answers) = caller::answers();
        self.database.call(self.next.fetch_add(1, Ordering::Relaxed), question, Some(caller));
        answers
    }

    /// Asks a question with one answer. When this returns, the database has the question. So it gets questions in the
    /// order in which they were asked.
    fn answer(&self, question: Question) -> impl Future<Output = DatabaseAnswer> + Send + use<> {
        answer(self.ask(question))
    }

    /// Sends a program the changes of a watch. If the watch ends, begins it again.
    async fn follow(self, question: Question, number: u64, sender: ControlSender, room: Arc<Semaphore>) {
        loop {
            if !tell(&sender, number, DatabaseAnswer::Begin, &room).await {
                return;
            }
            let mut answers = self.ask(question.clone());
            while let Some(part) = answers.next().await.and_then(reply).and_then(program::part) {
                if !tell(&sender, number, part, &room).await {
                    return;
                }
            }
            drop(answers);
            clock::sleep_until(clock::now() + AGAIN_AFTER).await;
        }
    }

    /// Sends a program the present value of a secret, and each later value.
    async fn follow_secret(self, secret: SecretParameter, sender: ControlSender) {
        let Ok(question) = self.access.follow(&secret.key) else { return };
        loop {
            let mut answers = self.ask(question.clone());
            while let Some(reply) = answers.next().await.and_then(reply) {
                let is_present = matches!(&reply, Reply::Entries(entries) if !entries.is_empty());
                let is_change = is_present || matches!(reply, Reply::Notification(_));
                if is_change && !self.tell_secret(&secret, &sender).await {
                    return;
                }
            }
            drop(answers);
            clock::sleep_until(clock::now() + AGAIN_AFTER).await;
        }
    }

    /// Sends a program the present value of a secret. Returns whether the program can still be reached.
    async fn tell_secret(&self, SecretParameter { name, key }: &SecretParameter, sender: &ControlSender) -> bool {
        let value = match self.secrets.secret(key).await {
            Ok(secret) => SecretBytes::new(secret.expose().to_vec()),
            Err(error) => {
                tracing::warn!(error = format!("{error:#}"), "a program continues with the previous secret");
                return true;
            }
        };
        sender.send(&Order::Secret { parameter: name.clone(), value }).is_ok()
    }
}

async fn answer(mut answers: caller::Answers) -> DatabaseAnswer {
    while let Some(answer) = answers.next().await {
        if let Some(answer) = reply(answer).and_then(program::answer) {
            return answer;
        }
    }
    DatabaseAnswer::Unknown { why: "the database has ended without an answer".to_owned() }
}

fn reply(answer: Answer) -> Option<Reply> {
    if let Answer::Database(reply) = answer { Some(reply) } else { None }
}

/// Sends a part of a watch, once the program accepts another part. Returns whether the program can still be reached.
async fn tell(sender: &ControlSender, number: u64, answer: DatabaseAnswer, room: &Semaphore) -> bool {
    let Ok(permit) = room.acquire().await else { return false };
    permit.forget();
    send(sender, number, answer)
}

fn send(sender: &ControlSender, number: u64, answer: DatabaseAnswer) -> bool {
    let sent = sender.send(&Order::Database { number, answer });
    if let Err(error) = &sent {
        tracing::warn!(%error, "a program does not take an answer of the database");
    }
    sent.is_ok()
}

impl ProgramRequests {
    /// Tells a new program which keys its ports use. A program that reconnects knows this already.
    pub(crate) fn tell_ports(&self) {
        let ports = &self.connected.ports;
        if !ports.is_empty()
            && let Err(error) = self.sender.send(&Order::Keys { ports: ports.to_vec() })
        {
            tracing::debug!(%error, "cannot tell a program which database keys its ports use");
        }
    }

    /// From now on, sends the program its secrets after each change.
    pub(crate) fn follow_secrets(&mut self) {
        for secret in self.connected.secrets.iter().cloned() {
            self.followers.spawn(self.way.clone().follow_secret(secret, self.sender.clone()));
        }
    }

    /// Handles a request of the program.
    pub(crate) fn take(&mut self, number: u64, request: DatabaseRequest) {
        while self.requests.try_join_next().is_some() {}
        while self.followers.try_join_next().is_some() {}
        let access = &self.way.access;
        let question = match request {
            DatabaseRequest::Taken { parts } => return self.has_taken(number, parts),
            DatabaseRequest::Cancel => return drop(self.watches.remove(&number)),
            DatabaseRequest::Watch { prefix } => {
                let question = access.follow(&prefix);
                return self.watch(number, question);
            }
            DatabaseRequest::Get { key } => access.get(key),
            DatabaseRequest::Transact(transaction) => access.transact(transaction, &self.connected.ports),
        };
        let question = if self.requests.len() < REQUESTS_MAX { question } else { Err(program::busy()) };
        match question {
            Ok(question) => {
                let (answer, sender) = (self.way.answer(question), self.sender.clone());
                self.requests.spawn(async move {
                    send(&sender, number, answer.await);
                });
            }
            Err(why) => drop(send(&self.sender, number, DatabaseAnswer::Refused(why))),
        }
    }

    fn watch(&mut self, number: u64, question: Result<Question, DatabaseRefusal>) {
        let has_room = self.watches.len() < WATCHES_MAX && !self.watches.contains_key(&number);
        let question =
            question.and_then(|question| if has_room { Ok(question) } else { Err(program::watches_enough()) });
        match question {
            Ok(question) => {
                let room = Arc::new(Semaphore::new(usize::try_from(WINDOW).unwrap_or(1)));
                let following = self.way.clone().follow(question, number, self.sender.clone(), Arc::clone(&room));
                let task = self.followers.spawn(following);
                self.watches.insert(number, Watching { room, task });
            }
            Err(why) => drop(send(&self.sender, number, DatabaseAnswer::Refused(why))),
        }
    }

    /// Notes that the program accepts further parts of a watch, up to the allowed number.
    fn has_taken(&self, number: u64, parts: u32) {
        let Some(Watching { room, .. }) = self.watches.get(&number) else { return };
        let missing = usize::try_from(WINDOW).unwrap_or(1).saturating_sub(room.available_permits());
        room.add_permits(usize::try_from(parts).unwrap_or(usize::MAX).min(missing));
    }
}
