//! Clients and servers of services of ROS 2.

use super::{RosSession, declare, key, lock, now_nanos, told};
use crate::logic::arrivals::{Counts, Refused, answered, checked};
use crate::logic::replies::{Failure, Replies, Requests, Taken, WAITING_MAX};
use crate::logic::value;
use crate::setup;
use comms::io::clock::now;
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use controllers::sdk::{RawReply, Waker};
use ros::logic::attachment::{Attachment, Gid};
use ros::logic::cdr;
use ros::logic::key::Topic;
use ros::logic::name::TypeName;
use ros::logic::route::SERVICE;
use ros::logic::schema::Schema;
use ros::logic::token::Role;
use ros::typed::Message;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use zenoh::Wait;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::query::{ConsolidationMode, Querier, Query, QueryTarget, Queryable, Reply};
use zenoh::sample::Sample;

/// The longest time of a server of ROS 2. The caller has its own, shorter time limit.
const ANSWER_WITHIN: Duration = Duration::from_secs(3600);
/// After this time a session knows the existing servers.
const SETTLED_AFTER: Duration = Duration::from_secs(1);
/// The longest reason of a server that is passed on, in bytes.
const REASON_MAX: usize = 500;

/// The schemas of a service, and the counts of its calls.
#[derive(Debug)]
pub(crate) struct Service {
    request: Schema,
    response: Schema,
    pub(crate) counts: Mutex<Counts>,
}

/// The caller of a service.
pub(crate) enum Caller {
    /// A process of the mission.
    Process(RawReply),
    /// A user who calls a node. If no node answers, the call is not refused.
    User(RawReply),
    /// This program.
    Own {
        take: Box<dyn FnOnce(Result<Vec<u8>, Failure>) + Send>,
        /// Whether a response is only used if no other server responds.
        is_last: fn(&[u8]) -> bool,
    },
}

/// A client of a service.
#[derive(Debug)]
pub(crate) struct Client {
    querier: Querier<'static>,
    service: Arc<Service>,
    name: String,
    sender: Gid,
    sequence: i64,
    since: Time,
    waiting: Arc<Mutex<Replies<Caller>>>,
    _token: LivelinessToken,
}

/// A server of a service. The server ends when this is dropped.
#[derive(Debug)]
pub(crate) struct Server {
    _queryable: Queryable<()>,
    _token: LivelinessToken,
    key: KeyExpr<'static>,
    service: Arc<Service>,
    requests: Arc<Mutex<Requests<Request>>>,
}

/// A request of a client of ROS 2.
#[derive(Debug)]
pub(crate) struct Request {
    query: Query,
    attachment: Attachment,
}

impl Service {
    /// Returns a service of this type that has no calls yet.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn new(of: &TypeName) -> Result<Arc<Self>, String> {
        let (request, response) = (setup::schema(&of.request())?, setup::schema(&of.response())?);
        Ok(Arc::new(Self { request, response, counts: Mutex::default() }))
    }
}

impl RosSession {
    /// Makes a client of a service; `id` is its number within the session.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn client(&self, id: u64, topic: &Topic, service: &Arc<Service>) -> Result<Client, String> {
        let token = self.token(id, Role::Client, topic, SERVICE);
        let querier = self.session.declare_querier(key(topic.key(self.domain))?);
        let querier = querier.target(QueryTarget::AllComplete).timeout(ANSWER_WITHIN);
        // The first reply is used. With another mode, replies would wait until the server forgets the request.
        let querier = querier.consolidation(ConsolidationMode::None);
        let querier = querier.wait().map_err(|error| told(topic, error.as_ref()))?;
        let sender = Gid::of(&token.key());
        let (service, name, waiting) = (Arc::clone(service), topic.name.to_string(), Arc::default());
        let shown = declare(&self.session, &token)?;
        Ok(Client { querier, service, name, sender, sequence: 0, since: now(), waiting, _token: shown })
    }

    /// Makes a server of a service, whose requests wake the loop; `id` is its number within the session.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn server(
        &self,
        id: u64,
        topic: &Topic,
        service: &Arc<Service>,
        waker: Waker,
    ) -> Result<Server, String> {
        let token = self.token(id, Role::Server, topic, SERVICE);
        let key = key(topic.key(self.domain))?;
        let requests: Arc<Mutex<Requests<Request>>> = Arc::default();
        let (theirs, of, name) = (Arc::clone(&requests), Arc::clone(service), topic.name.clone());
        let hear = move |query: Query| match hear(query, &of, &theirs) {
            Ok(()) => waker.wake(),
            Err((why, refused)) if refused.is_power_of_two() => {
                tracing::warn!(service = %name, why, refused, "requests of ROS 2 are refused");
            }
            Err(_) => {}
        };
        let queryable = self.session.declare_queryable(key.clone()).complete(true).callback(hear);
        let queryable = queryable.wait().map_err(|error| told(topic, error.as_ref()))?;
        let service = Arc::clone(service);
        Ok(Server { _queryable: queryable, _token: declare(&self.session, &token)?, key, service, requests })
    }
}

