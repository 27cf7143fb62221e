//! A driver for a thermometer with a heater on a serial port, and such a device, simulated on a pseudo-terminal.
//!
//! The protocol: the device sends `T 21.50` each 50 ms (°C) and obeys `H 1` and `H 0` (heater on, off), a line each.

use crate::headline;
use controllers::sdk::serde::{Deserialize, Serialize};
use controllers::sdk::{
    About, Arguments, Controller, In, Inputs, Kind, Message, Out, Outputs, Parameter, Progress, Registry, Signal,
    Stopping, Tick, Time,
};
use rustix::fd::OwnedFd;
use rustix::fs::{Mode, OFlags, open};
use rustix::io::{Errno, read, write};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{ControlModes, OptionalActions, tcgetattr, tcsetattr};
use std::time::Duration;

const PERIOD: Duration = Duration::from_millis(20);
/// How long the device may be silent.
const SILENCE: Duration = Duration::from_secs(1);
/// The longest line that can mean anything (bytes).
const LINE_MAX: usize = 64;

#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(crate = "controllers::sdk::serde")]
struct Temperature {
    /// (°C)
    celsius: f64,
}

impl Message for Temperature {
    const TYPE: &'static str = "Temperature";
    const FIELDS: &'static str = "celsius: Number";
}

/// Both ends of the line: bytes in, whole lines out. Nothing here waits.
#[derive(Debug)]
struct Line {
    port: OwnedFd,
    received: Vec<u8>,
}

impl Line {
    /// Opens a serial port, raw, at its present speed.
    fn open(path: &str) -> Result<Self, String> {
        let failed = |why: Errno| format!("cannot open the serial port `{path}`: {why}");
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let port = open(path, flags, Mode::empty()).map_err(failed)?;
        let mut settings = tcgetattr(&port).map_err(|_no_terminal| format!("`{path}` is not a serial port"))?;
        settings.make_raw();
        settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
        tcsetattr(&port, OptionalActions::Now, &settings).map_err(failed)?;
        Ok(Self { port, received: Vec::new() })
    }

    /// Returns the lines that have come in since the last time.
    fn lines(&mut self) -> Result<Vec<String>, String> {
        let mut bytes = [0; 256];
        loop {
            match read(&self.port, &mut bytes) {
                Ok(0) => return Err("the serial port was unplugged".to_owned()),
                Ok(count) => self.received.extend(&bytes[..count]),
                Err(Errno::AGAIN) => break,
                Err(Errno::INTR) => {}
                Err(why) => return Err(format!("cannot read from the serial port: {why}")),
            }
            if self.received.len() > 64 * LINE_MAX {
                break;
            }
        }
        let end = self.received.iter().rposition(|byte| *byte == b'\n').map_or(0, |end| end + 1);
        let whole: Vec<u8> = self.received.drain(..end).collect();
        if self.received.len() > LINE_MAX {
            self.received.clear();
        }
        Ok(String::from_utf8_lossy(&whole).lines().map(|line| line.trim().to_owned()).collect())
    }

    /// Sends a line; a line that does not fit into the queue is lost, as on a real line.
    fn say(&self, line: &str) -> Result<(), String> {
        match write(&self.port, format!("{line}\n").as_bytes()) {
            Ok(_) | Err(Errno::AGAIN | Errno::INTR) => Ok(()),
            Err(why) => Err(format!("cannot write to the serial port: {why}")),
        }
    }
}

#[derive(Outputs)]
struct DriverOutputs {
    /// The measured temperature.
    #[port("Out")]
    temperature: Out<Temperature>,
}

/// The driver. It does I/O in its calculations, and never waits there.
#[derive(Debug)]
struct SerialThermometer {
    path: String,
    heater: bool,
    line: Option<Line>,
    heard: Option<Time>,
    celsius: f64,
}

