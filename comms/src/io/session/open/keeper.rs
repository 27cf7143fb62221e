//! Dials the peers of a session, and dials them again when their links are lost.

use super::super::config::unix_locator;
use super::super::links::{Links, Place, lock};
use super::super::tunnel::Tunnels;
use super::super::{patience, reach};
use super::FOUND_AGAIN_WITHIN;
use crate::io::clock::now;
use crate::io::queue::Receiver;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::task::JoinSet;
use zenoh::config::{Locator, ZenohId};
use zenoh::internal::runtime::{Runtime, ZRuntime};

/// The first wait between two attempts to dial.
const RETRY_MIN: Duration = Duration::from_millis(100);
/// The longest wait between two attempts to dial; each wait is 1.5 times the previous one.
const RETRY_MAX: Duration = Duration::from_millis(500);
/// How much earlier known places are asked than places that were only announced on the network.
const HEAD_START: Duration = Duration::from_millis(300);
/// How long a place that was only announced on the network may take to prove its owner. A round trip may take 3 s.
const SHOWN_WITHIN: Duration = Duration::from_secs(8);
/// The same if many places were announced, since most of them are then false.
const SHOWN_WITHIN_OF_MANY: Duration = Duration::from_secs(1);
/// Up to this number, places count as few: they may be the addresses of one machine.
const FEW: usize = 4;
/// How many places are asked in one attempt.
const ASKED_MAX: usize = 64;
/// How often the keeper looks for a link that is being made, to set its time limit.
const LIMIT_EVERY: Duration = Duration::from_millis(100);
/// How often the keeper checks a place that zenoh dials by itself.
const LOOK_EVERY: Duration = Duration::from_secs(2);

/// The parts needed for dialling.
#[derive(Clone)]
pub(super) struct Dialler {
    pub(super) runtime: Runtime,
    pub(super) links: Arc<Mutex<Links>>,
    /// The tunnels through which other hosts are dialled, in a team.
    pub(super) tunnels: Option<Arc<Tunnels>>,
}

impl Dialler {
    /// Ends the links to a session.
    pub(super) fn cut(&self, session: &str) {
        if self.tunnels.as_ref().is_some_and(|tunnels| tunnels.cut(session)) {
            return;
        }
        self.ends_of(session).into_iter().for_each(patience::cut);
    }

    /// Returns the two ends of each TCP link to a session.
    pub(super) fn ends_of(&self, session: &str) -> Vec<patience::Ends> {
        let through = self.tunnels.as_ref().and_then(|tunnels| tunnels.ends_of(session));
        through.map_or_else(|| lock(&self.links).ends_of(session), |ends| vec![ends])
    }
}

/// An event that the keeper acts on.
pub(super) enum Change {
    /// A TCP link was made to a session, which may be dialled again there.
    Made { session: String, from: SocketAddr, to: Locator },
    /// A TCP link was made. Its round trip is not known yet.
    New(patience::Ends),
    /// A link was lost, or has to be made.
    Wanted(String),
    /// A session has lost one of its links, but still has others.
    Halved(String),
}

/// Dials the kept peers again when their links are lost, until the session closes. `port` is the port on which the session
/// itself listens.
pub(super) async fn keep(dialler: Dialler, port: Option<u16>, mut changes: Receiver<Change>) {
    let links = Arc::clone(&dialler.links);
    let mut dialling = JoinSet::new();
    loop {
        let change = tokio::select! {
            change = changes.recv() => change,
            Some(_) = dialling.join_next() => continue,
        };
        let session = match change {
            None => return,
            Some(Change::Made { session, from, to }) => {
                // A link that we accepted came from another port than the one on which the other side listens. The other side
                // dials us.
                if port != Some(from.port()) {
                    let (mut links, found) = (lock(&links), || Place::told(Vec::new(), Some(FOUND_AGAIN_WITHIN)));
                    links.kept.entry(session.clone()).or_insert_with(found);
                    links.prove(&session, &to);
                }
                continue;
            }
            Some(Change::New(ends)) => {
                if !patience::set_as_measured(ends) {
                    tracing::debug!(?ends, "the socket of a link was not found");
                }
                continue;
            }
            Some(Change::Wanted(session)) => session,
            Some(Change::Halved(session)) => {
                tracing::debug!(session, "a link was lost, the others are ended");
                dialler.cut(&session);
                continue;
            }
        };
        let Some(place) = lock(&links).kept.get(&session).cloned() else { continue };
        let Ok(id) = session.parse() else { continue };
        if !lock(&links).dialling.insert(session.clone()) {
            continue;
        }
        tracing::debug!(session, "no link, dialling");
        let dialler = dialler.clone();
        dialling.spawn(async move {
            let connecting = connect(&dialler, id);
            let over = match place.within {
                None => {
                    connecting.await;
                    false
                }
                Some(within) => tokio::time::timeout(within, connecting).await.is_err(),
            };
            if over {
                let mut links = lock(&dialler.links);
                links.dialling.remove(&session);
                links.kept.remove(&session);
                links.troubles.remove(&session);
                links.names.remove(&session);
            }
        });
    }
}