impl Caller {
    /// Returns this program as the caller; it takes the first answer.
    pub(crate) fn own(take: impl FnOnce(Result<Vec<u8>, Failure>) + Send + 'static) -> Self {
        Self::Own { take: Box::new(take), is_last: |_| false }
    }

    /// Changes the caller: responses for which `is_last` is true are only used if no other server responds.
    pub(crate) fn unless(self, is_last: fn(&[u8]) -> bool) -> Self {
        match self {
            Self::Own { take, .. } => Self::Own { take, is_last },
            Self::Process(_) | Self::User(_) => self,
        }
    }

    fn is_wanted(&self) -> bool {
        match self {
            Self::Process(reply) | Self::User(reply) => reply.is_wanted(),
            Self::Own { .. } => true,
        }
    }

    fn is_last(&self, result: &Result<Vec<u8>, Failure>) -> bool {
        let (Self::Own { is_last, .. }, Ok(response)) = (self, result) else { return false };
        is_last(response)
    }

    fn answer(self, result: Result<Vec<u8>, Failure>) {
        match self {
            Self::Process(reply) => reply.answer(result.map_err(ObjectError::from)),
            Self::User(reply) => reply.answer(result.map_err(Failure::of_node)),
            Self::Own { take, .. } => take(result),
        }
    }
}

impl std::fmt::Debug for Caller {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Caller")
    }
}

impl Client {
    /// Returns whether there is a server, as far as this session knows.
    pub(crate) fn has_server(&self) -> bool {
        self.querier.matching_status().wait().is_ok_and(|status| status.matching())
    }

    /// Calls the service with an encoded argument. The answer comes on another thread.
    pub(crate) fn call(&mut self, argument: &[u8], caller: Caller) {
        let request = value::message_in(argument).filter(|request| cdr::check(&self.service.request, request).is_ok());
        let Some(request) = request else {
            lock(&self.service.counts).refused += 1;
            let why = format!("its argument is not a `{}`", self.service.request.name());
            return caller.answer(Err(Failure::Refused(why)));
        };
        let added = lock(&self.waiting).add(caller);
        let number = match added {
            Ok(number) => number,
            Err(caller) => return caller.answer(Err(Failure::Busy)),
        };
        self.sequence += 1;
        let attachment = Attachment { sequence: self.sequence, nanos: now_nanos(), sender: self.sender };
        let is_known = self.has_server() || now() < self.since + SETTLED_AFTER;
        let (waiting, service, name) = (Arc::clone(&self.waiting), Arc::clone(&self.service), self.name.clone());
        let call = Waiting { number, attachment, waiting, service, name, is_known, last: Mutex::default() };
        let get = self.querier.get().payload(request.to_vec()).attachment(attachment.encode().to_vec());
        if let Err(error) = get.callback(move |reply| call.hear(&reply)).wait() {
            tracing::debug!(%error, "a request of ROS 2 was not sent");
        }
    }

    /// Removes the calls whose callers no longer wait. A late answer to them is dropped.
    pub(crate) fn forget(&self) {
        let lost = lock(&self.waiting).forget(Caller::is_wanted);
        lock(&self.service.counts).lost += lost;
    }
}

/// A waiting call. If it is dropped without an answer, the call is over.
struct Waiting {
    number: u64,
    /// The attachment of the call. Each response has to contain its number and sender.
    attachment: Attachment,
    waiting: Arc<Mutex<Replies<Caller>>>,
    service: Arc<Service>,
    name: String,
    /// Whether there may have been a server when the call was made.
    is_known: bool,
    /// A response that is used if no other response arrives.
    last: Mutex<Option<Vec<u8>>>,
}

impl Waiting {
    fn hear(&self, reply: &Reply) {
        let result = match reply.result() {
            Ok(sample) => self.response(sample),
            Err(error) => {
                let why = format!("the service answers: {}", reason(&error.payload().to_bytes()));
                Err(Failure::Refused(why))
            }
        };
        let taken = lock(&self.waiting).take_unless(self.number, |caller| caller.is_last(&result));
        match (taken, result) {
            (Taken::Call(caller), result) => self.answer(caller, result),
            (Taken::Waits, Ok(response)) => *lock(&self.last) = Some(response),
            (Taken::Waits | Taken::Over, _) => {}
        }
    }

