//! The only place that opens zenoh, and the only place that uses the `internal` interface of zenoh. It opens a session on a separate
//! runtime, which can dial a peer at any time.

mod keeper;
mod strays;

use super::config::Settings;
use super::links::{Links, Place, PlaceFound, lock};
use super::nearby::{self, Announced, NearbyNode};
use super::tunnel::{TunnelOptions, Tunnels};
use super::{OpenError, patience};
use crate::io::queue::{self, Sender};
use crate::logic::human::span;
use crate::logic::port::{Policy, Pushed};
use keeper::{Change, Dialler, connect, keep, keep_place, watch_place};
use rustix::io::{FdFlags, fcntl_setfd};
use std::net::SocketAddr;
use std::os::fd::BorrowedFd;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use strays::end_strays;
use tokio::sync::watch;
use zenoh::Wait;
use zenoh::config::{Locator, ZenohId};
use zenoh::internal::runtime::{RuntimeBuilder, ZRuntime};
use zenoh::sample::SampleKind;
use zenoh::session::{LinkEvent, TransportEvent};

/// How long a node that was found is dialled at its last known address. A reachable node announces itself every few seconds,
/// and a restarted node listens at another port.
const FOUND_AGAIN_WITHIN: Duration = Duration::from_secs(60);
/// The most changes of links that wait to be processed. Only a process with more peers than this can exceed it.
const CHANGES_MAX: usize = 1024;

/// A session that can dial.
pub(crate) struct Opened {
    pub(crate) session: zenoh::Session,
    dialler: Dialler,
    tasks: Vec<tokio::task::JoinHandle<()>>,
    to_keeper: Arc<Sender<Change>>,
    addresses: watch::Receiver<Vec<String>>,
}

/// Whether a session looks for nodes on the network, and whether they find it.
#[derive(Clone, Debug)]
pub(crate) enum Search {
    /// The session knows only the peers that it was given.
    Off,
    /// The session looks for nodes.
    Ask,
    /// The session looks for nodes, and is found by its name and its TCP port.
    Found(String, u16),
}

/// The peers that are dialled again when their links are lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Redial {
    /// The peers that the session was told to dial.
    Listed,
    /// Also the peers that were found on the network.
    Found,
}

impl std::fmt::Debug for Opened {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Opened").field("session", &self.session.zid()).finish_non_exhaustive()
    }
}

impl Opened {
    /// Opens a session. Blocks; must not be called from a task. With `tunnels`, other hosts reach the session, and the
    /// session dials them, only through these.
    pub(crate) fn open(
        settings: Settings,
        redial: Redial,
        search: Search,
        tunnels: Option<TunnelOptions>,
    ) -> Result<Self, OpenError> {
        let failed = |cause: zenoh::Error| OpenError::Zenoh { cause: plain(&cause) };
        let building = async { RuntimeBuilder::new(settings.into_config()).build().await };
        let mut runtime = ZRuntime::Net.block_in_place(building).map_err(failed)?;
        let session = zenoh::session::init(runtime.clone().into()).wait().map_err(failed)?;
        let id = session.zid().to_string();
        let bound = tunnels.map(|options| {
            let bound = ZRuntime::Net.block_in_place(Tunnels::bind(id.clone(), options));
            bound.map_err(|cause| OpenError::Tunnels { cause })
        });
        let (tunnels, listeners) =
            bound.transpose()?.map(|(tunnels, listeners)| (Arc::new(tunnels), listeners)).unzip();
        let (to_keeper, changes) = queue::channel(Policy::reject(CHANGES_MAX));
        let (to_keeper, links) = (Arc::new(to_keeper), Arc::new(Mutex::new(Links::default())));
        // Before the session starts: zenoh never reports the loss of a link that existed before the watch.
        watch_links(&session, redial, &links, &to_keeper).map_err(failed)?;
        let started = ZRuntime::Net.block_in_place(runtime.start());
        for locator in runtime.get_locators() {
            if locator.protocol().as_str() == "unixsock-stream" {
                keep_from_children(&format!("{}.lock", locator.address().as_str()));
            }
        }
        // After the session has started, because its port is known only then.
        let port = if let Search::Found(_, port) = search { Some(port) } else { None };
        let dialler = Dialler { runtime, links, tunnels };
        let keeper = ZRuntime::Net.spawn(keep(dialler.clone(), port, changes));
        let strays = ZRuntime::Net.spawn(end_strays(session.clone(), dialler.clone(), Arc::clone(&to_keeper)));
        let (addresses_tx, addresses) = watch::channel(Vec::new());
        // Hosts outside a team must not learn names. The empty name also distinguishes the nodes of teams from other nodes.
        let shown = |name: &String| if dialler.tunnels.is_some() { String::new() } else { name.clone() };
        let own = match &search {
            Search::Found(name, port) => Some(Announced { session: id.clone(), name: shown(name), port: *port }),
            Search::Off | Search::Ask => None,
        };
        let heard = hears(id, dialler.clone(), Arc::clone(&to_keeper));
        let looking = (!matches!(search, Search::Off)).then(|| nearby::look(own, addresses_tx, heard));
        let looking = looking.map(|looking| ZRuntime::Net.spawn(looking));
        let mut tasks: Vec<_> = [keeper, strays].into_iter().chain(looking).collect();
        if let Some(tunnels) = &dialler.tunnels {
            let serving = listeners.into_iter().flatten().map(|listener| Arc::clone(tunnels).serve(listener));
            tasks.extend(serving.map(|serving| ZRuntime::Net.spawn(serving)));
            tasks.push(ZRuntime::Net.spawn(Arc::clone(tunnels).judge()));
        }
        let opened = Self { session, dialler, tasks, to_keeper, addresses };
        match started {
            Ok(()) => Ok(opened),
            Err(cause) => {
                opened.close();
                Err(failed(cause))
            }
        }
    }

