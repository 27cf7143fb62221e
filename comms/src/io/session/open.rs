//! The only place that opens zenoh, and the only one that uses its `internal` interface: a session on a runtime of our
//! own, which can dial a peer at any time.

use super::config::Settings;
use super::links::{Links, Place, lock};
use super::nearby::{self, Announced, NearbyNode};
use super::{OpenError, patience, reach};
use crate::io::queue::{self, Receiver, Sender};
use crate::logic::human::span;
use crate::logic::port::{Policy, Pushed};
use rustix::io::{FdFlags, fcntl_setfd};
use std::net::SocketAddr;
use std::os::fd::BorrowedFd;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::sync::watch;
use tokio::task::JoinSet;
use zenoh::Wait;
use zenoh::config::{Locator, ZenohId};
use zenoh::internal::runtime::{Runtime, RuntimeBuilder, ZRuntime};
use zenoh::sample::SampleKind;
use zenoh::session::{LinkEvent, TransportEvent};

/// Waits between two attempts to dial: from here,
const RETRY_MIN: Duration = Duration::from_millis(100);
/// and half as much again each time, to here.
const RETRY_MAX: Duration = Duration::from_millis(500);
/// How long a node that was found is dialled where it was heard last. It is heard every few seconds while it can be reached; one
/// that was started again listens elsewhere.
const FOUND_AGAIN_WITHIN: Duration = Duration::from_secs(60);
/// How often a place is looked at that zenoh dials by itself.
const LOOK_EVERY: Duration = Duration::from_secs(2);
/// Links made and lost that have not been looked at yet. More can only be made or lost by a process with more peers than that.
const CHANGES_MAX: usize = 1024;

/// A session that can dial.
pub(crate) struct Opened {
    pub(crate) session: zenoh::Session,
    runtime: Runtime,
    links: Arc<Mutex<Links>>,
    tasks: Vec<tokio::task::JoinHandle<()>>,
    to_keeper: Arc<Sender<Change>>,
    addresses: watch::Receiver<Vec<String>>,
}

/// Whether a session looks for nodes on the network, and whether they find it.
#[derive(Clone, Debug)]
pub(crate) enum Search {
    /// It knows whom it was told of, alone.
    Off,
    /// It looks.
    Ask,
    /// It looks, and is found: its name, and its TCP port.
    Found(String, u16),
}

/// Which peers are dialled again when their links are lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Redial {
    /// Those that the session was told to dial.
    Told,
    /// Also those that were found.
    Found,
}

/// What the keeper hears of.
enum Change {
    /// A TCP link was made, to somebody who may be dialled there again.
    Made { session: String, from: SocketAddr, to: Locator },
    /// A TCP link was made, by a session that nobody tells how long its links take.
    Unmeasured(patience::Ends),
    /// A link was lost, or is to be made.
    Wanted(String),
    /// A session has lost one of its links, and still has these.
    Halved(Vec<patience::Ends>),
}

impl std::fmt::Debug for Opened {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Opened").field("session", &self.session.zid()).finish_non_exhaustive()
    }
}

impl Opened {
    /// Opens a session. Blocks; must not be called from a task.
    pub(crate) fn open(settings: Settings, redial: Redial, search: Search) -> Result<Self, OpenError> {
        let failed = |cause: zenoh::Error| OpenError::Zenoh { cause: plain(&cause) };
        let building = async { RuntimeBuilder::new(settings.into_config()).build().await };
        let mut runtime = ZRuntime::Net.block_in_place(building).map_err(failed)?;
        let session = zenoh::session::init(runtime.clone().into()).wait().map_err(failed)?;
        let (to_keeper, changes) = queue::channel(Policy::reject(CHANGES_MAX));
        let (to_keeper, links) = (Arc::new(to_keeper), Arc::new(Mutex::new(Links::default())));
        // Before it starts: of links that stand already zenoh never says that they are lost.
        watch_links(&session, redial, &links, &to_keeper).map_err(failed)?;
        let started = ZRuntime::Net.block_in_place(runtime.start());
        for locator in runtime.get_locators() {
            if locator.protocol().as_str() == "unixsock-stream" {
                keep_from_children(&format!("{}.lock", locator.address().as_str()));
            }
        }
        // After it has started: only then it is known where it listens.
        let port = if let Search::Found(_, port) = search { Some(port) } else { None };
        let keeper = ZRuntime::Net.spawn(keep(runtime.clone(), port, Arc::clone(&links), changes));
        let (addresses_tx, addresses) = watch::channel(Vec::new());
        let id = session.zid().to_string();
        let own = match &search {
            Search::Found(name, port) => Some(Announced { session: id.clone(), name: name.clone(), port: *port }),
            Search::Off | Search::Ask => None,
        };
        let heard = hears(id, Arc::clone(&links), Arc::clone(&to_keeper));
        let looking = (!matches!(search, Search::Off)).then(|| nearby::look(own, addresses_tx, heard));
        let looking = looking.map(|looking| ZRuntime::Net.spawn(looking));
        let tasks = [keeper].into_iter().chain(looking).collect();
        let opened = Self { session, runtime, links, tasks, to_keeper, addresses };
        match started {
            Ok(()) => Ok(opened),
            Err(cause) => {
                opened.close();
                Err(failed(cause))
            }
        }
    }

