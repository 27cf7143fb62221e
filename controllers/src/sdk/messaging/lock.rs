//! The lock of a resource, in the controller that has the resource, and the user of a lock.

use super::{Denied, LockAnswer, LockRequest, LockSettings, LockStatus, Refusal};
use crate::sdk::calls::Calls;
use crate::sdk::export::Reply;
use comms::io::entropy;
use comms::logic::messaging::lock::{LockEffect, LockInput, ResourceLock};
use comms::logic::messaging::lock_client::{ClientEffect, ClientInput, LockClient};
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::io;

/// How many requests wait for the next calculation.
const ASKED_MAX: usize = 256;

/// The lock in front of a resource of this controller. It is a field of the controller, which exports a procedure for
/// it that answers later: `exports.procedure_later("arm", "...", |robot: &mut Robot, request, reply|
/// robot.arm.ask(request, reply)).idle()`.
///
/// Its fencing numbers start from the time since the start of the host, so a restarted program has greater numbers. The
/// numbers are only valid at this resource.
#[derive(Debug)]
pub struct Lock {
    settings: LockSettings,
    /// The lock; it exists after the first calculation.
    lock: Option<ResourceLock>,
    asked: Vec<(LockRequest, Reply<LockAnswer>)>,
    now: Time,
}

impl Lock {
    /// Returns a lock without a holder.
    pub const fn new(settings: LockSettings) -> Self {
        Self { settings, lock: None, asked: Vec::new(), now: Time::ZERO }
    }

    /// Takes a request; the next [`Lock::work`] answers it.
    pub fn ask(&mut self, request: LockRequest, reply: Reply<LockAnswer>) {
        if self.asked.len() < ASKED_MAX {
            self.asked.push((request, reply));
        } else {
            reply.refuse("too many clients ask for the lock".to_owned());
        }
    }

    /// Answers requests, and ends leases. Called at the beginning of each calculation.
    pub fn work(&mut self, now: Time) {
        self.now = now;
        for (request, reply) in std::mem::take(&mut self.asked) {
            match self.handle(request) {
                Some(answer) => reply.send(answer),
                None => reply.refuse("the lock does not answer".to_owned()),
            }
        }
        let mut effects = Vec::new();
        self.lock_now().handle(now, LockInput::Tick, &mut effects);
        self.write(effects);
    }

    /// Returns whether a command may pass to the resource.
    ///
    /// # Errors
    /// The problem with the fencing number.
    pub fn admit(&mut self, fence: Option<u64>) -> Result<(), Refusal> {
        let now = self.now;
        self.lock_now().admit(now, fence)
    }

    /// Returns the fencing number of the holder; none without a holder. A resource without a holder has to be at rest.
    pub fn held(&mut self, now: Time) -> Option<u64> {
        self.lock_now().held(now)
    }

    /// Returns the status of the lock for people.
    pub fn status(&self) -> LockStatus {
        let first = ResourceLock::new(self.settings, 1, self.now);
        self.lock.as_ref().unwrap_or(&first).status(self.now)
    }

    /// Returns the answer to a request.
    pub(super) fn handle(&mut self, request: LockRequest) -> Option<LockAnswer> {
        let asker = match &request {
            LockRequest::Acquire { client, .. }
            | LockRequest::Renew { client, .. }
            | LockRequest::Release { client, .. } => *client,
            LockRequest::Look => comms::logic::messaging::lock::NOBODY,
        };
        let (now, mut effects) = (self.now, Vec::new());
        self.lock_now().handle(now, LockInput::Request(request), &mut effects);
        let answers = self.write(effects);
        answers.into_iter().rev().find(|(client, _)| *client == asker).map(|(_, answer)| answer)
    }

    fn lock_now(&mut self) -> &mut ResourceLock {
        let (settings, now) = (self.settings, self.now);
        self.lock.get_or_insert_with(|| ResourceLock::new(settings, now.nanos(), now))
    }

