//! Sends and receives messages of replicas over the node's session. News for all and messages to one replica are puts,
//! which may be lost. A question goes to exactly one replica, and has its own deadline. The replica asks again for
//! everything that does not arrive.

use super::{Arrival, Handle};
use crate::logic::database::question::Envelope;
use comms::io::session::{Author, CallError, Request, Server, Session, Subscription};
use comms::logic::port::Policy;
use comms::logic::{codec, key};
use dbmanager::logic::version_vector::ReplicaId;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::task::{AbortHandle, JoinSet};

/// The most messages that wait to be sent.
const OUTGOING_MAX: usize = 1024;
/// The most messages of other replicas that wait to be taken. Further ones are dropped; the replica asks for them again.
const INCOMING_MAX: usize = 1024;
/// The most requests and answers in transit. A replica asks two others in two seconds. A request to a replica that has
/// vanished stays open for a minute.
const ON_THE_WAY_MAX: usize = 256;

/// An outgoing message.
pub(super) enum Outgoing {
    /// A message to one replica, or to all.
    Put(Option<ReplicaId>, Vec<u8>),
    /// A question to one replica, and how long to wait for its answer.
    Ask(ReplicaId, Vec<u8>, Duration),
    /// The answer to a question.
    Reply(Box<Request>, Vec<u8>),
    /// From now on, the replica has this address.
    Address(ReplicaId),
}

/// The tasks that send and receive messages.
struct Wire {
    session: Arc<Session>,
    team: String,
    address: ReplicaId,
    handle: Handle,
    on_the_way: JoinSet<()>,
    /// The subscription at the present address.
    ears: Vec<AbortHandle>,
}

/// Begins to listen and to send. Returns the queue for outgoing messages, and the task. The task ends when the queue
/// has no sender any more.
pub(super) fn start(
    session: &Arc<Session>,
    team: &str,
    address: ReplicaId,
    handle: &Handle,
) -> Result<(Sender<Outgoing>, JoinSet<()>), CallError> {
    let (outgoing, to_send) = mpsc::channel(OUTGOING_MAX);
    let news = session.subscribe(&key::db_news_any(team), Policy::reject(INCOMING_MAX))?;
    let mut wire = Wire {
        session: Arc::clone(session),
        team: team.to_owned(),
        address,
        handle: handle.clone(),
        on_the_way: JoinSet::new(),
        ears: Vec::new(),
    };
    wire.on_the_way.spawn(hear(news, handle.clone()));
    wire.listen()?;
    let mut carrying = JoinSet::new();
    carrying.spawn(wire.carry(to_send));
    Ok((outgoing, carrying))
}

impl Wire {
    async fn carry(mut self, mut to_send: Receiver<Outgoing>) {
        while let Some(outgoing) = to_send.recv().await {
            while self.on_the_way.try_join_next().is_some() {}
            match outgoing {
                Outgoing::Put(to, bytes) => {
                    let key = match to {
                        Some(origin) => key::db_inbox(&self.team, origin.number()),
                        None => key::db_news(&self.team, self.address.number()),
                    };
                    if let Err(error) = self.session.put(&key, bytes) {
                        tracing::debug!(%error, "a message to other replicas was not sent");
                    }
                }
                Outgoing::Ask(..) | Outgoing::Reply(..) if self.on_the_way.len() > ON_THE_WAY_MAX => {
                    tracing::debug!("too many questions are being sent; one question is dropped");
                }
                Outgoing::Ask(to, bytes, within) => {
                    let (session, handle) = (Arc::clone(&self.session), self.handle.clone());
                    let key = key::db_ask(&self.team, to.number());
                    self.on_the_way.spawn(async move {
                        ask(session.call_signed(&key, bytes, within).await, &handle);
                    });
                }
                Outgoing::Reply(mut request, bytes) => {
                    self.on_the_way.spawn(async move {
                        request.reply(bytes).await;
                    });
                }
                Outgoing::Address(address) => {
                    self.address = address;
                    if let Err(error) = self.listen() {
                        tracing::error!(%error, "the database cannot be called under its new name");
                    }
                }
            }
        }
        // After this, no task uses the session any more.
        self.on_the_way.shutdown().await;
    }

    /// Listens at the present address and stops listening at the previous one.
    fn listen(&mut self) -> Result<(), CallError> {
        self.ears.drain(..).for_each(|ear| ear.abort());
        let number = self.address.number();
        let told = self.session.subscribe(&key::db_inbox(&self.team, number), Policy::reject(INCOMING_MAX))?;
        let asked = self.session.serve(&key::db_ask(&self.team, number))?;
        self.ears.push(self.on_the_way.spawn(hear(told, self.handle.clone())));
        self.ears.push(self.on_the_way.spawn(hear_questions(asked, self.handle.clone())));
        Ok(())
    }
}

async fn hear(mut envelopes: Subscription, handle: Handle) {
    while let Some((_, bytes, author)) = envelopes.next_signed().await {
        match codec::decode::<Envelope>(&bytes) {
            Ok(envelope) => handle.offer(Arrival::Envelope(envelope, author)),
            Err(error) => tracing::debug!(%error, "a message of another replica cannot be read"),
        }
    }
}

async fn hear_questions(mut questions: Server, handle: Handle) {
    while let Some(request) = questions.next().await {
        match codec::decode::<Envelope>(request.payload()) {
            Ok(envelope) => {
                let author = request.author();
                handle.offer(Arrival::Asked(Box::new(request), envelope, author));
            }
            Err(error) => request.refuse(&format!("the question cannot be read: {error}")),
        }
    }
}

/// Passes on the answer of another replica. If there is none, does nothing: the asking replica has its own deadline.
fn ask(answer: Result<(Vec<u8>, Author), CallError>, handle: &Handle) {
    match answer.map(|(bytes, author)| (codec::decode::<Envelope>(&bytes), author)) {
        Ok((Ok(envelope), author)) => handle.offer(Arrival::Envelope(envelope, author)),
        Ok((Err(error), _)) => tracing::debug!(%error, "an answer of another replica cannot be read"),
        Err(error) => tracing::debug!(%error, "another replica has not answered"),
    }
}
