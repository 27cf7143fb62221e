//! The exports of a program, and its calls of others. This module is between the loop and the data session.
//!
//! Calls that arrive wait in the inbox of the loop. A separate thread sends the program's own calls, because a link
//! that accepts nothing may block its sender.

use super::inbox::Inbox;
use super::keyring::Keyring;
use super::warrants::Warrants;
use crate::sdk::calls::CallOrder;
use crate::sdk::export::{ExportInterface, admit};
use crate::sdk::interface::Interface;
use comms::io::data::{CallWay, DataError, DataSession, ObjectEvent, ObjectServer, PendingCall, Responder};
use comms::logic::bytes::Bytes;
use comms::logic::codec;
use comms::logic::control::CallRoute;
use comms::logic::key::{self, ObjectKeys};
use comms::logic::object::{CallId, Exports, ObjectCall, ObjectError, Signature};
use std::collections::BTreeMap;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::Duration;

/// How many calls wait to be sent.
const JOBS_MAX: usize = 64;

/// Serves the exports of a program; it exists after the program's first links were made.
#[derive(Debug, Default)]
pub(super) struct Serving {
    _server: Option<ObjectServer>,
    _describing: Option<Responder>,
}

/// The calls that a program makes.
#[derive(Debug, Default)]
pub(super) struct Callers {
    shared: Arc<Shared>,
    jobs: Mutex<Option<SyncSender<Job>>>,
}

#[derive(Debug, Default)]
struct Shared {
    /// By the number of the wire, the routes.
    routes: Mutex<BTreeMap<u32, Route>>,
    pending: Mutex<BTreeMap<Call, PendingCall>>,
}

