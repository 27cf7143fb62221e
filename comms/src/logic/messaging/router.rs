//! A router: sends each message to every subscribed queue whose filters accept its header.
//!
//! The filters are evaluated here, at the sender, so no unwanted message is sent. Each subscriber has its own outbox
//! with one message in transit: a slow or absent subscriber fills only its own outbox and delays no other. A message
//! that was not received is sent again with the same identifier, so its queue takes it once. A subscriber whose queue
//! has ended, or that has been silent for long, is removed from the register. Invariant: each message that a
//! subscriber's filters accepted was delivered, or refused by its queue, or lost and counted, or waits in its outbox.

use super::header::{Header, Message, NAME_SIZE_MAX, count};
use super::queue::{Receipt, Rejected};
use super::wire::{RouterAnswer, RouterRefusal, RouterRequest, RouterStatus};
use crate::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::fmt;
use std::time::Duration;

/// How many subscribers a router has at most.
pub const SUBSCRIBERS_MAX: usize = 256;
/// How many filters a subscription has at most.
pub const FILTERS_MAX: usize = 16;
/// The longest name in the register, in bytes: the name of a queue, a blank, and the life of its owner in 16 digits.
const KEY_SIZE_MAX: usize = NAME_SIZE_MAX + 17;
/// How long the router waits for the answer of a queue.
pub const DELIVER_WITHIN: Duration = Duration::from_millis(500);
/// How often a subscriber renews its subscription.
pub const RENEW_EVERY: Duration = Duration::from_secs(1);
/// How long a silent subscriber stays in the register, unless a router sets another time.
pub const GONE_AFTER: Duration = Duration::from_secs(5);
/// The pause after a queue was full or could not be reached. It doubles with each failure, up to [`PAUSE_MAX`].
const PAUSE_MIN: Duration = Duration::from_millis(5);
const PAUSE_MAX: Duration = Duration::from_millis(500);

/// Accepts messages by their headers. Each given part has to match.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Filter {
    /// The category. A pattern that ends with `*` matches all categories with this beginning.
    pub category: Option<String>,
    /// The sender, with the same meaning of `*`.
    pub sender: Option<String>,
    /// The smallest accepted priority.
    pub priority_min: Option<u8>,
    /// The marker.
    pub marker: Option<u64>,
}

/// The declaration of a router.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RouterSettings {
    /// The type of its messages.
    pub type_name: String,
    /// How many messages wait for a subscriber at most. When there are more, its oldest message is dropped.
    pub outbox_max: usize,
    /// How long a subscriber stays in the register without a receipt or a renewal.
    pub gone_after: Duration,
}

/// An input of a router.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RouterInput {
    /// A program asks.
    Request(RouterRequest),
    /// The program sends a message to all.
    Publish(Message),
    /// The result of a [`RouterEffect::Deliver`].
    Delivered {
        /// The queue.
        queue: String,
        /// The number of the delivery.
        delivery: u64,
        /// The result.
        end: DeliveryEnd,
    },
    /// The time of [`Router::deadline`] has come.
    Tick,
}

/// How a delivery ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum DeliveryEnd {
    /// The queue has answered.
    Receipt(Receipt),
    /// The queue cannot be reached, or did not answer in time.
    Unreachable,
    /// There is no such queue, according to the name server.
    Unknown,
}

/// An effect of a router.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum RouterEffect {
    /// Answer the program that has sent the request.
    Answer(RouterAnswer),
    /// Put a message into a queue, then give [`RouterInput::Delivered`].
    Deliver {
        /// The queue.
        queue: String,
        /// The number of the delivery.
        delivery: u64,
        /// The message.
        message: Message,
        /// How long the answer is useful.
        within: Duration,
    },
    /// A subscriber was removed from the register: report it to the program.
    Dropped {
        /// The queue of the subscriber.
        queue: String,
        /// The reason.
        why: Gone,
        /// How many messages for this subscriber were lost.
        lost: u64,
    },
}

