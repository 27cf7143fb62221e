//! Dials the peers of a session, and dials them again when their links are lost.

use super::super::config::unix_locator;
use super::super::links::{Links, Place, lock};
use super::super::tunnel::Tunnels;
use super::super::{patience, reach};
use super::FOUND_AGAIN_WITHIN;
use crate::io::queue::Receiver;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tokio::task::JoinSet;
use zenoh::config::{Locator, ZenohId};
use zenoh::internal::runtime::{Runtime, ZRuntime};

/// The first wait between two attempts to dial.
const RETRY_MIN: Duration = Duration::from_millis(100);
/// The longest wait between two attempts to dial; each is half as long again as the one before.
const RETRY_MAX: Duration = Duration::from_millis(500);
/// How often a link that is being made is looked for, to give it a limit.
const LIMIT_EVERY: Duration = Duration::from_millis(100);
/// How often the keeper looks at a place that zenoh dials by itself.
const LOOK_EVERY: Duration = Duration::from_secs(2);

/// What it takes to dial.
#[derive(Clone)]
pub(super) struct Dialler {
    pub(super) runtime: Runtime,
    pub(super) links: Arc<Mutex<Links>>,
    /// Other hosts are dialled through these, if there are any.
    pub(super) tunnels: Option<Arc<Tunnels>>,
}

/// An event that the keeper acts on.
pub(super) enum Change {
    /// A TCP link was made, to somebody who may be dialled there again.
    Made { session: String, from: SocketAddr, to: Locator },
    /// A TCP link was made, and nobody has said yet how long it takes.
    New(patience::Ends),
    /// A link was lost, or is to be made.
    Wanted(String),
    /// A session has lost one of its links, and still has these.
    Halved(Vec<patience::Ends>),
}

/// Dials kept peers again as their links are lost, until the session closes. `port` is where it listens itself.
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
                // The other side of a link that we accepted listens elsewhere, and dials us.
                if port != Some(from.port()) {
                    let place = Place { locators: vec![to], within: Some(FOUND_AGAIN_WITHIN) };
                    lock(&links).kept.entry(session).or_insert(place);
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

/// Dials until the link stands, or is not to be kept any more. Two at a time for one peer do no harm: zenoh lets one
/// through.
pub(super) async fn connect(dialler: &Dialler, id: ZenohId) {
    let (links, session, mut wait) = (&*dialler.links, id.to_string(), RETRY_MIN);
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
        let Some(locators) = place.filter(|_| !dialler.runtime.is_closed()) else { return };
        let attempted = attempt(dialler, id, &locators).await;
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
async fn attempt(dialler: &Dialler, id: ZenohId, locators: &[Locator]) -> Result<(), String> {
    let (locator, took) = reach::first(locators).await?;
    let place = locator.address().as_str().to_owned();
    let way = match &dialler.tunnels {
        Some(tunnels) if locator.protocol().as_str() == "tcp" => {
            let dialled = tunnels.dial(&place, Some(&id.to_string())).await;
            let (_, name, path) =
                dialled.map_err(|why| format!("{place} answers after {} ms: {why}", took.as_millis()))?;
            lock(&dialler.links).names.insert(id.to_string(), name);
            through(&path)?
        }
        _ => locator,
    };
    if link(dialler, id, way, took).await {
        return Ok(());
    }
    Err(format!("{place} answers after {} ms, and makes no link", took.as_millis()))
}

/// Returns the way through a tunnel.
fn through(path: &Path) -> Result<Locator, String> {
    let locator = unix_locator(path).map_err(|error| error.to_string())?;
    locator.parse().map_err(|_no_locator| format!("`{locator}` is no locator"))
}

/// Has zenoh make a link to a place that has answered after so long.
async fn link(dialler: &Dialler, id: ZenohId, way: Locator, answered: Duration) -> bool {
    let place: Option<SocketAddr> = way.address().as_str().parse().ok().filter(|_| way.protocol().as_str() == "tcp");
    // It goes on to its end, whoever waits: what is cut short counts as being dialled for ever, and is dialled no more.
    let runtime = dialler.runtime.clone();
    let mut making = ZRuntime::Net.spawn(async move { runtime.connect_peer(&id.into(), &[way]).await });
    loop {
        tokio::select! {
            made = &mut making => return made.unwrap_or(false),
            // Zenoh says of a link when it stands. One that loses a packet before would wait for the system to send it again, later
            // and later, and no other dial may begin meanwhile.
            () = tokio::time::sleep(LIMIT_EVERY) => {
                place.iter().for_each(|place| patience::set_towards(*place, patience::of_new(answered)));
            }
        }
    }
}

/// Keeps a tunnel to a place, whoever is there.
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

/// Notes why a place that zenoh dials by itself is not linked.
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

/// Returns a factor from 0.75 to 1.25, so that programs that lost their links together do not dial together.
fn jitter() -> f64 {
    let millionth = crate::io::clock::now().nanos() % 1_000_000;
    0.75 + f64::from(u32::try_from(millionth).unwrap_or(0)) / 2e6
}
