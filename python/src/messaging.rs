//! Queues, locks and routers of a class, and the clients for queues, locks and routers of other processes.
//!
//! Each is a [`Station`]: it exports a procedure or makes calls, like its counterpart of the kit in Rust. The object of the class has it as
//! an attribute. Its message type encodes and checks the data; the kit implements the protocol.

mod lock;
mod queue;
mod router;
mod sender;

pub(crate) use lock::{LockOf, LockUserOf};
pub(crate) use queue::{QueueOf, Taken};
pub(crate) use router::{RouterOf, SubscriberOf};
pub(crate) use sender::{SendError, SenderOf, Sending};

use crate::message::MessageType;
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use controllers::sdk::messaging::{Filter, Full};
use controllers::sdk::{Activity, CallInterface, CallOrder, ExportInterface, RawReply};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::fmt::Debug;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Duration;

/// One queue, lock, router or client of an instance.
pub(crate) trait Station: Debug + Send + Sync {
    /// Begins an activation. `is_connected` tells whether the spec connects the station's calls.
    fn begin(&self, is_connected: bool);
    /// Receives and sends; called before and after each calculation.
    fn work(&self, now: Time);
    /// Takes the pending orders for the station's calls.
    fn take(&self) -> Vec<CallOrder> {
        Vec::new()
    }
    /// Takes the answer to one of the station's calls.
    fn deliver(&self, number: u64, result: Result<Vec<u8>, ObjectError>) {
        let _ = number;
        drop(result);
    }
    /// Carries out a call of one of the station's exports.
    fn serve(&self, name: &str, argument: &[u8], activity: Activity, reply: RawReply) {
        let _ = (name, argument, activity);
        drop(reply);
    }
}

/// The part of a declaration that all stations have, with the fields of `_messaging.py`.
#[derive(FromPyObject)]
struct DeclaredStation {
    kind: String,
    name: String,
    attribute: String,
    doc: String,
    status: Option<String>,
    is_optional: bool,
}

#[derive(FromPyObject)]
struct DeclaredQueue {
    message: Py<MessageType>,
    capacity: NonZeroUsize,
    full: String,
    lock: Option<String>,
}

#[derive(FromPyObject)]
struct DeclaredLock {
    lease: f64,
    preempt_after: Option<f64>,
}

#[derive(FromPyObject)]
struct DeclaredSubscriber {
    message: Py<MessageType>,
    capacity: NonZeroUsize,
    filters: Vec<DeclaredFilter>,
}

/// A filter, with the fields of `dca.Filter`.
#[derive(Clone, Debug, FromPyObject)]
pub(crate) struct DeclaredFilter {
    category: Option<String>,
    sender: Option<String>,
    priority_min: Option<u8>,
    marker: Option<u64>,
}

/// The declaration of a station in a class.
#[derive(Debug)]
pub(crate) struct StationOf {
    pub(crate) attribute: String,
    pub(crate) kind: Kind,
    /// The name of the station in interfaces.
    pub(crate) name: &'static str,
    status: Option<&'static str>,
    doc: &'static str,
    is_optional: bool,
}

/// The kinds of stations.
#[derive(Clone, Debug)]
pub(crate) enum Kind {
    Queue { message: Arc<Py<MessageType>>, capacity: NonZeroUsize, full: Full, lock: Option<String> },
    Sender { message: Arc<Py<MessageType>> },
    Lock { lease: Duration, preempt_after: Option<Duration> },
    LockUser,
    Router { message: Arc<Py<MessageType>>, outbox_max: usize },
    Subscriber { message: Arc<Py<MessageType>>, capacity: NonZeroUsize, filters: Vec<Filter> },
}

impl From<DeclaredFilter> for Filter {
    fn from(declared: DeclaredFilter) -> Self {
        let DeclaredFilter { category, sender, priority_min, marker } = declared;
        Self { category, sender, priority_min, marker }
    }
}

