//! The programs of a node: starting them, giving their addresses, and removing them.

use super::{Driver, settings};
use crate::io::child;
use crate::io::event::Event;
use crate::io::folder::{self, StartFolder};
use crate::io::policy::ExecutionPolicy;
use crate::io::run_dir;
use crate::io::starter::{self, Job, Start};
use crate::logic::agent::{Input, OVER_MAX};
use crate::logic::effect::{ProcessId, SpawnOrder};
use crate::logic::instance::watchdog::watched;
use crate::logic::protocol::Deployment;
use comms::io::control::ControlSender;
use comms::io::{core_dump, descriptors};
use comms::logic::codec::WIRE_VERSION;
use comms::logic::control::{Location, Notice, Order};
use language::plan::LeafKind;
use shim::protocol::{Gate, Sandbox, ShimReport, ShimStart, SoftLimits};
use std::path::PathBuf;
use tokio::sync::mpsc;

/// Returns why a program cannot be started. Blocks.
fn examine(order: &SpawnOrder, folder: &StartFolder, policy: &ExecutionPolicy) -> anyhow::Result<()> {
    let directory = folder.of(order.environment.directory.as_deref()).map_err(anyhow::Error::msg)?;
    folder::check_directory(&directory).map_err(anyhow::Error::msg)?;
    policy.admit(order).map(drop)
}

impl Driver {
    /// Looks at executables in a task: a folder of another machine may not answer.
    pub(super) fn find_programs(&mut self, deployment: Deployment, number: u32, programs: Vec<SpawnOrder>) {
        let (events, policy, folder) =
            (self.queues.events.clone(), self.gate.policy.clone(), self.running.start_folder.clone());
        self.queues.tasks.spawn(async move {
            let problem = move |order: SpawnOrder| {
                let problem = examine(&order, &folder, &policy).err()?;
                Some(format!("`{}` cannot be started: {problem:#}", order.path))
            };
            let looking = tokio::task::spawn_blocking(move || programs.into_iter().filter_map(problem).collect()).await;
            let problems = looking.unwrap_or_else(|error| vec![error.to_string()]);
            events.send(Event::Found(deployment, number, problems)).await.unwrap_or_default();
        });
    }

    /// Starts a program in parallel to the loop; orders for it wait in the meantime.
    pub(super) fn spawn(&mut self, order: SpawnOrder) {
        let process = order.process.clone();
        // Later notices of the previous program do not belong to this one.
        self.running.programs.remove(&process);
        self.running.returning.is_gone(&process);
        let start = self.start(order);
        if self.queues.jobs.try_send(Job::Start(Box::new(start))).is_err() {
            let reason = "too many programs wait to be started".to_owned();
            for report in [ShimReport::ExecFailed { reason }, ShimReport::Gone] {
                self.queues.pending.push_back(Input::Shim { process: process.clone(), report, output: Vec::new() });
            }
        }
    }

    /// Determines how a program is started, and opens the channel for its orders.
    pub(super) fn start(&mut self, order: SpawnOrder) -> Start {
        let (sender, orders) = mpsc::channel(starter::ORDERS_MAX);
        let process = order.process.clone();
        self.running.shims.insert(process.clone(), sender);
        self.running.living.entry(process.deployment.clone()).or_default();
        let is_controller = order.kind == LeafKind::Controller;
        let control = self.control_socket(order.kind, &process.deployment);
        let dir = self.dir.process(&process);
        let grace = self.settings.agent_loss_grace.or(self.config.programs.agent_loss_grace);
        let folder = self.running.start_folder.of(order.environment.directory.as_deref());
        let shim = ShimStart {
            working_directory: folder.clone().unwrap_or_default(),
            gate: if is_controller { Gate::None } else { Gate::Exec },
            agent_loss_grace: order.policy.agent_loss.or(grace),
            watchdog: watched(order.kind, &order.policy),
            limits: child::limits(&order.policy.usage),
            sandbox: Sandbox::default(),
            groups: Vec::new(),
            before: SoftLimits { descriptors: descriptors::before(), core: core_dump::before() },
            environment: self.environment(&order, &dir, control.as_deref()),
            secrets: order.secrets.iter().map(|secret| secret.word).collect(),
            command: order.command.clone(),
            dir,
        };
        let node = self.dir.path().to_owned();
        Start { process, order, shim, obstacle: folder.err(), control, node, orders }
    }