    /// Returns a receiver of the addresses at which this machine can be found, which changes with them.
    pub(crate) fn addresses(&self) -> watch::Receiver<Vec<String>> {
        self.addresses.clone()
    }

    /// Returns whether there is any link.
    pub(crate) fn is_linked(&self) -> bool {
        !lock(&self.dialler.links).standing.is_empty()
    }

    /// Returns whether a link to this session exists; always true for this session itself.
    pub(crate) fn is_linked_to(&self, session: &str) -> bool {
        session == self.id() || lock(&self.dialler.links).standing.contains(session)
    }

    /// Returns the peers that are dialled but not linked: the name or locator of each, and the reason, for people.
    pub(crate) fn unlinked(&self) -> Vec<(String, String)> {
        let links = lock(&self.dialler.links);
        let missing = links.kept.iter().filter(|(session, _)| !links.standing.contains(*session));
        let told = missing.map(|(session, place)| {
            let places = || place.all().map(ToString::to_string).collect::<Vec<_>>().join(", ");
            let who = links.names.get(session).cloned().unwrap_or_else(places);
            (who, links.troubles.get(session).cloned().unwrap_or_else(|| "a dial is in progress".to_owned()))
        });
        let own = links.troubles.iter().filter(|(who, _)| !links.kept.contains_key(*who));
        told.chain(own.map(|(who, why)| (who.clone(), why.clone()))).collect()
    }

    /// Sets how long the link to a session may carry nothing before it is given up. By default that is a whole lease.
    pub(crate) fn set_patience(&self, session: &str, patience: Duration) {
        if let Some(tunnels) = &self.dialler.tunnels
            && tunnels.set_patience(session, patience)
        {
            return;
        }
        let ends: Vec<patience::Ends> = {
            let mut links = lock(&self.dialler.links);
            let known = links.ends.get_mut(session).into_iter().flatten();
            let changed = known.filter(|(_, before)| *before != patience);
            changed.map(|(ends, before)| (*before = patience, *ends).1).collect()
        };
        if ends.into_iter().any(|ends| !patience::set(ends, patience)) {
            tracing::debug!(session, "the socket of a link was not found");
        }
    }

    /// Ends the links to a session.
    #[cfg(test)]
    pub(crate) fn cut(&self, session: &str) {
        self.dialler.cut(session);
    }

    /// Cuts the links to a session, unless data arrives from it within `time`. A long answer on a slow link delays all other
    /// messages, and cutting the link would lose that answer.
    pub(crate) fn cut_if_silent(&self, session: &str, time: Duration) {
        let (dialler, session) = (self.dialler.clone(), session.to_owned());
        let ends = dialler.ends_of(&session);
        let received = move || ends.iter().filter_map(|both| patience::received(*both)).sum::<u64>();
        let before = received();
        ZRuntime::Net.spawn(async move {
            tokio::time::sleep(time).await;
            if received() == before {
                dialler.cut(&session);
            }
        });
    }