    /// Returns the addresses at which this machine can be found now, and hears of every change.
    pub(crate) fn addresses(&self) -> watch::Receiver<Vec<String>> {
        self.addresses.clone()
    }

    /// Returns whether there is any link.
    pub(crate) fn is_linked(&self) -> bool {
        !lock(&self.links).standing.is_empty()
    }

    /// Returns who is dialled and not linked: who or where, and why, for a person.
    pub(crate) fn unlinked(&self) -> Vec<(String, String)> {
        let links = lock(&self.links);
        let missing = links.kept.iter().filter(|(session, _)| !links.standing.contains(*session));
        let told = missing.map(|(session, place)| {
            let places = || place.locators.iter().map(ToString::to_string).collect::<Vec<_>>().join(", ");
            let who = links.names.get(session).cloned().unwrap_or_else(places);
            (who, links.troubles.get(session).cloned().unwrap_or_else(|| "it is being dialled".to_owned()))
        });
        let own = links.troubles.iter().filter(|(who, _)| !links.kept.contains_key(*who));
        told.chain(own.map(|(who, why)| (who.clone(), why.clone()))).collect()
    }

    /// Lets the link to a session carry nothing for so long before it is given up, rather than for a whole lease.
    pub(crate) fn set_patience(&self, session: &str, patience: Duration) {
        let ends: Vec<patience::Ends> = {
            let mut links = lock(&self.links);
            let known = links.ends.get_mut(session).into_iter().flatten();
            let changed = known.filter(|(_, before)| *before != patience);
            changed.map(|(ends, before)| (*before = patience, *ends).1).collect()
        };
        if ends.into_iter().any(|ends| !patience::set(ends, patience)) {
            tracing::debug!(session, "the socket of a link was not found");
        }
    }

    /// Notes, as long as this session lives, why nodes that it was told of are not linked. Zenoh dials them itself, and says
    /// nothing.
    pub(crate) fn watch_told(&mut self, locators: &[String]) {
        let locators = locators.iter().filter_map(|locator| locator.parse::<Locator>().ok());
        let places: Vec<Locator> = locators.filter(|locator| locator.protocol().as_str() == "tcp").collect();
        for place in places {
            let links = Arc::clone(&self.links);
            self.tasks.push(ZRuntime::Net.spawn(watch_place(place, links)));
        }
    }

    /// Returns the session's id as it is written in a `Dial`.
    pub(crate) fn id(&self) -> String {
        self.session.zid().to_string()
    }

    /// Returns where the session listens.
    pub(crate) fn locators(&self) -> Vec<String> {
        self.runtime.get_locators().iter().map(ToString::to_string).collect()
    }

    /// Links to a peer and keeps linked to it; tries for as long as `within`. Blocks; must not be called from a task.
    /// Says why not.
    pub(crate) fn dial(&self, session: &str, locators: &[String], within: Duration) -> Result<(), String> {
        let id: ZenohId = session.parse().map_err(|_unhelpful| format!("`{session}` is not a session"))?;
        let locators: Result<Vec<Locator>, _> = locators.iter().map(|locator| locator.parse()).collect();
        let locators = locators.map_err(|cause: zenoh::Error| plain(&cause))?;
        if session == self.id() {
            return Ok(());
        }
        if locators.is_empty() {
            return Err("it listens nowhere that can be reached from here".to_owned());
        }
        // Before the first attempt, so that a link lost right after it is noticed.
        let place = Place { locators: locators.clone(), within: None };
        lock(&self.links).kept.insert(session.to_owned(), place);
        let connecting = connect(&self.runtime, &self.links, id);
        let linked = ZRuntime::Net.block_in_place(async { tokio::time::timeout(within, connecting).await });
        linked.map_err(|_elapsed| {
            self.forget(session);
            let places: Vec<String> = locators.iter().map(ToString::to_string).collect();
            format!("nobody answers at {} within {}", places.join(", "), span(within))
        })
    }