    /// Takes a notice of a program. When the program gives its identity, the node vouches for it before its address is
    /// given out.
    pub(super) fn said(&self, process: ProcessId, notice: Notice) -> Input {
        if let Notice::Hello { location: Some(Location { keys, .. }), .. } = &notice
            && let Some((order, (_, sender))) = self.vouch(&process, keys).zip(self.running.programs.get(&process))
            && let Err(error) = sender.send(&order)
        {
            tracing::debug!(%error, "cannot send a program the signature of its node");
        }
        Input::Control { process, notice }
    }

    /// Returns the order that shows programs of other hosts that this node has started this one, in a team.
    fn vouch(&self, process: &ProcessId, keys: &[u8]) -> Option<Order> {
        let path = &self.state.attachments.program(process)?.order.path;
        let delegation =
            self.config.network.member.as_ref()?.vouch_for(keys, &format!("`{path}` of `{}`", process.deployment))?;
        Some(Order::Vouch { delegation })
    }

    /// Returns where a program of this kind talks to its node, if it does.
    fn control_socket(&self, kind: LeafKind, deployment: &Deployment) -> Option<PathBuf> {
        (kind == LeafKind::Controller).then(|| self.dir.control_socket(deployment))
    }

    /// Tells a program that has connected the values of its parameters in the database.
    pub(super) fn tell_parameters(&self, sender: &ControlSender, process: &ProcessId) {
        let Some(program) = self.state.attachments.program(process) else { return };
        let parameters = self.parameters(&self.settings, &process.deployment, &program.order.path);
        if !parameters.is_empty() {
            settings::send(sender, &Order::Configure { parameters });
        }
    }

    /// Tells a program that is back how many of its notices are here, and every order after the first `taken`.
    ///
    /// # Errors
    /// The program has another version, has missed more orders than are kept, or does not accept its orders. The text is for a person.
    pub(super) fn resume(
        &self,
        process: &ProcessId,
        sender: &ControlSender,
        version: u16,
        taken: u64,
    ) -> Result<(), String> {
        if version != WIRE_VERSION {
            return Err(format!(
                "it speaks version {version} of the control protocol, this node version {WIRE_VERSION}"
            ));
        }
        let program = self.state.attachments.program(process).ok_or("it is not known any more")?;
        let missed = program.orders(taken).ok_or("it has missed too many orders")?;
        let notices = program.notices;
        tracing::debug!(?process, taken, notices, missed = missed.len(), "a program is back");
        let vouched = self.vouch(process, &program.keys);
        for order in std::iter::once(Order::Resumed { notices }).chain(vouched).chain(missed) {
            sender.send(&order).map_err(|error| error.to_string())?;
        }
        Ok(())
    }

    /// Closes the files and sockets of a deployment; the output of the last few stays in their folders.
    pub(super) fn bury(&mut self, deployment: &Deployment) {
        self.close_sockets(deployment);
        self.running.living.remove(deployment);
        self.running.programs.retain(|process, _| process.deployment != *deployment);
        self.running.losses.forget(|process| process.deployment == *deployment);
        if let Some(oldest) = self.state.attachments.take_buried(OVER_MAX) {
            let folder = self.dir.deployment(&oldest);
            self.later(Job::Remove(run_dir::other(self.dir.path(), &folder)));
            self.later(Job::Remove(folder));
        }
    }

    /// Removes a program; with the last one of a deployment, also the socket for its reports.
    pub(super) fn forget(&mut self, process: &ProcessId) {
        self.running.losses.forget(|other| other == process);
        self.running.programs.remove(process);
        if !self.state.attachments.has_programs(&process.deployment) {
            self.close_sockets(&process.deployment);
        }
    }

    fn close_sockets(&self, deployment: &Deployment) {
        let (folder, node) = (self.dir.deployment(deployment), self.dir.path().to_owned());
        self.later(Job::Close { deployment: deployment.clone(), folder, node });
    }
}