/// Dials until the link exists, or is not wanted any more. Two simultaneous calls for one peer do no harm: zenoh lets one of
/// them through.
pub(super) async fn connect(dialler: &Dialler, id: ZenohId) {
    let (links, session, mut wait) = (&*dialler.links, id.to_string(), RETRY_MIN);
    loop {
        let place = {
            let mut links = lock(links);
            let place = links.kept.get(&session).cloned().filter(|_| !links.standing.contains(&session));
            if place.is_none() {
                // Under the same lock, because from here on the keeper is told if the link is lost,
                // and must not find a dial in progress.
                links.dialling.remove(&session);
            }
            place
        };
        let Some(place) = place.filter(|_| !dialler.runtime.is_closed()) else { return };
        attempt(dialler, id, &place).await;
        // The event that reports the link may come a moment later.
        if lock(links).standing.contains(&session) {
            continue;
        }
        tokio::time::sleep(wait.mul_f64(jitter())).await;
        wait = RETRY_MAX.min(wait.mul_f64(1.5));
    }
}

/// Tries to make a link: at the known places, and a moment later also at the announced ones. In that time the known places
/// are retried, since a node may refuse until it has noticed that the old link is cut. If no link is made, the reason is
/// stored.
async fn attempt(dialler: &Dialler, id: ZenohId, place: &Place) {
    let session = id.to_string();
    let stands = || lock(&dialler.links).standing.contains(&session);
    let note = |why: String| {
        let mut links = lock(&dialler.links);
        if !links.standing.contains(&session) {
            links.troubles.insert(session.clone(), why);
        }
    };
    let others_failed = AtomicBool::new(false);
    let known = async {
        if place.known.is_empty() {
            return Err(());
        }
        while !stands() {
            match make(dialler, id, &place.known).await {
                Ok(()) => return Ok(()),
                Err(why) => note(why),
            }
            if others_failed.load(Ordering::Relaxed) {
                return Err(());
            }
            tokio::time::sleep(RETRY_MAX.mul_f64(jitter())).await;
        }
        Ok(())
    };
    let proposed = async {
        if !place.known.is_empty() {
            tokio::time::sleep(HEAD_START).await;
        }
        let made = if place.due(now()).is_empty() { Err(()) } else { propose(dialler, id).await.map_err(note) };
        others_failed.store(made.is_err(), Ordering::Relaxed);
        made
    };
    tokio::pin!(known, proposed);
    // The first attempt that makes a link ends the other one. If both fail, the wait ends as well.
    tokio::select! {
        Ok(()) = &mut known => {}
        Ok(()) = &mut proposed => {}
        else => {}
    }
}

/// Asks all places that were announced on the network at once, including those that are announced in the meantime. The first
/// place that proves the right key gets the link.
async fn propose(dialler: &Dialler, id: ZenohId) -> Result<(), String> {
    let (session, mut asking, mut why) = (id.to_string(), JoinSet::new(), String::new());
    let mut asked = Vec::new();
    loop {
        let due = lock(&dialler.links).kept.get(&session).map(|place| place.due(now())).unwrap_or_default();
        let new: Vec<Locator> = due.into_iter().filter(|place| !asked.contains(place)).collect();
        for locator in new.into_iter().take(ASKED_MAX - asked.len()) {
            asked.push(locator.clone());
            let within = if asked.len() > FEW { SHOWN_WITHIN_OF_MANY } else { SHOWN_WITHIN };
            let dialler = dialler.clone();
            asking.spawn(async move {
                let shown = tokio::time::timeout(within, shown(&dialler, id, std::slice::from_ref(&locator))).await;
                let silent = |_elapsed| Err(format!("{}: it did not identify itself in time", locator.address()));
                let shown = shown.unwrap_or_else(silent);
                (locator, shown)
            });
        }
        let answer = tokio::select! {
            Some(answer) = asking.join_next() => answer,
            () = tokio::time::sleep(LIMIT_EVERY), if !asking.is_empty() => continue,
            else => return Err(why),
        };
        match answer {
            Ok((_, Ok(shown))) => {
                // Each of the other places may be a further address of the same node.
                asking.abort_all();
                return enter(dialler, id, shown).await;
            }
            Ok((locator, Err(because))) => {
                lock(&dialler.links).fail(&session, &locator, now());
                why = because;
            }
            Err(error) => why = error.to_string(),
        }
    }
}

