//! A router of a controller, and the user that subscribes to a router.
//!
//! The subscriber always has one call open at the router. The router answers it with the next message that the filters
//! of the subscriber accept. So a spec connects a subscription like any call, the sender evaluates the filters, and a
//! missing subscriber is noticed.

use super::queue::{EncodedMessage, Label};
use super::{Queue, QueueMessage, Receipt, Rejected};
use crate::sdk::calls::Calls;
use crate::sdk::export::Reply;
use crate::sdk::port::Message;
use comms::io::entropy;
use comms::logic::messaging::request::Numbering;
use comms::logic::messaging::router::{
    DeliveryEnd, Filter, GONE_AFTER, Gone, RENEW_EVERY, Router as Machine, RouterEffect, RouterInput, RouterSettings,
};
use comms::logic::messaging::wire::{RouterAnswer, RouterRefusal, RouterRequest, RouterStatus};
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::io;
use std::marker::PhantomData;
use std::time::Duration;

/// How many subscribers may ask between two calculations.
const ASKED_MAX: usize = 512;
/// How many dropped subscribers wait to be reported.
const DROPPED_MAX: usize = 256;
/// How long a subscriber waits for an answer: longer than a router waits for a message.
const ASK_WITHIN: Duration = Duration::from_secs(3);
/// The pause after a subscription that was refused or did not reach the router.
const PAUSE: Duration = Duration::from_millis(500);

/// The call of a subscriber that is ready for its next message. It also contains the result of the last message.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Subscription {
    /// The name of the subscriber, for people.
    pub name: String,
    /// A random number for one run of the subscriber.
    pub life: u64,
    /// The type of the messages that it takes.
    pub type_name: String,
    /// The subscriber wants the messages that one of these filters accepts; without filters, all messages.
    pub filters: Vec<Filter>,
    /// The number of the last delivery that has arrived, and its result.
    pub last: Option<(u64, Receipt)>,
}

/// The answer of a router to a [`Subscription`].
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Delivery {
    /// No message yet: the subscriber is in the register, and asks again.
    Nothing,
    /// The next message.
    Message {
        /// The number of the delivery.
        number: u64,
        /// The message.
        message: QueueMessage,
    },
    /// The subscriber is not in the register, and cannot be.
    Refused(RouterRefusal),
}

impl Message for Subscription {
    const TYPE: &'static str = "Subscription";
}

impl Message for Delivery {
    const TYPE: &'static str = "Delivery";
}

impl Message for RouterStatus {
    const TYPE: &'static str = "RouterStatus";
}

/// Sends each message to all subscribers whose filters accept its header. It is a field of a controller, which exports
/// a procedure for it: `exports.procedure_later("News", "...", |desk: &mut Desk, subscription, reply|
/// desk.news.ask(subscription, reply))`.
///
/// A slow subscriber fills its own outbox, from which the oldest message is dropped, and does not delay other
/// subscribers. If a subscriber is silent for 5 s, it is dropped from the register. Dropped messages and dropped
/// subscribers are counted.
#[derive(Debug)]
pub struct Router<T> {
    machine: Machine,
    sender: String,
    numbering: Numbering,
    asked: Vec<(Subscription, Reply<Delivery>)>,
    /// Subscribers that wait for a message, and since when.
    open: BTreeMap<String, (Reply<Delivery>, Time)>,
    /// Deliveries that wait for the next call of their subscriber.
    ready: BTreeMap<String, (u64, QueueMessage)>,
    /// Deliveries whose receipt has not arrived yet.
    sent: BTreeMap<String, u64>,
    dropped: Vec<Dropped>,
    of: PhantomData<fn(T)>,
}

/// A subscriber that was dropped from the register.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Dropped {
    /// The name of the subscriber.
    pub name: String,
    /// The reason why it was dropped.
    pub why: Gone,
    /// How many messages for this subscriber were lost.
    pub lost: u64,
}

impl<T: Message> Router<T> {
    /// Returns a router without subscribers. `sender` is the sender of its messages. `outbox_max`
    /// is the largest number of messages that wait for one subscriber. Zero means one.
    ///
    /// # Errors
    /// If the system gives no random number for the router.
    pub fn new(sender: &str, outbox_max: usize) -> io::Result<Self> {
        Self::of_type(T::TYPE.to_owned(), sender, outbox_max)
    }