    /// Numbers that come from the clock do not have to be stored on disk. If a client is not asking at this moment, it
    /// learns of its grant when it asks again.
    fn write(&mut self, mut effects: Vec<LockEffect>) -> Vec<(u64, LockAnswer)> {
        let (now, mut answers, mut at) = (self.now, Vec::new(), 0);
        while let Some(effect) = effects.get(at).cloned() {
            match effect {
                LockEffect::Persist(number) => {
                    self.lock_now().handle(now, LockInput::Persisted(number), &mut effects);
                }
                LockEffect::Answer { client, answer } => answers.push((client, answer)),
            }
            at += 1;
        }
        answers
    }
}

/// Uses a lock that the spec connects, together with a field `#[calls("arm")] arm: Calls<LockRequest, LockAnswer>`.
#[derive(Debug)]
pub struct LockUser {
    client: LockClient,
    /// By the number of a call of the port, the number of the call of the state machine.
    open: BTreeMap<u64, u64>,
    inputs: Vec<ClientInput>,
    lost: Option<Denied>,
    /// The holder when this user was last told to wait. Empty without a holder.
    holder: String,
}

impl LockUser {
    /// Returns a user that requests nothing; `name` is for people.
    ///
    /// # Errors
    /// If the system gives no random number for the user.
    pub fn new(name: &str) -> io::Result<Self> {
        // 0 means no client.
        let client = LockClient::new(entropy::number()?.max(1), name.to_owned());
        Ok(Self { client, open: BTreeMap::new(), inputs: Vec::new(), lost: None, holder: String::new() })
    }

    /// Requests the lock, beginning with the next [`LockUser::work`].
    pub fn want(&mut self, priority: u8) {
        self.inputs.push(ClientInput::Want(priority));
    }

    /// Releases the lock, or stops waiting for it, with the next [`LockUser::work`].
    pub fn let_go(&mut self) {
        self.inputs.push(ClientInput::Drop);
    }

    /// Sends requests and renewals, and takes answers. Called once in each calculation, at least four times per lease.
    pub fn work(&mut self, now: Time, calls: &mut Calls<LockRequest, LockAnswer>) {
        let mut effects = Vec::new();
        while let Some((number, answer)) = calls.answer() {
            if let Some(call) = self.open.remove(&number) {
                if let Ok(LockAnswer::Waiting { holder, .. }) = &answer {
                    self.holder.clone_from(holder);
                }
                self.client.handle(now, ClientInput::Answer { call, answer: answer.ok() }, &mut effects);
            }
        }
        for input in std::mem::take(&mut self.inputs) {
            self.client.handle(now, input, &mut effects);
        }
        self.client.handle(now, ClientInput::Tick, &mut effects);
        for effect in effects {
            match effect {
                ClientEffect::Call { call, request, within } => {
                    self.open.insert(calls.call(request, within), call);
                }
                ClientEffect::Held { .. } => self.lost = None,
                ClientEffect::Lost(why) => self.lost = Some(why),
            }
        }
    }

    /// Returns the fencing number to send with each command, while the user may assume that it holds the lock.
    pub fn held(&self, now: Time) -> Option<u64> {
        self.client.held(now)
    }

    /// Returns whether a client with a greater priority waits for this user's lock.
    pub const fn is_wanted(&self) -> bool {
        self.client.is_wanted()
    }

    /// Returns the name of the holder when this user was last told to wait. Empty without a holder,
    /// or if the user was never told to wait.
    pub fn holder(&self) -> &str {
        &self.holder
    }

    /// Returns whether nothing is requested or held, and the server knows this.
    pub const fn is_idle(&self) -> bool {
        self.inputs.is_empty() && self.client.is_idle()
    }

    /// Returns why the lock was lost or refused since it was last requested.
    pub const fn lost(&self) -> Option<Denied> {
        self.lost
    }
}
