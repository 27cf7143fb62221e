//! Starts programs, closes deployments and removes their files. It does one job after the other, in
//! parallel to the loop of the node, because a file system may be slow.

mod others;

use crate::io::child::leftovers;
use crate::io::child::reach::{Reached, reach};
use crate::io::child::{self, ShimOrders, ShimReports};
use crate::io::event::{Event, hear_programs};
use crate::io::folder;
use crate::io::policy::{Admitted, ExecutionPolicy};
use crate::io::program_database::ProgramDatabase;
use crate::io::run_dir;
use crate::io::secrets::Secrets;
use crate::logic::attachments::Attachment;
use crate::logic::effect::{ProcessId, SpawnOrder};
use crate::logic::protocol::Deployment;
use anyhow::Context;
use comms::io::control::Listener;
use rustix::io::Errno;
use shim::protocol::{ShimOrder, ShimReport, ShimStart};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicU64;
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::task::{AbortHandle, JoinSet};

/// The most jobs that wait: every program of a few large plans.
pub(crate) const JOBS_MAX: usize = 32_768;
/// The most orders that wait for one shim.
pub(crate) const ORDERS_MAX: usize = 64;

/// A job that is done in parallel to the loop.
#[derive(Debug)]
pub(crate) enum Job {
    Start(Box<Start>),
    /// A program of a killed node that has to be reached again.
    Adopt(Box<Adopted>),
    /// No further program of this deployment will connect. `folder` is the folder of the deployment, and `node` is the
    /// folder of the node.
    Close {
        deployment: Deployment,
        folder: PathBuf,
        node: PathBuf,
    },
    /// The output of the deployment in this folder is no longer needed.
    Remove(PathBuf),
    /// The shim of the program in this folder has not ended the program in time.
    Kill(PathBuf),
}

/// A program to be started.
#[derive(Debug)]
pub(crate) struct Start {
    pub(crate) process: ProcessId,
    /// The order of the agent.
    pub(crate) order: SpawnOrder,
    pub(crate) shim: ShimStart,
    /// The reason why the program cannot be started, if there is one.
    pub(crate) obstacle: Option<String>,
    /// The socket to which the program connects, if it connects at all.
    pub(crate) control: Option<PathBuf>,
    /// The folder of the node.
    pub(crate) node: PathBuf,
    /// The first orders of its shim.
    pub(crate) orders: Receiver<ShimOrder>,
}

/// A program of a killed node that has to be reached again.
#[derive(Debug)]
pub(crate) struct Adopted {
    /// How to start the program if it was never started.
    pub(crate) start: Start,
    /// The known state of the program.
    pub(crate) program: Attachment,
}

/// Does the jobs.
#[derive(Debug)]
pub(crate) struct Starter {
    shim: PathBuf,
    policy: ExecutionPolicy,
    secrets: Arc<Secrets>,
    database: ProgramDatabase,
    events: Sender<Event>,
    /// The number of programs that have connected.
    connected: Arc<AtomicU64>,
    /// The tasks that accept programs, by deployment and socket: programs that run as another user have a separate socket.
    listeners: BTreeMap<(Deployment, PathBuf), AbortHandle>,
    tasks: JoinSet<()>,
    /// Programs of a killed node that are being reached now.
    attaching: JoinSet<(Adopted, Reached)>,
}

impl Starter {
    pub(crate) fn new(
        shim: PathBuf,
        policy: ExecutionPolicy,
        secrets: Arc<Secrets>,
        database: ProgramDatabase,
        events: Sender<Event>,
    ) -> Self {
        Self {
            shim,
            policy,
            secrets,
            database,
            events,
            connected: Arc::default(),
            listeners: BTreeMap::new(),
            tasks: JoinSet::new(),
            attaching: JoinSet::new(),
        }
    }