impl SerialThermometer {
    fn exchange(&mut self, now: Time) -> Result<Option<f64>, String> {
        let since = *self.heard.get_or_insert(now);
        let line = match &mut self.line {
            Some(line) => line,
            // A device that is plugged in a little later is waited for.
            None => match Line::open(&self.path) {
                Ok(line) => self.line.insert(line),
                Err(why) if now.since(since) > SILENCE => return Err(why),
                Err(_) => return Ok(None),
            },
        };
        let newest = line.lines()?.iter().rev().find_map(|line| line.strip_prefix("T ")?.parse::<f64>().ok());
        line.say(if self.heater { "H 1" } else { "H 0" })?;
        match newest.filter(|celsius| celsius.is_finite()) {
            Some(celsius) => {
                (self.heard, self.celsius) = (Some(now), celsius);
                Ok(Some(celsius))
            }
            None if now.since(since) > SILENCE => Err(format!("no word from the device at `{}` for 1 s", self.path)),
            None => Ok(None),
        }
    }
}

impl Controller for SerialThermometer {
    type Inputs = ();
    type Outputs = DriverOutputs;
    const TYPE: &'static str = "SerialThermometer";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[
            Parameter::new("path", Kind::Text(&[])).or("/dev/ttyUSB0"),
            Parameter::new("heater", Kind::Truth).or("true"),
        ];
        About::service("Reads a thermometer on a serial port, and switches its heater.")
            .every(PERIOD)
            .with(PARAMETERS)
            .signals_every(Duration::from_millis(100))
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let (path, heater) = (arguments.text("path").to_owned(), arguments.truth("heater"));
        Ok(Self { path, heater, line: None, heard: None, celsius: f64::NAN })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        (self.line, self.heard) = (None, None);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, (): &(), outputs: &mut DriverOutputs) -> Progress {
        match self.exchange(tick.now) {
            Ok(Some(celsius)) => outputs.temperature.send(Temperature { celsius }),
            Ok(None) => {}
            Err(why) => return Progress::Aborted(why),
        }
        Progress::Continue
    }

    fn stop(&mut self, _: Tick, (): &(), _: &mut DriverOutputs) -> Stopping {
        // The heater is off when this controller does not run. A missing device heats nothing.
        drop(self.line.take().map(|line| line.say("H 0")));
        Stopping::Finished
    }

    fn signals(&self) -> Vec<Signal> {
        vec![headline("temperature", "°C", self.celsius)]
    }
}

#[derive(Inputs)]
struct WarmInputs {
    /// A thermometer.
    #[port("In")]
    temperature: In<Temperature>,
}

/// Ends when it is warm.
#[derive(Debug)]
struct WaitWarm {
    threshold: f64,
}

impl Controller for WaitWarm {
    type Inputs = WarmInputs;
    type Outputs = ();
    const TYPE: &'static str = "WaitWarm";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("threshold", Kind::Number(-50.0, 200.0))];
        About::task("Ends when it is warmer than a threshold [°C].").every(PERIOD).triggered_by("In").with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        Ok(Self { threshold: arguments.number("threshold") })
    }

    fn main_calc(&mut self, _: Tick, inputs: &WarmInputs, (): &mut ()) -> Progress {
        match inputs.temperature.fresh() {
            Some(temperature) if temperature.celsius > self.threshold => Progress::Done(Vec::new()),
            Some(_) | None => Progress::Continue,
        }
    }
}

/// The device: a pseudo-terminal with its own name, and a thread that answers at its other end.
#[derive(Debug)]
struct FakeDevice {
    path: String,
    ends: Option<Ends>,
    celsius: f64,
    heats: bool,
    said: Time,
}

#[derive(Debug)]
struct Ends {
    device: Line,
    /// As long as this is open, a driver may come and go.
    _port: OwnedFd,
}

