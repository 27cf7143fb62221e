//! The page of a view for browsers: its connections, and the orders that they give.

use super::serve::{self, Guest, ORDER_WITHIN, Order, Shared};
use crate::live::Live;
use crate::logic::http::Door;
use crate::logic::top::{Action, GivenAnswer};
use crate::orders;
use anyhow::Context as _;
use node::console;
use serde_json::Value;
use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{mpsc, watch};
use tokio::task::{AbortHandle, JoinError, JoinSet};
use tokio::time::timeout;
use view::Model;

/// How long browsers have for the results of their orders when the command is left.
const ANSWERED_WITHIN: Duration = Duration::from_secs(1);
/// How many connections there may be at once: a browser has one for the stream, and a few for files.
const CONNECTIONS_MAX: usize = 128;
/// How many of them may not have shown the key yet. A further one takes the place of the oldest, so no stranger keeps a person from
/// giving an order.
const STRANGERS_MAX: usize = 64;
/// How many orders wait; further ones wait in their connections.
const ORDERS_MAX: usize = 4;

/// An event of the page.
pub(super) enum PageEvent {
    Accepted(TcpStream),
    Ordered(Order),
    /// An order was given, or could not be.
    Given(Result<String, JoinError>),
    /// A connection has ended.
    Ended(Result<(), JoinError>),
}

/// A page.
pub(super) struct Page {
    listener: TcpListener,
    shared: Arc<Shared>,
    orders: mpsc::Receiver<Order>,
    given: JoinSet<String>,
    tasks: JoinSet<()>,
    strangers: VecDeque<(AbortHandle, Arc<Guest>)>,
}

impl Page {
    /// Begins to listen, and prints the link.
    pub(super) async fn open(
        address: SocketAddr,
        model: Arc<Mutex<Model>>,
        version: watch::Receiver<u64>,
    ) -> anyhow::Result<Self> {
        let listener = TcpListener::bind(address).await.with_context(|| format!("listening on `{address}`"))?;
        let address = listener.local_addr()?;
        let (orders_tx, orders) = mpsc::channel(ORDERS_MAX);
        let door =
            Door { address: address.to_string(), port: address.port(), key: super::secret()?, token: super::secret()? };
        console::say(&format!("http://{address}/?key={}", door.key));
        console::note("open this link in a browser on this machine (Ctrl-C to leave)");
        let shared = Arc::new(Shared { door, model, version, orders: orders_tx });
        let (given, tasks, strangers) = (JoinSet::new(), JoinSet::new(), VecDeque::new());
        Ok(Self { listener, shared, orders, given, tasks, strangers })
    }

    /// Returns the next event.
    ///
    /// # Cancellation
    /// Safe.
    pub(super) async fn next(&mut self) -> PageEvent {
        loop {
            tokio::select! {
                accepted = self.listener.accept(), if self.tasks.len() < CONNECTIONS_MAX => {
                    // A browser that has left before it was accepted is no reason to end.
                    if let Ok((stream, _)) = accepted {
                        return PageEvent::Accepted(stream);
                    }
                }
                Some(order) = self.orders.recv() => return PageEvent::Ordered(order),
                Some(done) = self.given.join_next() => return PageEvent::Given(done),
                Some(ended) = self.tasks.join_next() => return PageEvent::Ended(ended),
            }
        }
    }

    /// Acts on an event.
    pub(super) fn take(&mut self, event: PageEvent, live: &Live) -> anyhow::Result<()> {
        match event {
            PageEvent::Accepted(stream) => {
                self.strangers.retain(|(task, guest)| !task.is_finished() && !guest.is_known());
                if self.strangers.len() >= STRANGERS_MAX
                    && let Some((oldest, _)) = self.strangers.pop_front()
                {
                    oldest.abort();
                }
                let guest = Arc::new(Guest::default());
                let connection = serve::connection(stream, Arc::clone(&self.shared), Arc::clone(&guest));
                self.strangers.push_back((self.tasks.spawn(connection), guest));
            }
            PageEvent::Ordered(order) => drop(self.given.spawn(give(order, live, &self.shared))),
            PageEvent::Given(done) => drop(done?),
            PageEvent::Ended(ended) => {
                ended.or_else(|error| if error.is_cancelled() { Ok(()) } else { Err(error) })?;
            }
        }
        Ok(())
    }

    /// Finishes the orders that were just given, and ends all connections. `changed` is the end of the changes.
    pub(super) async fn close(mut self, live: &Live, changed: watch::Sender<u64>) {
        self.orders.close();
        while let Ok(order) = self.orders.try_recv() {
            self.given.spawn(give(order, live, &self.shared));
        }
        if !self.given.is_empty() {
            finish(self.given).await;
            // The browsers get the results. Their streams end, since nothing changes any more.
            drop(changed);
            let answered = async { while self.tasks.join_next().await.is_some() {} };
            timeout(ANSWERED_WITHIN, answered).await.unwrap_or_default();
        }
        self.tasks.shutdown().await;
    }
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
