//! `dca lsp`: a language server, over standard input and output.
//!
//! One thread reads messages, and the main thread answers them in their order. Further threads ask programs for their
//! interfaces and compute proofs; their results arrive in the same queue. After each keystroke, the whole text is
//! checked. If the next keystroke is already in the queue, the text in between is not checked. Nothing is computed in
//! advance, so no result is out of date.

mod answer;
mod convert;
mod disk;
mod editor;
mod inbox;
mod interfaces;
mod lens;
mod position;
mod publish;
mod rpc;
mod server;
mod workspace;

use crate::Controllers;
use inbox::{Event, Inbox};
use interfaces::Interfaces;
use lens::Proofs;
use node::console::{self, Failure};
use node::io::programs;
use server::{Server, State};
use std::io::{self, BufReader};
use std::sync::mpsc::{SyncSender, sync_channel};

/// The most messages in the queue.
const QUEUE_MAX: usize = 256;

/// The arguments of `dca lsp`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    controllers: Controllers,
    /// The default; some editors pass it anyway
    #[arg(long, hide = true)]
    stdio: bool,
}

/// Runs the verb until the editor sends `exit` or disconnects.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let (events_tx, events) = sync_channel(QUEUE_MAX);
    let reader_tx = events_tx.clone();
    // The thread is not joined: it ends with standard input, or with the process.
    std::thread::Builder::new().name("reader".to_owned()).spawn(move || read(&reader_tx))?;
    let proofs = Proofs::new(events_tx.clone());
    let interfaces = Interfaces::new(programs::chosen(&arguments.controllers.programs), events_tx);
    let mut server = Server::new(interfaces, proofs);
    let mut inbox = Inbox::new(events, QUEUE_MAX);
    loop {
        let mut replies = Vec::new();
        match inbox.next(&mut replies) {
            Event::Message(message) => server.handle(message, &mut replies),
            Event::Interface(interface) => server.arrived(interface, &mut replies),
            Event::Proof(proof) => server.proved(proof, &mut replies),
            Event::End => return Err(Failure::Reported),
        }
        if !inbox.has_change() {
            server.publish(&mut replies);
        }
        for reply in replies {
            // If the editor has disconnected, it needs no answer.
            if !console::pass(&rpc::frame(&reply)).or(Err(Failure::Reported))? {
                return Err(Failure::Reported);
            }
        }
        match server.state() {
            State::Ended => return Ok(()),
            State::Abandoned => return Err(Failure::Reported),
            State::Fresh | State::Ready | State::ShutDown => {}
        }
    }
}

/// Passes on the editor's messages until they end.
fn read(events: &SyncSender<Event>) {
    let mut input = BufReader::new(io::stdin().lock());
    loop {
        let event = match rpc::read(&mut input) {
            Ok(Some(message)) => Event::Message(message),
            Ok(None) | Err(_) => Event::End,
        };
        let is_end = matches!(event, Event::End);
        if events.send(event).is_err() || is_end {
            return;
        }
    }
}
