//! One client: its subscriptions, and the messages that wait for it.

use super::outbox::Outbox;
use super::protocol::Subscription;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The most subscriptions of a client. Foxglove has one for each topic that a panel shows.
pub(super) const SUBSCRIPTIONS_MAX: usize = 1024;
/// The most parameters that a client follows by name.
const FOLLOWED_MAX: usize = 4096;
/// The most orders of a client that are carried out at once.
pub(super) const ORDERS_MAX: usize = 16;

/// A client.
#[derive(Debug, Default)]
pub(super) struct Viewer {
    pub(super) outbox: Outbox,
    /// The channel of each subscription, and the subscription of each channel.
    channels: BTreeMap<u32, u32>,
    subscriptions: BTreeMap<u32, u32>,
    follows_all: bool,
    followed: BTreeSet<String>,
    /// How many orders are being carried out.
    pub(super) orders: usize,
}

impl Viewer {
    /// Adds a subscription.
    ///
    /// # Errors
    /// Why it cannot be added.
    pub(super) fn subscribe(&mut self, Subscription { id, channel }: Subscription) -> Result<(), String> {
        if self.channels.len() >= SUBSCRIPTIONS_MAX {
            return Err(format!("a client may have {SUBSCRIPTIONS_MAX} subscriptions"));
        }
        if self.channels.contains_key(&id) {
            return Err(format!("the subscription {id} is there already"));
        }
        if self.subscriptions.contains_key(&channel) {
            return Err(format!("there is a subscription of the channel {channel} already"));
        }
        self.channels.insert(id, channel);
        self.subscriptions.insert(channel, id);
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
        if let Some(id) = self.subscriptions.get(&channel).copied() {
            self.unsubscribe(id);
        }
    }

    /// Returns the subscription of a channel.
    pub(super) fn subscription(&self, channel: u32) -> Option<u32> {
        self.subscriptions.get(&channel).copied()
    }

    /// Returns the channels that it has subscribed to.
    pub(super) fn wanted(&self) -> impl Iterator<Item = u32> {
        self.subscriptions.keys().copied()
    }

    /// Counts values of a channel that were lost on the way here.
    pub(super) fn lose(&mut self, channel: u32, topic: &Arc<str>, count: u64) {
        if self.subscriptions.contains_key(&channel) {
            self.outbox.lose(topic, count);
        }
    }

    /// Begins to follow parameters: all, if none is named.
    pub(super) fn follow(&mut self, names: Vec<String>) {
        self.follows_all |= names.is_empty();
        for name in names {
            if self.followed.len() < FOLLOWED_MAX {
                self.followed.insert(name);
            }
        }
    }

    /// Ends to follow parameters: all, if none is named.
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
