//! The session with the router of ROS 2: publishers, subscribers, and the tokens that show them to other nodes.

pub(crate) mod container;
pub(crate) mod installation;
pub(crate) mod managed;
pub(crate) mod parameters;
pub(crate) mod program;
pub(crate) mod services;

use crate::logic::arrivals::{Arrivals, Told};
use crate::logic::network::Network;
use crate::logic::others::Others;
use crate::setup;
use comms::io::clock::{Wakeup, now, unix_time};
use controllers::sdk::Waker;
use ros::logic::attachment::{Attachment, Gid};
use ros::logic::key::{GraphName, Topic};
use ros::logic::name::TypeName;
use ros::logic::qos::{Durability, History, Qos, Reliability};
use ros::logic::token::{Endpoint, Node, Role, Token};
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use zenoh::bytes::ZBytes;
use zenoh::key_expr::KeyExpr;
use zenoh::liveliness::LivelinessToken;
use zenoh::qos::CongestionControl;
use zenoh::sample::{Sample, SampleKind};
use zenoh::{Config, Session, Wait};
use zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt, AdvancedSubscriber, AdvancedSubscriberBuilderExt, CacheConfig,
    HistoryConfig, MissDetectionConfig, RecoveryConfig,
};

/// The time limit for the router's answer.
const OPEN_WITHIN: Duration = Duration::from_secs(5);
/// The pause before the next attempt to reach the router.
const RETRY_AFTER: Duration = Duration::from_millis(100);
/// How long the session may take to close. Zenoh alone takes up to 10 s if the router has vanished.
const CLOSE_WITHIN: Duration = Duration::from_millis(500);
/// How often a publisher sends its last number to late subscribers, as in `rmw_zenoh`.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// Settings of every session: it has one link to the router, and does not search for other peers.
const SETTINGS: [(&str, &str); 7] = [
    ("mode", "\"client\""),
    ("scouting/multicast/enabled", "false"),
    ("scouting/gossip/enabled", "false"),
    ("timestamping/enabled", "true"),
    ("connect/timeout_ms", "0"),
    ("connect/exit_on_failure", "true"),
    ("connect/retry", "{ period_init_ms: 100, period_max_ms: 1000, period_increase_factor: 2 }"),
];
/// The number of the node of the bridge within its session.
const NODE: u64 = 0;

/// The messages of a topic that wait for the loop.
pub(crate) type Waiting = Arc<Mutex<Arrivals>>;

/// A session in a network of ROS 2.
#[derive(Debug)]
pub(crate) struct RosSession {
    session: Session,
    /// Whether the router was connected at the last check.
    had_router: bool,
    domain: u32,
    node: Node,
    _token: LivelinessToken,
    _tokens: zenoh::pubsub::Subscriber<()>,
}

/// The endpoints whose type differs from the type in the spec, as far as the session knows them.
pub(crate) type Graph = Arc<Mutex<Others>>;

/// A publisher of a topic.
#[derive(Debug)]
pub(crate) struct Publisher {
    publisher: AdvancedPublisher<'static>,
    sender: Gid,
    /// The number of the last message.
    sequence: AtomicI64,
    _token: LivelinessToken,
}

/// A subscriber of a topic. The subscription ends when this is dropped.
#[derive(Debug)]
pub(crate) struct Subscriber {
    _subscriber: AdvancedSubscriber<()>,
    _token: LivelinessToken,
}

