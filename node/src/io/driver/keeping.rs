//! Writes the state that the next node needs.

use super::Driver;
use crate::io::child::leftovers;
use crate::io::event::Event;
use crate::io::journal;
use crate::io::kept::KeptFiles;
use crate::logic::protocol::{Deployment, Estop};
use comms::io::clock;
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::oneshot;

/// How often this node looks for ended children that no task waits for.
const REAP_EVERY: Duration = Duration::from_secs(10);

/// Collects orphans that have ended, for ever: the kernel keeps each ended process until it is collected.
pub(super) async fn reap_orphans() {
    let mut seen = BTreeSet::new();
    loop {
        clock::sleep_until(clock::now() + REAP_EVERY).await;
        seen = tokio::task::spawn_blocking(move || leftovers::reap_orphans(&seen)).await.unwrap_or_default();
    }
}

impl Driver {
    /// Writes an epoch in parallel to the loop: a disk may take long.
    pub(super) fn commit(&mut self, deployment: Deployment, hosts: Vec<String>) {
        let (journal, events) = (Arc::clone(&self.files.journal), self.queues.events.clone());
        self.queues.tasks.spawn(async move {
            let epoch = deployment.clone();
            let writing = tokio::task::spawn_blocking(move || journal::commit(&journal, &epoch, &hosts)).await;
            let written = writing.map_err(|error| error.to_string()).flatten();
            events.send(Event::Committed(deployment, written)).await.unwrap_or_default();
        });
    }

    /// Writes whether everything is stopped, in parallel to the loop. A node that leaves waits for the disk.
    pub(super) fn keep_estop(&mut self, number: u64, estop: Option<Estop>) {
        self.files.estop.want(estop);
        let (file, events) = (self.files.estop.clone(), self.queues.events.clone());
        let (tell, told) = oneshot::channel();
        self.files.settling.spawn_blocking(move || drop(tell.send(file.write())));
        self.queues.tasks.spawn(async move {
            if let Ok(written) = told.await {
                events.send(Event::EstopKept(number, written)).await.unwrap_or_default();
            }
        });
    }

    /// Removes the files of a deployment in parallel to the loop, and tells the agent. A node that leaves waits for the disk.
    pub(super) fn unkeep(&mut self, deployment: Deployment) {
        self.files.kept.unkeep(&deployment);
        let (files, events) = (self.files.kept.clone(), self.queues.events.clone());
        let (tell, told) = oneshot::channel();
        self.files.settling.spawn_blocking(move || drop(tell.send(files.write())));
        self.queues.tasks.spawn(async move {
            if let Ok(written) = told.await {
                events.send(Event::Unkept(deployment, written)).await.unwrap_or_default();
            }
        });
    }

    /// Notes the state that is to survive a reboot, and writes it in parallel to the loop. A node that leaves waits for the
    /// disk.
    pub(super) fn keep(&mut self, want: impl FnOnce(&KeptFiles)) {
        want(&self.files.kept);
        let files = self.files.kept.clone();
        self.files.settling.spawn_blocking(move || drop(files.write()));
    }
}
