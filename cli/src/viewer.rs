//! `dca view --page`: a page of all robots in a browser, as they change.
//!
//! The server listens on this machine alone. The printed link has a secret, so other users of the machine and pages of other
//! sites can neither read the page nor give orders. Orders count as those of the user of this command.

mod serve;

use crate::ConnectArgs;
use crate::live::Live;
use crate::logic::http::Door;
use crate::logic::top::{Action, GivenAnswer};
use crate::orders;
use crate::reader::Reader;
use anyhow::{Context as _, anyhow};
use comms::io::clock;
use node::console::{self, Failure, block_on};
use serde_json::Value;
use serve::{Guest, ORDER_WITHIN, Order, Shared};
use std::collections::VecDeque;
use std::io::IsTerminal as _;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::{mpsc, watch};
use tokio::task::{AbortHandle, JoinSet};
use tokio::time::timeout;
use view::Model;

/// How often the plans of new deployments are asked for.
const FOLLOW_EVERY: Duration = Duration::from_secs(1);
/// How long browsers have for the results of their orders when the command is left.
const ANSWERED_WITHIN: Duration = Duration::from_secs(1);
/// How many connections there may be at once: a browser has one for the stream, and a few for files.
const CONNECTIONS_MAX: usize = 128;
/// How many of them may not have shown the key yet. A further one takes the place of the oldest, so no stranger keeps a person from
/// giving an order.
const STRANGERS_MAX: usize = 64;
/// How many orders wait; further ones wait in their connections.
const ORDERS_MAX: usize = 4;

/// The arguments of `dca view`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// Serve a page for a browser on this machine [default: 127.0.0.1:7080]
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:7080", required = true)]
    page: SocketAddr,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let address = arguments.page;
    if !address.ip().is_loopback() {
        return Err(Failure::Usage(anyhow!(
            "cannot serve a page at `{address}`: it would be open to the network. Use an address of this machine, such as \
             `127.0.0.1:{port}`, and from another machine `ssh -L {port}:127.0.0.1:{port} ROBOT`",
            port = address.port()
        )));
    }
    block_on(async {
        let mut reader = Reader::new()?;
        let live = tokio::select! {
            live = Live::open(&arguments.connect) => live?,
            () = reader.left() => return Ok(()),
        };
        let served = serve(address, live, &mut reader).await;
        served.map_err(Failure::from)
    })
}

async fn serve(address: SocketAddr, mut live: Live, reader: &mut Reader) -> anyhow::Result<()> {
    unlock(&live).await;
    let listener = TcpListener::bind(address).await.with_context(|| format!("listening on `{address}`"))?;
    let address = listener.local_addr()?;
    let (changed, version) = watch::channel(0_u64);
    let (orders_tx, mut orders) = mpsc::channel(ORDERS_MAX);
    let mut given: JoinSet<String> = JoinSet::new();
    let number = u64::try_from(clock::unix_time().as_millis()).unwrap_or(u64::MAX);
    let door = Door { address: address.to_string(), port: address.port(), key: secret()?, token: secret()? };
    console::say(&format!("http://{address}/?key={}", door.key));
    console::note("open this link in a browser on this machine (Ctrl-C to leave)");
    let shared = Arc::new(Shared { door, model: Mutex::new(Model::new(number)), version, orders: orders_tx });
    let mut tasks: JoinSet<()> = JoinSet::new();
    let mut strangers: VecDeque<(AbortHandle, Arc<Guest>)> = VecDeque::new();
    let mut follow = tokio::time::interval(FOLLOW_EVERY);
    loop {
        tokio::select! {
            input = live.next() => {
                shared.model().apply(clock::now(), input);
                changed.send_modify(|count| *count += 1);
            }
            accepted = listener.accept(), if tasks.len() < CONNECTIONS_MAX => {
                // A browser that has left before it was accepted is no reason to end.
                let Ok((stream, _)) = accepted else { continue };
                strangers.retain(|(task, guest)| !task.is_finished() && !guest.is_known());
                if strangers.len() >= STRANGERS_MAX && let Some((oldest, _)) = strangers.pop_front() {
                    oldest.abort();
                }
                let guest = Arc::new(Guest::default());
                let task = tasks.spawn(serve::connection(stream, Arc::clone(&shared), Arc::clone(&guest)));
                strangers.push_back((task, guest));
            }
            Some(order) = orders.recv() => {
                given.spawn(give(order, &live, &shared));
            }
            Some(done) = given.join_next() => drop(done?),
            _ = follow.tick() => {
                let model = shared.model();
                live.follow(&model, None, None);
            }
            Some(ended) = tasks.join_next() => ended.or_else(|error| if error.is_cancelled() { Ok(()) } else { Err(error) })?,
            () = reader.left() => break,
        }
    }
    orders.close();
    while let Ok(order) = orders.try_recv() {
        given.spawn(give(order, &live, &shared));
    }
    if !given.is_empty() {
        finish(given).await;
        // The browsers get the results. Their streams end, since nothing changes any more.
        drop(changed);
        let answered = async { while tasks.join_next().await.is_some() {} };
        timeout(ANSWERED_WITHIN, answered).await.unwrap_or_default();
    }
    tasks.shutdown().await;
    live.close().await;
    Ok(())
}