    /// Links to a peer whenever it can be reached, and keeps linked to it; waits for nothing. Says why not.
    pub(crate) fn keep(&self, session: &str, locators: &[String]) -> Result<(), String> {
        let locators: Result<Vec<Locator>, _> = locators.iter().map(|locator| locator.parse()).collect();
        let locators = locators.map_err(|cause: zenoh::Error| plain(&cause))?;
        if session == self.id() {
            return Ok(());
        }
        lock(&self.links).kept.insert(session.to_owned(), Place { locators, within: None });
        match self.to_keeper.push(Change::Wanted(session.to_owned())) {
            Pushed::Stored | Pushed::Replaced(_) => Ok(()),
            Pushed::Rejected(_) => Err("too many links are lost".to_owned()),
        }
    }

    /// Dials a peer no more; a link that stands is left alone.
    pub(crate) fn forget(&self, session: &str) {
        lock(&self.links).kept.remove(session);
    }

    /// Closes the session. Blocks for up to 20 s when a peer has vanished without a word.
    pub(crate) fn close(self) {
        self.tasks.iter().for_each(tokio::task::JoinHandle::abort);
        for closed in [self.session.close().wait(), self.runtime.close().wait()] {
            closed.unwrap_or_else(|error| tracing::debug!(%error, "a session did not close"));
        }
    }
}

/// Notes which links stand, and tells the keeper of what it has to know.
fn watch_links(
    session: &zenoh::Session,
    redial: Redial,
    links: &Arc<Mutex<Links>>,
    to_keeper: &Arc<Sender<Change>>,
) -> zenoh::Result<()> {
    let (noted, links, lost) = (links, Arc::clone(links), Arc::clone(to_keeper));
    let on_transport = move |event: TransportEvent| {
        let session = event.transport().zid().to_string();
        match event.kind() {
            SampleKind::Put => {
                let mut links = lock(&links);
                links.troubles.remove(&session);
                links.standing.insert(session);
            }
            SampleKind::Delete => {
                lock(&links).standing.remove(&session);
                lost.push(Change::Wanted(session));
            }
        }
    };
    let info = session.info();
    info.transport_events_listener().history(true).callback(on_transport).background().wait()?;
    let (made, ends) = (Arc::clone(to_keeper), Arc::clone(noted));
    let on_link = move |event: LinkEvent| {
        let link = event.link();
        let session = link.zid().to_string();
        let Some(both) = address(link.src()).zip(address(link.dst())) else { return };
        if event.kind() == SampleKind::Delete {
            let left = lock(&ends).lose(&session, both);
            if !left.is_empty() {
                made.push(Change::Halved(left));
            }
            return;
        }
        lock(&ends).ends.entry(session.clone()).or_default().push((both, Duration::ZERO));
        match redial {
            Redial::Found => made.push(Change::Made { session, from: both.0, to: link.dst().clone() }),
            Redial::Told => made.push(Change::Unmeasured(both)),
        };
    };
    info.link_events_listener().history(true).callback(on_link).background().wait()
}

/// Returns the address of a TCP locator.
fn address(locator: &Locator) -> Option<SocketAddr> {
    locator.address().as_str().parse().ok().filter(|_| locator.protocol().as_str() == "tcp")
}

/// Dials whoever says that it is there.
fn hears(own: String, links: Arc<Mutex<Links>>, to_keeper: Arc<Sender<Change>>) -> impl Fn(NearbyNode) {
    move |NearbyNode { session, name, at }| {
        let Ok(locator) = format!("tcp/{at}").parse::<Locator>() else { return };
        if session == own || session.parse::<ZenohId>().is_err() {
            return;
        }
        let is_wanted = lock(&links).find(&session, name, (at.ip(), locator), FOUND_AGAIN_WITHIN);
        if is_wanted {
            to_keeper.push(Change::Wanted(session));
        }
    }
}