impl Kind {
    /// Reads the part of a declaration that only stations of one kind have.
    fn of(kind: &str, declared: &Bound<'_, PyAny>) -> PyResult<Self> {
        let message = || -> PyResult<_> { Ok(Arc::new(declared.getattr("message")?.extract()?)) };
        let span = |seconds: f64| {
            Duration::try_from_secs_f64(seconds).map_err(|_out_of_range| PyValueError::new_err("not a span of time"))
        };
        Ok(match kind {
            "queue" => {
                let DeclaredQueue { message, capacity, full, lock } = declared.extract()?;
                let full = match full.as_str() {
                    "drop lowest" => Full::DropLowest,
                    "drop oldest" => Full::DropOldest,
                    _ => Full::Reject,
                };
                Self::Queue { message: Arc::new(message), capacity, full, lock }
            }
            "sender" => Self::Sender { message: message()? },
            "lock" => {
                let DeclaredLock { lease, preempt_after } = declared.extract()?;
                Self::Lock { lease: span(lease)?, preempt_after: preempt_after.map(span).transpose()? }
            }
            "lock user" => Self::LockUser,
            "router" => {
                let outbox_max: NonZeroUsize = declared.getattr("outbox_max")?.extract()?;
                Self::Router { message: message()?, outbox_max: outbox_max.get() }
            }
            "subscriber" => {
                let DeclaredSubscriber { message, capacity, filters } = declared.extract()?;
                let filters = filters.into_iter().map(Filter::from).collect();
                Self::Subscriber { message: Arc::new(message), capacity, filters }
            }
            other => return Err(PyValueError::new_err(format!("`{other}` is not a kind of stations"))),
        })
    }
}

impl StationOf {
    /// Reads a declaration; `for_ever` makes its texts live as long as the process.
    pub(crate) fn of(declared: &Bound<'_, PyAny>, for_ever: fn(String) -> &'static str) -> PyResult<Self> {
        let DeclaredStation { kind, name, attribute, doc, status, is_optional } = declared.extract()?;
        let (name, status, doc) = (for_ever(name), status.map(for_ever), for_ever(doc));
        Ok(Self { attribute, kind: Kind::of(&kind, declared)?, name, status, doc, is_optional })
    }

    /// Returns the exports of the station.
    pub(crate) fn exports(&self) -> Vec<ExportInterface> {
        match &self.kind {
            Kind::Queue { .. } => queue::exports(self.name, self.status, self.doc).interfaces(),
            Kind::Lock { .. } => lock::exports(self.name, self.status, self.doc).interfaces(),
            Kind::Router { .. } => router::exports(self.name, self.status, self.doc).interfaces(),
            Kind::Sender { .. } | Kind::LockUser | Kind::Subscriber { .. } => Vec::new(),
        }
    }

    /// Returns the calls that the station makes.
    pub(crate) fn calls(&self) -> Option<CallInterface> {
        use controllers::sdk::messaging::{Delivery, LockAnswer, LockRequest, QueueMessage, Receipt, Subscription};
        let required = !self.is_optional;
        match &self.kind {
            Kind::Sender { .. } => Some(CallInterface::new::<QueueMessage, Receipt>(self.name, self.doc, required)),
            Kind::LockUser => Some(CallInterface::new::<LockRequest, LockAnswer>(self.name, self.doc, required)),
            Kind::Subscriber { .. } => {
                Some(CallInterface::new::<Subscription, Delivery>(self.name, self.doc, required))
            }
            Kind::Queue { .. } | Kind::Lock { .. } | Kind::Router { .. } => None,
        }
    }
}

/// The stations of an instance.
#[derive(Debug, Default)]
pub(crate) struct Stations {
    all: Vec<(Arc<dyn Station>, Names)>,
    /// The names of the stations' attributes, each with its object.
    pub(crate) objects: Vec<(String, Py<PyAny>)>,
}

/// The names in an interface that belong to a station.
#[derive(Debug)]
struct Names {
    exports: Vec<&'static str>,
    calls: Option<&'static str>,
}

