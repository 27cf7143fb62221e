//! A queue of a controller, and the client that sends to a queue.

use super::lock::Lock;
use super::{Full, Header, MessageId, QueueMessage, QueueStatus, Receipt, Rejected};
use crate::sdk::calls::Calls;
use crate::sdk::port::{Message, is_fit};
use comms::io::entropy;
use comms::logic::messaging::header::DATA_SIZE_MAX;
use comms::logic::messaging::queue::{MessageQueue, QueueSettings};
use comms::logic::messaging::request::Numbering;
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::io;
use std::marker::PhantomData;
use std::num::NonZeroUsize;
use std::time::Duration;

/// How long the client waits for an answer of a queue before it sends the message again.
const TRY_WITHIN: Duration = Duration::from_millis(250);
/// How many messages of a client may be in transit.
const SENDING_MAX: usize = 32;

/// Receives messages, and returns them by priority. It is a field of a controller, which exports a procedure for it:
/// `exports.procedure("Commands", "...", |robot: &mut Robot, message| Ok(robot.commands.receive(message)))`.
#[derive(Debug)]
pub struct Queue<T> {
    queue: MessageQueue,
    /// The time of the controller's last call of [`Queue::take`].
    now: Time,
    of: PhantomData<fn() -> T>,
}

/// A message that was taken out of a queue.
#[derive(Clone, Debug, PartialEq)]
pub struct Taken<T> {
    /// The header.
    pub header: Header,
    /// The fencing number under which the message was sent.
    pub fence: Option<u64>,
    /// The data.
    pub data: T,
}

impl<T: Message> Queue<T> {
    /// Returns an empty queue. A capacity of zero means one.
    pub fn new(capacity: usize, full: Full) -> Self {
        let capacity = NonZeroUsize::new(capacity).unwrap_or(NonZeroUsize::MIN);
        let settings = QueueSettings { type_name: T::TYPE.to_owned(), capacity, full, data_size_max: DATA_SIZE_MAX };
        Self { queue: MessageQueue::new(settings), now: Time::ZERO, of: PhantomData }
    }

    /// Receives a message: the procedure that a queue exports.
    pub fn receive(&mut self, message: QueueMessage) -> Receipt {
        if message.type_name == T::TYPE {
            let problem = match postcard::from_bytes::<T>(&message.data) {
                Ok(data) if is_fit(&data) => None,
                Ok(_) => Some("with a number that is not finite"),
                Err(_) => Some("of other fields"),
            };
            if let Some(problem) = problem {
                let (expected, found) = (T::TYPE.to_owned(), format!("{} {problem}", T::TYPE));
                return self.queue.turn_away(Rejected::WrongType { expected, found });
            }
        }
        self.queue.receive(self.now, message)
    }

    /// Receives a message for a resource. Only messages of the lock's holder are accepted.
    pub fn receive_under(&mut self, lock: &mut Lock, message: QueueMessage) -> Receipt {
        match lock.admit(message.fence) {
            Ok(()) => self.receive(message),
            Err(refusal) => self.queue.turn_away(Rejected::Fenced(refusal)),
        }
    }

    /// Takes the message with the highest priority. If several messages have this priority, takes the message that arrived first.
    pub fn take(&mut self, now: Time) -> Option<Taken<T>> {
        self.now = now;
        while let Some(QueueMessage { header, fence, data, .. }) = self.queue.take() {
            // The message was already decoded once when it was received.
            if let Ok(data) = postcard::from_bytes(&data) {
                return Some(Taken { header, fence, data });
            }
        }
        None
    }

    /// Takes a message for a resource. If the grant of a message has ended since it was sent, the message is dropped
    /// and counted.
    pub fn take_under(&mut self, lock: &mut Lock, now: Time) -> Option<Taken<T>> {
        lock.work(now);
        self.queue.retain(|message| lock.admit(message.fence).is_ok());
        self.take(now)
    }

    /// Returns the status of the queue for people.
    pub fn status(&self) -> QueueStatus {
        let settings = self.queue.settings();
        QueueStatus {
            type_name: settings.type_name.clone(),
            fields: T::FIELDS.to_owned(),
            capacity: u64::try_from(settings.capacity.get()).unwrap_or(u64::MAX),
            full: settings.full,
            lock: String::new(),
            counters: self.queue.counters(),
            last_sender: self.queue.last_sender().to_owned(),
        }
    }
}

