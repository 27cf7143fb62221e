//! One client: its subscriptions, and the messages that wait for it.

use super::outbox::Outbox;
use super::protocol::Subscription;
use comms::logic::time::Time;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::time::Duration;

/// The most subscriptions of a client. Foxglove has one for each topic that a panel shows.
pub(super) const SUBSCRIPTIONS_MAX: usize = 1024;
/// The most parameters that a client follows by name.
const FOLLOWED_MAX: usize = 4096;
/// The most orders of a client that are carried out at once.
pub(super) const ORDERS_MAX: usize = 16;

/// A moment on the clock of this machine, which never goes back, and since 1970.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Arrival {
    pub(crate) time: Time,
    pub(crate) since_1970: Duration,
}

/// The subscription of a channel.
#[derive(Debug)]
struct Subscribed {
    id: u32,
    /// Earlier values are not for it.
    since: Time,
    /// Whether it has had a value. Values that were lost before are not its loss.
    has_begun: bool,
}

/// A value for a client.
#[derive(Clone, Copy, Debug)]
pub(super) struct NewValue<'a> {
    pub(super) channel: u32,
    pub(super) topic: &'a Arc<str>,
    /// When it arrived; without it, it was never stored.
    pub(super) arrived: Option<Time>,
    /// How many earlier values have not arrived here.
    pub(super) lost: u64,
}

/// A client.
#[derive(Debug, Default)]
pub(super) struct Viewer {
    pub(super) outbox: Outbox,
    /// The channel of each subscription, and the subscription of each channel.
    channels: BTreeMap<u32, u32>,
    subscriptions: BTreeMap<u32, Subscribed>,
    follows_all: bool,
    followed: BTreeSet<String>,
    /// How many orders are being carried out.
    pub(super) orders: usize,
}

impl Viewer {
    /// Adds a subscription of values from now on.
    ///
    /// # Errors
    /// Why it cannot be added.
    pub(super) fn subscribe(&mut self, Subscription { id, channel }: Subscription, now: Time) -> Result<(), String> {
        if self.channels.len() >= SUBSCRIPTIONS_MAX {
            return Err(format!("a client may have {SUBSCRIPTIONS_MAX} subscriptions"));
        }
        if self.channels.contains_key(&id) {
            return Err(format!("the subscription {id} already exists"));
        }
        if self.subscriptions.contains_key(&channel) {
            return Err(format!("the channel {channel} already has a subscription"));
        }
        self.channels.insert(id, channel);
        self.subscriptions.insert(channel, Subscribed { id, since: now, has_begun: false });
        Ok(())
    }

    /// Removes the subscription with this number.
    pub(super) fn unsubscribe(&mut self, id: u32) {
        if let Some(channel) = self.channels.remove(&id) {
            self.subscriptions.remove(&channel);
            self.outbox.forget(id);
        }
    }

    /// Removes the subscription of a channel that does not exist any more.
    pub(super) fn forget(&mut self, channel: u32) {
        if let Some(id) = self.subscriptions.get(&channel).map(|one| one.id) {
            self.unsubscribe(id);
        }
    }

    /// Returns whether the client wants a value of a channel that arrived at this time.
    pub(super) fn wants(&self, channel: u32, arrived: Time) -> bool {
        self.subscriptions.get(&channel).is_some_and(|one| one.since <= arrived)
    }

    /// Adds a value of a channel, if it wants that. `frame` makes the message for a subscription.
    pub(super) fn put(&mut self, value: NewValue<'_>, frame: impl FnOnce(u32) -> Vec<u8>) {
        let NewValue { channel, topic, arrived, lost } = value;
        let Some(one) = self.subscriptions.get_mut(&channel) else { return };
        if arrived.is_some_and(|arrived| arrived < one.since) {
            return;
        }
        if std::mem::replace(&mut one.has_begun, true) && lost > 0 {
            self.outbox.lose(topic, lost);
        }
        self.outbox.value(topic, one.id, frame(one.id));
    }

    /// Returns the channels that it has subscribed to.
    pub(super) fn wanted(&self) -> impl Iterator<Item = u32> {
        self.subscriptions.keys().copied()
    }

    /// Subscribes to the named parameters, or to all parameters if no name is given.
    pub(super) fn follow(&mut self, names: Vec<String>) {
        self.follows_all |= names.is_empty();
        for name in names {
            if self.followed.len() < FOLLOWED_MAX {
                self.followed.insert(name);
            }
        }
    }

    /// Unsubscribes from the named parameters, or from all parameters if no name is given.
    pub(super) fn unfollow(&mut self, names: &[String]) {
        if names.is_empty() {
            self.follows_all = false;
            self.followed.clear();
        }
        for name in names {
            self.followed.remove(name);
        }
    }

    /// Returns whether it follows any parameter.
    pub(super) fn is_follower(&self) -> bool {
        self.follows_all || !self.followed.is_empty()
    }

    /// Returns whether it follows this parameter.
    pub(super) fn follows(&self, name: &str) -> bool {
        self.follows_all || self.followed.contains(name)
    }
}