/// Dials kept peers again as their links are lost, until the session closes. `port` is where it listens itself.
async fn keep(runtime: Runtime, port: Option<u16>, links: Arc<Mutex<Links>>, mut changes: Receiver<Change>) {
    let mut dialling = JoinSet::new();
    loop {
        let change = tokio::select! {
            change = changes.recv() => change,
            Some(_) = dialling.join_next() => continue,
        };
        let session = match change {
            None => return,
            Some(Change::Made { session, from, to }) => {
                // The other side of a link that we accepted listens elsewhere, and dials us.
                if port != Some(from.port()) {
                    let place = Place { locators: vec![to], within: Some(FOUND_AGAIN_WITHIN) };
                    lock(&links).kept.entry(session).or_insert(place);
                }
                continue;
            }
            Some(Change::Unmeasured(ends)) => {
                if !patience::set_as_measured(ends) {
                    tracing::debug!(?ends, "the socket of a link was not found");
                }
                continue;
            }
            Some(Change::Wanted(session)) => session,
            // Zenoh takes a new link for one more of the old session, even where the other side has lost that and begun anew; then
            // each sends what the other does not understand. So no session outlives any of its links.
            Some(Change::Halved(left)) => {
                left.into_iter().for_each(patience::cut);
                continue;
            }
        };
        let Some(place) = lock(&links).kept.get(&session).cloned() else { continue };
        let Ok(id) = session.parse() else { continue };
        if !lock(&links).dialling.insert(session.clone()) {
            continue;
        }
        tracing::debug!(session, "no link, dialling");
        let (runtime, links) = (runtime.clone(), Arc::clone(&links));
        dialling.spawn(async move {
            let connecting = connect(&runtime, &links, id);
            let over = match place.within {
                None => {
                    connecting.await;
                    false
                }
                Some(within) => tokio::time::timeout(within, connecting).await.is_err(),
            };
            if over {
                let mut links = lock(&links);
                links.dialling.remove(&session);
                links.kept.remove(&session);
                links.troubles.remove(&session);
                links.names.remove(&session);
            }
        });
    }
}

/// Dials until the link stands, or is not to be kept any more. Two at a time for one peer do no harm: zenoh lets one
/// through.
async fn connect(runtime: &Runtime, links: &Mutex<Links>, id: ZenohId) {
    let (session, mut wait) = (id.to_string(), RETRY_MIN);
    loop {
        let place = {
            let mut links = lock(links);
            let kept = links.kept.get(&session).map(|place| place.locators.clone());
            let place = kept.filter(|_| !links.standing.contains(&session));
            if place.is_none() {
                // With the same look: a link that is lost from here on is told to the keeper, who has to find nobody dialling.
                links.dialling.remove(&session);
            }
            place
        };
        let Some(locators) = place.filter(|_| !runtime.is_closed()) else { return };
        let attempted = attempt(runtime, id, &locators).await;
        {
            let mut links = lock(links);
            if links.standing.contains(&session) {
                continue;
            }
            // The event that a link stands may be a moment late.
            if let Err(why) = attempted {
                links.troubles.insert(session.clone(), why);
            }
        }
        tokio::time::sleep(wait.mul_f64(jitter())).await;
        wait = RETRY_MAX.min(wait.mul_f64(1.5));
    }
}

/// Tries once to make a link. Says why there is none, for a person.
async fn attempt(runtime: &Runtime, id: ZenohId, locators: &[Locator]) -> Result<(), String> {
    let (locator, took) = reach::first(locators).await?;
    let place = locator.address().as_str().to_owned();
    // It goes on to its end, whoever waits: what is cut short counts as being dialled for ever, and is dialled no more.
    let runtime = runtime.clone();
    let making = ZRuntime::Net.spawn(async move { runtime.connect_peer(&id.into(), &[locator]).await });
    match making.await {
        Ok(true) => Ok(()),
        Ok(false) | Err(_) => Err(format!("{place} answers after {} ms, and makes no link", took.as_millis())),
    }
}

