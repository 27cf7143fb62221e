//! The server of a view for Foxglove and Lichtblick: its connections, and the robots behind it.

mod connection;
mod orders;
mod robots;

use super::serve::{Guest, ORDER_WITHIN};
use crate::live::Live;
use crate::logic::foxglove::{Entrance, Hub};
use anyhow::Context as _;
use comms::io::clock;
use comms::logic::time::Time;
use connection::Shared;
use node::console;
use node::logic::protocol;
use orders::Carried;
use robots::{News, Robots};
use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, watch};
use tokio::task::{AbortHandle, JoinError, JoinSet};
use tokio::time::timeout;
use view::Model;

/// How many connections there may be at once, those included that have not finished their handshake.
const CONNECTIONS_MAX: usize = 64;
/// How many of them may not have finished their handshake. A further one takes the place of the oldest, so no stranger keeps a person
/// from connecting.
const STRANGERS_MAX: usize = 32;
/// How long after one look at the model the next may come: much often happens at once.
const LOOK_AGAIN: Duration = Duration::from_millis(200);
/// How often programs are looked for, and how often the model is looked at, whether something has changed or not.
const LOOK_EVERY: Duration = Duration::from_secs(1);
/// How long clients have to take the results of their orders when the command is left.
const ANSWERED_WITHIN: Duration = Duration::from_secs(1);

/// An event of the server.
pub(super) struct FoxgloveEvent(Event);

enum Event {
    Accepted(TcpStream),
    /// A client has asked for something.
    Asked,
    News(News),
    /// An order was carried out, or could not be.
    Given(Result<Carried, JoinError>),
    /// A connection has ended.
    Ended(Result<(), JoinError>),
    /// It is time to look at the model.
    Look,
}

/// The server.
pub(super) struct Foxglove {
    listener: TcpListener,
    shared: Arc<Shared>,
    connections: JoinSet<()>,
    strangers: VecDeque<(AbortHandle, Arc<Guest>)>,
    given: JoinSet<Carried>,
    robots: Robots,
    /// When the clock of the model began, since 1970.
    origin: Duration,
    looked: Time,
    has_changed: bool,
}

impl Foxglove {
    /// Begins to listen, and prints the address to open.
    pub(super) async fn open(address: SocketAddr, origins: Vec<String>, number: u64) -> anyhow::Result<Self> {
        let listener = TcpListener::bind(address).await.with_context(|| format!("listening on `{address}`"))?;
        let address = listener.local_addr()?;
        let entrance = Entrance { key: super::secret()?, origins };
        let link =
            if address.is_ipv4() { format!("ws://localhost:{}", address.port()) } else { format!("ws://{address}") };
        console::say(&link);
        console::note(&format!(
            "open this address in Foxglove or Lichtblick on this machine, as a connection of the kind `Foxglove WebSocket` (Ctrl-C \
             to leave); another user of this machine needs `{link}/?key={}`",
            entrance.key
        ));
        let (changed, _) = watch::channel(0);
        let shared = Arc::new(Shared {
            entrance,
            hub: Mutex::new(Hub::new(number)),
            changed,
            asked: Notify::new(),
            told: Mutex::default(),
        });
        let (now, since_1970) = (clock::now(), clock::unix_time());
        Ok(Self {
            listener,
            shared,
            connections: JoinSet::new(),
            strangers: VecDeque::new(),
            given: JoinSet::new(),
            robots: Robots::new(),
            origin: since_1970.saturating_sub(now.since(Time::ZERO)),
            looked: now,
            has_changed: true,
        })
    }

    /// Tells clients about an event of a robot.
    pub(super) fn event(&self, event: &protocol::Event) {
        self.shared.hub().event(event);
        self.shared.wake();
    }

    /// Takes note that the model has changed.
    pub(super) fn changed(&mut self) {
        self.has_changed = true;
    }

    /// Returns the next event.
    ///
    /// # Cancellation
    /// Safe.
    pub(super) async fn next(&mut self) -> FoxgloveEvent {
        FoxgloveEvent(self.next_event().await)
    }

    async fn next_event(&mut self) -> Event {
        let look = self.looked + if self.has_changed { LOOK_AGAIN } else { LOOK_EVERY };
        loop {
            tokio::select! {
                accepted = self.listener.accept(), if self.connections.len() < CONNECTIONS_MAX => {
                    // A client that has left before it was accepted is no reason to end.
                    if let Ok((stream, _)) = accepted {
                        return Event::Accepted(stream);
                    }
                }
                () = self.shared.asked.notified() => return Event::Asked,
                news = self.robots.next() => return Event::News(news),
                Some(done) = self.given.join_next() => return Event::Given(done),
                Some(ended) = self.connections.join_next() => return Event::Ended(ended),
                () = clock::sleep_until(look) => return Event::Look,
            }
        }
    }

    /// Acts on an event.
    pub(super) fn take(
        &mut self,
        FoxgloveEvent(event): FoxgloveEvent,
        live: &Live,
        model: &Model,
    ) -> anyhow::Result<()> {
        let mut hub = self.shared.hub();
        match event {
            Event::Accepted(stream) => {
                self.strangers.retain(|(task, guest)| !task.is_finished() && !guest.is_known());
                if self.strangers.len() >= STRANGERS_MAX
                    && let Some((oldest, _)) = self.strangers.pop_front()
                {
                    oldest.abort();
                }
                let guest = Arc::new(Guest::default());
                let connection = connection::run(stream, Arc::clone(&self.shared), Arc::clone(&guest));
                self.strangers.push_back((self.connections.spawn(connection), guest));
            }
            Event::Asked => {
                for given in hub.orders() {
                    self.given.spawn(orders::give(given, live, model, self.robots.taps()));
                }
                // New subscriptions are fetched at once.
                self.robots.follow(live, model, &mut hub);
                self.has_changed = true;
            }
            Event::News(news) => self.robots.take(news, &mut hub),
            Event::Given(done) => {
                let Carried { viewer, ticket, answer } = done?;
                hub.answer(viewer, &ticket, &answer);
            }
            Event::Ended(ended) => {
                ended.or_else(|error| if error.is_cancelled() { Ok(()) } else { Err(error) })?;
            }
            Event::Look => {
                (self.looked, self.has_changed) = (clock::now(), false);
                if !hub.is_empty() {
                    hub.look(model, self.looked, self.origin);
                }
                self.robots.follow(live, model, &mut hub);
            }
        }
        drop(hub);
        self.shared.wake();
        Ok(())
    }

    /// Finishes the orders that were just given, and ends all connections.
    pub(super) async fn close(mut self) {
        if !self.given.is_empty() {
            console::note("waiting for the results of orders");
            let finished = async {
                while let Some(done) = self.given.join_next().await {
                    if let Ok(Carried { viewer, ticket, answer }) = done {
                        self.shared.hub().answer(viewer, &ticket, &answer);
                        self.shared.wake();
                    }
                }
            };
            if timeout(ORDER_WITHIN, finished).await.is_err() {
                console::note("left before the result of an order: it may have been carried out");
            }
        }
        self.shared.end();
        let ended = async { while self.connections.join_next().await.is_some() {} };
        timeout(ANSWERED_WITHIN, ended).await.unwrap_or_default();
        self.connections.shutdown().await;
        self.given.shutdown().await;
        self.robots.close().await;
    }
}
