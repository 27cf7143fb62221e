//! A controller as a program of its own. A node starts it, and sends it orders over a control
//! socket. Its data uses a separate session.
//!
//! Three parties share the process. The *listener* (the main thread) reads the node's orders, makes the links, and
//! opens and closes wires. The *cycle* (a thread with absolute deadlines) owns the controller, and no other thread
//! calls it. Zenoh's threads hand over arriving samples and wake the cycle. Invariant: each activation ends with
//! exactly one notice, after `stop` has finished. The loss of the node does not change this: the listener looks for the
//! next node, and the cycle continues. It ends only if the parent of this process is also gone.
//!
//! The environment of a program: `DCA_CONTROL`, the node's socket; `DCA_INSTANCE`, its path in the plan, and a number
//! behind `#` if there may be two of it; `DCA_DEPLOYMENT`, the name of its deployment, for people; `DCA_DATA_SOCKET`,
//! the socket of its data session; `DCA_REMOTE`, present when other hosts must reach it; `NOTIFY_SOCKET` and
//! `WATCHDOG_USEC`, the watcher of its loop and the bound; `DCA_DIRECT`: with `off`, wires on one host also go over
//! zenoh.

mod agreement;
mod cycle;
mod database;
mod devices;
mod early;
mod ending;
mod heartbeat;
mod inbox;
mod keyring;
mod links;
mod node_line;
mod objects;
mod peaks;
mod secret;
mod taps;
mod warrants;
mod wire;

use super::arguments::{Arguments, accepted};
use super::interface::{Binding, Interface};
use super::module::Module;
use super::registry::{CreateError, Registry};
use comms::io::control::ControlError;
use comms::io::data::DataSession;
use comms::io::direct::DirectPath;
use comms::io::session::{OpenError, Reach, Role, prepare_process};
use comms::io::stack::on_own_stack;
use comms::logic::codec::WIRE_VERSION;
use comms::logic::control::{Dial, Location, Notice, Order};
use comms::logic::seal::{LINK, Refusal};
use cycle::Cycle;
use heartbeat::Watcher;
use inbox::{Command, Inbox};
use keyring::Keyring;
use links::Links;
use node_line::{NodeLine, NoticeLog};
use signal_hook::consts::SIGTERM;
use signal_hook::iterator::Signals;
use std::io::Write;
use std::os::unix::process::parent_id;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use team::program::ProgramIdentity;
use thiserror::Error;
use tracing_subscriber::EnvFilter;

const USAGE: &str = "usage: PROGRAM TYPE [[NAME=]VALUE]...   started by a node
       PROGRAM --list              lists the controller types of this program
       PROGRAM --dca-interface     prints the interfaces of these types, as `module` blocks";