/// Waits for the orders that are still being given, and prints the results.
async fn finish(mut given: JoinSet<String>) {
    console::note("waiting for the results of orders");
    let finished = async {
        while let Some(done) = given.join_next().await {
            console::note(&done.unwrap_or_else(|error| error.to_string()));
        }
    };
    if timeout(ORDER_WITHIN, finished).await.is_err() {
        console::note("left before the result of an order: it may have been carried out");
    }
}

/// Unlocks the key of the user before the page is there, if the nodes are in a team. Without it, the page only shows.
async fn unlock(live: &Live) {
    if !std::io::stdin().is_terminal() {
        return;
    }
    for (client, host) in live.locals() {
        if client.asks_for_passphrase(&host).await.unwrap_or_default()
            && let Err(failure) = client.unlock(&host).await
        {
            console::note(&format!("warning: the page gives no orders: {}", crate::client::words(&failure)));
        }
    }
}

/// Gives an order of the page; answers with a word about it, and returns it.
fn give(order: Order, live: &Live, shared: &Shared) -> impl Future<Output = String> + Send + use<> {
    let Order { path, body, reply } = order;
    let action = action(&shared.model(), &path, &body);
    let (clients, connect) = (live.clients(), live.connect());
    let home = if let Some(Action::Answer(answer)) = &action { live.client_of(&answer.home) } else { None };
    async move {
        let word = match action {
            Some(Action::Answer(answer)) => match home {
                Some(client) => orders::tell(client, answer).await,
                None => format!("`{}` does not answer", answer.home),
            },
            Some(action) => orders::everywhere(&clients, &connect, &action).await,
            None => "the question is no longer open".to_owned(),
        };
        // A browser that has left needs no word.
        drop(reply.send(word.clone()));
        word
    }
}

/// Reads an order of the page. An answer has to be one of those of a question that is open.
fn action(model: &Model, path: &str, body: &Value) -> Option<Action> {
    match path {
        "/estop" => Some(Action::Estop),
        "/release" => Some(Action::Release),
        "/answer" => {
            let text = |name: &str| body.get(name).and_then(Value::as_str);
            let (number, option) = (body.get("question").and_then(Value::as_u64)?, text("option")?);
            let mut open = model.questions();
            let question = open.find(|one| {
                one.question.number == number
                    && text("path") == Some(one.path)
                    && text("deployment") == Some(&one.deployment.to_string())
            })?;
            let option = question.question.options.iter().find(|known| *known == option)?.clone();
            let (deployment, home, path) =
                (question.deployment.clone(), question.home.to_owned(), question.path.to_owned());
            Some(Action::Answer(GivenAnswer { deployment, home, path, question: number, option }))
        }
        _ => None,
    }
}

/// Returns a secret of 128 random bits in hexadecimal digits.
fn secret() -> anyhow::Result<String> {
    let bytes: [u8; 16] = ::team::random()?.bytes();
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}
