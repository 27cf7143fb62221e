//! A running node: one `select!` that turns every event into an input of the agent and carries its effects out, in order.

mod adoption;
mod environment;
mod gate;
mod inputs;
mod keeping;
mod launching;
mod losses;
mod output;
mod returning;
mod settings;
mod start;

use crate::io::caller::Caller;
use crate::io::cgroup;
use crate::io::database;
use crate::io::estop::EstopFile;
use crate::io::event::{Connection, Event};
use crate::io::folder::StartFolder;
use crate::io::guard::Guard;
use crate::io::input_log::InputLog;
use crate::io::journal::{self, Journal};
use crate::io::kept::KeptFiles;
use crate::io::kernel;
use crate::io::logging::{self, Log};
use crate::io::peers::{Arrival, Life, Peers};
use crate::io::policy::ExecutionPolicy;
use crate::io::run_dir::RunDir;
use crate::io::service_manager::ServiceManager;
use crate::io::starter::{self, Job};
use crate::io::{ready, tail};
use crate::logic::agent::{Identity, Input};
use crate::logic::database::settings::Settings;
use crate::logic::effect::{Effect, ProcessId};
use crate::logic::gate::Attempt;
use crate::logic::nameserver::Change;
use crate::logic::node_state::NodeState;
use crate::logic::protocol::{Answer, Deployment};
use anyhow::Context;
use comms::io::clock;
use comms::io::control::ControlSender;
use comms::io::entropy;
use comms::io::session::Reach;
use comms::logic::control::Order;
use comms::logic::time::Time;
pub use environment::Inherited;
use losses::Losses;
use returning::Returning;
use shim::protocol::{ShimOrder, ShimReport};
use std::collections::{BTreeMap, VecDeque};
use std::path::PathBuf;
use std::process;
use std::sync::{Arc, Mutex};
use std::time::Duration;
use team::member::Member;
use tokio::signal::unix::{SignalKind, signal};
use tokio::sync::mpsc::{self, Receiver, Sender};
use tokio::sync::watch;
use tokio::task::JoinSet;

/// How many events wait for the driver.
const EVENTS_MAX: usize = 4096;
/// How long the disk has to take the ends of deployments when the node leaves.
const SETTLE_WITHIN: Duration = Duration::from_secs(1);
/// Source: signal(7), Linux on x86 and ARM.
const SIGXFSZ: i32 = 25;

/// How a node is started.
#[derive(Clone, Debug)]
pub struct Config {
    /// The host's name in specs.
    pub name: String,
    /// The folder of this user's nodes.
    pub base: PathBuf,
    /// Its reach, and the nodes that it knows.
    pub network: NetworkConfig,
    /// The programs that it runs.
    pub programs: ProgramsConfig,
    /// Whether it adopts the programs that a killed node of its name has left in its folder.
    pub adopts: bool,
    /// A name for this boot of the machine, where the kernel has none.
    pub boot: Option<String>,
    /// Folder of the database and the journal; none for a node whose memory ends with it.
    pub state: Option<PathBuf>,
    /// Its replica of the team's database.
    pub database: DatabaseConfig,
    /// The log of the process, if it is this node's alone.
    pub log: Option<Log>,
    /// The service manager that has started the node. None if no service manager has started it.
    pub service: ServiceManager,
}

/// The network of a node.
#[derive(Clone, Debug)]
pub struct NetworkConfig {
    /// The reach of its session.
    pub reach: Reach,
    /// The node as a member of its team, if it is in one; then its reach is that team.
    pub member: Option<Arc<Member>>,
    /// The TCP port it listens on when the network can reach it; 0 for any that is free.
    pub port: u16,
    /// Locators of nodes known beforehand.
    pub peers: Vec<String>,
}

/// The programs of a node.
#[derive(Clone, Debug)]
pub struct ProgramsConfig {
    /// Programs that offer controller types.
    pub controllers: Vec<PathBuf>,
    /// The variables that every program takes over from this process.
    pub inherited: Inherited,
    /// How long programs have to stop when this node is gone; none if they continue, for a node that is restarted.
    pub agent_loss_grace: Option<Duration>,
}

