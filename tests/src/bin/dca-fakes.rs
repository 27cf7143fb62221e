//! Stand-ins for every controller of the library, for tests of supervisors. They have the same interfaces, but no
//! physics.
//!
//! In a program's working folder, `fakes/journal` lists the changes of each stand-in: a line `TIME PATH active`, `…
//! ended` or `… stopped`, with TIME on the machine's clock in nanoseconds. A file `fakes/orders/PATH`, with `+` for
//! `/`, gives an order to a stand-in: `done`, `done found`, `abort why`, or `hang`. A hanging stand-in continues to
//! run, but sends nothing and never ends. `fakes/heard/PATH` counts its samples, with a line `PORT COUNT` for each
//! input.

use comms::io::clock::now;
use comms::logic::time::Time;
use controllers::sdk::{
    About, Arguments, Binding, Configured, Delivery, DeliveryError, Direction, Interface, Module, Progress, Registry,
    Schedule, Signal, Stopping, process,
};
use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::process::ExitCode;
use std::time::Duration;

/// The interval between two checks for orders.
const PERIOD: Duration = Duration::from_millis(20);
/// The number of checks after which a stand-in writes its counts.
const TELL_EVERY: u32 = 5;

struct Fake {
    interface: Interface,
    path: String,
    /// Whether it works. It sends only while it works.
    works: bool,
    heard: BTreeMap<String, u64>,
    looks: u32,
}

impl Fake {
    fn note(&self, word: &str) {
        let line = format!("{} {} {word}\n", now().nanos(), self.path);
        let journal = OpenOptions::new().append(true).create(true).open("fakes/journal");
        // If a line is missing, the test that reads the journal reports it.
        journal.and_then(|mut journal| journal.write_all(line.as_bytes())).unwrap_or_default();
    }

    fn file(&self, folder: &str) -> String {
        format!("fakes/{folder}/{}", self.path.replace('/', "+"))
    }

    fn order(&self) -> Option<String> {
        let file = self.file("orders");
        let order = fs::read_to_string(&file).ok()?;
        fs::remove_file(&file).ok()?;
        Some(order)
    }
}

impl Module for Fake {
    fn interface(&self) -> &Interface {
        &self.interface
    }

    fn deliver(&mut self, port: &str, _: &[u8], _: Time) -> Result<Delivery, DeliveryError> {
        *self.heard.entry(port.to_owned()).or_default() += 1;
        Ok(Delivery::Stored)
    }

    fn init(&mut self, _: &[u8], _: Time) -> Result<(), String> {
        drop(self.order());
        self.works = true;
        self.note("active");
        Ok(())
    }

    fn configure(&mut self, _: Arguments, _: bool) -> Result<Configured, String> {
        Ok(Configured::Later)
    }

    fn calculate(&mut self, _: Time) -> Progress {
        self.looks += 1;
        if self.looks.is_multiple_of(TELL_EVERY) {
            let lines = self.heard.iter().map(|(port, count)| format!("{port} {count}\n"));
            // A reader sees the whole new file or the whole old one.
            let (file, draft) = (self.file("heard"), self.file("draft"));
            let written = fs::write(&draft, lines.collect::<String>());
            written.and_then(|()| fs::rename(&draft, &file)).unwrap_or_default();
        }
        let Some(order) = self.order() else { return Progress::Continue };
        let progress = match order.trim().split_once(' ').unwrap_or((order.trim(), "")) {
            ("done", "") => Progress::Done(Vec::new()),
            ("done", tag) => Progress::outcome(tag, &()),
            ("abort", why) => Progress::Aborted(why.to_owned()),
            _ => {
                self.works = false;
                Progress::Continue
            }
        };
        if progress != Progress::Continue {
            (self.works, ()) = (false, self.note("ended"));
        }
        progress
    }

    fn stop(&mut self, _: Time) -> Stopping {
        self.works = false;
        self.note("stopped");
        Stopping::Finished
    }

    fn drain(&mut self, send: &mut dyn FnMut(&'static str, Vec<u8>)) {
        if self.works {
            let outputs = self
                .interface
                .ports
                .iter()
                .filter(|port| (port.direction, port.binding) == (Direction::Out, Binding::Wire));
            // These tests do not read the content.
            outputs.for_each(|port| send(port.name, vec![0]));
        }
    }

    fn signals(&self) -> Vec<Signal> {
        Vec::new()
    }
}

/// Makes a stand-in that checks for orders as often as all others.
fn fake(interface: &Interface, _: &Arguments) -> Result<Box<dyn Module>, String> {
    let path = std::env::var("DCA_INSTANCE").unwrap_or_default();
    Ok(Box::new(Fake { interface: interface.clone(), path, works: false, heard: BTreeMap::new(), looks: 0 }))
}

fn main() -> ExitCode {
    let mut registry = Registry::default();
    for interface in controllers::registry().interfaces() {
        let schedule = Schedule { period: PERIOD, trigger: None };
        let about = About { schedule, signals_every: None, ..interface.about.clone() };
        registry.add_module(Interface { about, ..interface.clone() }, fake);
    }
    process::run(&registry)
}
