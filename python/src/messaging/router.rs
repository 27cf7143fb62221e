//! A router of a class, and the subscriber to another process's router.

use super::queue::{Held, Source, Taken, all, take, waiting};
use super::{DeclaredFilter, Station, no_number};
use crate::message::MessageType;
use comms::logic::messaging::router::Gone;
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use controllers::sdk::messaging::{
    Delivery, EncodedMessage, Filter, Full, Router, RouterUser, Subscribed, Subscription,
};
use controllers::sdk::{Activity, AnyCalls, CallOrder, Calls, Exports, RawReply};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::num::NonZeroUsize;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Returns the exports of a router: the procedure that takes subscriptions, and its state for people.
pub(super) fn exports(name: &'static str, status: Option<&'static str>, doc: &'static str) -> Exports<Router<()>> {
    let mut exports = Exports::default();
    exports.procedure_later(name, doc, |router: &mut Router<()>, subscription: Subscription, reply| {
        router.ask(subscription, reply);
    });
    if let Some(status) = status {
        exports.state(status, "Its subscribers.", Router::status);
    }
    exports
}

/// A router of an instance.
#[derive(Debug)]
pub(crate) struct RouterStation {
    message: Arc<Py<MessageType>>,
    held: Mutex<(Router<()>, Exports<Router<()>>)>,
    now: Mutex<Time>,
}

impl RouterStation {
    pub(super) fn new(
        message: &Arc<Py<MessageType>>,
        (path, outbox_max): (&str, usize),
        exports: Exports<Router<()>>,
    ) -> PyResult<Arc<Self>> {
        let router = Router::of_type(message.get().name.clone(), path, outbox_max).map_err(no_number)?;
        let (held, now) = (Mutex::new((router, exports)), Mutex::new(Time::ZERO));
        Ok(Arc::new(Self { message: Arc::clone(message), held, now }))
    }

    fn held(&self) -> MutexGuard<'_, (Router<()>, Exports<Router<()>>)> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> MutexGuard<'_, Time> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Station for RouterStation {
    fn begin(&self, _: bool) {}

    fn work(&self, now: Time) {
        *self.now() = now;
        self.held().0.work(now);
    }

    fn serve(&self, name: &str, argument: &[u8], activity: Activity, reply: RawReply) {
        let (router, exports) = &mut *self.held();
        exports.serve(router, name, argument, activity, reply);
    }
}

/// A router, as seen by its class.
#[pyclass(frozen, module = "dca", name = "Router")]
#[derive(Debug)]
pub(crate) struct RouterOf(pub(crate) Arc<RouterStation>);

#[pymethods]
impl RouterOf {
    /// Sends a message to all subscribers whose filters accept its header.
    #[pyo3(signature = (value, *, category = String::new(), priority = 0, marker = 0))]
    fn send(&self, value: &Bound<'_, PyAny>, category: String, priority: u8, marker: u64) -> PyResult<()> {
        let message = self.0.message.get();
        let (type_name, data) = (message.name.clone(), message.bytes(value)?);
        let encoded = EncodedMessage { type_name, data, category, priority, marker, ..EncodedMessage::default() };
        let now = *self.0.now();
        self.0.held().0.send_encoded(now, encoded).map(drop).map_err(PyValueError::new_err)
    }

    /// The names of the subscribers.
    #[getter]
    fn subscribers(&self) -> Vec<String> {
        self.0.held().0.status().subscribers.into_iter().map(|one| one.queue).collect()
    }

    /// Takes the subscribers that were removed since the last call: the name, the reason, and the number of lost
    /// messages for each.
    fn dropped(&self) -> Vec<(String, &'static str, u64)> {
        let mut held = self.0.held();
        let dropped = std::iter::from_fn(|| held.0.dropped());
        dropped.map(|one| (one.name, why(one.why), one.lost)).collect()
    }
}

const fn why(gone: Gone) -> &'static str {
    match gone {
        Gone::Unknown => "it is not there",
        Gone::Silent => "no message from it arrives",
        Gone::WrongType => "it takes another type",
    }
}

/// The subscriber of a router.
#[derive(Debug)]
pub(crate) struct SubscriberStation {
    path: String,
    held: Mutex<Subscriber>,
}

#[derive(Debug)]
struct Subscriber {
    user: RouterUser,
    calls: Calls<Subscription, Delivery>,
    queue: Held,
    type_name: String,
    filters: Vec<Filter>,
}

impl SubscriberStation {
    pub(super) fn new(
        message: &Arc<Py<MessageType>>,
        capacity: NonZeroUsize,
        (path, filters): (&str, Vec<Filter>),
    ) -> PyResult<Arc<Self>> {
        let user = RouterUser::new(path, filters.clone()).map_err(no_number)?;
        let queue = Held::new(message, capacity, Full::Reject);
        let type_name = message.get().name.clone();
        let held = Mutex::new(Subscriber { user, calls: Calls::default(), queue, type_name, filters });
        Ok(Arc::new(Self { path: path.to_owned(), held }))
    }

    fn held(&self) -> MutexGuard<'_, Subscriber> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Station for SubscriberStation {
    fn begin(&self, is_connected: bool) {
        let mut held = self.held();
        held.calls = Calls::default();
        if is_connected {
            held.calls.connect();
        }
        if let Ok(user) = RouterUser::new(&self.path, held.filters.clone()) {
            held.user = user;
        }
    }

    fn work(&self, now: Time) {
        let Subscriber { user, calls, queue, type_name, .. } = &mut *self.held();
        queue.look_at(now);
        user.work_with(now, calls, type_name, &mut |message| queue.receive(message));
    }

    fn take(&self) -> Vec<CallOrder> {
        self.held().calls.take()
    }

    fn deliver(&self, number: u64, result: Result<Vec<u8>, ObjectError>) {
        self.held().calls.deliver(number, result);
    }
}

impl Source for SubscriberStation {
    fn with(&self, run: &mut dyn FnMut(&mut Held)) {
        run(&mut self.held().queue);
    }
}

/// Another process's router, as seen by its subscriber.
#[pyclass(frozen, module = "dca", name = "Subscriber")]
#[derive(Debug)]
pub(crate) struct SubscriberOf(pub(crate) Arc<SubscriberStation>);

#[pymethods]
impl SubscriberOf {
    /// Takes the next message; `None` if none waits.
    fn take(&self, py: Python<'_>) -> PyResult<Option<Taken>> {
        take(py, &*self.0)
    }

    /// Takes all waiting messages.
    fn __iter__<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        all(py, &*self.0)
    }

    /// How many messages wait.
    fn __len__(&self) -> usize {
        waiting(&*self.0)
    }

    /// The state of the subscription: `asking` while it is unknown, `yes`, or the reason why it was refused.
    #[getter]
    fn state(&self) -> String {
        match self.0.held().user.state() {
            Subscribed::Asking => "asking".to_owned(),
            Subscribed::Yes => "yes".to_owned(),
            Subscribed::Refused(why) => why.to_string(),
            Subscribed::Unknown(why) => why.to_string(),
        }
    }

    /// Replaces the filters. From now on the subscriber gets the messages that one of the filters accepts, or all
    /// messages without filters.
    fn set_filters(&self, filters: Vec<DeclaredFilter>) {
        let mut held = self.0.held();
        held.filters = filters.into_iter().map(Filter::from).collect();
        let filters = held.filters.clone();
        held.user.set_filters(filters);
    }
}
