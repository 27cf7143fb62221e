//! A program of ROS 2 as a process: this program starts it, reports its end, and moves its node through its lifecycle.
//!
//! Without a lifecycle, the program of ROS 2 runs while the process runs. With a lifecycle, the program is started and configured before
//! this program says hello to the node of the host. So a mission begins only if its program can be configured. After that, starts and
//! stops of the process are `activate` and `deactivate`. A container of components is started with the process, and then loads its
//! components. If the program of ROS 2 ends without a request, this program ends in the same way in two cases: if the spec restarts it
//! after a failure, and while the process does not run. So the node of the host treats both as one program.

use crate::control::{Control, Life, Loader};
use crate::io::container::ContainerNode;
use crate::io::installation::{self, Environment, Prepared};
use crate::io::lock;
use crate::io::managed::{Bell, Managed};
use crate::io::parameters::{self, Asked, NodeParameters};
use crate::io::program::{self, End, Program};
use crate::logic::command::{Declared, What};
use crate::logic::component::Component;
use crate::logic::ending::{Ending, TERMINATE_WITHIN};
use crate::logic::lifecycle::{Standing, State};
use crate::setup;
use comms::io::clock::now;
use comms::logic::object::ObjectError;
use comms::logic::signals::Signal;
use comms::logic::time::Time;
use controllers::sdk::{
    About, Activity, Arguments, Configured, Delivery, DeliveryError, Interface, Kind, Module, Parameter, Progress,
    RawReply, Stopping, Waker,
};
use ros::logic::key::GraphName;
use std::sync::{Arc, Mutex};
use std::time::Duration;

/// The controller type, which plans name.
const TYPE: &str = "RosNode";
/// How often this program checks its node.
const PERIOD: Duration = Duration::from_millis(100);
const SIGNALS_EVERY: Duration = Duration::from_millis(500);
/// How long SIGTERM and SIGKILL may take after the time of a stop.
const FORCE_WITHIN: Duration = Duration::from_millis(2500);
/// The time limit for the end of a process that does not end by SIGKILL.
const KILL_WITHIN: Duration = Duration::from_secs(1);
/// The only middleware of ROS 2 whose services this program can call.
const MIDDLEWARE: &str = "rmw_zenoh_cpp";
const PARAMETERS: &[Parameter] = &[
    Parameter::new("package", Kind::Text(&[])),
    Parameter::new("executable", Kind::Text(&[])).or(""),
    Parameter::new("launch", Kind::Text(&[])).or(""),
    Parameter::new("setup", Kind::Text(&[])).or(""),
    Parameter::new("node", Kind::Text(&[])).or(""),
    Parameter::new("remaps", Kind::Text(&[])).or(""),
    Parameter::new("files", Kind::Text(&[])).or(""),
    Parameter::new("lifecycle_ms", Kind::Text(&[])).or(""),
    Parameter::new("components_ms", Kind::Text(&[])).or(""),
    Parameter::new("component_words", Kind::Text(&[])).or("0"),
    Parameter::new("stop_ms", Kind::Text(&[])).or("5000"),
    Parameter::new("ends", Kind::Truth).or("false"),
    Parameter::new("restarts", Kind::Truth).or("false"),
];

/// Returns the interface of a program of ROS 2.
pub(crate) fn interface() -> Interface {
    let about = About::service("Runs a program of ROS 2. `dca` makes it from a module with `ros`.");
    let about = about.every(PERIOD).with(PARAMETERS).signals_every(SIGNALS_EVERY);
    Interface { type_name: TYPE, about, ports: Vec::new(), exports: Vec::new(), calls: Vec::new(), inner: Vec::new() }
}

/// Which part handles the end of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Care {
    /// The loop handles it.
    Loop,
    /// No part handles it: the process does not run, so this program ends together with the program of ROS 2.
    Nothing,
}

/// The effect of a stop of the process on the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rest {
    /// The program continues, and its node is not active.
    Stays,
    /// The node is being deactivated.
    Waits,
    /// The program has to end, and has this time after SIGINT.
    Ends(Duration),
}

/// The meaning of an end of the program that was not requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Rules {
    /// Whether exit code 0 means that the work is done.
    ends: bool,
    /// Whether the process is restarted after a failure.
    restarts: bool,
}

/// A program of ROS 2.
#[derive(Debug)]
pub(crate) struct RosNode {
    interface: Interface,
    prepared: Prepared,
    stop: Duration,
    rules: Rules,
    control: Control,
    program: Option<Program>,
    care: Arc<Mutex<Care>>,
    ending: Option<Ending>,
    is_stopping: bool,
    /// The reason why the program could not be started.
    trouble: Option<String>,
    bell: Arc<Bell>,
    /// The services for the parameters of the node; or the reason why they cannot be called.
    parameters: Result<NodeParameters, String>,
}

