//! Messages of replicas over the node's session. News to all and messages to one replica are puts that may be lost. A
//! question goes to exactly one replica and has its own deadline. The replica asks again for whatever does not arrive.

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

/// How many messages wait to be sent.
const OUTGOING_MAX: usize = 1024;
/// How many messages of others wait to be taken; others are dropped, and asked for again.
const INCOMING_MAX: usize = 1024;
/// How many requests and answers are in transit at a time. A replica asks two others in two seconds, and a replica that
/// vanished leaves its request open for a minute.
const ON_THE_WAY_MAX: usize = 256;

/// An outgoing message.
pub(super) enum Outgoing {
    /// To one, or to all.
    Put(Option<ReplicaId>, Vec<u8>),
    /// A question to one, and how long its answer is waited for.
    Ask(ReplicaId, Vec<u8>, Duration),
    /// The answer to a question.
    Reply(Box<Request>, Vec<u8>),
    /// This replica has this name from now on.
    Address(ReplicaId),
}

/// The tasks that carry messages.
struct Wire {
    session: Arc<Session>,
    team: String,
    address: ReplicaId,
    handle: Handle,
    on_the_way: JoinSet<()>,
    /// The subscription at the present address.
    ears: Vec<AbortHandle>,
}

/// Begins to listen and to send. Returns the queue for outgoing messages, and the task, which ends when the queue has
/// no sender any more.
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
        // No task holds the session any more when this ends.
        self.on_the_way.shutdown().await;
    }

    /// Listens at the present address, and at no other.
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

/// Hands on the answer of another replica. Without one nothing happens: the asking replica has its own deadline.
fn ask(answer: Result<(Vec<u8>, Author), CallError>, handle: &Handle) {
    match answer.map(|(bytes, author)| (codec::decode::<Envelope>(&bytes), author)) {
        Ok((Ok(envelope), author)) => handle.offer(Arrival::Envelope(envelope, author)),
        Ok((Err(error), _)) => tracing::debug!(%error, "an answer of another replica cannot be read"),
        Err(error) => tracing::debug!(%error, "another replica has not answered"),
    }
}