/// Why a subscriber was dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Gone {
    /// Its queue does not exist.
    Unknown,
    /// Neither a receipt nor a renewal has come for [`RouterSettings::gone_after`].
    Silent,
    /// Its queue accepts another type.
    WrongType,
}

/// The traffic through a router.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RouterCounters {
    /// Sent by the program.
    pub published: u64,
    /// Subscribers that were removed.
    pub dropped_subscribers: u64,
}

/// The status of a subscriber.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SubscriberStatus {
    /// The queue of the subscriber.
    pub queue: String,
    /// The filters of the subscription.
    pub filters: Vec<Filter>,
    /// Messages that its filters accepted.
    pub matched: u64,
    /// Messages that its queue accepted.
    pub delivered: u64,
    /// Given up in the outbox.
    pub lost: u64,
    /// Messages that its queue refused for good.
    pub refused: u64,
    /// In the outbox.
    pub waiting: u64,
    /// Whether the last delivery did not reach its queue.
    pub is_unreachable: bool,
}

/// The router.
#[derive(Clone, Debug)]
pub struct Router {
    settings: RouterSettings,
    register: BTreeMap<String, Subscriber>,
    delivery: u64,
    counters: RouterCounters,
}

#[derive(Clone, Debug)]
struct Subscriber {
    filters: Vec<Filter>,
    outbox: VecDeque<Message>,
    /// The message in transit: the number of its delivery, and when that began.
    on_its_way: Option<(u64, Message, Time)>,
    /// Nothing is sent before this time.
    resume: Time,
    pause: Duration,
    /// When the last receipt or renewal came.
    heard: Time,
    /// Whether the last delivery did not reach the queue.
    is_unreachable: bool,
    matched: u64,
    delivered: u64,
    lost: u64,
    refused: u64,
}

impl Filter {
    /// Returns whether the filter accepts a header.
    pub fn takes(&self, header: &Header) -> bool {
        let text = |wanted: &Option<String>, found: &str| {
            wanted.as_ref().is_none_or(|wanted| match wanted.strip_suffix('*') {
                Some(start) => found.starts_with(start),
                None => wanted == found,
            })
        };
        text(&self.category, &header.category)
            && text(&self.sender, &header.sender)
            && self.priority_min.is_none_or(|least| header.priority >= least)
            && self.marker.is_none_or(|marker| marker == header.marker)
    }

    fn is_short(&self) -> bool {
        [&self.category, &self.sender].into_iter().flatten().all(|text| text.len() <= NAME_SIZE_MAX)
    }
}

impl fmt::Display for Filter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let parts = [
            self.category.as_ref().map(|category| format!("category {category}")),
            self.sender.as_ref().map(|sender| format!("sender {sender}")),
            self.priority_min.map(|least| format!("priority {least}")),
            self.marker.map(|marker| format!("marker {marker}")),
        ];
        let parts: Vec<String> = parts.into_iter().flatten().collect();
        f.write_str(if parts.is_empty() { "everything" } else { "" })?;
        f.write_str(&parts.join(", "))
    }
}

impl Router {
    /// Returns a router without subscribers.
    pub fn new(settings: RouterSettings) -> Self {
        Self { settings, register: BTreeMap::new(), delivery: 0, counters: RouterCounters::default() }
    }

    /// Takes an input.
    pub fn handle(&mut self, now: Time, input: RouterInput, effects: &mut Vec<RouterEffect>) {
        match input {
            RouterInput::Request(request) => {
                let answer = self.answer(now, request);
                effects.push(RouterEffect::Answer(answer));
            }
            RouterInput::Publish(message) => self.publish(&message),
            RouterInput::Delivered { queue, delivery, end } => self.delivered(now, &queue, delivery, end, effects),
            RouterInput::Tick => {}
        }
        self.time_out(now, effects);
        self.send(now, effects);
    }

    /// Returns the time at which the router has to be called with [`RouterInput::Tick`]; none if it waits for nothing.
    pub fn deadline(&self) -> Option<Time> {
        let silent = self.register.values().map(|one| one.heard + self.settings.gone_after);
        self.register.values().filter_map(Subscriber::deadline).chain(silent).min()
    }