    /// Notes why the nodes that this session was given are not linked, as long as the session lives. Zenoh dials these nodes
    /// itself, and does not report errors. Nodes behind tunnels are dialled here.
    pub(crate) fn watch_told(&mut self, locators: &[String]) {
        let locators = locators.iter().filter_map(|locator| locator.parse::<Locator>().ok());
        let places: Vec<Locator> = locators.filter(|locator| locator.protocol().as_str() == "tcp").collect();
        if let Some(tunnels) = &self.dialler.tunnels {
            let kept = |place| ZRuntime::Net.spawn(keep_place(place, self.dialler.clone(), Arc::clone(tunnels)));
            self.tasks.extend(places.into_iter().map(kept));
            return;
        }
        for place in places {
            let links = Arc::clone(&self.dialler.links);
            self.tasks.push(ZRuntime::Net.spawn(watch_place(place, links)));
        }
    }

    /// Checks again all peers at the other ends of tunnels.
    pub(crate) fn judge_again(&self) {
        self.dialler.tunnels.iter().for_each(|tunnels| tunnels.judge_again());
    }

    /// Returns the session's id in the form of a `Dial`.
    pub(crate) fn id(&self) -> String {
        self.session.zid().to_string()
    }

    /// Returns the ids of the sessions that are linked now.
    pub(crate) fn linked_to(&self) -> Vec<String> {
        lock(&self.dialler.links).standing.iter().cloned().collect()
    }

    /// Returns where the session listens.
    pub(crate) fn locators(&self) -> Vec<String> {
        let own = self.dialler.runtime.get_locators().into_iter().map(|locator| locator.to_string());
        own.chain(self.dialler.tunnels.iter().flat_map(|tunnels| tunnels.locators().to_vec())).collect()
    }

    /// Links to a peer, and restores the link when it is lost. Waits at most `within` for the first link; the error is the
    /// reason, for people. Blocks; must not be called from a task.
    pub(crate) fn dial(&self, session: &str, locators: &[String], within: Duration) -> Result<(), String> {
        let id: ZenohId = session.parse().map_err(|_unhelpful| format!("`{session}` is not a session"))?;
        let locators: Result<Vec<Locator>, _> = locators.iter().map(|locator| locator.parse()).collect();
        let locators = locators.map_err(|cause: zenoh::Error| plain(&cause))?;
        if session == self.id() {
            return Ok(());
        }
        if locators.is_empty() {
            return Err("it does not listen on an address that can be reached from here".to_owned());
        }
        // Before the first attempt, so that the loss of a link right after it is noticed.
        let place = Place::told(locators.clone(), None);
        lock(&self.dialler.links).kept.insert(session.to_owned(), place);
        let connecting = connect(&self.dialler, id);
        let linked = ZRuntime::Net.block_in_place(async { tokio::time::timeout(within, connecting).await });
        linked.map_err(|_elapsed| {
            self.forget(session);
            let places: Vec<String> = locators.iter().map(ToString::to_string).collect();
            let why = lock(&self.dialler.links).troubles.remove(session);
            let why = why.map(|why| format!(" ({why})")).unwrap_or_default();
            format!("nothing answers at {} within {}{why}", places.join(", "), span(within))
        })
    }

    /// Returns a function that takes announcements of nodes on the network.
    #[cfg(test)]
    pub(super) fn ear(&self) -> impl Fn(NearbyNode) + use<> {
        hears(self.id(), self.dialler.clone(), Arc::clone(&self.to_keeper))
    }

    /// Links to a peer as soon as it can be reached, and restores the link when it is lost. Does not wait. The error is the
    /// reason, for people.
    pub(crate) fn keep(&self, session: &str, locators: &[String]) -> Result<(), String> {
        let locators: Result<Vec<Locator>, _> = locators.iter().map(|locator| locator.parse()).collect();
        let locators = locators.map_err(|cause: zenoh::Error| plain(&cause))?;
        if session == self.id() {
            return Ok(());
        }
        lock(&self.dialler.links).kept.insert(session.to_owned(), Place::told(locators, None));
        match self.to_keeper.push(Change::Wanted(session.to_owned())) {
            Pushed::Stored | Pushed::Replaced(_) => Ok(()),
            Pushed::Rejected(_) => Err("too many links are lost".to_owned()),
        }
    }