impl RosNode {
    /// Makes a node that is not active, and finds its program. If the node has a lifecycle, also starts and configures the program, and
    /// blocks until this is done.
    ///
    /// # Errors
    /// The error is a sentence for a person.
    pub(crate) fn new(arguments: &Arguments, rest: &[String]) -> Result<Self, String> {
        let declared = declared(arguments, rest)?;
        let stop = millis(arguments, "stop_ms")?;
        let rules = Rules { ends: arguments.truth("ends"), restarts: arguments.truth("restarts") };
        let prepared = installation::prepare(&declared, installation::environment(arguments.text("setup"))?)?;
        let bell = Arc::new(Bell::default());
        let control = control(arguments, &declared, &prepared.environment, &bell)?;
        let about = interface().about.stop_within(stop + FORCE_WITHIN);
        let exports = if declared.node.is_some() { parameters::exports() } else { Vec::new() };
        let interface = Interface { about, exports, ..interface() };
        let parameters = parameters_of(arguments, &declared, &prepared.environment);
        let care = Arc::new(Mutex::new(Care::Loop));
        let mut node = Self {
            interface,
            prepared,
            stop,
            rules,
            control,
            program: None,
            care,
            ending: None,
            is_stopping: false,
            trouble: None,
            bell,
            parameters,
        };
        program::handle_interrupts()?;
        node.get_ready().inspect_err(|_| node.end(TERMINATE_WITHIN))?;
        Ok(node)
    }

    /// Moves a node with a lifecycle as far as it can go before its process runs.
    fn get_ready(&mut self) -> Result<(), String> {
        while let Some(standing) = self.control.standing() {
            match standing {
                Standing::Reached => break,
                Standing::Failed(why) => return Err(why.clone()),
                Standing::Underway => {}
            }
            self.step(now());
            if let Some(why) = self.trouble.take() {
                return Err(why);
            }
            self.has_gone()?;
            self.bell.wait(now() + PERIOD);
        }
        *lock(&self.care) = Care::Nothing;
        // The program may have ended a moment ago.
        self.has_gone()
    }

    fn has_gone(&mut self) -> Result<(), String> {
        self.take_end().map_or(Ok(()), |end| {
            Err(format!("its program `{}` has ended with {end} before it was configured", self.shown()))
        })
    }

    /// From now on the loop does not handle the end of the program.
    fn rest(&mut self) {
        *lock(&self.care) = Care::Nothing;
        // If a program has ended at a stop, the next activation starts it again.
        self.take_end();
    }

    fn start(&mut self) -> Result<(), String> {
        let (care, bell) = (Arc::clone(&self.care), Arc::clone(&self.bell));
        let shown = self.shown();
        let ended = move |end: End| match *lock(&care) {
            Care::Loop => bell.ring(),
            Care::Nothing => {
                tracing::error!(%end, "the program of ROS 2 `{shown}` has ended");
                end.take_over()
            }
        };
        self.program = Some(Program::start(&self.prepared, ended)?);
        Ok(())
    }

    /// Returns the end of the program, once none of its processes is left.
    fn take_end(&mut self) -> Option<End> {
        let end = self.program.as_ref().and_then(Program::end)?;
        self.forget_program(now());
        Some(end)
    }

    /// Takes the news, and starts the program if it is time for it.
    fn step(&mut self, now: Time) {
        let starts = self.control.step(now);
        self.start_if(starts, now);
    }

    fn start_if(&mut self, starts: bool, now: Time) {
        if !starts {
            return;
        }
        self.trouble = self.start().err();
        if self.trouble.is_some() {
            self.forget_program(now);
        }
    }

    /// Records that the program is gone.
    fn forget_program(&mut self, now: Time) {
        self.program = None;
        self.control.ended(now);
    }

    /// Returns the end of the process that follows from the end of the program.
    fn over(&self, end: End) -> Progress {
        let Rules { ends, restarts } = self.rules;
        if end == End::Exit(0) && ends {
            return Progress::Done(Vec::new());
        }
        let why = format!("its program `{}` has ended with {end}", self.shown());
        if restarts {
            tracing::error!("{why}");
            end.take_over();
        }
        Progress::Aborted(why)
    }

