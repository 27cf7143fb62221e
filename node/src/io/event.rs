//! The events of the driver, and the task that receives the notices of a deployment's programs.

use crate::io::caller::Caller;
use crate::io::peers::Arrival;
use crate::io::program_database::ProgramDatabase;
use crate::logic::effect::ProcessId;
use crate::logic::protocol::{Deployment, Request};
use comms::io::control::{ControlReceiver, ControlSender, Listener};
use comms::logic::control::{Notice, UserCall};
use comms::logic::seal::Refused;
use shim::protocol::ShimReport;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use tokio::sync::mpsc::Sender;
use tokio::task::JoinSet;

/// Something that happened outside the agent.
#[derive(Debug)]
pub(crate) enum Event {
    /// An arrival from another node or from a command line.
    Arrival(Arrival),
    /// A report of a shim, with the last lines of the program's output.
    Shim(ProcessId, ShimReport, Vec<String>),
    /// The shim of a program of a killed node was reached, or is gone. Its reports have come before this event.
    Reached(ProcessId),
    /// A program has connected. It has named the path of its instance itself.
    Program(Connection, ControlSender),
    /// A program has connected again after it had lost its node.
    Resumed {
        connection: Connection,
        sender: ControlSender,
        /// The version of the control protocol.
        version: u16,
        /// How many orders the program has taken, and how many notices it has made.
        counts: (u64, u64),
    },
    /// A notice of a program.
    Control(Connection, Notice),
    /// The values that wires of a program have lost, that its inputs have refused, and that were not delivered.
    Losses(Connection, Counted),
    /// The messages that a program has dropped because the other ends of its wires have not sealed them.
    Refused(Connection, Vec<Refused>),
    /// A user wants to call a procedure of a program. The program asks, with this number, whether the user may make the call.
    Judge(Connection, ControlSender, u64, UserCall),
    /// The epoch of a deployment is in the journal, or the reason why it is not.
    Committed(Deployment, Result<(), String>),
    /// The write with this number is on the disk, or the reason why it is not. It says whether everything is stopped.
    EstopKept(u64, Result<(), String>),
    /// The record of a deployment was removed from the disk, or the reason why it was not.
    Unkept(Deployment, Result<(), String>),
    /// A call that a user has signed. It is in the ledger.
    Admitted(u64, Request, Caller),
    /// Whether an order of another node may be carried out. The number identifies the order.
    Judged(u64, Result<(), String>),
    /// The time that a thread of the driver was waiting for has come.
    Alarm,
    /// The programs of a change that cannot be started on this host.
    Found(Deployment, u32, Vec<String>),
}

/// Counts of a program since its start: see [`Notice::Losses`].
#[derive(Debug)]
pub(crate) struct Counted {
    pub(crate) wires: Vec<(u32, u64)>,
    pub(crate) refused: Vec<(String, u64)>,
    pub(crate) undelivered: Vec<(u32, u64)>,
}

/// The connection of a program to its node.
#[derive(Clone, Debug)]
pub(crate) struct Connection {
    pub(crate) deployment: Deployment,
    pub(crate) instance: String,
    /// A number that no other connection of this node has. So a restarted program is not confused with the previous one.
    pub(crate) number: u64,
}

/// Accepts every program that connects to the socket of a deployment, until it is aborted.
pub(crate) async fn hear_programs(
    listener: Listener,
    deployment: Deployment,
    connected: Arc<AtomicU64>,
    database: ProgramDatabase,
    events: Sender<Event>,
) {
    let mut programs = JoinSet::new();
    loop {
        while programs.try_join_next().is_some() {}
        match listener.accept().await {
            Ok((sender, receiver)) => {
                let number = connected.fetch_add(1, Ordering::Relaxed);
                let connection = Connection { deployment: deployment.clone(), instance: String::new(), number };
                let hearing = hear(events.clone(), database.clone(), connection, sender, receiver);
                programs.spawn(async move {
                    if let Err(error) = hearing.await {
                        tracing::warn!(error = format!("{error:#}"), "the connection of a program has failed");
                    }
                });
            }
            Err(error) => tracing::warn!(%error, "a program could not connect"),
        }
    }
}

/// Passes on the notices of a program until it sends no more. The first one identifies the program. Its database
/// requests go directly to the database.
async fn hear(
    events: Sender<Event>,
    database: ProgramDatabase,
    mut connection: Connection,
    sender: ControlSender,
    mut receiver: ControlReceiver,
) -> anyhow::Result<()> {
    let Some(hello) = receiver.recv().await? else { return Ok(()) };
    let channel = sender.clone();
    let (event, hello) = greeted(hello, &mut connection, sender)?;
    let mut requests = database.open(&connection.deployment, &connection.instance, channel.clone());
    if hello.is_some() {
        requests.tell_ports();
    }
    requests.follow_secrets();
    // If the driver does not listen any more, it has ended.
    if events.send(event).await.is_err() {
        return Ok(());
    }
    let mut notice = if hello.is_some() { hello } else { receiver.recv().await? };
    while let Some(said) = notice {
        let event = match said {
            Notice::Database { number, request } => {
                requests.take(number, request);
                None
            }
            Notice::Losses { wires, refused, undelivered } => {
                Some(Event::Losses(connection.clone(), Counted { wires, refused, undelivered }))
            }
            Notice::Refused { wires } => Some(Event::Refused(connection.clone(), wires)),
            Notice::Judge { number, call } => Some(Event::Judge(connection.clone(), channel.clone(), number, call)),
            said @ (Notice::Hello { .. }
            | Notice::Connected
            | Notice::ConnectFailed { .. }
            | Notice::Switched { .. }
            | Notice::Running { .. }
            | Notice::Done { .. }
            | Notice::Aborted { .. }
            | Notice::Stopping { .. }
            | Notice::Stopped { .. }
            | Notice::StopUnconfirmed { .. }
            | Notice::Resume { .. }
            | Notice::Expecting { .. }
            | Notice::Taken { .. }
            | Notice::Message(_)
            | Notice::Sent { .. }) => Some(Event::Control(connection.clone(), said)),
        };
        if let Some(event) = event
            && events.send(event).await.is_err()
        {
            return Ok(());
        }
        notice = receiver.recv().await?;
    }
    Ok(())
}

/// Returns the event for the first notice of a program. Also returns the notice itself if the driver needs it as well.
fn greeted(
    hello: Notice,
    connection: &mut Connection,
    sender: ControlSender,
) -> anyhow::Result<(Event, Option<Notice>)> {
    Ok(match hello {
        Notice::Hello { ref instance, .. } => {
            connection.instance.clone_from(instance);
            (Event::Program(connection.clone(), sender), Some(hello))
        }
        Notice::Resume { instance, version, orders, notices } => {
            connection.instance = instance;
            (Event::Resumed { connection: connection.clone(), sender, version, counts: (orders, notices) }, None)
        }
        Notice::Connected
        | Notice::ConnectFailed { .. }
        | Notice::Switched { .. }
        | Notice::Running { .. }
        | Notice::Done { .. }
        | Notice::Aborted { .. }
        | Notice::Stopping { .. }
        | Notice::Stopped { .. }
        | Notice::StopUnconfirmed { .. }
        | Notice::Expecting { .. }
        | Notice::Taken { .. }
        | Notice::Message(_)
        | Notice::Sent { .. }
        | Notice::Database { .. }
        | Notice::Losses { .. }
        | Notice::Refused { .. }
        | Notice::Judge { .. } => anyhow::bail!("a program did not identify itself"),
    })
}