    /// Stops dialling a peer; an existing link is kept.
    pub(crate) fn forget(&self, session: &str) {
        lock(&self.dialler.links).kept.remove(session);
    }

    /// Closes the session. Blocks for up to 20 s when a peer has vanished without closing its link.
    pub(crate) fn close(self) {
        self.tasks.iter().for_each(tokio::task::JoinHandle::abort);
        for closed in [self.session.close().wait(), self.dialler.runtime.close().wait()] {
            closed.unwrap_or_else(|error| tracing::debug!(%error, "a session did not close"));
        }
        self.dialler.tunnels.iter().for_each(|tunnels| tunnels.close());
    }
}

/// Notes the present links, and passes their changes on to the keeper.
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
            SampleKind::Put => lock(&links).stand(session),
            SampleKind::Delete => {
                lock(&links).fall(&session);
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
        let both = ends_of(link);
        if event.kind() == SampleKind::Delete {
            if lock(&ends).lose(&session, both) {
                made.push(Change::Halved(session));
            }
            return;
        }
        let Some(both) = both else { return };
        lock(&ends).gain(&session, both);
        // The first bytes may be lost as well; the system would repeat them at growing intervals.
        made.push(Change::New(both));
        if redial == Redial::Found {
            made.push(Change::Made { session, from: both.0, to: link.dst().clone() });
        }
    };
    info.link_events_listener().history(true).callback(on_link).background().wait()
}

/// Returns the two ends of a TCP link.
fn ends_of(link: &zenoh::session::Link) -> Option<patience::Ends> {
    address(link.src()).zip(address(link.dst()))
}

/// Returns the address of a TCP locator.
fn address(locator: &Locator) -> Option<SocketAddr> {
    locator.address().as_str().parse().ok().filter(|_| locator.protocol().as_str() == "tcp")
}

/// Dials each announced session of the same kind. Nodes of teams announce no names. Other nodes announce their names.
fn hears(own: String, dialler: Dialler, to_keeper: Arc<Sender<Change>>) -> impl Fn(NearbyNode) {
    move |NearbyNode { session, name, at }| {
        let Ok(locator) = format!("tcp/{at}").parse::<Locator>() else { return };
        let is_ours = name.is_empty() == dialler.tunnels.is_some();
        if session == own || !is_ours || session.parse::<ZenohId>().is_err() {
            return;
        }
        let heard = PlaceFound { session: session.clone(), name, by: at.ip(), locator };
        if lock(&dialler.links).find(heard, FOUND_AGAIN_WITHIN) {
            to_keeper.push(Change::Wanted(session));
        }
    }
}

/// Marks zenoh's lock file of a Unix socket as close-on-exec.
///
/// Zenoh opens it without `O_CLOEXEC`, so every program that is started later would hold the lock. A node that is killed and
/// restarted could not listen before the last of its programs has ended.
#[expect(unsafe_code, reason = "a descriptor that zenoh keeps to itself can only be named by its number")]
fn keep_from_children(lock: &str) {
    let entries = std::fs::read_dir("/proc/self/fd").into_iter().flatten().flatten();
    for entry in entries.filter(|entry| std::fs::read_link(entry.path()).is_ok_and(|file| file == Path::new(lock))) {
        let Some(number) = entry.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        // SAFETY: zenoh keeps the lock open for as long as it listens. The caller has just opened the listener and holds it.
        // The descriptor is only borrowed, to set a flag.
        let borrowed = unsafe { BorrowedFd::borrow_raw(number) };
        if let Err(error) = fcntl_setfd(borrowed, FdFlags::CLOEXEC) {
            tracing::warn!(%error, lock, "programs started from here will keep the socket locked");
        }
    }
}

/// Returns the text of zenoh's error, without the places in its source that zenoh adds.
pub(crate) fn plain(cause: &zenoh::Error) -> String {
    let text = cause.to_string();
    let end = text.find(" at /").or_else(|| text.find(" at zenoh")).unwrap_or(text.len());
    text[..end].trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests;
