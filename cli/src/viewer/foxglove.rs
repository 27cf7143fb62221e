//! The server of a view for Foxglove and Lichtblick: its connections, and the robots behind it.

mod connection;
mod layout;
mod orders;
mod recording;
mod robots;

use super::results;
use super::visitors::{ANSWERED_WITHIN, Limits, Visitors};
use crate::live::Live;
use crate::logic::foxglove::{Entrance, Hub};
use comms::io::clock;
use comms::logic::time::Time;
use connection::Shared;
use node::console;
use node::logic::protocol;
use orders::Carried;
use robots::{News, Robots};
use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::net::TcpStream;
use tokio::sync::{Notify, watch};
use tokio::task::{JoinError, JoinSet};
use view::Model;

pub(crate) use layout::put as put_layout;
pub(super) use layout::write as write_layout;
pub(crate) use recording::serve as serve_record;

/// A client is let in when its handshake is finished.
const LIMITS: Limits = Limits { connections: 64, strangers: 32 };
/// How long after one look at the model the next may come: much often happens at once.
const LOOK_AGAIN: Duration = Duration::from_millis(200);
/// How often the view looks for programs, and how often it reads the model even if nothing has changed.
const LOOK_EVERY: Duration = Duration::from_secs(1);

/// An event of the server.
pub(super) struct FoxgloveEvent(Event);

enum Event {
    Accepted(anyhow::Result<TcpStream>),
    /// A client has asked for something.
    Asked,
    News(News),
    /// An order was carried out, or could not be.
    Given(Result<Carried, JoinError>),
    /// It is time to look at the model.
    Look,
}

/// A server, and the clients that are connected.
struct FoxgloveServer {
    visitors: Visitors,
    shared: Arc<Shared>,
}

impl FoxgloveServer {
    /// Begins to listen, and prints the address to open.
    async fn open(address: SocketAddr, origins: Vec<String>, hub: Hub) -> anyhow::Result<Self> {
        let (visitors, address) = Visitors::listen("--foxglove", address, LIMITS).await?;
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
        let shared =
            Arc::new(Shared { entrance, hub: Mutex::new(hub), changed, asked: Notify::new(), told: Mutex::default() });
        Ok(Self { visitors, shared })
    }

    /// Serves a client.
    fn accept(&mut self, stream: TcpStream) {
        let shared = Arc::clone(&self.shared);
        self.visitors.serve(|guest| connection::run(stream, shared, guest));
    }

    /// Ends all connections.
    async fn close(self) {
        self.shared.end();
        self.visitors.close(ANSWERED_WITHIN).await;
    }
}

/// The server of the view.
pub(super) struct Foxglove {
    server: FoxgloveServer,
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
        let server = FoxgloveServer::open(address, origins, Hub::new(number)).await?;
        let (now, since_1970) = (clock::now(), clock::unix_time());
        Ok(Self {
            server,
            given: JoinSet::new(),
            robots: Robots::new(),
            origin: since_1970.saturating_sub(now.since(Time::ZERO)),
            looked: now,
            has_changed: true,
        })
    }

    /// Tells clients about an event of a robot.
    pub(super) fn event(&self, event: &protocol::Event) {
        self.server.shared.hub().event(event);
        self.server.shared.wake();
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
        tokio::select! {
            accepted = self.server.visitors.next() => Event::Accepted(accepted),
            () = self.server.shared.asked.notified() => Event::Asked,
            news = self.robots.next() => Event::News(news),
            Some(done) = self.given.join_next() => Event::Given(done),
            () = clock::sleep_until(look) => Event::Look,
        }
    }

    /// Acts on an event.
    pub(super) fn take(
        &mut self,
        FoxgloveEvent(event): FoxgloveEvent,
        live: &Live,
        model: &Model,
    ) -> anyhow::Result<()> {
        let shared = Arc::clone(&self.server.shared);
        let mut hub = shared.hub();
        match event {
            Event::Accepted(accepted) => self.server.accept(accepted?),
            Event::Asked => {
                for given in hub.orders() {
                    let taps = given.callee().and_then(|program| self.robots.taps(program.mission.fleet));
                    self.given.spawn(orders::give(given, live, model, taps));
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
            Event::Look => {
                (self.looked, self.has_changed) = (clock::now(), false);
                if !hub.is_empty() {
                    hub.look(model, self.looked, self.origin);
                }
                self.robots.follow(live, model, &mut hub);
            }
        }
        drop(hub);
        shared.wake();
        Ok(())
    }

    /// Finishes the orders that were just given, and ends all connections.
    pub(super) async fn close(mut self) {
        if !self.given.is_empty() {
            results(async {
                while let Some(done) = self.given.join_next().await {
                    if let Ok(Carried { viewer, ticket, answer }) = done {
                        self.server.shared.hub().answer(viewer, &ticket, &answer);
                        self.server.shared.wake();
                    }
                }
            })
            .await;
        }
        self.server.close().await;
        self.given.shutdown().await;
        self.robots.close().await;
    }
}
