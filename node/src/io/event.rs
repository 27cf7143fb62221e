//! The events of the driver, and the task that hears the programs of a deployment.

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
    /// From another node, or a command line.
    Arrival(Arrival),
    /// A report of a shim, with the end of the program's output.
    Shim(ProcessId, ShimReport, Vec<String>),
    /// The shim of a program that a killed node has left was reached, or is gone; its reports have come before.
    Reached(ProcessId),
    /// A program has connected; the program itself has named its instance path.
    Program(Connection, ControlSender),
    /// A program has connected that has lost its node.
    Resumed {
        connection: Connection,
        sender: ControlSender,
        /// The version of the control protocol.
        version: u16,
        /// How many orders it has taken, and how many notices it has made.
        counts: (u64, u64),
    },
    /// A notice of a program.
    Control(Connection, Notice),
    /// The values that wires of a program have lost and its inputs have refused.
    Losses(Connection, Counted),
    /// The messages that a program has dropped because the other ends of its wires have not sealed them.
    Refused(Connection, Vec<Refused>),
    /// A user wants to call a procedure of a program, which asks under this number whether the user may.
    Judge(Connection, ControlSender, u64, UserCall),
    /// The epoch of a deployment is in the journal, or why it is not.
    Committed(Deployment, Result<(), String>),
    /// The write of this number, which says whether everything is stopped, is on the disk; or why it is not.
    EstopKept(u64, Result<(), String>),
    /// The record of a deployment was removed from the disk, or why it was not.
    Unkept(Deployment, Result<(), String>),
    /// A call that a user has signed, and that is written down.
    Admitted(u64, Request, Caller),
    /// Whether an order of another node may be carried out, by its number.
    Judged(u64, Result<(), String>),
    /// The moment has come for which a thread of the driver waits.
    Alarm,
    /// The programs of a change that cannot be started here.
    Found(Deployment, u32, Vec<String>),
}

/// The values that a program has counted since it began: see [`Notice::Losses`].
#[derive(Debug)]
pub(crate) struct Counted {
    pub(crate) wires: Vec<(u32, u64)>,
    pub(crate) refused: Vec<(String, u64)>,
}

/// A program's way to its node.
#[derive(Clone, Debug)]
pub(crate) struct Connection {
    pub(crate) deployment: Deployment,
    pub(crate) instance: String,
    /// Unique among the connections of this node: a restarted program is not taken for the previous one.
    pub(crate) number: u64,
}

/// Hears every program that connects to the socket of a deployment, until it is aborted.
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
                        tracing::warn!(error = format!("{error:#}"), "a program cannot be heard any more");
                    }
                });
            }
            Err(error) => tracing::warn!(%error, "a program could not connect"),
        }
    }
}

/// Passes on the notices of a program, which begin with its identity, until it sends no more. Its database requests go
/// to the database directly.
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
    // If the driver does not listen any more, it is gone.
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
            Notice::Losses { wires, refused } => Some(Event::Losses(connection.clone(), Counted { wires, refused })),
            Notice::Refused { wires } => Some(Event::Refused(connection.clone(), wires)),
            Notice::Judge { number, call } => Some(Event::Judge(connection.clone(), channel.clone(), number, call)),
            said @ (Notice::Hello { .. }
            | Notice::Connected
            | Notice::ConnectFailed { .. }
            | Notice::Switched { .. }
            | Notice::Running { .. }
            | Notice::Done { .. }
            | Notice::Aborted { .. }
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

/// Returns what the first notice of a program means. The notice comes back if the driver has to hear it as well.
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
        | Notice::Stopped { .. }
        | Notice::StopUnconfirmed { .. }
        | Notice::Expecting { .. }
        | Notice::Taken { .. }
        | Notice::Message(_)
        | Notice::Sent { .. }
        | Notice::Database { .. }
        | Notice::Losses { .. }
        | Notice::Refused { .. }
        | Notice::Judge { .. } => anyhow::bail!("a program did not say who it is"),
    })
}