/// Returns the data of a message in its encoded form.
///
/// # Errors
/// If the data cannot be encoded, or a number in it is not finite.
pub(super) fn encoded<T: Message>(data: &T) -> Result<Vec<u8>, String> {
    if !is_fit(data) {
        return Err(format!("a number of the `{}` is not finite", T::TYPE));
    }
    postcard::to_stdvec(data).map_err(|cause| format!("cannot encode a value of type `{}`: {cause}", T::TYPE))
}

/// The fields of a message, except its data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Label<'a> {
    /// The kind of the message; receivers may filter by it.
    pub category: &'a str,
    /// Messages of a higher priority are taken first.
    pub priority: u8,
    /// A number that the sender chooses; answers repeat it.
    pub marker: u64,
}

impl Label<'_> {
    pub(super) fn message<T: Message>(self, data: &T) -> Result<EncodedMessage, String> {
        let Self { category, priority, marker } = self;
        let (type_name, data) = (T::TYPE.to_owned(), encoded(data)?);
        Ok(EncodedMessage {
            type_name,
            data,
            category: category.to_owned(),
            priority,
            marker,
            ..EncodedMessage::default()
        })
    }
}

impl EncodedMessage {
    /// Returns the message with its header, ready to send.
    pub(super) fn numbered(self, id: MessageId, sender: &str) -> Result<QueueMessage, String> {
        let Self { type_name, data, category, recipient, priority, marker, fence } = self;
        let header = Header { category, id, sender: sender.to_owned(), recipient, priority, marker };
        let message = QueueMessage { header, type_name, fence, data };
        message.check().map_err(|malformed| malformed.to_string())?;
        Ok(message)
    }
}

/// How sending a message ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SendEnd {
    /// The message is in the queue, or was taken from it.
    Accepted,
    /// The queue has rejected the message.
    Rejected(Rejected),
    /// No queue is available: nothing is connected, the program has no queue of this name, or its process does not run.
    Unknown(ObjectError),
    /// No answer arrived in time: it is unknown whether the message is in the queue.
    Deadline,
    /// No answer arrived in time, and the last attempt found that the program of the queue is gone.
    Gone,
}

/// A message with encoded data, of a program in another language.
#[derive(Clone, Debug, Default)]
pub struct EncodedMessage {
    /// The type of the data.
    pub type_name: String,
    /// The data.
    pub data: Vec<u8>,
    /// See [`Header::category`].
    pub category: String,
    /// The recipient, which is a process that the spec connects. If empty, it is the first such process.
    pub recipient: String,
    /// See [`Header::priority`].
    pub priority: u8,
    /// See [`Header::marker`].
    pub marker: u64,
    /// The fencing number of the lock, for a queue in front of a resource.
    pub fence: Option<u64>,
}

/// Sends to the queue that the spec connects, together with a field `#[calls("Orders")] orders: Calls<QueueMessage,
/// Receipt>`.
///
/// If the receipt of a message does not arrive, the client sends the message again until its deadline. The identifier
/// stays the same, so the queue takes the message only once.
#[derive(Debug)]
pub struct QueueClient<T> {
    sender: String,
    numbering: Numbering,
    /// By number, the messages that are being sent.
    sending: BTreeMap<u64, Sending>,
    /// By the number of a call, the number of its message.
    calls: BTreeMap<u64, u64>,
    ends: Vec<(u64, SendEnd)>,
    of: PhantomData<fn(T)>,
}

#[derive(Debug)]
struct Sending {
    message: QueueMessage,
    until: Time,
    /// When the message is sent again, unless a call is open.
    due: Time,
    is_open: bool,
    /// Whether the program of the queue was gone at the last attempt.
    is_gone: bool,
}

impl<T: Message> QueueClient<T> {
    /// Returns a client that has not sent anything. Replies go to `sender`.
    ///
    /// # Errors
    /// If the system gives no random number for the client.
    pub fn new(sender: &str) -> io::Result<Self> {
        let numbering = Numbering::new(entropy::number()?);
        let (sending, calls, ends) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
        Ok(Self { sender: sender.to_owned(), numbering, sending, calls, ends, of: PhantomData })
    }

