//! `dca view`: all robots as they change, on a page for a browser, for Foxglove, and as traces for OpenTelemetry.
//! `dca replay --foxglove` serves a record.
//!
//! The servers listen on this machine alone. Neither other users of the machine nor pages of other sites can read or give orders.
//! Orders have the rights of the user of this command.

mod database;
pub(crate) mod foxglove;
mod otlp;
mod output;
mod page;
mod parameters;
mod serve;
mod visitors;
mod ways;

use crate::ConnectArgs;
use crate::live::Live;
use crate::logic::collector::Collector;
use crate::logic::foxglove::origin;
use crate::reader::Reader;
use anyhow::anyhow;
use clap::ArgGroup;
use comms::io::clock;
use foxglove::Foxglove;
use node::console::{self, Failure, block_on};
use otlp::Otlp;
use page::Page;
use serve::ORDER_WITHIN;
use std::io::IsTerminal as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::timeout;
use view::{Input, Model};

/// How often the plans of new deployments are asked for.
const FOLLOW_EVERY: Duration = Duration::from_secs(1);

/// The usual address of the page, and of the server for Foxglove.
const PAGE: &str = "127.0.0.1:7080";
pub(crate) const FOXGLOVE: &str = "127.0.0.1:8765";

/// The arguments of `dca view`.
#[derive(Debug, clap::Args)]
#[command(group(ArgGroup::new("shown").required(true).multiple(true).args(["page", "foxglove", "otlp", "layout"])))]
pub(crate) struct Arguments {
    /// Serve a page for a browser on this machine [default: 127.0.0.1:7080]
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = PAGE, value_parser = address)]
    page: Option<SocketAddr>,
    /// Serve topics, parameters and services for Foxglove or Lichtblick on this machine [default: 127.0.0.1:8765]
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = FOXGLOVE, value_parser = address)]
    foxglove: Option<SocketAddr>,
    /// Send the missions as traces to a collector of OpenTelemetry, such as `http://localhost:4318`
    #[arg(long, value_name = "URL", value_parser = Collector::parse)]
    otlp: Option<Collector>,
    /// Write a layout for Foxglove or Lichtblick with panels for the missions that run, instead of serving anything
    #[arg(long, value_name = "FILE", conflicts_with_all = ["page", "foxglove", "otlp"])]
    layout: Option<PathBuf>,
    /// Let a web page of this origin connect to `--foxglove`, such as `https://viewer.example`; may be given more than once
    /// [default: Foxglove, Lichtblick and pages of this machine]
    #[arg(long = "origin", value_name = "ORIGIN", value_parser = origin, requires = "foxglove")]
    origins: Vec<String>,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Reads an address of this machine.
///
/// # Errors
/// One sentence about the mistake.
pub(crate) fn address(text: &str) -> Result<SocketAddr, String> {
    let port = text.parse::<u16>();
    text.parse().map_err(|_not_an_address| match port {
        Ok(port) => format!("an address has a host and a port: `127.0.0.1:{port}`"),
        Err(_) => "it is not an address with a port, such as `127.0.0.1:7080`".to_owned(),
    })
}

/// Refuses an address that others can reach.
pub(crate) fn local(option: &str, address: Option<SocketAddr>) -> Result<(), Failure> {
    let Some(address) = address.filter(|address| !address.ip().is_loopback()) else { return Ok(()) };
    Err(Failure::Usage(anyhow!(
        "cannot serve `{option}` at `{address}`: it would be open to the network. Use an address of this machine, such as \
         `127.0.0.1:{port}`, and from another machine `ssh -L {port}:127.0.0.1:{port} ROBOT`",
        port = address.port()
    )))
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    local("--page", arguments.page)?;
    local("--foxglove", arguments.foxglove)?;
    block_on(async {
        let mut reader = Reader::new()?;
        let live = tokio::select! {
            live = Live::open(&arguments.connect) => live?,
            () = reader.left() => return Ok(()),
        };
        if let Some(file) = &arguments.layout {
            return foxglove::write_layout(file, live, &mut reader).await;
        }
        let served = serve(arguments, live, &mut reader).await;
        served.map_err(Failure::from)
    })
}

async fn serve(arguments: &Arguments, mut live: Live, reader: &mut Reader) -> anyhow::Result<()> {
    unlock(&live).await;
    let number = u64::try_from(clock::unix_time().as_millis()).unwrap_or(u64::MAX);
    let model = Arc::new(Mutex::new(Model::new(number)));
    let (changed, version) = watch::channel(0_u64);
    let mut page = match arguments.page {
        Some(address) => Some(Page::open(address, Arc::clone(&model), version).await?),
        None => None,
    };
    let mut foxglove = match arguments.foxglove {
        Some(address) => Some(Foxglove::open(address, arguments.origins.clone(), number).await?),
        None => None,
    };
    let mut otlp = arguments.otlp.clone().map(Otlp::new);
    let mut follow = tokio::time::interval(FOLLOW_EVERY);
    loop {
        tokio::select! {
            input = live.next() => {
                if let Input::Event { home, event } = &input {
                    if let Some(foxglove) = &foxglove {
                        foxglove.event(event);
                    }
                    if let Some(otlp) = &mut otlp {
                        otlp.event(home, event);
                    }
                }
                model.lock().unwrap_or_else(PoisonError::into_inner).apply(clock::now(), input);
                changed.send_modify(|count| *count += 1);
                if let Some(foxglove) = &mut foxglove {
                    foxglove.changed();
                }
            }
            Some(event) = async { Some(page.as_mut()?.next().await) } => {
                if let Some(page) = &mut page {
                    page.take(event, &live)?;
                }
            }
            Some(event) = async { Some(foxglove.as_mut()?.next().await) } => {
                if let Some(foxglove) = &mut foxglove {
                    foxglove.take(event, &live, &model.lock().unwrap_or_else(PoisonError::into_inner))?;
                }
            }
            _ = follow.tick() => {
                live.follow(&model.lock().unwrap_or_else(PoisonError::into_inner), None, None);
                if let Some(otlp) = &mut otlp {
                    otlp.send();
                }
            }
            () = reader.left() => break,
        }
    }
    if let Some(page) = page {
        page.close(&live, changed).await;
    }
    if let Some(foxglove) = foxglove {
        foxglove.close().await;
    }
    if let Some(otlp) = otlp {
        otlp.close().await;
    }
    live.close().await;
    Ok(())
}

/// Unlocks the key of the user before anything is served, if the nodes are in a team. Without it, the view only shows.
async fn unlock(live: &Live) {
    if !std::io::stdin().is_terminal() {
        return;
    }
    for (client, host) in live.locals() {
        if client.asks_for_passphrase(&host).await.unwrap_or_default()
            && let Err(failure) = client.unlock(&host).await
        {
            console::note(&format!("warning: this view gives no orders: {}", crate::client::words(&failure)));
        }
    }
}

/// Waits for the results of the orders that are still being given when the command is left.
async fn results(finished: impl Future<Output = ()>) {
    console::note("waiting for the results of orders");
    if timeout(ORDER_WITHIN, finished).await.is_err() {
        console::note("this command ended before the result of an order arrived: the order may have been carried out");
    }
}

/// Returns a secret of 128 random bits in hexadecimal digits.
fn secret() -> anyhow::Result<String> {
    let bytes: [u8; 16] = ::team::random()?.bytes();
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}
