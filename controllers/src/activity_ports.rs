//! The program that has the ports of an activity, whose states run in a node. `dca` adds it to a mission whose activities
//! have connections.
//!
//! The program is never activated. Values of wires and messages of queues come to its inputs. It
//! passes the messages to its node, and the node reports the result of each message, because only
//! the node knows whether the activity runs. For the outputs, the node gives values to the program,
//! and the program sends them. So the node itself has no data session, and an activity has the same
//! wires as a program.

use crate::sdk::messaging::{QueueMessage, Receipt, Rejected};
use crate::sdk::{
    About, Access, Activity, Arguments, Configured, Delivery, DeliveryError, Direction, ExportInterface, ExportKind,
    Interface, Kind, Module, ObjectError, Outlets, Parameter, PortInterface, Progress, RawReply, Signal, Stopping,
};
use comms::logic::control::{MessageFate, PortMessage};
use comms::logic::messaging::header::Malformed;
use comms::logic::messaging::port::{Expected, Given, Offer, PORTS, PortInbox};
use comms::logic::object::{Signature, TypeForm};
use comms::logic::time::Time;

/// The longest message, in bytes: a node stores each message on its disk.
const SIZE_MAX: usize = 64 * 1024;
/// The type of texts; the bytes of a text are checked.
const TEXT: &str = "Text";
/// The ports, each as `in NAME LIMIT TYPE` or `out NAME TYPE`, with `;` between them.
const PARAMETERS: &[Parameter] = &[Parameter::new("ports", Kind::Text(&[]))];

/// Returns the interface of a program without ports.
pub(crate) fn interface() -> Interface {
    let about =
        About::service("Has the ports of an activity. `dca` adds it to a mission whose activities are connected.");
    let about = about.with(PARAMETERS);
    Interface { type_name: PORTS, about, ports: Vec::new(), exports: Vec::new(), calls: Vec::new(), inner: Vec::new() }
}

/// The ports of one activity.
#[derive(Debug)]
pub(crate) struct ActivityPorts {
    interface: Interface,
    inputs: Vec<Input>,
    inbox: PortInbox<RawReply>,
    /// The time of its last turn.
    now: Time,
}

/// An input, with its type.
#[derive(Clone, Copy, Debug)]
struct Input {
    name: &'static str,
    kind: &'static str,
}

impl ActivityPorts {
    /// Makes the idle ports.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn new(arguments: &Arguments) -> Result<Self, String> {
        let (mut inputs, mut limits, mut ports, mut exports) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for text in arguments.text("ports").split(';') {
            let words: Vec<&str> = text.split(' ').collect();
            match words[..] {
                ["in", name, limit, kind] => {
                    let limit = limit.parse().map_err(|_large| format!("`{limit}` is not a limit of `{name}`"))?;
                    let (name, kind) = (for_ever(name), for_ever(kind));
                    inputs.push(Input { name, kind });
                    limits.push((name.to_owned(), limit));
                    ports.push(PortInterface::optional(name, Direction::In, kind));
                    exports.push(export(name));
                }
                ["out", name, kind] => {
                    ports.push(PortInterface::optional(for_ever(name), Direction::Out, for_ever(kind)));
                }
                _ => return Err(format!("`{text}` is not a port of an activity")),
            }
        }
        let interface = Interface { ports, exports, ..interface() };
        Ok(Self { interface, inputs, inbox: PortInbox::new(limits), now: Time::ZERO })
    }

    fn input(&self, name: &str) -> Option<(usize, Input)> {
        self.inputs.iter().copied().enumerate().find(|(_, input)| input.name == name)
    }
}

/// Returns the queue of an input, as other programs call it.
fn export(name: &'static str) -> ExportInterface {
    let form = |name| TypeForm::new(name, "");
    ExportInterface {
        name,
        kind: ExportKind::Procedure,
        signature: Signature { argument: form("QueueMessage"), result: form("Receipt") },
        doc: "A message for the activity.",
        is_answered_idle: true,
        access: Access::Operate,
    }
}