    /// Returns the status of the router; `fields` are the fields of its message type.
    pub fn status(&self, fields: String) -> RouterStatus {
        let subscribers = self.register.iter().map(|(queue, one)| one.status(queue.clone())).collect();
        RouterStatus { type_name: self.settings.type_name.clone(), fields, counters: self.counters, subscribers }
    }

    fn answer(&mut self, now: Time, request: RouterRequest) -> RouterAnswer {
        match request {
            RouterRequest::Subscribe { queue, type_name, filters } => {
                match self.subscribe(now, queue, type_name, filters) {
                    Ok(answer) => answer,
                    Err(refusal) => RouterAnswer::Refused(refusal),
                }
            }
            RouterRequest::Unsubscribe { queue } => {
                self.register.remove(&queue);
                RouterAnswer::Unsubscribed
            }
            RouterRequest::Look => RouterAnswer::Status(self.status(String::new())),
        }
    }

    fn subscribe(
        &mut self,
        now: Time,
        queue: String,
        type_name: String,
        filters: Vec<Filter>,
    ) -> Result<RouterAnswer, RouterRefusal> {
        if type_name != self.settings.type_name {
            return Err(RouterRefusal::WrongType { sent: self.settings.type_name.clone(), taken: type_name });
        }
        let is_short = queue.len() <= KEY_SIZE_MAX && filters.iter().all(Filter::is_short);
        if filters.len() > FILTERS_MAX || !is_short {
            return Err(RouterRefusal::Filters { max: count(FILTERS_MAX), size_max: count(NAME_SIZE_MAX) });
        }
        if let Some(known) = self.register.get_mut(&queue) {
            known.filters = filters;
            // The subscriber has just sent a message, so it is running.
            (known.heard, known.is_unreachable) = (now, false);
            (known.pause, known.resume) = (PAUSE_MIN, known.resume.min(now));
            return Ok(RouterAnswer::Subscribed { is_known: true, lost: known.lost });
        }
        if self.register.len() >= SUBSCRIBERS_MAX {
            return Err(RouterRefusal::Full { max: count(SUBSCRIBERS_MAX) });
        }
        self.register.insert(queue, Subscriber::new(filters, now));
        Ok(RouterAnswer::Subscribed { is_known: false, lost: 0 })
    }

    fn publish(&mut self, message: &Message) {
        self.counters.published += 1;
        let outbox_max = self.settings.outbox_max.max(1);
        for (queue, subscriber) in &mut self.register {
            if !subscriber.filters.is_empty() && !subscriber.filters.iter().any(|filter| filter.takes(&message.header))
            {
                continue;
            }
            subscriber.matched += 1;
            if subscriber.outbox.len() >= outbox_max {
                subscriber.outbox.pop_front();
                subscriber.lost += 1;
            }
            let mut message = message.clone();
            message.header.recipient.clone_from(queue);
            subscriber.outbox.push_back(message);
        }
    }

    fn delivered(&mut self, now: Time, queue: &str, delivery: u64, end: DeliveryEnd, effects: &mut Vec<RouterEffect>) {
        let Some(subscriber) = self.register.get_mut(queue) else { return };
        let Some((_, message, _)) = subscriber.on_its_way.take_if(|(number, ..)| *number == delivery) else { return };
        subscriber.is_unreachable = !matches!(end, DeliveryEnd::Receipt(_));
        if !subscriber.is_unreachable {
            subscriber.heard = now;
        }
        let gone = match end {
            DeliveryEnd::Receipt(Receipt::Accepted) => {
                subscriber.delivered += 1;
                subscriber.pause = PAUSE_MIN;
                None
            }
            DeliveryEnd::Receipt(Receipt::Rejected(Rejected::Full { .. } | Rejected::Senders)) => {
                subscriber.try_later(now, message);
                None
            }
            DeliveryEnd::Receipt(Receipt::Rejected(Rejected::WrongType { .. })) => {
                subscriber.refused += 1;
                Some(Gone::WrongType)
            }
            DeliveryEnd::Receipt(Receipt::Rejected(_)) => {
                subscriber.refused += 1;
                None
            }
            DeliveryEnd::Unreachable => {
                subscriber.try_later(now, message);
                None
            }
            DeliveryEnd::Unknown => {
                subscriber.try_later(now, message);
                Some(Gone::Unknown)
            }
        };
        if let Some(why) = gone {
            self.drop_subscriber(queue, why, effects);
        }
    }

