//! The page of a view for browsers: its connections, and the orders that they give.

use super::parameters::ParameterChange;
use super::results;
use super::serve::{self, Order, Shared};
use super::visitors::{ANSWERED_WITHIN, Limits, Visitors};
use super::ways::WaysRequest;
use crate::live::Live;
use crate::logic::http::Door;
use crate::logic::top::{Action, GivenAnswer};
use crate::orders;
use node::console;
use serde_json::Value;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::{mpsc, watch};
use tokio::task::{JoinError, JoinSet};
use view::Model;

/// A browser has one connection for the stream, and a few for files.
const LIMITS: Limits = Limits { connections: 128, strangers: 64 };
/// How many orders wait; further ones wait in their connections.
const ORDERS_MAX: usize = 4;
/// How many requests for connections to robots wait; further ones wait in their own connections.
const WAYS_MAX: usize = 16;

/// An event of the page.
pub(super) enum PageEvent {
    Accepted(anyhow::Result<TcpStream>),
    Ordered(Order),
    /// A connection needs a way to robots.
    Wanted(WaysRequest),
    /// An order was given, or could not be.
    Given(Result<String, JoinError>),
}

/// A page.
pub(super) struct Page {
    visitors: Visitors,
    shared: Arc<Shared>,
    orders: mpsc::Receiver<Order>,
    wanted: mpsc::Receiver<WaysRequest>,
    given: JoinSet<String>,
}

impl Page {
    /// Begins to listen, and prints the link.
    pub(super) async fn open(
        address: SocketAddr,
        model: Arc<Mutex<Model>>,
        version: watch::Receiver<u64>,
    ) -> anyhow::Result<Self> {
        let (visitors, address) = Visitors::listen("--page", address, LIMITS).await?;
        let (orders_tx, orders) = mpsc::channel(ORDERS_MAX);
        let (ways, wanted) = mpsc::channel(WAYS_MAX);
        let door =
            Door { address: address.to_string(), port: address.port(), key: super::secret()?, token: super::secret()? };
        console::say(&format!("http://{address}/?key={}", door.key));
        console::note("open this link in a browser on this machine (Ctrl-C to leave)");
        let shared = Arc::new(Shared { door, model, version, orders: orders_tx, ways });
        Ok(Self { visitors, shared, orders, wanted, given: JoinSet::new() })
    }

    /// Returns the next event.
    ///
    /// # Cancellation
    /// Safe.
    pub(super) async fn next(&mut self) -> PageEvent {
        tokio::select! {
            accepted = self.visitors.next() => PageEvent::Accepted(accepted),
            Some(order) = self.orders.recv() => PageEvent::Ordered(order),
            Some(wanted) = self.wanted.recv() => PageEvent::Wanted(wanted),
            Some(done) = self.given.join_next() => PageEvent::Given(done),
        }
    }

    /// Acts on an event.
    pub(super) fn take(&mut self, event: PageEvent, live: &Live) -> anyhow::Result<()> {
        match event {
            PageEvent::Accepted(accepted) => {
                let (stream, shared) = (accepted?, Arc::clone(&self.shared));
                self.visitors.serve(|guest| serve::connection(stream, shared, guest));
            }
            PageEvent::Ordered(order) => drop(self.given.spawn(give(order, live, &self.shared))),
            PageEvent::Wanted(wanted) => wanted.answer(live),
            PageEvent::Given(done) => drop(done?),
        }
        Ok(())
    }

    /// Finishes the orders that were just given, and ends all connections. `changed` is the end of the changes.
    pub(super) async fn close(mut self, live: &Live, changed: watch::Sender<u64>) {
        self.orders.close();
        while let Ok(order) = self.orders.try_recv() {
            self.given.spawn(give(order, live, &self.shared));
        }
        if self.given.is_empty() {
            return self.visitors.close(Duration::ZERO).await;
        }
        results(async {
            while let Some(done) = self.given.join_next().await {
                console::note(&done.unwrap_or_else(|error| error.to_string()));
            }
        })
        .await;
        // The browsers get the results. Their streams end, since nothing changes any more.
        drop(changed);
        self.visitors.close(ANSWERED_WITHIN).await;
    }
}

/// Carries out an order of the page. Answers with a word about the result, and returns the result.
fn give(order: Order, live: &Live, shared: &Shared) -> impl Future<Output = String> + Send + use<> {
    let Order { path, body, reply } = order;
    let model = shared.model();
    let action = action(&model, &path, &body);
    let change = if path == "/parameter" { ParameterChange::read(&body, live, &model) } else { None };
    let (clients, connect) = (live.clients(), live.connect());
    let home = if let Some(Action::Answer(answer)) = &action {
        live.client_of(&answer.mission.robot(&answer.mission.home))
    } else {
        None
    };
    async move {
        let word = match action {
            Some(Action::Answer(answer)) => match home {
                Some(client) => orders::tell(client, answer).await,
                None => format!("`{}` does not answer", answer.mission.home),
            },
            Some(action) => orders::everywhere(&clients, &connect, &action).await,
            None => match change {
                Some(change) => change.carry_out().await,
                None if path == "/parameter" => "NOT DONE: this order cannot be read".to_owned(),
                None => "the question is no longer open".to_owned(),
            },
        };
        // A browser that has left needs no word.
        drop(reply.send(word.clone()));
        word
    }
}

/// Reads an order of the page. An answer has to be an answer of an open question.
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
                    && text("mission") == Some(&one.mission.key())
            })?;
            let option = question.question.options.iter().find(|known| *known == option)?.clone();
            let (mission, path) = (question.mission.clone(), question.path.to_owned());
            Some(Action::Answer(GivenAnswer { mission, path, question: number, option }))
        }
        _ => None,
    }
}