/// The replica of the database that a node has.
#[derive(Clone, Debug)]
pub struct DatabaseConfig {
    /// The engine of a new database; nothing for the default.
    pub store: Option<dbmanager::io::store::Engine>,
    /// Name of the team whose database it is.
    pub team: String,
    /// Whether the database begins a team at once.
    pub founds: bool,
}

/// A running node.
#[derive(Debug)]
struct Driver {
    config: Config,
    dir: RunDir,
    state: NodeState,
    peers: Peers,
    database: database::DatabaseThread,
    gate: Gate,
    files: Files,
    running: Running,
    queues: Queues,
    /// The robot's settings for its node.
    settings: Settings,
    /// Why the node had to leave.
    yielded: Option<String>,
    /// The moment that a thread waits for, or the last one.
    alarm: Option<Time>,
}

/// The decisions about which programs may run here.
#[derive(Debug)]
struct Gate {
    /// Decides who may start, stop and change something, if the node is in a team.
    guard: Option<Guard>,
    /// The orders of other nodes that were accepted and are not answered yet.
    accepted: BTreeMap<u64, Attempt>,
    /// Decides which programs may run here.
    policy: ExecutionPolicy,
}

/// The files in which a node keeps its state.
#[derive(Debug)]
struct Files {
    journal: Arc<Mutex<Journal>>,
    estop: EstopFile,
    kept: KeptFiles,
    inputs: InputLog,
    /// The pending writes of ends to the journal, finished before the node leaves.
    settling: JoinSet<()>,
}

/// The programs that run here.
#[derive(Debug)]
struct Running {
    shims: BTreeMap<ProcessId, Sender<ShimOrder>>,
    programs: BTreeMap<ProcessId, (u64, ControlSender)>,
    /// For each deployment with programs here, a sender that is dropped when the deployment ends.
    living: BTreeMap<Deployment, watch::Sender<()>>,
    /// The losses on the wires of its programs.
    losses: Losses,
    returning: Returning,
    /// Where programs run.
    start_folder: StartFolder,
}

/// The work that waits.
#[derive(Debug)]
struct Queues {
    pending: VecDeque<Input>,
    events: Sender<Event>,
    /// The jobs in parallel to the loop.
    jobs: Sender<Job>,
    tasks: JoinSet<()>,
}

/// Runs a node until `leave` turns true and nothing of it is left, or for ever. `ready` turns true when it can be called.
///
/// # Errors
/// The folder, the session or a controllers' program cannot be used.
pub async fn run(config: Config, mut leave: watch::Receiver<bool>, ready: watch::Sender<bool>) -> anyhow::Result<()> {
    // A file that exceeds the limit of this process is an error of its writer, like a full disk, and does not end the
    // process.
    let _too_long = signal(SignalKind::from_raw(SIGXFSZ)).context("asking for a signal")?;
    kernel::check().map_err(anyhow::Error::msg)?;
    let (events, mut arriving) = mpsc::channel(EVENTS_MAX);
    let mut driver = Driver::open(config, events).await?;
    ready::announce(&driver.peers, &driver.config.network.reach, ready, &mut driver.queues.tasks);
    let mut leaving = false;
    let mut settings = driver.database.settings();
    loop {
        let deadline = driver.state.agent.deadline();
        let input = tokio::select! {
            event = next(&mut arriving) => driver.input(event),
            () = until(deadline) => Some(Input::Tick),
            () = until(driver.config.service.due()) => {
                driver.config.service.turn(clock::now());
                None
            }
            Ok(()) = settings.changed() => {
                let settings = settings.borrow_and_update().clone();
                driver.configure(settings);
                None
            }
            asked = leave.wait_for(|leave| *leave), if !leaving => {
                leaving = true;
                // If the sender is gone, there can be no more requests, which has the same meaning.
                drop(asked);
                Some(Input::Leave)
            }
        };
        driver.queues.pending.extend(input);
        if driver.drain() {
            let yielded = driver.yielded.take();
            driver.close().await?;
            return yielded.map_or(Ok(()), |why| Err(anyhow::Error::msg(why)));
        }
    }
}