    /// Does jobs until there are no more.
    ///
    /// # Cancellation
    /// No more messages arrive from the programs that it has started.
    pub(crate) async fn run(mut self, mut jobs: Receiver<Job>) {
        loop {
            while self.tasks.try_join_next().is_some() {}
            let job = tokio::select! {
                job = jobs.recv() => job,
                Some(Ok((adopted, reached))) = self.attaching.join_next() => {
                    self.reached(adopted, reached).await;
                    continue;
                }
            };
            let Some(job) = job else { return };
            match job {
                Job::Start(start) => self.start(*start).await,
                Job::Adopt(adopted) => self.adopt(*adopted),
                Job::Close { deployment, folder, node } => {
                    self.database.forget(&deployment);
                    let ended = self.listeners.extract_if(.., |(of, _), _| *of == deployment);
                    ended.for_each(|(_, listener)| listener.abort());
                    // This task waits for it, so that no program is started in the folder at the same time.
                    let removing = tokio::task::spawn_blocking(move || run_dir::remove_sockets(&node, &folder));
                    if let Err(error) = removing.await {
                        tracing::error!(%error, "the sockets of a deployment cannot be removed");
                    }
                }
                // This task waits for it, so that no program is started in the folder at the same time.
                Job::Kill(dir) => {
                    if let Err(error) = tokio::task::spawn_blocking(move || leftovers::kill_shim(&dir)).await {
                        tracing::error!(%error, "a shim cannot be killed");
                    }
                }
                Job::Remove(folder) => {
                    if let Err(error) = tokio::fs::remove_dir_all(&folder).await {
                        tracing::debug!(%error, "the folder of an old deployment stays");
                    }
                }
            }
        }
    }

    /// Begins to reach a program again.
    fn adopt(&mut self, adopted: Adopted) {
        let Start { process, order, shim, control, node, .. } = &adopted.start;
        self.database.connect(order);
        // The program keeps the socket to the node that it got at its start.
        let user = run_dir::user_of(node, &shim.dir);
        let control = control.as_ref().map(|path| user.map_or_else(|| path.clone(), |_| run_dir::other(node, path)));
        let at = (process.deployment.clone(), control.unwrap_or_default());
        if adopted.start.control.is_some() && !self.listeners.contains_key(&at) {
            match others::listener(&at.1, user) {
                Ok(listener) => self.listen(listener, at),
                Err(error) => tracing::error!(%error, "the programs of a killed node cannot come back"),
            }
        }
        let (dir, reports) = (shim.dir.clone(), adopted.program.reports);
        self.attaching.spawn_blocking(move || (adopted, reach(&dir, reports)));
    }

    /// Continues with a program that was reached again, starts a program that never ran, or reports the end of a program.
    async fn reached(&mut self, adopted: Adopted, reached: Reached) {
        let Adopted { start, program } = adopted;
        let process = start.process.clone();
        match reached {
            Reached::Running(attached) => {
                let missed = program.shim_orders(attached.taken);
                self.tasks.spawn(attached.orders.pass(missed, start.orders));
                self.tasks.spawn(hear(process, attached.reports, Some(attached.missed), self.events.clone()));
                return;
            }
            Reached::Never => self.start(start).await,
            Reached::Ended(end) => {
                let end = end.filter(|_| !program.has_ended);
                for (report, output) in end.into_iter().chain([(ShimReport::Gone, Vec::new())]) {
                    self.events.send(Event::Shim(process.clone(), report, output)).await.unwrap_or_default();
                }
            }
        }
        self.events.send(Event::Reached(process)).await.unwrap_or_default();
    }

    fn listen(&mut self, listener: Listener, at: (Deployment, PathBuf)) {
        let (connected, events) = (Arc::clone(&self.connected), self.events.clone());
        let hearing = hear_programs(listener, at.0.clone(), connected, self.database.clone(), events);
        self.listeners.insert(at, self.tasks.spawn(hearing));
    }

