//! A second plant for `specs/door_opening.dca`: the same six devices, served by MuJoCo in a Python program beside this
//! one.
//!
//! Python hears a line of JSON and answers with one, see `door.py`. Nothing here waits for it but the start: a
//! calculation takes the answer to the line before and sends the next.

use controllers::message::{
    ArmCommand, ArmState, BaseCommand, BaseState, CameraState, FtCommand, FtState, GripperCommand, GripperState,
    LaserState,
};
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Out, Outputs, Parameter, Progress, Registry, Signal, Tick, Time,
};
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::sync::mpsc::{Receiver, sync_channel};
use std::time::Duration;

const SCRIPT: &str = include_str!("door.py");
/// The longest time in which Python has to find its libraries and make the world.
const START: Duration = Duration::from_secs(30);
/// The longest silence after that.
const SILENCE: Duration = Duration::from_secs(2);

/// The inputs of the controller.
#[derive(Debug, Inputs)]
struct Commands {
    /// To the arm.
    #[device("arm/cmd", owner)]
    arm: In<ArmCommand>,
    /// To the base.
    #[device("base/cmd", owner)]
    base: In<BaseCommand>,
    /// To the wrist sensor.
    #[device("ft/cmd", owner)]
    force: In<FtCommand>,
    /// To the gripper.
    #[device("gripper/cmd", owner)]
    gripper: In<GripperCommand>,
}

/// The outputs of the controller.
#[derive(Debug, Outputs)]
struct States {
    /// The arm's encoders.
    #[device("arm/state", owner)]
    arm: Out<ArmState>,
    /// The base's encoders.
    #[device("base/state", owner)]
    base: Out<BaseState>,
    /// The wrist sensor.
    #[device("ft/state", owner)]
    force: Out<FtState>,
    /// The gripper.
    #[device("gripper/state", owner)]
    gripper: Out<GripperState>,
    /// The laser.
    #[device("laser/state", owner)]
    laser: Out<LaserState>,
    /// The camera.
    #[device("camera/state", owner)]
    camera: Out<CameraState>,
}

/// A line to Python: the time to advance to, whether a new world begins, and the newest command of each device.
#[derive(Debug, Default, Serialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Request {
    now: Time,
    begin: bool,
    arm: Option<ArmCommand>,
    base: Option<BaseCommand>,
    ft: Option<FtCommand>,
    gripper: Option<GripperCommand>,
}

/// A line from Python: the samples that are due, and the truth as name, unit, value and whether a summary shows it.
#[derive(Debug, Default, Deserialize)]
#[serde(crate = "controllers::sdk::serde", deny_unknown_fields)]
struct Answer {
    arm: Option<ArmState>,
    base: Option<BaseState>,
    ft: Option<FtState>,
    gripper: Option<GripperState>,
    laser: Option<LaserState>,
    camera: Option<CameraState>,
    signals: Vec<(String, String, f64, bool)>,
}

/// The Python program; it ends with its standard input.
#[derive(Debug)]
struct Python {
    child: Child,
    requests: ChildStdin,
    answers: Receiver<String>,
}

impl Python {
    /// Starts it with `name=value` arguments.
    fn start(interpreter: &str, arguments: &[String]) -> Result<Self, String> {
        let mut command = Command::new(interpreter);
        command.args(["-u", "-c", SCRIPT]).args(arguments).stdin(Stdio::piped()).stdout(Stdio::piped());
        let mut child = command.spawn().map_err(|why| format!("cannot start `{interpreter}`: {why}"))?;
        let (requests, lines) = child.stdin.take().zip(child.stdout.take()).expect("both were asked for as pipes");
        let (tx, answers) = sync_channel(1);
        // It ends with the program's standard output, at the latest when the child is killed.
        let _reader = std::thread::spawn(move || {
            BufReader::new(lines).lines().map_while(Result::ok).try_for_each(|line| tx.send(line))
        });
        Ok(Self { child, requests, answers })
    }

    fn send(&mut self, request: &Request) -> Result<(), String> {
        let mut line = serde_json::to_string(request).map_err(|why| format!("cannot write a line to Python: {why}"))?;
        line.push('\n');
        self.requests.write_all(line.as_bytes()).map_err(|_closed| "Python has ended; `dca logs` says why".to_owned())
    }
}