/// Waits for a deadline; for ever if there is none.
///
/// # Cancellation
/// Safe.
pub(crate) async fn until(deadline: Option<Time>) {
    match deadline {
        Some(deadline) => clock::sleep_until(deadline).await,
        None => std::future::pending().await,
    }
}

async fn next(arriving: &mut Receiver<Event>) -> Event {
    match arriving.recv().await {
        Some(event) => event,
        // The driver itself holds a sender, so the channel never ends.
        None => std::future::pending().await,
    }
}

impl Driver {
    async fn open(config: Config, events: Sender<Event>) -> anyhow::Result<Self> {
        let machine = start::machine();
        let (dir, before) = start::take_folder(&config, &machine).await?;
        let journal = start::journal(&config, &dir)?;
        let offered = start::offered(&config).await?;
        let boot = entropy::number().context("reading a random number from the system")?;
        let origin = start::origin(&machine, dir.path());
        let inputs = InputLog::new(dir.path(), &start::life(&config, &machine), config.adopts);
        let is_adopting = before.is_some();
        let (estop_file, estop) = EstopFile::open(config.state.clone());
        let (guard, policy) = gate::open(&config)?;
        let (kept, earlier) = start::kept(&config).await?;
        let state = start::state(before, offered, guard.is_some(), || {
            let (host, epoch, open) = (config.name.clone(), journal.epoch(), journal.open_ends());
            let (pid, is_guarded) = (process::id(), guard.is_some());
            Identity { host, boot, pid, machine, epoch, open, is_guarded, estop, earlier }
        });
        let (mut tasks, (sink, arrivals)) = (JoinSet::new(), mpsc::channel(EVENTS_MAX));
        start::show_team(&config, &dir)?;
        let options = start::session_options(&config, &dir)?;
        let life = Life { boot: state.agent.boot(), started: state.agent.started(), origin };
        let peers = Peers::open(options, life, config.network.member.clone(), sink, &mut tasks).await?;
        peers.hold(state.agent.holders().clone());
        peers.beat(state.agent.beaten().clone());
        let options = start::database_options(&config, &dir);
        let session = Arc::clone(peers.session());
        let database = tokio::task::spawn_blocking(move || database::start(&options, &session)).await??;
        let (jobs, waiting) = mpsc::channel(starter::JOBS_MAX);
        tasks.spawn(start::starter(&config, &database, policy.clone(), events.clone()).run(waiting));
        tasks.spawn(start::forward(arrivals, events.clone()));
        tasks.spawn(keeping::reap_orphans());
        tasks.spawn(crate::io::founding::begin(config.network.member.clone(), database.handle().clone()));
        let mut driver = Self {
            state,
            config,
            dir,
            peers,
            database,
            gate: Gate { guard, accepted: BTreeMap::new(), policy },
            files: Files {
                journal: Arc::new(Mutex::new(journal)),
                estop: estop_file,
                kept,
                inputs,
                settling: JoinSet::new(),
            },
            running: Running {
                shims: BTreeMap::new(),
                programs: BTreeMap::new(),
                living: BTreeMap::new(),
                losses: Losses::default(),
                returning: Returning::default(),
                start_folder: StartFolder::here(),
            },
            queues: Queues { pending: VecDeque::new(), events, jobs, tasks },
            settings: Settings::default(),
            yielded: None,
            alarm: None,
        };
        if is_adopting {
            driver.adopt();
        }
        Ok(driver)
    }