impl RosSession {
    /// Opens a session with the router, and declares a node with this name. The tokens of other nodes go to `graph`.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn open(network: &Network, name: String, graph: Graph) -> Result<Self, String> {
        let session = open(network)?;
        let node = Node { id: NODE, namespace: None, name };
        let token = Token { domain: network.domain, session: session.zid().to_string(), node, endpoint: None };
        let shown = declare(&session, &token)?;
        let tokens = watch(&session, network.domain, graph)?;
        let domain = network.domain;
        Ok(Self { session, had_router: true, domain, node: token.node, _token: shown, _tokens: tokens })
    }

    /// Logs that the router has gone or has returned since the last check.
    pub(crate) fn look_at_router(&mut self) {
        let has_router = self.is_connected();
        if std::mem::replace(&mut self.had_router, has_router) == has_router {
            return;
        }
        if has_router {
            tracing::info!("the router of ROS 2 is back");
        } else {
            tracing::warn!("the router of ROS 2 is away; no message passes until it is back");
        }
    }

    /// Returns whether the router is connected.
    pub(crate) fn is_connected(&self) -> bool {
        self.session.info().routers_zid().wait().next().is_some()
    }

    /// Declares a publisher of a topic; `id` is the number of the publisher within the session.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn publisher(&self, id: u64, topic: &Topic, qos: Qos) -> Result<Publisher, String> {
        let token = self.token(id, Role::Publisher, topic, qos);
        let keeps_all = qos.history == History::KeepAll && qos.reliability == Reliability::Reliable;
        let congestion = if keeps_all { CongestionControl::Block } else { CongestionControl::Drop };
        let publisher = self.session.declare_publisher(key(topic.key(self.domain))?).congestion_control(congestion);
        let publisher = publisher.reliability(match qos.reliability {
            Reliability::Reliable => zenoh::qos::Reliability::Reliable,
            Reliability::BestEffort => zenoh::qos::Reliability::BestEffort,
        });
        let mut publisher = publisher.advanced();
        if qos.durability == Durability::TransientLocal {
            publisher = publisher.cache(CacheConfig::default().max_samples(depth(qos))).publisher_detection();
            if qos.reliability == Reliability::Reliable {
                let detection = MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT);
                publisher = publisher.sample_miss_detection(detection);
            }
        }
        let publisher = publisher.wait().map_err(|error| told(topic, error.as_ref()))?;
        let shown = declare(&self.session, &token)?;
        let sender = Gid::of(&token.key());
        Ok(Publisher { publisher, sender, sequence: AtomicI64::new(0), _token: shown })
    }

    /// Subscribes to a topic. Its messages go to `waiting`, and `waker` is woken for each.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn subscriber(
        &self,
        id: u64,
        topic: &Topic,
        qos: Qos,
        waiting: Waiting,
        waker: Waker,
    ) -> Result<Subscriber, String> {
        let token = self.token(id, Role::Subscriber, topic, qos);
        let name = topic.name.clone();
        let hear = move |sample: Sample| {
            let attachment = sample.attachment().map(ZBytes::to_bytes);
            let parts: Vec<&[u8]> = sample.payload().slices().collect();
            let taken = lock(&waiting).take(attachment.as_deref(), &parts);
            match taken {
                Ok(()) => waker.wake(),
                // Without this limit, a publisher could fill the disk with log lines.
                Err(Told { why, refused }) if refused.is_power_of_two() => {
                    tracing::warn!(topic = %name, %why, refused, "messages of ROS 2 are refused");
                }
                Err(_) => {}
            }
        };
        let mut subscriber = self.session.declare_subscriber(key(topic.key(self.domain))?).callback(hear).advanced();
        if qos.durability == Durability::TransientLocal {
            let history = HistoryConfig::default().detect_late_publishers().max_samples(depth(qos));
            subscriber = subscriber.history(history).query_timeout(Duration::MAX);
            if qos.reliability == Reliability::Reliable {
                subscriber = subscriber.recovery(RecoveryConfig::default().heartbeat());
            }
        }
        let subscriber = subscriber.wait().map_err(|error| told(topic, error.as_ref()))?;
        Ok(Subscriber { _subscriber: subscriber, _token: declare(&self.session, &token)? })
    }

    fn token(&self, id: u64, role: Role, topic: &Topic, qos: Qos) -> Token {
        let endpoint = Endpoint { id, role, topic: topic.clone(), qos, takes_buffers: false };
        let session = self.session.zid().to_string();
        Token { domain: self.domain, session, node: self.node.clone(), endpoint: Some(endpoint) }
    }

    /// Closes the session, and waits for a limited time until it is closed.
    pub(crate) fn close(self) {
        let (done, until) = (Arc::new(Wakeup::default()), now() + CLOSE_WITHIN);
        let told = Arc::clone(&done);
        let close = move || {
            if let Err(error) = self.session.close().wait() {
                tracing::debug!(%error, "a session with ROS 2 was not closed");
            }
            told.wake();
        };
        if std::thread::Builder::new().name("close".to_owned()).spawn(close).is_ok() {
            done.wait(Some(until));
        }
    }
}