impl Stations {
    /// Makes the stations of an instance at `path`.
    ///
    /// # Errors
    /// If the system has no random number, or a queue names a lock that the class does not have.
    pub(crate) fn make(py: Python<'_>, declared: &[StationOf], path: &str) -> PyResult<Self> {
        let mut stations = Self::default();
        let locks: Vec<(&str, Arc<lock::LockStation>)> = declared
            .iter()
            .filter_map(|one| match one.kind {
                Kind::Lock { lease, preempt_after } => {
                    let exports = lock::exports(one.name, one.status, one.doc);
                    Some((one.attribute.as_str(), lock::LockStation::new(lease, preempt_after, exports)))
                }
                Kind::Queue { .. }
                | Kind::Sender { .. }
                | Kind::LockUser
                | Kind::Router { .. }
                | Kind::Subscriber { .. } => None,
            })
            .collect();
        let lock_of =
            |name: &str| locks.iter().find(|(attribute, _)| *attribute == name).map(|(_, lock)| Arc::clone(lock));
        for one in declared {
            let (station, object): (Arc<dyn Station>, Py<PyAny>) = match &one.kind {
                Kind::Queue { message, capacity, full, lock } => {
                    let lock = lock.as_deref().map(|name| {
                        let missing = || {
                            PyValueError::new_err(format!(
                                "the queue `{}` has a lock `{name}`, which the class does not have",
                                one.name
                            ))
                        };
                        lock_of(name).ok_or_else(missing)
                    });
                    let exports = queue::exports(one.name, one.status, one.doc);
                    let station = queue::QueueStation::new(message, *capacity, *full, lock.transpose()?, exports);
                    (Arc::clone(&station) as _, Py::new(py, QueueOf::of(station))?.into_any())
                }
                Kind::Sender { message } => {
                    let station = sender::SenderStation::new(message, path)?;
                    (Arc::clone(&station) as _, Py::new(py, SenderOf(station))?.into_any())
                }
                Kind::Lock { .. } => {
                    let Some(station) = lock_of(&one.attribute) else { continue };
                    (Arc::clone(&station) as _, Py::new(py, LockOf(station))?.into_any())
                }
                Kind::LockUser => {
                    let station = lock::LockUserStation::new(path)?;
                    (Arc::clone(&station) as _, Py::new(py, LockUserOf(station))?.into_any())
                }
                Kind::Router { message, outbox_max } => {
                    let exports = router::exports(one.name, one.status, one.doc);
                    let station = router::RouterStation::new(message, (path, *outbox_max), exports)?;
                    (Arc::clone(&station) as _, Py::new(py, RouterOf(station))?.into_any())
                }
                Kind::Subscriber { message, capacity, filters } => {
                    let station = router::SubscriberStation::new(message, *capacity, (path, filters.clone()))?;
                    (Arc::clone(&station) as _, Py::new(py, SubscriberOf(station))?.into_any())
                }
            };
            let exports = one.exports().iter().map(|export| export.name).collect();
            stations.all.push((station, Names { exports, calls: one.calls().map(|_| one.name) }));
            stations.objects.push((one.attribute.clone(), object));
        }
        Ok(stations)
    }

    /// Begins an activation; `connected` are the calls that the spec connects.
    pub(crate) fn begin(&self, connected: &[&'static str]) {
        for (station, names) in &self.all {
            station.begin(names.calls.is_some_and(|name| connected.contains(&name)));
        }
    }

    /// Hears and sends.
    pub(crate) fn work(&self, now: Time) {
        self.all.iter().for_each(|(station, _)| station.work(now));
    }

    /// Takes the pending orders for calls.
    pub(crate) fn take(&self, order: &mut dyn FnMut(&'static str, CallOrder)) {
        for (station, names) in &self.all {
            let Some(name) = names.calls else { continue };
            station.take().into_iter().for_each(|one| order(name, one));
        }
    }

    /// Returns the station that makes these calls.
    pub(crate) fn caller(&self, name: &str) -> Option<&Arc<dyn Station>> {
        self.all.iter().find(|(_, names)| names.calls == Some(name)).map(|(station, _)| station)
    }

    /// Returns the station that has this export.
    pub(crate) fn server(&self, name: &str) -> Option<&Arc<dyn Station>> {
        self.all.iter().find(|(_, names)| names.exports.contains(&name)).map(|(station, _)| station)
    }
}

/// Returns the exception for a missing random number.
fn no_number(error: std::io::Error) -> PyErr {
    pyo3::exceptions::PyOSError::new_err(error.to_string())
}