/// Returns a text that lives as long as the process, like the names in interfaces. An interface is made once.
fn for_ever(text: &str) -> &'static str {
    Box::leak(text.to_owned().into_boxed_str())
}

/// Returns why an activity cannot take a value. None if it can take the value.
fn misfit(kind: &str, value: &[u8]) -> Option<Rejected> {
    let size = value.len();
    if size > SIZE_MAX {
        let count = |size| u64::try_from(size).unwrap_or(u64::MAX);
        return Some(Rejected::Malformed(Malformed::Data { size: count(size), size_max: count(SIZE_MAX) }));
    }
    let is_text = kind != TEXT || postcard::from_bytes::<String>(value).is_ok();
    let found = || format!("{kind} of other fields");
    (!is_text).then(|| Rejected::WrongType { expected: kind.to_owned(), found: found() })
}

fn answer(way: RawReply, receipt: &Receipt) {
    let encoded = postcard::to_stdvec(receipt);
    way.answer(
        encoded.map_err(|cause| ObjectError::Refused { reason: format!("a receipt cannot be written: {cause}") }),
    );
}

fn give(given: impl IntoIterator<Item = Given<RawReply>>) {
    given.into_iter().for_each(|Given { way, receipt }| answer(way, &receipt));
}

impl Module for ActivityPorts {
    fn interface(&self) -> &Interface {
        &self.interface
    }

    fn deliver(&mut self, port: &str, bytes: &[u8], arrived: Time) -> Result<Delivery, DeliveryError> {
        let missing = || DeliveryError::NoInput { type_name: PORTS, port: port.to_owned() };
        let (port, Input { name, kind }) = self.input(port).ok_or_else(missing)?;
        if misfit(kind, bytes).is_some() {
            self.inbox.lose(port, 1);
            return Err(DeliveryError::malformed(name, kind));
        }
        give(self.inbox.offer(arrived, Offer { port, value: bytes.to_vec(), priority: 0, receipt: None }));
        Ok(Delivery::Stored)
    }

    fn lose(&mut self, port: &str, count: u64) {
        if let Some((port, _)) = self.input(port) {
            self.inbox.lose(port, count);
        }
    }

    fn init(&mut self, _: &[u8], _: Time) -> Result<(), String> {
        Ok(())
    }

    fn configure(&mut self, _: Arguments, _: bool) -> Result<Configured, String> {
        Err("the ports of an activity have no parameters that change".to_owned())
    }

    fn calculate(&mut self, _: Time) -> Progress {
        Progress::Continue
    }

    fn hears_idle(&self) -> bool {
        true
    }

    fn stop(&mut self, _: Time) -> Stopping {
        Stopping::Finished
    }