    /// Returns a router for encoded messages of this type, for a program in another language.
    ///
    /// # Errors
    /// As in [`Router::new`].
    pub fn of_type(type_name: String, sender: &str, outbox_max: usize) -> io::Result<Self> {
        let settings = RouterSettings { type_name, outbox_max, gone_after: GONE_AFTER };
        Ok(Self {
            machine: Machine::new(settings),
            sender: sender.to_owned(),
            numbering: Numbering::new(entropy::number()?),
            asked: Vec::new(),
            open: BTreeMap::new(),
            ready: BTreeMap::new(),
            sent: BTreeMap::new(),
            dropped: Vec::new(),
            of: PhantomData,
        })
    }

    /// Takes a subscription; the next [`Router::work`] handles it.
    pub fn ask(&mut self, subscription: Subscription, reply: Reply<Delivery>) {
        if self.asked.len() < ASKED_MAX {
            self.asked.push((subscription, reply));
        } else {
            reply.refuse("too many clients subscribe at the same time");
        }
    }

    /// Sends a message to all subscribers whose filters accept it, with the next [`Router::work`]; returns its number.
    ///
    /// # Errors
    /// If the data or a name is too long.
    pub fn send(&mut self, now: Time, label: Label<'_>, data: &T) -> Result<u64, String> {
        self.send_encoded(now, label.message(data)?)
    }

    /// Sends a message with encoded data. Otherwise it works like [`Router::send`].
    ///
    /// # Errors
    /// If the data or a name is too long.
    pub fn send_encoded(&mut self, now: Time, message: EncodedMessage) -> Result<u64, String> {
        let id = self.numbering.next();
        let message = message.numbered(id, &self.sender)?;
        self.handle(now, RouterInput::Publish(message));
        Ok(id.number)
    }

    /// Answers subscribers, and drops missing ones. Called once in each calculation.
    pub fn work(&mut self, now: Time) {
        for (subscription, reply) in std::mem::take(&mut self.asked) {
            self.subscribe(now, subscription, reply);
        }
        self.handle(now, RouterInput::Tick);
        let waiting = std::mem::take(&mut self.open);
        for (key, (reply, since)) in waiting {
            if !reply.is_wanted() {
                continue;
            }
            if let Some((number, message)) = self.ready.remove(&key) {
                self.sent.insert(key, number);
                reply.send(Delivery::Message { number, message });
            } else if now.since(since) >= RENEW_EVERY {
                reply.send(Delivery::Nothing);
            } else {
                self.open.insert(key, (reply, since));
            }
        }
    }

    /// Returns a subscriber that was dropped. Callers repeat this until it returns none. Dropped subscribers are also
    /// counted if this is never called.
    pub fn dropped(&mut self) -> Option<Dropped> {
        if self.dropped.is_empty() { None } else { Some(self.dropped.remove(0)) }
    }

    /// Returns the status of the router for people.
    pub fn status(&self) -> RouterStatus {
        let mut status = self.machine.status(T::FIELDS.to_owned());
        status.subscribers.iter_mut().for_each(|one| one.queue = name_of(&one.queue).to_owned());
        status
    }

    fn subscribe(&mut self, now: Time, subscription: Subscription, reply: Reply<Delivery>) {
        let Subscription { name, life, type_name, filters, last } = subscription;
        let key = format!("{name} {life:016x}");
        let before = self.sent.remove(&key);
        if let Some(number) = before {
            let end = match last {
                Some((known, receipt)) if known == number => DeliveryEnd::Receipt(receipt),
                // The answer was lost in transit. It is sent again, and the subscriber's queue takes it only once.
                _ => DeliveryEnd::Unreachable,
            };
            self.handle(now, RouterInput::Delivered { queue: key.clone(), delivery: number, end });
        }
        let request = RouterRequest::Subscribe { queue: key.clone(), type_name, filters };
        match self.handle(now, RouterInput::Request(request)) {
            Some(RouterAnswer::Refused(refusal)) => reply.send(Delivery::Refused(refusal)),
            // The subscriber learns at once that it is in the register.
            Some(RouterAnswer::Subscribed { is_known: false, .. }) => reply.send(Delivery::Nothing),
            Some(RouterAnswer::Subscribed { .. } | RouterAnswer::Unsubscribed | RouterAnswer::Status(_)) | None => {
                self.open.insert(key, (reply, now));
            }
        }
    }