/// Notes why a place that zenoh dials by itself is not linked.
async fn watch_place(place: Locator, links: Arc<Mutex<Links>>) {
    let name = place.to_string();
    loop {
        let (resolved, unknown) = match reach::resolve(&place).await {
            Ok(addresses) => (addresses, None),
            Err(why) => (Vec::new(), Some(why)),
        };
        let is_linked = || lock(&links).ends.values().flatten().any(|((_, there), _)| resolved.contains(there));
        let trouble = if is_linked() || unknown.is_some() {
            unknown
        } else {
            let why = match reach::first(std::slice::from_ref(&place)).await {
                Ok((_, took)) => format!("it answers after {} ms, and makes no link", took.as_millis()),
                Err(why) => why,
            };
            Some(why).filter(|_| !is_linked())
        };
        match trouble {
            Some(why) => lock(&links).troubles.insert(name.clone(), why),
            None => lock(&links).troubles.remove(&name),
        };
        tokio::time::sleep(LOOK_EVERY).await;
    }
}

/// Returns a factor from 0.75 to 1.25, so that programs that lost their links together do not dial together.
fn jitter() -> f64 {
    let millionth = crate::io::clock::now().nanos() % 1_000_000;
    0.75 + f64::from(u32::try_from(millionth).unwrap_or(0)) / 2e6
}

/// Marks zenoh's lock on a Unix socket as not for children.
///
/// Zenoh opens it without `O_CLOEXEC`. Every program started later would hold the lock, and a node that is killed and
/// started again could not listen before the last of its programs has ended.
#[expect(unsafe_code, reason = "a descriptor that zenoh keeps to itself can only be named by its number")]
fn keep_from_children(lock: &str) {
    let entries = std::fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    for entry in entries.filter(|entry| std::fs::read_link(entry.path()).is_ok_and(|file| file == Path::new(lock))) {
        let Some(number) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        // SAFETY: zenoh keeps the lock open for as long as it listens, and the caller has just opened the listener and
        // holds it; the descriptor is only borrowed, to set a flag.
        let borrowed = unsafe { BorrowedFd::borrow_raw(number) };
        if let Err(error) = fcntl_setfd(borrowed, FdFlags::CLOEXEC) {
            tracing::warn!(%error, lock, "programs started from here will keep the socket locked");
        }
    }
}