    fn drop_subscriber(&mut self, queue: &str, why: Gone, effects: &mut Vec<RouterEffect>) {
        let Some(subscriber) = self.register.remove(queue) else { return };
        self.counters.dropped_subscribers += 1;
        let waiting = count(subscriber.outbox.len()) + u64::from(subscriber.on_its_way.is_some());
        let lost = subscriber.lost + waiting;
        effects.push(RouterEffect::Dropped { queue: queue.to_owned(), why, lost });
    }

    /// Ends deliveries without a result, and removes subscribers that are silent for long.
    fn time_out(&mut self, now: Time, effects: &mut Vec<RouterEffect>) {
        let late = |subscriber: &Subscriber| {
            let (delivery, _, sent) = subscriber.on_its_way.as_ref()?;
            (now >= *sent + 2 * DELIVER_WITHIN).then_some(*delivery)
        };
        let late: Vec<_> = self.register.iter().filter_map(|(queue, one)| Some((queue.clone(), late(one)?))).collect();
        for (queue, delivery) in late {
            self.delivered(now, &queue, delivery, DeliveryEnd::Unreachable, effects);
        }
        let gone_after = self.settings.gone_after;
        let silent = self.register.iter().filter(|(_, one)| now >= one.heard + gone_after);
        for queue in silent.map(|(queue, _)| queue.clone()).collect::<Vec<_>>() {
            self.drop_subscriber(&queue, Gone::Silent, effects);
        }
    }

    fn send(&mut self, now: Time, effects: &mut Vec<RouterEffect>) {
        for (queue, subscriber) in &mut self.register {
            if subscriber.on_its_way.is_some() || now < subscriber.resume {
                continue;
            }
            let Some(message) = subscriber.outbox.pop_front() else { continue };
            self.delivery += 1;
            subscriber.on_its_way = Some((self.delivery, message.clone(), now));
            let (queue, delivery, within) = (queue.clone(), self.delivery, DELIVER_WITHIN);
            effects.push(RouterEffect::Deliver { queue, delivery, message, within });
        }
    }
}

impl Subscriber {
    const fn new(filters: Vec<Filter>, now: Time) -> Self {
        Self {
            filters,
            outbox: VecDeque::new(),
            on_its_way: None,
            resume: now,
            pause: PAUSE_MIN,
            heard: now,
            is_unreachable: false,
            matched: 0,
            delivered: 0,
            lost: 0,
            refused: 0,
        }
    }

    /// Puts the message back. It is the oldest, so it is the next again.
    fn try_later(&mut self, now: Time, message: Message) {
        self.outbox.push_front(message);
        self.resume = now + self.pause;
        self.pause = (self.pause * 2).min(PAUSE_MAX);
    }

    fn deadline(&self) -> Option<Time> {
        match &self.on_its_way {
            Some((_, _, sent)) => Some(*sent + 2 * DELIVER_WITHIN),
            None => (!self.outbox.is_empty()).then_some(self.resume),
        }
    }

    fn status(&self, queue: String) -> SubscriberStatus {
        SubscriberStatus {
            queue,
            filters: self.filters.clone(),
            matched: self.matched,
            delivered: self.delivered,
            lost: self.lost,
            refused: self.refused,
            waiting: count(self.outbox.len()) + u64::from(self.on_its_way.is_some()),
            is_unreachable: self.is_unreachable,
        }
    }
}

#[cfg(test)]
mod tests;