    /// Returns what happens to the program when the process stops.
    fn rest_of_program(&self) -> Rest {
        let Some(lifecycle) = self.control.lifecycle() else { return Rest::Ends(self.stop) };
        let why = match lifecycle.standing() {
            Standing::Underway => return Rest::Waits,
            Standing::Reached if lifecycle.state() == Some(State::Finalized) => "it has been shut down",
            Standing::Reached if lifecycle.may_activate() => {
                "a request to activate it has no answer; the node may still become active"
            }
            Standing::Reached => return Rest::Stays,
            Standing::Failed(why) => why,
        };
        tracing::warn!(why, "the program of ROS 2 is ended");
        Rest::Ends(TERMINATE_WITHIN)
    }

    /// Continues the end of the program; returns whether none of its processes is left.
    fn has_ended(&mut self, now: Time) -> bool {
        if let (Some(ending), Some(program)) = (&mut self.ending, &self.program) {
            while let Some(step) = ending.due(now) {
                program.take(step);
            }
        }
        self.take_end().is_some() || self.program.is_none()
    }

    /// Stops the program, and waits until none of its processes is left. Blocks for a limited time.
    fn end(&mut self, patience: Duration) {
        *lock(&self.care) = Care::Loop;
        let begin = now();
        self.ending = Some(Ending::new(begin, patience));
        let until = begin + patience + TERMINATE_WITHIN + KILL_WITHIN;
        while !self.has_ended(now()) && now() < until {
            self.bell.wait(now() + PERIOD);
        }
    }

    /// Returns the path of the program, for a person.
    fn shown(&self) -> String {
        self.prepared.path.display().to_string()
    }
}

/// Returns the services for the parameters of a node, or the reason why they cannot be called.
fn parameters_of(
    arguments: &Arguments,
    declared: &Declared,
    environment: &Environment,
) -> Result<NodeParameters, String> {
    let node = declared.node.clone().ok_or("the name of its node is not known: `node \"/name\";`")?;
    check_middleware(environment).map_err(|middleware| {
        format!("`RMW_IMPLEMENTATION` is `{middleware}`: parameters can only be asked for with `{MIDDLEWARE}`")
    })?;
    let network = setup::network_of(arguments, |name| environment.get(name).cloned())?;
    let own = format!("{}_parameters", setup::node_name(arguments));
    Ok(NodeParameters::new(Asked { node, network, own }))
}

/// Checks that the program uses the middleware whose services can be called; otherwise returns the middleware that it uses.
fn check_middleware(environment: &Environment) -> Result<(), &str> {
    let middleware = environment.get("RMW_IMPLEMENTATION").map_or("", String::as_str);
    if middleware == MIDDLEWARE { Ok(()) } else { Err(middleware) }
}

/// Returns the control of a program.
fn control(
    arguments: &Arguments,
    declared: &Declared,
    environment: &Environment,
    bell: &Arc<Bell>,
) -> Result<Control, String> {
    let has_lifecycle = !arguments.text("lifecycle_ms").is_empty();
    if !has_lifecycle && declared.components.is_empty() {
        return Ok(Control::None);
    }
    let (what, limit) = if has_lifecycle { ("a lifecycle", "lifecycle_ms") } else { ("components", "components_ms") };
    let name = declared.node.as_ref().ok_or_else(|| format!("a program with {what} needs the name of its node"))?;
    check_middleware(environment).map_err(|middleware| {
        format!("`RMW_IMPLEMENTATION` is `{middleware}`: {what} can only be controlled with `{MIDDLEWARE}`")
    })?;
    let within = millis(arguments, limit)?;
    let components = installation::requests(declared, environment)?;
    let network = setup::network_of(arguments, |name| environment.get(name).cloned())?;
    let (own, bell) = (setup::node_name(arguments), Arc::clone(bell));
    if has_lifecycle {
        let managed = Managed::open(name, &network, own, bell)?;
        return Ok(Control::Lifecycle(Life::new(name.to_string(), managed, within, now())));
    }
    let node = ContainerNode::open(name, &network, own, bell)?;
    Ok(Control::Container(Loader { name: name.to_string(), components, node, within, container: None, number: 0 }))
}