    /// Turns an event into an input; keeps the channels it brings.
    fn input(&mut self, event: Event) -> Option<Input> {
        while self.queues.tasks.try_join_next().or_else(|| self.files.settling.try_join_next()).is_some() {}
        match event {
            Event::Arrival(Arrival::Input(input)) => Some(input),
            Event::Arrival(Arrival::Call(call, request, caller)) => self.called(call, request, caller),
            Event::Admitted(call, request, caller) => self.admit(call, request, caller),
            Event::Judged(number, verdict) => Some(Input::Judged { number, verdict }),
            Event::Shim(process, report, output) => {
                if report == ShimReport::Gone {
                    self.running.shims.remove(&process);
                    self.running.returning.is_gone(&process);
                }
                Some(Input::Shim { process, report, output })
            }
            Event::Program(Connection { deployment, instance, number }, sender) => {
                let process = self.state.attachments.find(&deployment, &instance)?.clone();
                self.running.returning.is_back(&process, 0);
                self.tell_parameters(&sender, &process);
                self.running.programs.insert(process, (number, sender));
                None
            }
            Event::Resumed { connection: Connection { deployment, instance, number }, sender, version, counts } => {
                let process = self.state.attachments.find(&deployment, &instance)?.clone();
                let (orders, notices) = counts;
                self.running.returning.is_back(&process, notices);
                let why = self.resume(&process, &sender, version, orders).err();
                // The program first waits for an order, so the parameters come after this order.
                self.tell_parameters(&sender, &process);
                self.running.programs.insert(process.clone(), (number, sender));
                why.map(|why| Input::Undelivered { process, why })
            }
            Event::Control(Connection { deployment, instance, number }, notice) => {
                let process = self.state.attachments.find(&deployment, &instance)?.clone();
                let is_current = self.running.programs.get(&process).is_some_and(|(current, _)| *current == number);
                is_current.then(|| self.said(process, notice))
            }
            Event::Losses(Connection { deployment, instance, .. }, counted) => {
                let process = self.state.attachments.find(&deployment, &instance)?.clone();
                self.running.losses.note(process, instance, counted);
                None
            }
            Event::Refused(connection, wires) => self.refused(&connection, wires),
            Event::Judge(connection, sender, number, call) => {
                self.judge_call(connection, sender, number, call);
                None
            }
            Event::Reached(process) => {
                self.running.returning.shim_is_back(&process);
                None
            }
            Event::Alarm => Some(Input::Tick),
            Event::Committed(deployment, written) => Some(Input::Committed { deployment, written }),
            Event::EstopKept(number, written) => Some(Input::EstopKept { number, written }),
            Event::Unkept(deployment, written) => Some(Input::Unkept { deployment, written }),
            Event::Found(deployment, number, problems) => Some(Input::Found { deployment, number, problems }),
        }
    }