    fn answer(&self, caller: Caller, result: Result<Vec<u8>, Failure>) {
        let mut counts = lock(&self.service.counts);
        *(if result.is_ok() { &mut counts.received } else { &mut counts.refused }) += 1;
        drop(counts);
        caller.answer(result);
    }

    fn response(&self, sample: &Sample) -> Result<Vec<u8>, Failure> {
        let response = sample.payload().to_bytes();
        let attachment = sample.attachment().map(ZBytes::to_bytes);
        match answered(&self.service.response, &self.attachment, attachment.as_deref(), &response) {
            Ok(()) => Ok(value::of_message(&response)),
            Err(why) => Err(Failure::Refused(format!("the service was called, and its response is refused: {why}"))),
        }
    }
}

impl Drop for Waiting {
    fn drop(&mut self) {
        let taken = lock(&self.waiting).take(self.number);
        let Some(caller) = taken else { return };
        if let Some(response) = lock(&self.last).take() {
            return self.answer(caller, Ok(response));
        }
        lock(&self.service.counts).lost += 1;
        let failure = if self.is_known { Failure::Gone } else { Failure::NoServer };
        let failure = failure(self.name.clone());
        caller.answer(Err(failure));
    }
}

impl Server {
    /// Returns the next request for the procedure: its number and its argument.
    pub(crate) fn next(&self) -> Option<(u64, Vec<u8>)> {
        lock(&self.requests).next()
    }

    /// Answers a request.
    pub(crate) fn answer(&self, number: u64, result: Result<Vec<u8>, ObjectError>) {
        let taken = lock(&self.requests).take(number);
        let Some(Request { query, attachment }) = taken else { return };
        let response = result.and_then(|result| match value::message_in(&result) {
            Some(response) if cdr::check(&self.service.response, response).is_ok() => Ok(response.to_vec()),
            _ => Err(ObjectError::Refused { reason: "its result is not the response of the service".to_owned() }),
        });
        let sent = match response {
            Ok(response) => {
                lock(&self.service.counts).received += 1;
                let attachment = Attachment { nanos: now_nanos(), ..attachment };
                query.reply(self.key.clone(), response).attachment(attachment.encode().to_vec()).wait()
            }
            Err(why) => {
                lock(&self.service.counts).lost += 1;
                query.reply_err(why.to_string()).wait()
            }
        };
        if let Err(error) = sent {
            tracing::debug!(%error, "a response of ROS 2 was not sent");
        }
    }
}

/// Takes a request. If the request is refused, returns the reason and the number of refusals so far.
/// Returns the value of a wire for a message of DCA itself.
pub(super) fn to_value<M: Message>(message: &M) -> Vec<u8> {
    value::of_message(&message.to_cdr().unwrap_or_default())
}

/// Returns the message in an answer; none if there is no such answer.
pub(super) fn from_answer<M: Message>(answer: Result<Vec<u8>, Failure>) -> Option<M> {
    let answer = answer.ok()?;
    M::from_cdr(value::message_in(&answer)?).ok()
}

fn hear(query: Query, service: &Service, requests: &Mutex<Requests<Request>>) -> Result<(), (String, u64)> {
    let (query, why) = match read(&query, service) {
        Err(why) => (query, why.to_string()),
        Ok((attachment, argument)) => {
            let added = lock(requests).add(Request { query, attachment }, argument);
            let Err(Request { query, .. }) = added else { return Ok(()) };
            (query, format!("{WAITING_MAX} requests are waiting already"))
        }
    };
    let mut counts = lock(&service.counts);
    counts.refused += 1;
    let refused = counts.refused;
    drop(counts);
    if let Err(error) = query.reply_err(why.clone()).wait() {
        tracing::debug!(%error, "a refusal was not sent");
    }
    Err((why, refused))
}

/// Returns the attachment and the argument in a request.
fn read(query: &Query, service: &Service) -> Result<(Attachment, Vec<u8>), Refused> {
    let attachment = query.attachment().map(ZBytes::to_bytes);
    let request = query.payload().map(ZBytes::to_bytes).unwrap_or_default();
    let attachment = checked(&service.request, attachment.as_deref(), &request)?;
    Ok((attachment, value::of_message(&request)))
}

/// Returns the reason that a server gives, as one line.
fn reason(bytes: &[u8]) -> String {
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(REASON_MAX)]);
    text.chars().map(|character| if character.is_control() { ' ' } else { character }).collect()
}