    /// Sends a message with the next [`QueueClient::work`]; returns its number. `fence` is the fencing number of the
    /// lock, for a queue in front of a resource.
    ///
    /// # Errors
    /// If too many messages are in transit, or the data is too long.
    pub fn send(
        &mut self,
        now: Time,
        label: Label<'_>,
        data: &T,
        fence: Option<u64>,
        within: Duration,
    ) -> Result<u64, String> {
        let message = EncodedMessage { fence, ..label.message(data)? };
        self.send_encoded(now, message, within)
    }

    /// Sends a message to the process with this path, one of the processes that the spec connects. Otherwise it works
    /// like [`QueueClient::send`].
    ///
    /// # Errors
    /// If too many messages are in transit, or the data is too long.
    pub fn send_to(
        &mut self,
        now: Time,
        label: Label<'_>,
        process: &str,
        data: &T,
        within: Duration,
    ) -> Result<u64, String> {
        let message = EncodedMessage { recipient: process.to_owned(), ..label.message(data)? };
        self.send_encoded(now, message, within)
    }

    /// Sends a message with encoded data of any type. Otherwise it works like [`QueueClient::send`].
    ///
    /// # Errors
    /// If too many messages are in transit, or the data is too long.
    pub fn send_encoded(&mut self, now: Time, message: EncodedMessage, within: Duration) -> Result<u64, String> {
        if self.sending.len() >= SENDING_MAX {
            return Err(format!("{SENDING_MAX} messages are already on their way; send fewer at a time"));
        }
        let id = self.numbering.next();
        let message = message.numbered(id, &self.sender)?;
        self.sending
            .insert(id.number, Sending { message, until: now + within, due: now, is_open: false, is_gone: false });
        Ok(id.number)
    }

    /// Sends the messages that are due, and takes receipts. Called once in each calculation.
    pub fn work(&mut self, now: Time, calls: &mut Calls<QueueMessage, Receipt>) {
        while let Some((call, answer)) = calls.answer() {
            if let Some(number) = self.calls.remove(&call) {
                self.answered(now, number, answer);
            }
        }
        let late: Vec<u64> =
            self.sending.iter().filter(|(_, one)| one.until <= now).map(|(&number, _)| number).collect();
        for number in late {
            let is_gone = self.sending.get(&number).is_some_and(|one| one.is_gone);
            self.end(number, if is_gone { SendEnd::Gone } else { SendEnd::Deadline });
        }
        for (&number, one) in self.sending.iter_mut().filter(|(_, one)| !one.is_open && one.due <= now) {
            let within = TRY_WITHIN.min(one.until.since(now));
            let (message, to) = (one.message.clone(), &one.message.header.recipient);
            let call = if to.is_empty() { calls.call(message, within) } else { calls.call_to(to, message, within) };
            self.calls.insert(call, number);
            one.is_open = true;
        }
    }

    /// Returns how the sending of a message ended, with its number. Callers repeat this until it returns none.
    pub fn end_of(&mut self) -> Option<(u64, SendEnd)> {
        if self.ends.is_empty() { None } else { Some(self.ends.remove(0)) }
    }

    fn answered(&mut self, now: Time, number: u64, answer: Result<Receipt, ObjectError>) {
        let end = match answer {
            Ok(Receipt::Accepted) => SendEnd::Accepted,
            Ok(Receipt::Rejected(rejected)) => SendEnd::Rejected(rejected),
            Err(error @ (ObjectError::Deadline { .. } | ObjectError::Gone | ObjectError::Busy { .. })) => {
                if let Some(one) = self.sending.get_mut(&number) {
                    (one.is_open, one.due, one.is_gone) = (false, now + TRY_WITHIN / 8, error == ObjectError::Gone);
                }
                return;
            }
            Err(
                error @ (ObjectError::NoSuchName { .. }
                | ObjectError::NoSuchProcedure { .. }
                | ObjectError::WrongType { .. }
                | ObjectError::Refused { .. }
                | ObjectError::TooLarge { .. }
                | ObjectError::Unanswered { .. }
                | ObjectError::NotConnected { .. }),
            ) => SendEnd::Unknown(error),
        };
        self.end(number, end);
    }

    fn end(&mut self, number: u64, end: SendEnd) {
        if self.sending.remove(&number).is_some() {
            self.calls.retain(|_, other| *other != number);
            self.ends.push((number, end));
        }
    }
}