    fn handle(&mut self, now: Time, input: RouterInput) -> Option<RouterAnswer> {
        let (mut effects, mut answer) = (Vec::new(), None);
        self.machine.handle(now, input, &mut effects);
        for effect in effects {
            match effect {
                RouterEffect::Answer(answered) => answer = Some(answered),
                RouterEffect::Deliver { queue, delivery, mut message, .. } => {
                    message.header.recipient = name_of(&queue).to_owned();
                    self.ready.insert(queue, (delivery, message));
                }
                RouterEffect::Dropped { queue, why, lost } => {
                    self.ready.remove(&queue);
                    self.sent.remove(&queue);
                    self.open.remove(&queue);
                    if self.dropped.len() < DROPPED_MAX {
                        self.dropped.push(Dropped { name: name_of(&queue).to_owned(), why, lost });
                    }
                }
            }
        }
        answer
    }
}

/// Returns the name of a subscriber, without its life.
fn name_of(key: &str) -> &str {
    key.rsplit_once(' ').map_or(key, |(name, _)| name)
}

/// The state of a user's subscription.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Subscribed {
    /// It is not known yet whether the router sends to the user.
    Asking,
    /// The router sends to the user.
    Yes,
    /// The router does not send, and gives the reason.
    Refused(RouterRefusal),
    /// No router is available, or it did not answer.
    Unknown(ObjectError),
}

/// Subscribes to the router that the spec connects, together with a field `#[calls("News")] news: Calls<Subscription,
/// Delivery>`. Messages go into a queue of the controller.
#[derive(Debug)]
pub struct RouterUser {
    name: String,
    life: u64,
    filters: Vec<Filter>,
    /// The number of the open call, and the time at which the user stops waiting for it.
    open: Option<(u64, Time)>,
    last: Option<(u64, Receipt)>,
    /// The time of the next call.
    due: Time,
    state: Subscribed,
}

impl RouterUser {
    /// Returns a user that wants the messages that one of the filters accepts; without filters, all messages. `name` is
    /// for people.
    ///
    /// # Errors
    /// If the system gives no random number for the user.
    pub fn new(name: &str, filters: Vec<Filter>) -> io::Result<Self> {
        let (life, name, due) = (entropy::number()?, name.to_owned(), Time::ZERO);
        Ok(Self { name, life, filters, open: None, last: None, due, state: Subscribed::Asking })
    }

    /// Takes the messages that have arrived, and asks for more. Called once in each calculation.
    pub fn work<T: Message>(&mut self, now: Time, calls: &mut Calls<Subscription, Delivery>, queue: &mut Queue<T>) {
        self.work_with(now, calls, T::TYPE, &mut |message| queue.receive(message));
    }

    /// Does the same as [`RouterUser::work`] for messages of the type `type_name`, which `receive` takes.
    pub fn work_with(
        &mut self,
        now: Time,
        calls: &mut Calls<Subscription, Delivery>,
        type_name: &str,
        receive: &mut dyn FnMut(QueueMessage) -> Receipt,
    ) {
        while let Some((number, answer)) = calls.answer() {
            if self.open.take_if(|(open, _)| *open == number).is_some() {
                self.answered(now, answer, receive);
            }
        }
        // Answers to calls of an earlier activation never arrive.
        self.open.take_if(|(_, until)| *until <= now);
        if self.open.is_none() && self.due <= now {
            let (name, life, type_name) = (self.name.clone(), self.life, type_name.to_owned());
            let (filters, last) = (self.filters.clone(), self.last.clone());
            let subscription = Subscription { name, life, type_name, filters, last };
            self.open = Some((calls.call(subscription, ASK_WITHIN), now + 2 * ASK_WITHIN));
        }
    }

    /// Replaces the filters from now on.
    pub fn set_filters(&mut self, filters: Vec<Filter>) {
        self.filters = filters;
    }

    /// Returns the state of the subscription.
    pub const fn state(&self) -> &Subscribed {
        &self.state
    }

    fn answered(
        &mut self,
        now: Time,
        answer: Result<Delivery, ObjectError>,
        receive: &mut dyn FnMut(QueueMessage) -> Receipt,
    ) {
        self.due = now;
        self.state = match answer {
            Ok(Delivery::Nothing) => Subscribed::Yes,
            Ok(Delivery::Message { number, message }) => {
                let receipt = receive(message);
                if let Receipt::Rejected(Rejected::WrongType { .. }) = receipt {
                    self.due = now + PAUSE;
                }
                self.last = Some((number, receipt));
                Subscribed::Yes
            }
            Ok(Delivery::Refused(refusal)) => {
                self.due = now + PAUSE;
                Subscribed::Refused(refusal)
            }
            Err(error) => {
                self.due = now + PAUSE;
                Subscribed::Unknown(error)
            }
        };
    }
}

#[cfg(test)]
mod tests;