impl FakeDevice {
    /// Makes the terminal, and a link to it under the name that the driver gets.
    fn plug_in(&self) -> Result<Ends, String> {
        let failed = |why: Errno| format!("cannot make a pseudo-terminal: {why}");
        let device = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).map_err(failed)?;
        grantpt(&device).and_then(|()| unlockpt(&device)).map_err(failed)?;
        rustix::fs::fcntl_setfl(&device, OFlags::NONBLOCK).map_err(failed)?;
        let name = ptsname(&device, Vec::new()).map_err(failed)?;
        let port = Line::open(name.to_str().map_err(|_no_text| "the name of a terminal is not text")?)?.port;
        // A link left by an earlier run is replaced; a file that is not a link is kept.
        if std::fs::symlink_metadata(&self.path).is_ok_and(|link| link.is_symlink()) {
            std::fs::remove_file(&self.path).map_err(|why| format!("cannot replace `{}`: {why}", self.path))?;
        }
        std::os::unix::fs::symlink(&*name.to_string_lossy(), &self.path)
            .map_err(|why| format!("cannot make `{}`: {why}", self.path))?;
        Ok(Ends { device: Line { port: device, received: Vec::new() }, _port: port })
    }

    fn answer(&mut self, tick: Tick) -> Result<(), String> {
        let Some(ends) = &mut self.ends else { return Ok(()) };
        for line in ends.device.lines()? {
            self.heats = line == "H 1" || line != "H 0" && self.heats;
        }
        self.celsius += tick.dt().min(0.1) * if self.heats { 5.0 } else { -0.1 * (self.celsius - 20.0) };
        if tick.now.since(self.said) >= Duration::from_millis(50) {
            self.said = tick.now;
            ends.device.say(&format!("T {:.2}", self.celsius))?;
        }
        Ok(())
    }
}

impl Controller for FakeDevice {
    type Inputs = ();
    type Outputs = ();
    const TYPE: &'static str = "FakeThermometer";

    fn about() -> About {
        const PARAMETERS: &[Parameter] = &[Parameter::new("path", Kind::Text(&[]))];
        About::service("A thermometer with a heater on a pseudo-terminal; a link to that is made at a path.")
            .remembers()
            .every(PERIOD)
            .with(PARAMETERS)
    }

    fn new(arguments: &Arguments) -> Result<Self, String> {
        let path = arguments.text("path").to_owned();
        Ok(Self { path, ends: None, celsius: 20.0, heats: false, said: Time::ZERO })
    }

    fn init(&mut self, _: &[u8]) -> Result<(), String> {
        self.ends = Some(self.plug_in()?);
        Ok(())
    }

    fn main_calc(&mut self, tick: Tick, (): &(), (): &mut ()) -> Progress {
        self.answer(tick).map_or_else(Progress::Aborted, |()| Progress::Continue)
    }

    fn stop(&mut self, _: Tick, (): &(), (): &mut ()) -> Stopping {
        if self.ends.take().is_some() {
            // If the link is already gone, nothing is left to do.
            drop(std::fs::remove_file(&self.path));
        }
        Stopping::Finished
    }
}

pub(crate) fn add(registry: &mut Registry) {
    registry.add::<SerialThermometer>().add::<WaitWarm>().add::<FakeDevice>();
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::event::{PollFd, PollFlags, Timespec, poll};

    /// The driver's side of a real pseudo-terminal, without a device that answers.
    #[test]
    fn what_is_no_line_of_the_protocol_is_passed_over() {
        let path = std::env::temp_dir().join(format!("dca-serial-{}", std::process::id())).display().to_string();
        let fake = FakeDevice { path: path.clone(), ends: None, celsius: 0.0, heats: false, said: Time::ZERO };
        let ends = fake.plug_in().unwrap();
        let mut driver = SerialThermometer { path: path.clone(), heater: true, line: None, heard: None, celsius: 0.0 };
        let at = |millis| Time::ZERO + Duration::from_millis(millis);
        assert_eq!(driver.exchange(at(0)), Ok(None));
        let lines: [(&[u8], _); 4] =
            [(b"T 21.5\nT 2", Some(21.5)), (b"2.5\n", Some(22.5)), (b"T nan\n", None), (b"\x7fT\n", None)];
        for (said, heard) in lines {
            assert_eq!(write(&ends.device.port, said), Ok(said.len()));
            // The kernel hands it over when it likes.
            let port = &driver.line.as_ref().unwrap().port;
            let wait = Timespec { tv_sec: 10, tv_nsec: 0 };
            assert_eq!(poll(&mut [PollFd::new(port, PollFlags::IN)], Some(&wait)), Ok(1));
            assert_eq!(driver.exchange(at(10)), Ok(heard), "{said:?}");
        }
        let silent = driver.exchange(at(1100)).unwrap_err();
        assert_eq!(silent, format!("no word from the device at `{path}` for 1 s"));
        drop(ends);
        assert!(driver.exchange(at(1110)).unwrap_err().contains("the serial port"));
        std::fs::remove_file(&path).unwrap();
    }
}
