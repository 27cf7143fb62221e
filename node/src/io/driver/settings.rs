//! Applies the keys of the robot in the database to the running node and to its programs.

use super::Driver;
use crate::logic::agent::Input;
use crate::logic::database::settings::{Settings, changes};
use crate::logic::protocol::Deployment;
use comms::io::control::ControlSender;
use comms::logic::control::Order;

impl Driver {
    /// Tells each program whose parameters have changed.
    pub(super) fn configure(&mut self, settings: Settings) {
        for (process, program) in self.state.attachments.programs() {
            let (deployment, path) = (&process.deployment, &program.order.path);
            let parameters = self.parameters(&settings, deployment, path);
            let changed = changes(&self.parameters(&self.settings, deployment, path), &parameters);
            if let Some((_, sender)) = self.running.programs.get(process).filter(|_| !changed.is_empty()) {
                send(sender, &Order::Configure { parameters });
                self.queues.pending.push_back(Input::Configured { process: process.clone(), parameters: changed });
            }
        }
        let before = std::mem::replace(&mut self.settings, settings);
        let Settings { log, unfit, .. } = &self.settings;
        if let Some(process) = self.config.log.as_ref().filter(|_| *log != before.log)
            && let Err(error) = process.filter(log.as_deref())
        {
            tracing::warn!(error = format!("{error:#}"), "the setting `log` does nothing");
        }
        unfit.iter().filter(|one| !before.unfit.contains(one)).for_each(|sentence| tracing::warn!("{sentence}"));
    }

    /// Returns the parameters of an instance in the settings, in the form for its program.
    pub(super) fn parameters(&self, settings: &Settings, deployment: &Deployment, path: &str) -> Vec<(String, String)> {
        self.state.agent.in_si(deployment, path, settings.parameters(&deployment.name, path))
    }
}

/// Tells a program something that it can do without.
pub(super) fn send(sender: &ControlSender, order: &Order) {
    if let Err(error) = sender.send(order) {
        tracing::debug!(%error, "cannot send a program its parameters");
    }
}