async fn make(dialler: &Dialler, id: ZenohId, locators: &[Locator]) -> Result<(), String> {
    enter(dialler, id, shown(dialler, id, locators).await?).await
}

/// A place that answers. In a team, it has also proved its owner.
struct Shown {
    locator: Locator,
    /// The locator of the link; in a team, the locator of a tunnel.
    way: Locator,
    took: Duration,
}

/// Finds a place that answers, and checks its owner.
async fn shown(dialler: &Dialler, id: ZenohId, locators: &[Locator]) -> Result<Shown, String> {
    let (locator, took) = reach::first(locators).await?;
    let place = locator.address().as_str().to_owned();
    let way = match &dialler.tunnels {
        Some(tunnels) if locator.protocol().as_str() == "tcp" => {
            let dialled = tunnels.dial(&place, Some(&id.to_string())).await;
            let (_, name, path) =
                dialled.map_err(|why| format!("{place} answers after {} ms: {why}", took.as_millis()))?;
            let mut links = lock(&dialler.links);
            links.names.insert(id.to_string(), name);
            // The place has proved the key of that session. The link may be lost again before zenoh returns.
            links.prove(&id.to_string(), &locator);
            drop(links);
            through(&path)?
        }
        _ => locator.clone(),
    };
    Ok(Shown { locator, way, took })
}

/// Makes the link to a place.
async fn enter(dialler: &Dialler, id: ZenohId, Shown { locator, way, took }: Shown) -> Result<(), String> {
    if link(dialler, id, way, took).await {
        lock(&dialler.links).prove(&id.to_string(), &locator);
        return Ok(());
    }
    Err(format!("{} answers after {} ms, and makes no link", locator.address(), took.as_millis()))
}

/// Returns the way through a tunnel.
fn through(path: &Path) -> Result<Locator, String> {
    let locator = unix_locator(path).map_err(|error| error.to_string())?;
    locator.parse().map_err(|_no_locator| format!("`{locator}` is not a locator"))
}

/// Makes zenoh connect to a place that took `answered` to answer.
async fn link(dialler: &Dialler, id: ZenohId, way: Locator, answered: Duration) -> bool {
    let place: Option<SocketAddr> = way.address().as_str().parse().ok().filter(|_| way.protocol().as_str() == "tcp");
    // The dial continues to its end, even without a waiting caller. Zenoh would treat a cancelled dial as still in progress,
    // and would never dial the session again.
    let runtime = dialler.runtime.clone();
    let mut making = ZRuntime::Net.spawn(async move { runtime.connect_peer(&id.into(), &[way]).await });
    loop {
        tokio::select! {
            made = &mut making => return made.unwrap_or(false),
            // Zenoh reports a link only when it is ready. If a packet is lost before that, the system repeats it at growing
            // intervals, and no other dial may begin in that time.
            () = tokio::time::sleep(LIMIT_EVERY) => {
                place.iter().for_each(|place| patience::set_towards(*place, patience::of_new(answered)));
            }
        }
    }
}

/// Keeps a tunnel to an address, regardless of the session there.
pub(super) async fn keep_place(place: Locator, dialler: Dialler, tunnels: Arc<Tunnels>) {
    let (name, mut there) = (place.to_string(), None::<String>);
    loop {
        let is_linked = there.as_ref().is_some_and(|session| lock(&dialler.links).standing.contains(session));
        if !is_linked {
            let made = match reach::first(std::slice::from_ref(&place)).await {
                Ok(_) => tunnels.dial(place.address().as_str(), None).await,
                Err(why) => Err(why),
            };
            let linked = match made {
                Ok((session, _, path)) => {
                    let way = through(&path).ok().zip(session.parse().ok());
                    there = Some(session);
                    let linked = match way {
                        Some((way, id)) => link(&dialler, id, way, Duration::ZERO).await,
                        None => false,
                    };
                    linked.then_some(()).ok_or_else(|| "it makes no link".to_owned())
                }
                Err(why) => Err(why),
            };
            match linked {
                Ok(()) => lock(&dialler.links).troubles.remove(&name),
                Err(why) => lock(&dialler.links).troubles.insert(name.clone(), why),
            };
        }
        tokio::time::sleep(RETRY_MAX.mul_f64(jitter())).await;
    }
}

/// Notes why zenoh has no link to a place that it dials by itself.
pub(super) async fn watch_place(place: Locator, links: Arc<Mutex<Links>>) {
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

/// Returns a random factor from 0.75 to 1.25, so that programs that lost their links at the same time dial at different
/// times.
fn jitter() -> f64 {
    let millionth = now().nanos() % 1_000_000;
    0.75 + f64::from(u32::try_from(millionth).unwrap_or(0)) / 2e6
}
