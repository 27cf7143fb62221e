//! The lock for a resource of a class, and the user of a lock of another process.

use super::{Station, no_number};
use comms::logic::object::ObjectError;
use comms::logic::time::Time;
use controllers::sdk::messaging::Lock;
use controllers::sdk::messaging::{LockAnswer, LockRequest, LockSettings, LockUser, Refusal};
use controllers::sdk::{Activity, AnyCalls, CallOrder, Calls, Exports, RawReply};
use pyo3::prelude::*;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// The most users that wait for a lock.
const WAITING_MAX: usize = 64;

/// Returns the exports of a lock: the procedure that takes requests, and its state for people.
pub(super) fn exports(name: &'static str, status: Option<&'static str>, doc: &'static str) -> Exports<Lock> {
    let mut exports = Exports::default();
    exports.procedure_later(name, doc, |lock: &mut Lock, request: LockRequest, reply| lock.ask(request, reply));
    if let Some(status) = status {
        exports.state(status, "Who holds it.", Lock::status);
    }
    exports
}

/// A lock of an instance.
#[derive(Debug)]
pub(crate) struct LockStation {
    held: Mutex<(Lock, Exports<Lock>)>,
    now: Mutex<Time>,
}

impl LockStation {
    pub(super) fn new(lease: Duration, preempt_after: Option<Duration>, exports: Exports<Lock>) -> Arc<Self> {
        let lock = Lock::new(LockSettings { lease, preempt_after, waiting_max: WAITING_MAX });
        Arc::new(Self { held: Mutex::new((lock, exports)), now: Mutex::new(Time::ZERO) })
    }

    fn held(&self) -> MutexGuard<'_, (Lock, Exports<Lock>)> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn now(&self) -> MutexGuard<'_, Time> {
        self.now.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Lets a command through to the resource, or refuses it.
    pub(super) fn admit(&self, fence: Option<u64>) -> Result<(), Refusal> {
        self.held().0.admit(fence)
    }
}

impl Station for LockStation {
    fn begin(&self, _: bool) {}

    fn work(&self, now: Time) {
        *self.now() = now;
        self.held().0.work(now);
    }

    fn serve(&self, name: &str, argument: &[u8], activity: Activity, reply: RawReply) {
        let (lock, exports) = &mut *self.held();
        exports.serve(lock, name, argument, activity, reply);
    }
}

/// A lock, as seen by the class with the resource.
#[pyclass(frozen, module = "dca", name = "Lock")]
#[derive(Debug)]
pub(crate) struct LockOf(pub(crate) Arc<LockStation>);

#[pymethods]
impl LockOf {
    /// The fencing number of the present holder; `None` if the lock is free. The resource of a free lock has to be at
    /// rest.
    #[getter]
    fn held(&self) -> Option<u64> {
        let now = *self.0.now();
        self.0.held().0.held(now)
    }

    /// The name of the present holder; empty if the lock is free.
    #[getter]
    fn holder(&self) -> String {
        self.0.held().0.status().holder.unwrap_or_default()
    }

    /// Returns whether a command with this fencing number may be carried out.
    #[pyo3(signature = (fence))]
    fn admits(&self, fence: Option<u64>) -> bool {
        self.0.admit(fence).is_ok()
    }
}

/// The user of another process's lock.
#[derive(Debug)]
pub(crate) struct LockUserStation {
    name: String,
    held: Mutex<User>,
}

#[derive(Debug)]
struct User {
    user: LockUser,
    calls: Calls<LockRequest, LockAnswer>,
    now: Time,
}

impl LockUserStation {
    pub(super) fn new(path: &str) -> PyResult<Arc<Self>> {
        let (user, calls) = (LockUser::new(path).map_err(no_number)?, Calls::default());
        Ok(Arc::new(Self { name: path.to_owned(), held: Mutex::new(User { user, calls, now: Time::ZERO }) }))
    }

    fn held(&self) -> MutexGuard<'_, User> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Station for LockUserStation {
    fn begin(&self, is_connected: bool) {
        let mut held = self.held();
        held.calls = Calls::default();
        if is_connected {
            held.calls.connect();
        }
        // Answers to calls of the previous activation never arrive.
        if let Ok(user) = LockUser::new(&self.name) {
            held.user = user;
        }
    }

    fn work(&self, now: Time) {
        let User { user, calls, now: last } = &mut *self.held();
        *last = now;
        user.work(now, calls);
    }

    fn take(&self) -> Vec<CallOrder> {
        self.held().calls.take()
    }

    fn deliver(&self, number: u64, result: Result<Vec<u8>, ObjectError>) {
        self.held().calls.deliver(number, result);
    }
}

/// Another process's lock, as seen by its user.
#[pyclass(frozen, module = "dca", name = "LockUser")]
#[derive(Debug)]
pub(crate) struct LockUserOf(pub(crate) Arc<LockUserStation>);

#[pymethods]
impl LockUserOf {
    /// Wants the lock, with a priority.
    #[pyo3(signature = (priority = 0))]
    fn want(&self, priority: u8) {
        self.0.held().user.want(priority);
    }

    /// Releases the lock, or stops waiting for it.
    fn let_go(&self) {
        self.0.held().user.let_go();
    }

    /// The fencing number to send with each command, as long as the lock counts as held; otherwise `None`.
    #[getter]
    fn held(&self) -> Option<u64> {
        let held = self.0.held();
        held.user.held(held.now)
    }

    /// Whether a user of greater priority waits for the lock that this user holds.
    #[getter]
    fn is_wanted(&self) -> bool {
        self.0.held().user.is_wanted()
    }

    /// Whether the lock is neither wanted nor held.
    #[getter]
    fn is_idle(&self) -> bool {
        self.0.held().user.is_idle()
    }

    /// The name of the holder when this user was last told to wait.
    #[getter]
    fn holder(&self) -> String {
        self.0.held().user.holder().to_owned()
    }

    /// Why the lock was lost, or could not be granted, since it was last wanted; otherwise `None`.
    #[getter]
    fn lost(&self) -> Option<String> {
        self.0.held().user.lost().map(|why| why.to_string())
    }
}
