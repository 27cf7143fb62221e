//! The queue of messages from an editor. Requests that the editor has cancelled are removed.

use super::interfaces::InterfaceReply;
use super::lens::ProofReply;
use super::rpc::Message;
use super::server::{Reply, refusal};
use lsp_types::LspErrorCodes;
use lsp_types::json_rpc::Id;
use serde_json::Value;
use std::collections::VecDeque;
use std::sync::mpsc::Receiver;

/// An event for the server.
#[derive(Debug)]
pub(super) enum Event {
    /// A message of the editor.
    Message(Message),
    /// A program has printed its interface, or has failed to print it.
    Interface(InterfaceReply),
    /// A proof about a text is finished.
    Proof(ProofReply),
    /// The editor sends no more messages.
    End,
}

/// The events in their order.
pub(super) struct Inbox {
    events: Receiver<Event>,
    waiting: VecDeque<Event>,
    waiting_max: usize,
}

impl Inbox {
    pub(super) fn new(events: Receiver<Event>, waiting_max: usize) -> Self {
        Self { events, waiting: VecDeque::new(), waiting_max }
    }

    /// Waits for the next event. Also reads later events that have already arrived. So a waiting request that the
    /// editor has cancelled gets an answer that says this, and is never handled.
    pub(super) fn next(&mut self, replies: &mut Vec<Reply>) -> Event {
        if self.waiting.is_empty() {
            let first = self.events.recv().unwrap_or(Event::End);
            self.waiting.push_back(first);
        }
        while self.waiting.len() < self.waiting_max {
            let Ok(event) = self.events.try_recv() else { break };
            match cancelled(&event) {
                Some(id) => self.call_off(&id, replies),
                None => self.waiting.push_back(event),
            }
        }
        self.waiting.pop_front().unwrap_or(Event::End)
    }

    /// Returns whether a later event in the queue changes a text.
    pub(super) fn has_change(&self) -> bool {
        let is_change = |event: &Event| matches!(event, Event::Message(Message::Notification { method, .. }) if method == "textDocument/didChange");
        self.waiting.iter().any(is_change)
    }

    fn call_off(&mut self, id: &Id, replies: &mut Vec<Reply>) {
        let is_it = |event: &Event| matches!(event, Event::Message(Message::Request { id: other, .. }) if other == id);
        if let Some(place) = self.waiting.iter().position(is_it) {
            self.waiting.remove(place);
            replies.push(refusal(id.clone(), LspErrorCodes::RequestCancelled, "the request was cancelled"));
        }
    }
}

/// Returns the request that an event cancels, if it cancels one.
fn cancelled(event: &Event) -> Option<Id> {
    let Event::Message(Message::Notification { method, params }) = event else { return None };
    let id: &Value = params.get("id").filter(|_| method == "$/cancelRequest")?;
    serde_json::from_value(id.clone()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::sync::mpsc::sync_channel;

    #[test]
    fn a_request_that_waits_can_be_called_off() {
        let (events_tx, events) = sync_channel(8);
        let request = |id: i64| Message::Request { id: Id::Number(id), method: "a".to_owned(), params: Value::Null };
        let cancel =
            |id: i64| Message::Notification { method: "$/cancelRequest".to_owned(), params: json!({"id": id}) };
        for message in [request(1), request(2), cancel(2), cancel(9), request(3)] {
            events_tx.send(Event::Message(message)).unwrap();
        }
        drop(events_tx);
        let mut inbox = Inbox::new(events, 8);
        let (mut replies, mut handled) = (Vec::new(), Vec::new());
        while let Event::Message(Message::Request { id, .. }) = inbox.next(&mut replies) {
            handled.push(id);
        }
        assert_eq!(handled, [Id::Number(1), Id::Number(3)]);
        assert_eq!((replies.len(), &replies[0]["id"], &replies[0]["error"]["code"]), (1, &json!(2), &json!(-32800)));
    }
}