    fn carry_out(&mut self, effect: Effect) {
        match effect {
            Effect::Transmit { to, frame } => self.peers.send(&to, &frame),
            Effect::Ping { round, only, shows } => self.peers.ping(round, only.as_ref(), shows),
            Effect::Greet(namesake) => self.peers.greet(&namesake),
            Effect::Holders(holders) => self.peers.hold(holders),
            Effect::Beat(hosts) => self.peers.beat(hosts),
            Effect::Peer(change) => self.peer(&change),
            Effect::Spawn(order) => self.spawn(*order),
            Effect::Shim { process, order } => {
                if let Some(shim) = self.running.shims.get(&process)
                    && let Err(error) = shim.try_send(order)
                {
                    tracing::warn!(%error, "a shim does not take its orders");
                }
            }
            Effect::Control { process, order } => self.control(process, &order),
            Effect::CloseProcess { process } => self.forget(&process),
            Effect::KillShim { process } => self.later(Job::Kill(self.dir.process(&process))),
            Effect::CloseDeployment { deployment } => self.bury(&deployment),
            Effect::PersistEpoch { deployment, hosts } => self.commit(deployment, hosts),
            Effect::Judge { number, deployment, from, order } => self.judge(number, &deployment, &from, &order),
            Effect::JudgeResumed { deployment, signed } => self.judge_resumed(deployment, signed.as_deref()),
            Effect::OrderEnded { number, outcome } => self.order_ended(number, &outcome),
            Effect::FindPrograms { deployment, number, programs } => {
                self.find_programs(deployment, number, programs);
            }
            Effect::Settled { deployment } => {
                let journal = Arc::clone(&self.files.journal);
                self.files.settling.spawn_blocking(move || journal::settle(&journal, &deployment));
            }
            Effect::Keep(kept) => self.keep(|files| files.keep(&kept)),
            Effect::Unkeep { deployment } => self.unkeep(deployment),
            Effect::KeepAll(all) => self.keep(|files| files.keep_all(&all)),
            Effect::KeepTombstones(all) => self.keep(|files| files.keep_tombstones(all)),
            Effect::KeepEstop { number, estop } => self.keep_estop(number, estop),
            Effect::Answer { call, mut answer } => {
                if let Answer::Status(status) = &mut *answer {
                    status.containment = cgroup::containment();
                    status.network = start::network(&self.config);
                    status.policy = self.gate.policy.in_use();
                    self.running.losses.tell(status, &self.state.agent);
                }
                if !self.peers.answer(call, *answer) {
                    self.peers.take(call);
                    self.queues.pending.push_back(Input::CallGone { call });
                }
            }
            Effect::EndAnswers { call } => self.peers.take(call).into_iter().for_each(Caller::end),
            Effect::Tail { call, process, follow } => {
                let dir = self.dir.process(&process);
                self.tail(call, &process.deployment, |caller, over| tail::tail(dir, follow, over, caller));
            }
            Effect::TailAll { call, deployment, programs } => {
                let dir = |leaf| self.dir.process(&ProcessId { deployment: deployment.clone(), leaf });
                let programs = programs.into_iter().map(|(leaf, path)| (path, dir(leaf))).collect();
                self.tail(call, &deployment, |caller, over| tail::all(programs, over, caller));
            }
            Effect::WriteDatabase(commit) => self.database.handle().write(*commit),
            Effect::Yield { why } => self.yielded = Some(why),
            Effect::Leave => {}
        }
    }

    fn control(&mut self, process: ProcessId, order: &Order) {
        let why = match self.running.programs.get(&process).map(|(_, sender)| sender.send(order)) {
            Some(Ok(())) => return,
            Some(Err(error)) => error.to_string(),
            None if self.running.returning.expects(&process) => return,
            None => "it has no control channel".to_owned(),
        };
        self.queues.pending.push_back(Input::Undelivered { process, why });
    }

    /// Tells the database of a new node, drops the link to a lost one, and logs every change, if the log belongs to
    /// this node alone.
    fn peer(&self, change: &Change) {
        match change {
            Change::Appeared { .. } => self.database.handle().appeared(),
            // The node may be suspended while its system still takes messages.
            Change::Lost { host } => self.peers.cut(host),
            Change::Missing { .. }
            | Change::Detour { .. }
            | Change::Refused { .. }
            | Change::Namesake { .. }
            | Change::Twice { .. } => {}
        }
        if self.config.log.is_some() {
            logging::peer(change);
        }
    }

    /// Starts a job that runs at the same time as the loop. The loop does not wait for it.
    fn later(&self, job: Job) {
        if let Err(error) = self.queues.jobs.try_send(job) {
            tracing::warn!(%error, "the queue of jobs is full: one is dropped");
        }
    }

    async fn close(mut self) -> anyhow::Result<()> {
        self.leave_orders();
        let deadline = clock::now() + SETTLE_WITHIN;
        while let Some(_settled) = tokio::select! {
            settled = self.files.settling.join_next() => settled,
            () = clock::sleep_until(deadline) => None,
        } {}
        self.peers.answered().await;
        self.queues.tasks.shutdown().await;
        self.database.close().await;
        self.peers.close().await;
        Ok(())
    }
}
