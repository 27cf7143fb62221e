//! A data session of the command line that receives the outputs of running programs.

use crate::io::observer;
use crate::io::value_queue::SharedQueue;
use comms::io::clock;
use comms::io::data::{CallWay, DataSession, Subscription};
use comms::logic::bytes::Bytes;
use comms::logic::codec::Enveloped;
use comms::logic::control::Dial;
use comms::logic::object::{CallId, Exported, Exports, ObjectCall, ObjectError};
use comms::logic::tap::{Outputs, Tapped};
use comms::logic::{codec, key};
use node::console::Failure;
use std::borrow::Cow;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

/// How long a program may take to be linked, which takes four round trips of up to 3 s each.
const DIAL_WITHIN: Duration = Duration::from_secs(18);
const ANSWER_WITHIN: Duration = Duration::from_secs(4);
/// The pause before a program is asked again, if its server was not known yet.
const ASK_AGAIN: Duration = Duration::from_millis(50);

/// The session, and the values it receives.
pub(crate) struct Taps {
    session: Arc<DataSession>,
    /// The way in which the session makes calls.
    way: CallWay,
    subscriptions: Vec<Subscription>,
    /// The number of calls that were made.
    called: AtomicU64,
    /// How long a link may take, and how long each answer may take. The answer to a call has its own limit.
    within: (Duration, Duration),
}

impl Taps {
    /// Opens the session, which has no links yet. In a team, `team` is the file with the credentials that the node of
    /// this machine gives its programs.
    pub(crate) async fn open(team: Option<PathBuf>) -> Result<Self, Failure> {
        // Zenoh's calls block the thread.
        let opened =
            tokio::task::spawn_blocking(move || observer::open(team.as_deref())).await.map_err(anyhow::Error::from)?;
        let (session, way) = opened?;
        Ok(Self {
            session: Arc::new(session),
            way,
            subscriptions: Vec::new(),
            called: AtomicU64::new(0),
            within: (DIAL_WITHIN, ANSWER_WITHIN),
        })
    }

    /// Sets how long a link may take, and each answer.
    #[must_use]
    pub(crate) fn within(mut self, limit: Duration) -> Self {
        self.within = (limit, limit);
        self
    }

    /// Returns how long a link may take.
    pub(crate) fn patience(&self) -> Duration {
        self.within.0
    }

    /// Links to a program, and keeps the link.
    pub(crate) async fn dial(&self, dial: Dial) -> Result<(), Failure> {
        let (session, (within, _)) = (Arc::clone(&self.session), self.within);
        let dialled = tokio::task::spawn_blocking(move || session.dial(&dial, within)).await;
        dialled.map_err(anyhow::Error::from)?.map_err(|error| Failure::Unreachable(error.into()))
    }

    /// Stops dialling a program.
    pub(crate) fn forget(&self, session: &str) {
        self.session.forget(session);
    }

    /// Asks a program for its outputs; returns nothing if the program does not list them.
    pub(crate) async fn outputs(&self, robot: &str, path: &str) -> Result<Option<Outputs>, Failure> {
        self.described(key::outputs(robot, path)).await
    }

    /// Asks a program for its exports; returns nothing if the program does not list them.
    pub(crate) async fn exports(&self, robot: &str, path: &str) -> Result<Option<Exports>, Failure> {
        self.described(key::exports(robot, path)).await
    }

    /// Asks a program for information that every program gives. If the link is new, the session may not know the
    /// program's server yet, so it asks again.
    async fn described<T: Enveloped>(&self, key: String) -> Result<Option<T>, Failure> {
        let (_, within) = self.within;
        let until = clock::now() + within;
        loop {
            let (session, key) = (Arc::clone(&self.session), key.clone());
            let answer = tokio::task::spawn_blocking(move || session.fetch(&key, within)).await;
            let answer = answer.map_err(anyhow::Error::from)?.map_err(|error| Failure::Unreachable(error.into()))?;
            if answer.is_some() || clock::now() >= until {
                return Ok(answer.map(|bytes| codec::decode(&bytes)).transpose().map_err(anyhow::Error::from)?);
            }
            clock::sleep_until(clock::now() + ASK_AGAIN).await;
        }
    }

    /// Receives a key from now on, until the subscription is dropped. Dropping it may block.
    pub(crate) async fn listen(
        &self,
        key: String,
        take: impl FnMut(Cow<'_, [u8]>) + Send + Sync + 'static,
    ) -> Result<Subscription, Failure> {
        let session = Arc::clone(&self.session);
        let heard = tokio::task::spawn_blocking(move || session.on_sample(&key, take)).await;
        Ok(heard.map_err(anyhow::Error::from)?.map_err(anyhow::Error::from)?)
    }

    /// Receives an output from now on, even if its program is restarted elsewhere. Each value goes to `values` with
    /// `number`. When `values` is full, it drops the oldest values, and the numbers of the values show the gap.
    pub(crate) async fn hear(
        &mut self,
        robot: &str,
        path: &str,
        output: &str,
        number: usize,
        values: Arc<SharedQueue<usize, Tapped>>,
    ) -> Result<(), Failure> {
        let take = move |bytes: Cow<'_, [u8]>| {
            if let Ok(tapped) = codec::decode(&bytes) {
                values.push(&number, bytes.len(), tapped);
            }
        };
        let heard = self.listen(key::tap(robot, path, output), take).await?;
        self.subscriptions.push(heard);
        Ok(())
    }

    /// Prepares a call of a procedure or state. The call is not signed yet.
    pub(crate) fn prepare(&self, exported: &Exported, argument: Vec<u8>, within: Duration) -> ObjectCall {
        let number = self.called.fetch_add(1, Ordering::Relaxed);
        ObjectCall {
            id: CallId { session: self.session.id(), number },
            caller: "dca".to_owned(),
            name: exported.name.clone(),
            signature: exported.signature.clone(),
            within,
            argument: Bytes(argument),
            warrant: None,
        }
    }

    /// Calls a program, and waits for the result.
    pub(crate) async fn call(
        &self,
        robot: &str,
        path: &str,
        call: ObjectCall,
    ) -> Result<Result<Vec<u8>, ObjectError>, Failure> {
        let (session, keys) = (Arc::clone(&self.session), key::object(robot, path));
        let way = self.way.clone();
        let calling = tokio::task::spawn_blocking(move || session.call_and_wait(&keys, &way, &call));
        let calling = calling.await;
        Ok(calling.map_err(anyhow::Error::from)?)
    }

    /// Closes the session.
    pub(crate) async fn close(self) {
        let Self { session, subscriptions, .. } = self;
        let closing = tokio::task::spawn_blocking(move || {
            drop(subscriptions);
            Arc::into_inner(session).into_iter().for_each(DataSession::close);
        });
        if let Err(error) = closing.await {
            tracing::debug!(%error, "closing the taps");
        }
    }
}