/// Why a program cannot start as a controller.
#[derive(Debug, Error)]
enum ProcessError {
    #[error("a controller is started by `dca-node` or `dca run`, not by hand: {variable} is not set\n{USAGE}")]
    NoNode { variable: &'static str },
    #[error("{error}{}", usage(.error))]
    Create {
        #[from]
        error: CreateError,
    },
    #[error("cannot open a data session: {0}")]
    Session(#[from] OpenError),
    #[error("cannot talk to the node: {0}")]
    Control(#[from] ControlError),
    #[error("the controller does not accept orders: it is stuck in a calculation")]
    Stuck,
    #[error("cannot accept connections from other hosts of the team: {0}")]
    Team(String),
    #[error("cannot start a thread: {0}")]
    Thread(#[from] std::io::Error),
}

/// Returns the usage, which follows an error that only a person can make: a node only starts existing types.
fn usage(error: &CreateError) -> String {
    match error {
        CreateError::UnknownType { .. } => format!("\n{USAGE}"),
        CreateError::Argument { .. } | CreateError::Refused { .. } => String::new(),
    }
}

/// The process of another language in which controllers run.
#[derive(Clone, Debug)]
pub struct Embedding {
    /// The words of the command line behind the program.
    pub arguments: Vec<String>,
    /// Runs the control loop on its thread, once. It also makes the preparations that the language needs for a thread.
    pub around: fn(&mut (dyn FnMut() + Send)),
}

/// Runs this process as the controller that its arguments name. A `main` needs only this call.
pub fn run(registry: &Registry) -> ExitCode {
    run_in(registry, &Embedding { arguments: std::env::args().skip(1).collect(), around: |run| run() })
}

/// The log lines of a controller, unless `RUST_LOG` is set: the warnings of DCA.
const LOGGED: &str = "off,controllers=warn,comms=warn";

/// Sends the log of this process to standard error, which `dca logs` shows. `RUST_LOG` sets the filter, or else `usual`. If the
/// program has already begun a log, this does nothing.
pub fn log(usual: &str) {
    let filter = EnvFilter::try_from_default_env().unwrap_or_else(|_| EnvFilter::new(usual));
    let lines = tracing_subscriber::fmt().with_env_filter(filter).with_ansi(false).with_writer(std::io::stderr);
    lines.try_init().unwrap_or_default();
}

/// Runs the process of another language as the controller that its arguments name.
pub fn run_in(registry: &Registry, embedding: &Embedding) -> ExitCode {
    prepare_process(Role::End);
    let no_thread = |error| tell(&ProcessError::Thread(error).to_string(), ExitCode::FAILURE);
    on_own_stack(|| run_named(registry, embedding)).unwrap_or_else(no_thread)
}

fn run_named(registry: &Registry, Embedding { arguments, around }: &Embedding) -> ExitCode {
    let text = match arguments.first().map(String::as_str) {
        None => return tell(USAGE, ExitCode::from(2)),
        Some("--help" | "-h") => format!("{USAGE}\n"),
        Some("--version" | "-V") => version(std::env::args_os().next()),
        Some("--dca-interface") => registry.interface_text(),
        Some("--list") => registry.interfaces().map(|one| format!("{}\n", one.type_name)).collect(),
        Some(name) => {
            log(LOGGED);
            return match take_part(registry, name, arguments.get(1..).unwrap_or_default(), *around) {
                Ok(code) => code,
                Err(error @ (ProcessError::Create { .. } | ProcessError::NoNode { .. })) => {
                    tell(&error.to_string(), ExitCode::from(2))
                }
                Err(error) => tell(&error.to_string(), ExitCode::FAILURE),
            };
        }
    };
    let written = std::io::stdout().write_all(text.as_bytes());
    if written.is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

/// Returns the name under which the program was called, and the version of DCA with which it was built.
fn version(called: Option<std::ffi::OsString>) -> String {
    let called = called.map(PathBuf::from).unwrap_or_default();
    let name = called.file_name().map_or("controller".into(), |name| name.to_string_lossy().into_owned());
    format!("{name} (DCA {})\n", env!("CARGO_PKG_VERSION"))
}

fn tell(text: &str, code: ExitCode) -> ExitCode {
    // The loss of standard error cannot be reported anywhere.
    drop(std::io::stderr().write_all(format!("{text}\n").as_bytes()));
    code
}

fn take_part(
    registry: &Registry,
    name: &str,
    arguments: &[String],
    around: fn(&mut (dyn FnMut() + Send)),
) -> Result<ExitCode, ProcessError> {
    let parent = parent_id();
    let word = std::env::var_os("DCA_INSTANCE").unwrap_or_default().to_string_lossy().into_owned();
    // A number after the path distinguishes it from another program of the same process.
    let instance = word.split('#').next().unwrap_or_default().to_owned();
    let deployment = std::env::var_os("DCA_DEPLOYMENT").unwrap_or_default().to_string_lossy().into_owned();
    let module = registry.create_at(&deployment, &instance, name, arguments)?;
    let variable = |variable| std::env::var_os(variable).ok_or(ProcessError::NoNode { variable });
    let (socket, _) = (PathBuf::from(variable("DCA_CONTROL")?), variable("DCA_INSTANCE")?);
    let interface = module.interface().clone();
    let (inbox, mut keyring, mut direct) = (Arc::new(Inbox::default()), None, None);
    let session = if needs_session(&interface) {
        let socket = PathBuf::from(variable("DCA_DATA_SOCKET")?);
        let reach = match team(&inbox)? {
            Some(identity) => {
                keyring = Some(Arc::new(Keyring::new(&identity, &inbox)));
                Reach::Team(identity)
            }
            None if std::env::var_os("DCA_REMOTE").is_some() => Reach::Lan,
            None => Reach::Host,
        };
        let session = DataSession::open(&socket, reach)?;
        direct = direct_path(&interface, &socket, keyring.as_ref());
        Some(Arc::new(session))
    } else {
        None
    };
    let keys = keyring.as_deref().map(Keyring::public).unwrap_or_default();
    let mut location = session.as_ref().map(|session| Location { keys, ..session.location() });
    if let (Some(location), Some(direct)) = (&mut location, &direct) {
        location.local.push(direct.locator());
        inbox.read_from(direct.inlets());
    }
    let links = Arc::new(Links::new(keyring, direct));
    let (notices, orders) = node_line::connect(&socket, &word, parent)?;
    links.keyring().into_iter().for_each(|keyring| keyring.warrants().ask_by(&notices));
    notices.send(&hello(&interface, &word, location))?;
    let parameters = interface.about.parameters;
    // The registry has already made a controller from the arguments, so they fit.
    let arguments = Arguments::parse(parameters, arguments).unwrap_or_default().of(&deployment, &instance);
    let program = Program { interface, instance, arguments, overlay: Vec::new(), session, notices, around };
    program.serve(module, inbox, links, orders)
}

/// Returns the identity of this program in its team; none without a team.
fn team(inbox: &Arc<Inbox>) -> Result<Option<Arc<ProgramIdentity>>, ProcessError> {
    let Some(file) = std::env::var_os("DCA_TEAM") else { return Ok(None) };
    let inbox = Arc::clone(inbox);
    let identity = ProgramIdentity::open(Path::new(&file), move |who| inbox.refuse(LINK, Refusal::NoWire, Some(who)));
    identity.map(|identity| Some(Arc::new(identity))).map_err(|error| ProcessError::Team(format!("{error:#}")))
}

fn needs_session(interface: &Interface) -> bool {
    let is_called = !interface.exports.is_empty() || !interface.calls.is_empty();
    let is_seen = interface.about.signals_every.is_some() || !interface.inner.is_empty();
    !interface.ports.is_empty() || is_seen || is_called
}

/// Opens the direct path of wires to programs of this host. Without it these wires use the data session. In a team,
/// both ends of a wire prove their identity with their keys.
fn direct_path(interface: &Interface, socket: &Path, keyring: Option<&Arc<Keyring>>) -> Option<Arc<DirectPath>> {
    let has_wires = interface.ports.iter().any(|port| port.binding == Binding::Wire);
    if !has_wires || std::env::var_os("DCA_DIRECT").is_some_and(|word| word == "off") {
        return None;
    }
    let opened = DirectPath::open(&socket.with_extension("wire"), keyring.map(Keyring::guard));
    opened.inspect_err(|error| tracing::warn!(%error, "wires on this host are not direct")).ok().map(Arc::new)
}

fn hello(interface: &Interface, instance: &str, location: Option<Location>) -> Notice {
    let names = |devices: Vec<&'static str>| devices.into_iter().map(str::to_owned).collect();
    Notice::Hello {
        version: WIRE_VERSION,
        instance: instance.to_owned(),
        signals: location.is_some(),
        location,
        owns: names(interface.owns()),
        needs: names(interface.needs()),
    }
}

/// The constants of a program's life.
struct Program {
    interface: Interface,
    instance: String,
    /// The values of the spec, with the present secrets.
    arguments: Arguments,
    /// The values of the database that replace them.
    overlay: Vec<(String, String)>,
    session: Option<Arc<DataSession>>,
    notices: NoticeLog,
    /// See [`Embedding::around`].
    around: fn(&mut (dyn FnMut() + Send)),
}

impl Program {
    /// Obeys the node until it sends `Exit`, or until node and parent are gone. Then stops the running activation, and
    /// ends.
    fn serve(
        mut self,
        module: Box<dyn Module>,
        inbox: Arc<Inbox>,
        links: Arc<Links>,
        mut orders: NodeLine,
    ) -> Result<ExitCode, ProcessError> {
        let cycle = Cycle::new(module, Arc::clone(&inbox), Arc::clone(&links), self.notices.clone());
        if let Some(watcher) = Watcher::of_environment() {
            watcher.tell(cycle.heartbeat())?;
        }
        let database = cycle.database();
        let (mut cycle, around) = (Some(cycle), self.around);
        let run = move || around(&mut || cycle.take().into_iter().for_each(Cycle::run));
        let running = std::thread::Builder::new().name("cycle".to_owned()).spawn(run)?;
        obey_sigterm(&inbox, &self.notices)?;
        let code = loop {
            match orders.next() {
                Ok(Order::Exit) => break ExitCode::SUCCESS,
                Ok(Order::Database { number, answer }) => database.take(number, answer, &inbox),
                Ok(Order::Resumed { .. }) => {
                    database.renew(&inbox);
                    links.keyring().into_iter().for_each(|keyring| keyring.warrants().renew());
                    inbox.tell_losses_again();
                }
                Ok(Order::Keys { ports }) => drop(inbox.command(Command::Connect(ports))),
                Ok(order) => {
                    if let Err(error) = self.obey(order, &inbox, &links) {
                        break tell(&error.to_string(), ExitCode::FAILURE);
                    }
                }
                Err(error) => break tell(&error.to_string(), ExitCode::FAILURE),
            }
        };
        inbox.command(Command::Leave);
        // A loop that panics ends the process, so there is no other result.
        drop(running.join());
        self.notices.flush();
        links.clear();
        if let Some(session) = self.session.and_then(Arc::into_inner) {
            session.close();
        }
        Ok(code)
    }

    /// Returns the values of the spec, replaced by the values of the database.
    fn overlaid(&self) -> Arguments {
        let mut arguments = self.arguments.clone();
        // The overlay contains no wrong values.
        drop(arguments.overlay(self.interface.about.parameters, &self.overlay));
        arguments
    }

    /// Makes links. If there are links already, a stop must not wait for the programs at the other ends. So further
    /// links are made in a separate thread, which ends with its answer.
    fn link(&self, orders: links::LinkOrders, inbox: &Arc<Inbox>, links: &Arc<Links>) -> Result<(), ProcessError> {
        let Some(session) = &self.session else {
            return Ok(self.notices.send(&Notice::Connected)?);
        };
        if !links.are_made() {
            return Ok(self.notices.send(&answer(links.make(session, &self.interface, orders, inbox)))?);
        }
        let (session, interface, notices) = (Arc::clone(session), self.interface.clone(), self.notices.clone());
        let (inbox, links) = (Arc::clone(inbox), Arc::clone(links));
        let make = move || {
            let _turn = links.turn();
            let made = links.make(&session, &interface, orders, &inbox);
            if let Err(error) = notices.send(&answer(made)) {
                tracing::debug!(%error, "cannot inform the node");
            }
        };
        std::thread::Builder::new().name("links".to_owned()).spawn(make)?;
        Ok(())
    }

    /// Links to a program that was restarted; a stop must not wait for this.
    fn relink(&self, lost: String, found: Dial, inbox: &Arc<Inbox>, links: &Arc<Links>) -> Result<(), ProcessError> {
        let Some(session) = &self.session else { return Ok(()) };
        session.forget(&lost);
        // A robot continues even if its node sends nonsense.
        session.keep(&found).unwrap_or_else(|error| tracing::warn!(%error, "a link is not made again"));
        if links.hears_directly(&lost) {
            let (session, inbox, links) = (Arc::clone(session), Arc::clone(inbox), Arc::clone(links));
            let relink = move || {
                let _turn = links.turn();
                links.relink(&session, &inbox, &lost, &found);
            };
            std::thread::Builder::new().name("links".to_owned()).spawn(relink)?;
        }
        Ok(())
    }

    fn obey(&mut self, order: Order, inbox: &Arc<Inbox>, links: &Arc<Links>) -> Result<(), ProcessError> {
        match order {
            Order::Connect { robot, incoming, outgoing, devices } => {
                let instance = self.instance.clone();
                self.link(links::LinkOrders { instance, robot, incoming, outgoing, devices }, inbox, links)?;
            }
            Order::Open { wires, generation } => {
                links.switch(&wires, true);
                self.notices.send(&Notice::Switched { generation })?;
            }
            Order::Close { wires, generation } => {
                links.switch(&wires, false);
                self.notices.send(&Notice::Switched { generation })?;
            }
            Order::Flip { ticket, flip } => {
                links.flip(&flip);
                self.notices.send(&Notice::Switched { generation: ticket })?;
            }
            Order::Expect { ticket, expect, then } => {
                inbox.expect(ticket, expect, then);
                self.notices.send(&Notice::Expecting { ticket })?;
            }
            Order::Activate { activation, value, since } => {
                hand_over(inbox, Command::Activate { activation, value, since })?;
            }
            Order::Stop { activation } => hand_over(inbox, Command::Stop { activation })?,
            Order::Received { number, fate } => hand_over(inbox, Command::Received { number, fate })?,
            Order::Send { number, port, value } => {
                // The value is sent at once, so that an order to close its wires does not overtake it.
                links.send(&port, value);
                self.notices.send(&Notice::Sent { number })?;
            }
            Order::Configure { parameters } => {
                let (overlay, wrong) = accepted(self.interface.about.parameters, parameters, &self.overlay);
                for why in wrong {
                    // A message to people is enough: a robot continues with its present value rather than with a guess.
                    tell(
                        &format!("a value of the database is ignored, and its parameter is unchanged: {why}"),
                        ExitCode::SUCCESS,
                    );
                }
                self.overlay = overlay;
                hand_over(inbox, Command::Configure(self.overlaid()))?;
            }
            Order::Secret { parameter, value } => {
                // A node that was killed and has returned repeats its earlier orders.
                if self.arguments.secret(&parameter).is_ok_and(|before| before.as_slice() != value.expose()) {
                    self.arguments.renew_secret(&parameter, value);
                    hand_over(inbox, Command::Configure(self.overlaid()))?;
                }
            }
            Order::Shape { wires } => links.shape(wires),
            Order::Calls { calls } => links.call(calls),
            Order::Rejoin => links.rejoin(),
            Order::Partners { partners } => links.take_partners(partners),
            Order::Vouch { delegation } => {
                links.keyring().into_iter().for_each(|keyring| keyring.take_delegation(&delegation));
            }
            Order::Judged { number, refusal } => {
                if let Some(keyring) = links.keyring() {
                    keyring.warrants().judged(number, refusal);
                }
            }
            Order::Relink { lost, found } => self.relink(lost, found, inbox, links)?,
            Order::Exit | Order::Resumed { .. } | Order::Database { .. } | Order::Keys { .. } => {}
        }
        Ok(())
    }
}

fn answer(made: Result<(), String>) -> Notice {
    made.map_or_else(|reason| Notice::ConnectFailed { reason }, |()| Notice::Connected)
}

fn hand_over(inbox: &Inbox, command: Command) -> Result<(), ProcessError> {
    if inbox.command(command) { Ok(()) } else { Err(ProcessError::Stuck) }
}

/// On SIGTERM the controller stops as on `Exit`; then the process leaves at once.
fn obey_sigterm(inbox: &Arc<Inbox>, notices: &NoticeLog) -> Result<(), ProcessError> {
    let (mut signals, inbox, notices) = (Signals::new([SIGTERM])?, Arc::clone(inbox), notices.clone());
    let obey = move || {
        if signals.forever().next().is_some() {
            inbox.command(Command::Leave);
            inbox.wait_left();
            notices.flush();
            std::process::exit(128 + SIGTERM);
        }
    };
    // The thread lives as long as the process: a thread that waits for a signal cannot be joined.
    std::thread::Builder::new().name("signals".to_owned()).spawn(obey)?;
    Ok(())
}