    async fn start(&mut self, start: Start) {
        let Start { process, order, shim, obstacle, control, node, orders } = start;
        self.database.connect(&order);
        let started = match obstacle {
            Some(why) => Err(anyhow::Error::msg(why)),
            None => self.try_start(order, shim, control, node).await,
        };
        match started {
            Ok((shim, reports)) => {
                self.tasks.spawn(shim.pass(Vec::new(), orders));
                self.tasks.spawn(hear(process, reports, None, self.events.clone()));
            }
            Err(error) => {
                let reason = format!("{error:#}");
                for report in [ShimReport::ExecFailed { reason }, ShimReport::Gone] {
                    self.events.send(Event::Shim(process.clone(), report, Vec::new())).await.unwrap_or_default();
                }
            }
        }
    }

    /// Starts the shim of a program, if the policy of this host allows the program. The policy is checked before secrets are opened.
    async fn try_start(
        &mut self,
        order: SpawnOrder,
        mut start: ShimStart,
        control: Option<PathBuf>,
        node: PathBuf,
    ) -> anyhow::Result<(ShimOrders, ShimReports)> {
        let keys: Vec<String> = order.secrets.iter().map(|secret| secret.key.clone()).collect();
        let deployment = order.process.deployment.clone();
        let policy = self.policy.clone();
        let admitting = tokio::task::spawn_blocking(move || {
            folder::check_directory(&start.working_directory).map_err(anyhow::Error::msg)?;
            let Admitted { limits, sandbox, environment } = policy.admit(&order)?;
            (start.limits, start.sandbox) = (limits, sandbox);
            start.environment.retain(|(name, _)| environment.iter().all(|(other, _)| other != name));
            start.environment.extend(environment);
            run_dir::make_process(&start.dir).context("making its folder")?;
            let control = others::move_to_user(&mut start, control, &node, policy.member())?;
            anyhow::Ok((start, control))
        });
        let (start, control) = admitting.await??;
        let secrets = self.secrets.open(&keys).await?;
        let at = control.map(|path| (deployment, path)).filter(|at| !self.listeners.contains_key(at));
        let shim = self.shim.clone();
        let starting = tokio::task::spawn_blocking(move || {
            let user = start.sandbox.user.as_ref().map(|user| (user.uid, user.gid));
            let listener = at.map(|at| anyhow::Ok((others::listener(&at.1, user)?, at))).transpose();
            let listener = listener.context("opening its control socket")?;
            let started = child::start(&shim, &start).map_err(|error| not_started(error, &shim))?;
            anyhow::Ok((listener, started))
        });
        let (listener, (shim, reports)) = starting.await??;
        if let Some((listener, at)) = listener {
            self.listen(listener, at);
        }
        Ok((shim.with(secrets), reports))
    }
}

/// Returns why a program was not started. Its shim gets the arguments and the environment of the program, so these may be too long.
fn not_started(error: io::Error, shim: &Path) -> anyhow::Error {
    let is_too_long = error.raw_os_error() == Some(Errno::TOOBIG.raw_os_error());
    let error = anyhow::Error::from(error);
    if is_too_long {
        return error.context("its arguments and environment are longer than the system takes (an argument: 128 kB)");
    }
    error.context(format!("starting {}", shim.display()))
}

/// Passes on the reports of a shim until the shim is gone. If this node has attached to the shim, the shim counts as
/// reached after the `missed` reports.
async fn hear(process: ProcessId, reports: ShimReports, mut missed: Option<usize>, events: Sender<Event>) {
    let (sink, mut arriving) = mpsc::channel(16);
    let forwarding = async {
        loop {
            if missed.take_if(|missed| *missed == 0).is_some() {
                events.send(Event::Reached(process.clone())).await.unwrap_or_default();
            }
            let Some((report, output)) = arriving.recv().await else { break };
            events.send(Event::Shim(process.clone(), report, output)).await.unwrap_or_default();
            missed = missed.map(|missed| missed - 1);
        }
    };
    tokio::join!(reports.listen(sink), forwarding);
}