/// Returns zenoh's words without the places in its source that it adds.
pub(crate) fn plain(cause: &zenoh::Error) -> String {
    let text = cause.to_string();
    let end = text.find(" at /").or_else(|| text.find(" at zenoh")).unwrap_or(text.len());
    text[..end].trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::super::config::unix_locator;
    use super::*;
    use std::sync::mpsc::sync_channel;

    /// A link may stand as soon as a session begins to listen and to dial; its loss is heard all the same.
    #[test]
    fn the_loss_of_the_very_first_link_is_heard() {
        let path = std::env::temp_dir().join(format!("dca-open-{}.sock", std::process::id()));
        let locator = unix_locator(&path).unwrap();
        let listening = Settings::node().listen(std::slice::from_ref(&locator));
        let node = Opened::open(listening, Redial::Found, Search::Off).unwrap();
        // A client is linked before it is open.
        let client = Opened::open(Settings::client(&locator), Redial::Told, Search::Off).unwrap();
        let (events_tx, events) = sync_channel(4);
        let on_event = move |event: TransportEvent| {
            events_tx.try_send((event.kind(), event.transport().zid().to_string())).unwrap();
        };
        let info = client.session.info();
        let _listener = info.transport_events_listener().history(true).callback(on_event).wait().unwrap();
        let within = Duration::from_secs(20);
        assert_eq!(events.recv_timeout(within), Ok((SampleKind::Put, node.id())));
        let id = node.id();
        node.close();
        assert_eq!(events.recv_timeout(within), Ok((SampleKind::Delete, id)));
        client.close();
    }

    /// Returns a session that listens on a TCP port of this machine.
    fn on_tcp() -> Opened {
        let locators = ["tcp/127.0.0.1:0".to_owned()];
        Opened::open(Settings::data().listen(&locators), Redial::Told, Search::Off).unwrap()
    }

    /// Who is dialled from anywhere names the socket on its own machine, too, which is not there on others.
    #[test]
    fn a_socket_that_is_not_there_hides_no_other_place() {
        let (a, b) = (on_tcp(), on_tcp());
        let nowhere = "unixsock-stream//nowhere/at/all".to_owned();
        b.dial(&a.id(), &[nowhere, a.locators().remove(0)], Duration::from_secs(20)).unwrap();
        a.close();
        b.close();
    }

    /// Carries what comes to the returned place on to another one, and back. At a word the far end of each connection is closed, and
    /// the near one left open.
    fn relay(to: String) -> (String, std::sync::mpsc::SyncSender<()>) {
        use std::net::{Shutdown, TcpListener, TcpStream};
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let place = format!("tcp/{}", listener.local_addr().unwrap());
        let (half_tx, half) = sync_channel(1);
        std::thread::spawn(move || {
            let far_ends = Arc::new(Mutex::new(Vec::<TcpStream>::new()));
            let noted = Arc::clone(&far_ends);
            std::thread::spawn(move || {
                for near in listener.incoming().map_while(Result::ok) {
                    let Ok(far) = TcpStream::connect(to.trim_start_matches("tcp/")) else { continue };
                    noted.lock().unwrap().push(far.try_clone().unwrap());
                    let (mut near_read, mut far_write) = (near.try_clone().unwrap(), far.try_clone().unwrap());
                    let (mut far_read, mut near_write) = (far, near);
                    std::thread::spawn(move || std::io::copy(&mut far_read, &mut near_write));
                    std::thread::spawn(move || {
                        drop(std::io::copy(&mut near_read, &mut far_write));
                        // Taken and not passed on.
                        std::io::copy(&mut near_read, &mut std::io::sink())
                    });
                }
            });
            for () in half {
                far_ends.lock().unwrap().drain(..).for_each(|far| far.shutdown(Shutdown::Both).unwrap());
            }
        });
        (place, half_tx)
    }

    /// One side loses the session and begins anew while the other still believes in the old one, which it dialled itself.
    #[test]
    fn a_session_that_one_side_has_lost_begins_anew_on_both() {
        let (a, b) = (on_tcp(), on_tcp());
        let (heard_tx, heard) = sync_channel(1000);
        let key = "dca/test/anew";
        let on_sample = move |_: zenoh::sample::Sample| heard_tx.try_send(()).unwrap_or_default();
        let _subscriber = a.session.declare_subscriber(key).callback(on_sample).wait().unwrap();
        let (place, half) = relay(b.locators().remove(0));
        let within = Duration::from_secs(20);
        a.dial(&b.id(), &[place], within).unwrap();
        b.keep(&a.id(), &a.locators()).unwrap();
        let began = crate::io::clock::now();
        let hears = || {
            while heard.try_recv().is_ok() {}
            while crate::io::clock::now() - began < 2 * within {
                b.session.put(key, "x").wait().unwrap();
                if heard.recv_timeout(Duration::from_millis(20)).is_ok() {
                    return true;
                }
            }
            false
        };
        assert!(hears());
        // Of each side what becomes of its session with the other.
        let [(_of_a, at_a), (_of_b, at_b)] = [&a, &b].map(|side| {
            let (events_tx, events) = sync_channel(16);
            let on_event = move |event: TransportEvent| events_tx.try_send(event.kind()).unwrap_or_default();
            let info = side.session.info();
            (info.transport_events_listener().history(false).callback(on_event).wait().unwrap(), events)
        });
        half.send(()).unwrap();
        for (side, events) in [("who has lost it", at_b), ("who has not", at_a)] {
            for expected in [SampleKind::Delete, SampleKind::Put] {
                assert_eq!(events.recv_timeout(within), Ok(expected), "{side} begins anew");
            }
        }
        assert!(hears(), "who has begun anew is not told who listens");
        a.close();
        b.close();
    }

    /// A place that takes a connection and says nothing holds a dial up; the peer is dialled elsewhere all the same.
    #[test]
    fn who_was_dialled_in_vain_is_dialled_again() {
        let silent = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let path = std::env::temp_dir().join(format!("dca-again-{}.sock", std::process::id()));
        let locator = unix_locator(&path).unwrap();
        let node =
            Opened::open(Settings::data().listen(std::slice::from_ref(&locator)), Redial::Told, Search::Off).unwrap();
        let other = Opened::open(Settings::data(), Redial::Told, Search::Off).unwrap();
        let wrong = format!("tcp/{}", silent.local_addr().unwrap());
        let said = other.dial(&node.id(), &[wrong], Duration::from_millis(200));
        assert!(said.is_err_and(|why| why.starts_with("nobody answers")));
        drop(silent);
        assert_eq!(other.dial(&node.id(), &[locator], Duration::from_secs(20)), Ok(()));
        other.close();
        node.close();
    }
}