/// Identifies a call of this program: its activation, the name of the call in the interface, and its number.
pub(super) type Call = (u32, &'static str, u64);

/// The path to the called export.
#[derive(Clone, Debug)]
struct Route {
    call: &'static str,
    keys: ObjectKeys,
    /// The called process.
    path: String,
    /// The procedure or state of this process.
    name: String,
    signature: Signature,
    way: CallWay,
    is_open: bool,
}

/// A job of the thread that sends calls.
#[derive(Debug)]
#[expect(clippy::large_enum_variant, reason = "few wait, and most of them are the large one")]
enum Job {
    Make { call: Call, route: Route, argument: Vec<u8>, within: Duration },
    Cancel(Call),
    CancelAll,
}

impl Serving {
    pub(super) fn make(
        session: &Arc<DataSession>,
        keyring: Option<&Keyring>,
        interface: &Interface,
        robot: &str,
        instance: &str,
        inbox: &Arc<Inbox>,
    ) -> Result<Self, DataError> {
        let (exports, inbox, of) = (interface.exports.clone(), Arc::clone(inbox), Arc::downgrade(session));
        let keys = key::object(robot, instance);
        let serve = |exports: Vec<_>| {
            let gate = keyring.map(|keyring| keyring.gate(&keys));
            let warrants = keyring.map(|keyring| Arc::clone(keyring.warrants()));
            let of = Served { key: keys.call.clone(), exports, inbox, session: of, warrants };
            session.serve_calls(&keys, gate, move |event| of.hear(event))
        };
        let server = Some(exports).filter(|exports| !exports.is_empty()).map(serve).transpose()?;
        // A program without exports also answers: silence means that it was not reached.
        let exports = interface.exports.iter().map(ExportInterface::exported).collect();
        let described = codec::encode(&Exports { exports }).ok();
        let describing = session.answer(&key::exports(robot, instance), move || described.clone())?;
        Ok(Self { _server: server, _describing: Some(describing) })
    }
}

/// The exports of a program, and the queue for their calls.
struct Served {
    key: String,
    exports: Vec<ExportInterface>,
    inbox: Arc<Inbox>,
    session: Weak<DataSession>,
    /// The calls of users, in a team.
    warrants: Option<Arc<Warrants>>,
}

impl Served {
    fn hear(&self, event: ObjectEvent) {
        match event {
            ObjectEvent::Called(incoming) => match (admit(&self.exports, &incoming.call), &self.warrants) {
                (Ok(access), Some(warrants)) => warrants.admit(&self.key, access, *incoming, &self.session),
                (Ok(_), None) => self.inbox.called(*incoming, &self.session),
                (Err(error), _) => incoming.way.answer(Err(error)),
            },
            ObjectEvent::Cancelled(id) => self.inbox.cancelled(&id),
        }
    }
}

impl Callers {
    /// Takes the routes of all calls; they replace the previous routes, and new routes are closed.
    pub(super) fn take(
        &self,
        session: &Arc<DataSession>,
        keyring: Option<&Keyring>,
        instance: &str,
        interface: &Interface,
        routes: &[CallRoute],
        inbox: &Arc<Inbox>,
    ) -> Result<(), String> {
        let mut known = self.shared.routes();
        let mut next = BTreeMap::new();
        for route in routes {
            let declared = interface.calls.iter().find(|call| call.name == route.call);
            let declared = declared.ok_or_else(|| format!("`{}` calls no `{}`", interface.type_name, route.call))?;
            let is_open = known.get(&route.wire).is_some_and(|before| before.is_open);
            let (keys, signature) = (key::object(&route.deployment, &route.path), declared.signature.clone());
            let (path, name, wire) = (route.path.clone(), route.name.clone(), route.wire);
            let way = keyring.map_or(CallWay::Open, |keyring| keyring.way(route.seal, &keys));
            next.insert(wire, Route { call: declared.name, keys, path, name, signature, way, is_open });
        }
        *known = next;
        drop(known);
        let mut jobs = self.jobs();
        if jobs.is_none() && !interface.calls.is_empty() {
            let (jobs_tx, to_do) = sync_channel(JOBS_MAX);
            let (session, shared, inbox) = (Arc::downgrade(session), Arc::clone(&self.shared), Arc::clone(inbox));
            let caller = instance.to_owned();
            let work = move || work(&to_do, &session, &caller, &shared, &inbox);
            std::thread::Builder::new().name("calls".to_owned()).spawn(work).map_err(|error| error.to_string())?;
            *jobs = Some(jobs_tx);
        }
        Ok(())
    }

    /// Returns the calls that have a route, open or closed.
    pub(super) fn connected(&self) -> Vec<&'static str> {
        self.shared.routes().values().map(|route| route.call).collect()
    }

    /// Opens or closes routes.
    pub(super) fn switch(&self, wires: &[u32], open: bool) {
        let mut routes = self.shared.routes();
        for wire in wires {
            routes.entry(*wire).and_modify(|route| route.is_open = open);
        }
    }

    /// Executes an order of the loop about a call; never waits.
    pub(super) fn order(&self, activation: u32, call: &'static str, order: CallOrder, inbox: &Inbox) {
        let (job, number) = match order {
            CallOrder::Cancel { number } => (Job::Cancel((activation, call, number)), number),
            CallOrder::Make { number, to, argument, within } => {
                let is_meant = |route: &&Route| {
                    let is_there = to.as_ref().is_none_or(|to| route.path == *to);
                    route.call == call && route.is_open && is_there
                };
                let route = self.shared.routes().values().find(is_meant).cloned();
                let Some(route) = route else {
                    let error = ObjectError::NotConnected { name: call.to_owned() };
                    return inbox.answered((activation, call, number), Err(error));
                };
                (Job::Make { call: (activation, call, number), route, argument, within }, number)
            }
        };
        let is_make = matches!(job, Job::Make { .. });
        let sent = self.jobs().as_ref().is_some_and(|jobs| jobs.try_send(job).is_ok());
        if !sent && is_make {
            let waiting = u32::try_from(JOBS_MAX).unwrap_or(u32::MAX);
            inbox.answered((activation, call, number), Err(ObjectError::Busy { waiting }));
        }
    }

    /// Stops waiting for all answers.
    pub(super) fn cancel_all(&self) {
        if let Some(jobs) = &*self.jobs() {
            // If the queue is full, the calls end when their time is over.
            jobs.try_send(Job::CancelAll).unwrap_or_default();
        }
    }

    /// Stops the thread that sends calls.
    pub(super) fn clear(&self) {
        *self.jobs() = None;
        self.shared.pending().clear();
    }

    fn jobs(&self) -> MutexGuard<'_, Option<SyncSender<Job>>> {
        self.jobs.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Shared {
    fn routes(&self) -> MutexGuard<'_, BTreeMap<u32, Route>> {
        self.routes.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn pending(&self) -> MutexGuard<'_, BTreeMap<Call, PendingCall>> {
        self.pending.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn work(jobs: &Receiver<Job>, session: &Weak<DataSession>, caller: &str, shared: &Arc<Shared>, inbox: &Arc<Inbox>) {
    let mut made = 0;
    while let Ok(job) = jobs.recv() {
        let Some(session) = session.upgrade() else { return };
        match job {
            Job::Cancel(call) => drop(shared.pending().remove(&call)),
            Job::CancelAll => {
                let all = std::mem::take(&mut *shared.pending());
                drop(all);
            }
            Job::Make { call, route, argument, within } => {
                made += 1;
                let id = CallId { session: session.id(), number: made };
                let (name, signature, argument) = (route.name, route.signature, Bytes(argument));
                let (caller, warrant) = (caller.to_owned(), None);
                let asked = ObjectCall { id, caller, name, signature, within, argument, warrant };
                let (theirs, to) = (Arc::clone(shared), Arc::clone(inbox));
                let take = move |result| {
                    theirs.pending().remove(&call);
                    to.answered(call, result);
                };
                match session.call(&route.keys, &route.way, &asked, take) {
                    Ok(pending) => {
                        let mut all = shared.pending();
                        // If the answer has already arrived, there is nothing to remove later. An answer that arrives
                        // now waits for this lock.
                        if !pending.is_over() {
                            all.insert(call, pending);
                        }
                    }
                    Err(error) => inbox.answered(call, Err(error)),
                }
            }
        }
    }
}