/// Returns the program that the arguments declare. `rest` contains the number of its own arguments, these arguments, and the arguments of
/// the process.
fn declared(arguments: &Arguments, rest: &[String]) -> Result<Declared, String> {
    let count = rest.first().map_or(Ok(0), |count| count.parse::<usize>());
    let count = count.map_err(|error| format!("the number of arguments belongs after `--`: {error}"))?;
    let rest = rest.get(1..).unwrap_or_default();
    let few = "there are fewer arguments than `--` says";
    let (words, rest) = rest.split_at_checked(count).ok_or(few)?;
    let count = arguments.text("component_words").parse().map_err(|error| format!("`component_words`: {error}"))?;
    let (components, given) = rest.split_at_checked(count).ok_or(few)?;
    let name = |parameter: &str| {
        let text = arguments.text(parameter);
        let is_fit = !text.contains('/') && !text.starts_with('.');
        is_fit.then(|| text.to_owned()).ok_or_else(|| format!("`{text}` is not a name of a {parameter}"))
    };
    let what = match (name("executable")?, name("launch")?) {
        (executable, launch) if launch.is_empty() && !executable.is_empty() => What::Executable(executable),
        (executable, launch) if executable.is_empty() && !launch.is_empty() => What::LaunchFile(launch),
        _ => return Err("a program of ROS 2 is an executable or a launch file".to_owned()),
    };
    let node = match arguments.text("node") {
        "" => None,
        text => Some(GraphName::parse(text).ok_or_else(|| format!("`{text}` is not a name of a node of ROS 2"))?),
    };
    let list = |parameter: &str, separator: char| {
        let parts = arguments.text(parameter).split(separator).filter(|part| !part.is_empty());
        parts.map(str::to_owned).collect::<Vec<_>>()
    };
    Ok(Declared {
        package: name("package")?,
        what,
        node,
        remaps: list("remaps", ' '),
        files: list("files", ':'),
        components: Component::list(components)?,
        words: words.to_vec(),
        given: given.to_vec(),
    })
}

fn millis(arguments: &Arguments, name: &str) -> Result<Duration, String> {
    let millis = arguments.text(name).parse().map_err(|error| format!("`{name}`: {error}"))?;
    Ok(Duration::from_millis(millis))
}

impl Module for RosNode {
    fn interface(&self) -> &Interface {
        &self.interface
    }

    fn deliver(&mut self, port: &str, _: &[u8], _: Time) -> Result<Delivery, DeliveryError> {
        Err(DeliveryError::NoInput { type_name: TYPE, port: port.to_owned() })
    }

    fn init(&mut self, _: &[u8], now: Time) -> Result<(), String> {
        if self.control.lifecycle().is_none() && self.program.is_some() {
            return Err(format!("its earlier program `{}` is still there", self.shown()));
        }
        *lock(&self.care) = Care::Loop;
        (self.ending, self.is_stopping, self.trouble) = (None, false, None);
        let starts = self.control.begin(now);
        self.start_if(starts, now);
        self.trouble.take().map_or(Ok(()), Err)
    }

    fn configure(&mut self, _: Arguments, _: bool) -> Result<Configured, String> {
        Err("a program of ROS 2 has no parameters that DCA changes".to_owned())
    }

    fn calculate(&mut self, now: Time) -> Progress {
        self.step(now);
        if let Some(end) = self.take_end() {
            return self.over(end);
        }
        if let Some(why) = self.trouble.take() {
            return Progress::Aborted(why);
        }
        match self.control.standing() {
            Some(Standing::Failed(why)) => Progress::Aborted(why.clone()),
            Some(Standing::Underway | Standing::Reached) | None => Progress::Continue,
        }
    }

    fn stop(&mut self, now: Time) -> Stopping {
        let is_first = !std::mem::replace(&mut self.is_stopping, true);
        let starts = if is_first { self.control.stop(now, self.stop) } else { self.control.step(now) };
        self.start_if(starts, now);
        if self.ending.is_none() && self.program.is_some() {
            match self.rest_of_program() {
                Rest::Stays => {
                    self.rest();
                    return Stopping::Finished;
                }
                Rest::Waits => {}
                Rest::Ends(patience) => self.ending = Some(Ending::new(now, patience)),
            }
        }
        if self.has_ended(now) {
            self.rest();
            return Stopping::Finished;
        }
        Stopping::Again
    }

    fn unconfirmed(&mut self) -> Option<String> {
        let is_there = self.ending.is_some() && self.program.is_some();
        is_there.then(|| format!("the program of ROS 2 `{}` has not ended by SIGKILL", self.shown()))
    }

    fn drain(&mut self, _: &mut dyn FnMut(&'static str, Vec<u8>)) {}

    fn serve(&mut self, name: &str, argument: &[u8], _: Activity, reply: RawReply) {
        match &mut self.parameters {
            Ok(parameters) => parameters.call(name, argument, reply),
            Err(why) => reply.answer(Err(ObjectError::Refused { reason: why.clone() })),
        }
    }

    fn signals(&self) -> Vec<Signal> {
        self.control.signal().into_iter().collect()
    }

    fn take_waker(&mut self, waker: Waker) {
        self.bell.take_waker(waker);
    }
}

impl Drop for RosNode {
    /// The node of the host tells this program to end, so the program of ROS 2 gets the time of a stop.
    fn drop(&mut self) {
        if self.program.is_some() {
            self.end(self.stop);
        }
        std::mem::replace(&mut self.control, Control::None).close();
    }
}
