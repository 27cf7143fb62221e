//! `dca ctl`: orders of people for an activity that runs.

use crate::ConnectArgs;
use crate::client::{Clients, unasked};
use crate::complete;
use crate::logic::process_name::DeploymentName;
use crate::stop::{Located, locate};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Answer, Request, TellRequest};
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
    #[arg(add = ArgValueCompleter::new(complete::processes))]
    activity: String,
    #[command(subcommand)]
    order: Order,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// An order for an activity.
#[derive(Debug, clap::Subcommand)]
enum Order {
    /// Give it a message
    Message {
        /// The input port
        port: String,
        /// The content
        text: String,
        /// The priority; of messages that wait, a greater one comes first
        #[arg(long, value_name = "NUMBER", default_value_t = 0)]
        priority: u8,
    },
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let told = tell(&clients, arguments).await;
        clients.close().await;
        told
    })
}

async fn tell(clients: &Clients, arguments: &Arguments) -> Result<(), Failure> {
    let Located { client, deployment, home } = locate(clients.statuses().await?, &arguments.name).await?;
    let Order::Message { port, text, priority } = &arguments.order;
    let (process, port, text) = (arguments.activity.clone(), port.clone(), text.clone());
    let request = TellRequest { name: deployment.name.clone(), process, port, text, priority: *priority };
    let request = client.signed(&home, Request::Tell(Box::new(request)), deployment.epoch).await?;
    let answer = client.ask(&home, &request, ANSWER_WITHIN).await?;
    let Answer::Told(told) = answer else { return Err(unasked(&home, &answer)) };
    let path = told.map_err(|why| anyhow!("cannot give the message: {why}"))?;
    console::say(&format!("`{path}` gets the message\n"));
    Ok(())
}