    fn drain(&mut self, _: &mut dyn FnMut(&'static str, Vec<u8>)) {}

    fn drain_to(&mut self, _: &mut dyn Outlets) {}

    fn signals(&self) -> Vec<Signal> {
        Vec::new()
    }

    fn serve(&mut self, name: &str, argument: &[u8], _: Activity, reply: RawReply) {
        let Some((port, Input { kind, .. })) = self.input(name) else {
            let known = self.inputs.iter().map(|input| input.name.to_owned()).collect();
            return reply.answer(Err(ObjectError::NoSuchProcedure { name: name.to_owned(), known }));
        };
        let message = match postcard::from_bytes::<QueueMessage>(argument) {
            Ok(message) => message,
            Err(cause) => {
                let reason = format!("the argument is not a `QueueMessage`: {cause}");
                return reply.answer(Err(ObjectError::Refused { reason }));
            }
        };
        let rejected = match message.check() {
            Err(malformed) => Some(Rejected::Malformed(malformed)),
            Ok(()) if message.type_name != kind => {
                Some(Rejected::WrongType { expected: kind.to_owned(), found: message.type_name.clone() })
            }
            Ok(()) => misfit(kind, &message.data),
        };
        if let Some(rejected) = rejected {
            return answer(reply, &Receipt::Rejected(rejected));
        }
        let (value, priority) = (message.data, message.header.priority);
        let receipt = Some(Expected { id: message.header.id, way: reply });
        give(self.inbox.offer(self.now, Offer { port, value, priority, receipt }));
    }

    fn drain_messages(&mut self, now: Time, hand: &mut dyn FnMut(PortMessage)) {
        self.now = now;
        while let Some(message) = self.inbox.next_for_node() {
            hand(message);
        }
    }

    fn received(&mut self, number: u64, fate: MessageFate) {
        give(self.inbox.fate(self.now, number, fate));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sdk::messaging::{Header, MessageId};
    use std::sync::mpsc::{Receiver, sync_channel};

    fn ports(list: &str) -> Result<ActivityPorts, String> {
        let given = Arguments::parse(PARAMETERS, &[list]).map_err(|error| error.to_string())?;
        ActivityPorts::new(&given)
    }

    fn speech() -> ActivityPorts {
        ports("in speech 2 Text;out say Text").unwrap()
    }

    fn call(ports: &mut ActivityPorts, kind: &str, data: Vec<u8>) -> Receiver<Receipt> {
        let (sender, receiver) = sync_channel(1);
        let header = Header {
            category: String::new(),
            id: MessageId { life: 7, number: 1 },
            sender: "mic".to_owned(),
            recipient: String::new(),
            priority: 9,
            marker: 0,
        };
        let message = QueueMessage { header, type_name: kind.to_owned(), fence: None, data };
        let argument = postcard::to_stdvec(&message).unwrap();
        let take = move |result: Result<Vec<u8>, ObjectError>| {
            sender.send(postcard::from_bytes(&result.unwrap()).unwrap()).unwrap();
        };
        ports.serve("speech", &argument, Activity::Idle, RawReply::new(take, || true));
        receiver
    }

    fn text(text: &str) -> Vec<u8> {
        postcard::to_stdvec(text).unwrap()
    }

    #[test]
    fn its_ports_are_those_of_its_argument() {
        let interface = speech().interface().text();
        for line in
            ["in speech: Text optional;", "out say: Text optional;", "proc speech(QueueMessage) -> Receipt idle;"]
        {
            assert!(interface.contains(line), "{interface}");
        }
        for wrong in ["", "in speech Text", "in speech many Text", "out", "by speech Text"] {
            assert!(ports(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_message_gets_its_receipt_once_the_node_has_it() {
        let mut ports = speech();
        let receipt = call(&mut ports, TEXT, text("stop"));
        let mut handed = Vec::new();
        ports.drain_messages(Time::ZERO, &mut |message| handed.push(message));
        assert_eq!((handed[0].value.clone(), handed[0].priority, handed[0].has_receipt), (text("stop"), 9, true));
        assert!(receipt.try_recv().is_err());
        ports.received(handed[0].number, MessageFate::Taken);
        assert_eq!(receipt.try_recv(), Ok(Receipt::Accepted));
    }

    #[test]
    fn what_no_activity_can_read_is_turned_away() {
        let mut ports = speech();
        let wrong_type = |found: &str| Rejected::WrongType { expected: TEXT.to_owned(), found: found.to_owned() };
        for (kind, data, found) in [("Pose", text("stop"), "Pose"), (TEXT, vec![200, 1], "Text of other fields")] {
            let receipt = call(&mut ports, kind, data);
            assert_eq!(receipt.try_recv(), Ok(Receipt::Rejected(wrong_type(found))));
        }
        assert!(ports.deliver("speech", &[200, 1], Time::ZERO).is_err());
        let long = text(&"a".repeat(SIZE_MAX));
        assert!(ports.deliver("speech", &long, Time::ZERO).is_err());
        assert!(ports.deliver("say", &text("stop"), Time::ZERO).is_err());
        ports.deliver("speech", &text("go"), Time::ZERO).unwrap();
        let mut handed = Vec::new();
        ports.drain_messages(Time::ZERO, &mut |message| handed.push(message));
        assert_eq!(handed.iter().map(|message| message.lost).collect::<Vec<_>>(), [2], "the node is told of both");
    }
}