impl Publisher {
    /// Publishes a message.
    pub(crate) fn publish(&self, message: Vec<u8>) {
        let sequence = self.sequence.fetch_add(1, Ordering::Relaxed) + 1;
        let attachment = Attachment { sequence, nanos: now_nanos(), sender: self.sender };
        let put = self.publisher.put(message).attachment(attachment.encode().to_vec()).wait();
        if let Err(error) = put {
            tracing::debug!(%error, "a message of ROS 2 was not sent");
        }
    }
}

fn now_nanos() -> i64 {
    i64::try_from(unix_time().as_nanos()).unwrap_or(i64::MAX)
}

pub(crate) fn lock<T>(shared: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

fn open(network: &Network) -> Result<Session, String> {
    let mut config = Config::default();
    let own = SETTINGS.iter().map(|(key, value)| (*key, *value));
    let given = network.settings.iter().map(|(key, value)| (key.as_str(), value.as_str()));
    for (key, value) in own.chain(given) {
        let why = |error: Box<dyn std::error::Error + Send + Sync>| {
            // Zenoh adds the position in its source code.
            let told = error.to_string();
            let cause = told.split(" at /").next().unwrap_or_default();
            format!("`ZENOH_CONFIG_OVERRIDE` cannot set `{key}` to `{value}`: {cause}")
        };
        config.insert_json5(key, value).map_err(why)?;
    }
    let (until, pause) = (now() + OPEN_WITHIN, Wakeup::default());
    loop {
        #[expect(
            clippy::disallowed_methods,
            reason = "this network is not DCA's: it has other settings and other peers"
        )]
        match zenoh::open(config.clone()).wait() {
            Ok(session) => return Ok(session),
            Err(error) if now() >= until => {
                tracing::debug!(%error, "the router of ROS 2 does not answer");
                return Err(format!(
                    "no router of ROS 2 answers at {} within {} s; is `ros2 run rmw_zenoh_cpp rmw_zenohd` running?",
                    network.router(),
                    OPEN_WITHIN.as_secs()
                ));
            }
            Err(_) => drop(pause.wait(Some(now() + RETRY_AFTER))),
        }
    }
}

/// Receives the tokens of all nodes, like every process of ROS 2.
fn watch(session: &Session, domain: u32, graph: Graph) -> Result<zenoh::pubsub::Subscriber<()>, String> {
    let hear = move |token: Sample| {
        let mut graph = lock(&graph);
        match token.kind() {
            SampleKind::Put => {
                let told = graph.appear(token.key_expr().as_str());
                told.into_iter().for_each(|why| tracing::warn!(why, "a topic of ROS 2 has two types"));
            }
            SampleKind::Delete => graph.vanish(token.key_expr().as_str()),
        }
    };
    let tokens = session.liveliness().declare_subscriber(key(Token::all(domain))?).history(true).callback(hear);
    tokens.wait().map_err(|error| format!("cannot look for the nodes of ROS 2: {error}"))
}

fn declare(session: &Session, token: &Token) -> Result<LivelinessToken, String> {
    let why = |error| format!("cannot show `{}` to ROS 2: {error}", token.node.name);
    session.liveliness().declare_token(key(token.key())?).wait().map_err(why)
}

fn key(text: String) -> Result<KeyExpr<'static>, String> {
    KeyExpr::try_from(text).map_err(|error| format!("a key of ROS 2 is refused: {error}"))
}

/// Returns the topic with this name and this type; no type is one whose name ROS 2 refuses.
///
/// # Errors
/// The error is a sentence for a person.
fn topic(network: &Network, name: &str, of: Option<TypeName>) -> Result<Topic, String> {
    let of = of.ok_or("no name for a type")?;
    let hash = network.hash(&setup::schema(&of)?);
    let parsed = GraphName::parse(name).ok_or_else(|| format!("`{name}` is longer than ROS 2 allows"))?;
    Ok(Topic { name: parsed, of, hash })
}

fn told(topic: &Topic, error: &dyn std::error::Error) -> String {
    format!("cannot take part in `{}`: {error}", topic.name)
}

/// Returns the largest number of messages that wait; the text of a route limits it.
pub(crate) fn depth(qos: Qos) -> usize {
    usize::try_from(qos.depth).unwrap_or(usize::MAX).max(1)
}