impl Drop for Python {
    fn drop(&mut self) {
        // A child that has ended cannot be killed; it still has to be waited for.
        let _ended = self.child.kill();
        let _code = self.child.wait();
    }
}

/// A robot before a door, in MuJoCo.
#[derive(Debug)]
struct MujocoDoor {
    python: Python,
    request: Request,
    /// When the line was sent that is not answered yet.
    asked: Option<Time>,
    signals: Vec<Signal>,
}

impl MujocoDoor {
    /// Sends what came out of the physics.
    fn publish(&mut self, answer: Answer, outputs: &mut States) {
        let Answer { arm, base, ft, gripper, laser, camera, signals } = answer;
        let _sent = (arm.map(|state| outputs.arm.send(state)), base.map(|state| outputs.base.send(state)));
        let _sent = (ft.map(|state| outputs.force.send(state)), gripper.map(|state| outputs.gripper.send(state)));
        let _sent = (laser.map(|state| outputs.laser.send(state)), camera.map(|state| outputs.camera.send(state)));
        self.signals =
            signals.into_iter().map(|(name, unit, value, headline)| Signal { name, unit, value, headline }).collect();
    }

    fn exchange(&mut self, now: Time, outputs: &mut States) -> Result<(), String> {
        if let Ok(line) = self.python.answers.try_recv() {
            let answer = serde_json::from_str(&line).map_err(|why| format!("Python said what is no answer: {why}"))?;
            self.publish(answer, outputs);
            self.asked = None;
        }
        match self.asked {
            Some(asked) if now.since(asked) > SILENCE => Err("no word from MuJoCo for 2 s".to_owned()),
            Some(_) => Ok(()),
            None => {
                let request = Request { now, ..std::mem::take(&mut self.request) };
                self.asked = Some(now);
                self.python.send(&request)
            }
        }
    }
}

impl Controller for MujocoDoor {
    type Inputs = Commands;
    type Outputs = States;
    const TYPE: &'static str = "MujocoDoor";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("side", Kind::Text(&["left", "right"])).or("left"),
            Parameter::new("swing", Kind::Text(&["pull", "push"])).or("pull"),
            Parameter::new("seed", Kind::Number(0.0, 1e9)).or("1"),
            Parameter::new("python", Kind::Text(&[])).or("python3"),
        ];
        About::service("Simulates the robot before a door with MuJoCo and owns its devices.")
            .remembers()
            .every(Duration::from_millis(4))
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(40))
    }

    /// The physics is there before the program says that it is.
    fn new(arguments: &Arguments) -> Result<Self, String> {
        let told = ["side", "swing"].map(|name| format!("{name}={}", arguments.text(name)));
        let seed = format!("seed={}", arguments.number("seed"));
        let mut python = Python::start(arguments.text("python"), &[told.as_slice(), &[seed]].concat())?;
        python.send(&Request::default())?;
        python.answers.recv_timeout(START).map_err(|_silent| {
            "Python does not answer: does it have the packages `mujoco` and `numpy`? `dca logs` says more".to_owned()
        })?;
        Ok(Self { python, request: Request::default(), asked: None, signals: Vec::new() })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.request = Request { begin: true, ..Request::default() };
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, inputs: &Commands, outputs: &mut States) -> Progress {
        let request = &mut self.request;
        request.arm = inputs.arm.fresh().cloned().or(request.arm.take());
        request.base = inputs.base.fresh().cloned().or(request.base.take());
        request.ft = inputs.force.fresh().cloned().or(request.ft.take());
        request.gripper = inputs.gripper.fresh().cloned().or(request.gripper.take());
        match self.exchange(tick.now, outputs) {
            Ok(()) => Progress::Continue,
            Err(why) => Progress::Aborted(why),
        }
    }

    fn signals(&self) -> Vec<Signal> {
        self.signals.clone()
    }
}

/// Adds the controllers of this example.
pub(crate) fn add(registry: &mut Registry) {
    registry.add::<MujocoDoor>();
}
