//! `dca ctl`: orders of people for an activity that runs.

use crate::ConnectArgs;
use crate::client::{Clients, unasked};
use crate::complete;
use crate::logic::process_name::{DeploymentName, ProcessName};
use crate::stop::{Located, locate};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use language::plan::Notice;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{ActivityInput, Answer, Request, TellRequest};
use std::time::Duration;

/// How long the home of the deployment has to answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);

/// The arguments of `dca ctl`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// The deployment: NAME, or NAME@NUMBER for one run of it
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: DeploymentName,
    /// The activity, as a path or the end of one
    #[arg(value_parser = ProcessName::parse_one, add = ArgValueCompleter::new(complete::processes))]
    activity: ProcessName,
    #[command(subcommand)]
    order: Order,
}

/// An order for an activity.
#[derive(Debug, clap::Subcommand)]
enum Order {
    /// Give it a message
    Message(Message),
    /// Ask it to suspend: its transition `on suspend` is taken
    Suspend(ConnectArgs),
    /// Ask it to go on: its transition `on resume` is taken
    Resume(ConnectArgs),
}

impl Order {
    fn connect(&self) -> &ConnectArgs {
        match self {
            Self::Message(message) => &message.connect,
            Self::Suspend(connect) | Self::Resume(connect) => connect,
        }
    }

    fn told(&self) -> ActivityInput {
        match self {
            Self::Message(Message { port, text, priority, .. }) => {
                ActivityInput::Message { port: port.clone(), text: text.clone(), priority: *priority }
            }
            Self::Suspend(_) => ActivityInput::Notice(Notice::Suspend),
            Self::Resume(_) => ActivityInput::Notice(Notice::Resume),
        }
    }

    /// The name of the order, for a person.
    fn name(&self) -> &'static str {
        match self {
            Self::Message(_) => "the message",
            Self::Suspend(_) => "the order to suspend",
            Self::Resume(_) => "the order to resume",
        }
    }
}

/// A message for an activity.
#[derive(Debug, clap::Args)]
struct Message {
    /// The input port
    port: String,
    /// The content
    text: String,
    /// The priority; of messages that wait, a greater one comes first
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    priority: u8,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    block_on(async {
        let clients = Clients::open(arguments.order.connect()).await?;
        let told = tell(&clients, arguments).await;
        clients.close().await;
        told
    })
}

async fn tell(clients: &Clients, arguments: &Arguments) -> Result<(), Failure> {
    let Located { client, deployment, home } = locate(clients.statuses().await?, &arguments.name).await?;
    let activity = &arguments.activity;
    if activity.deployment().is_some_and(|named| !named.is(&deployment)) {
        return Err(Failure::Usage(anyhow!("`{activity}` is not a process of `{deployment}`")));
    }
    let (name, process) = (deployment.name.clone(), activity.process().unwrap_or_default().to_owned());
    let order = &arguments.order;
    let request = TellRequest { name, process, order: order.told() };
    let request = client.signed(&home, Request::Tell(Box::new(request)), deployment.epoch).await?;
    let answer = client.ask(&home, &request, ANSWER_WITHIN).await?;
    let Answer::Delivered(told) = answer else { return Err(unasked(&home, &answer)) };
    let path = told.map_err(|why| anyhow!("cannot give {}: {why}", order.name()))?;
    console::say(&format!("`{path}` gets {}\n", order.name()));
    Ok(())
}
