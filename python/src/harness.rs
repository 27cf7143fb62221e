//! Runs Python controllers in one thread and in virtual time, for tests.

use crate::declaration::Class;
use crate::instance::Instance;
use crate::quantity::{seconds, span};
use comms::logic::time::Time;
use controllers::sdk::Arguments;
use controllers::sdk::harness::{Disturbance, Ending, Harness, ModuleId, Report, WireId};
use pyo3::exceptions::{PyIndexError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::cell::RefCell;
use std::rc::Rc;

/// A value that has left an output: the time, the number of the module, the output, and the encoded value.
type SentValue = (Time, usize, &'static str, Vec<u8>);
/// The end of an activation: the module, the time in seconds, `done`, `aborted` or `stopped`, the value for the next process, and
/// the reason of an abort.
type Ended<'py> = (usize, f64, &'static str, Bound<'py, PyBytes>, String);

/// The native half of `dca.testing.Harness`, which identifies modules and wires by numbers.
#[pyclass(unsendable, module = "dca")]
pub(crate) struct NativeHarness {
    harness: Harness,
    modules: Vec<ModuleId>,
    wires: Vec<WireId>,
    sent: Rc<RefCell<Vec<SentValue>>>,
}

#[pymethods]
impl NativeHarness {
    #[new]
    fn new(seed: u64, is_busy: bool) -> Self {
        let quiet = Disturbance { seed, ..Disturbance::NONE };
        let mut harness = Harness::new(if is_busy { Disturbance::busy(seed) } else { quiet });
        let sent: Rc<RefCell<Vec<SentValue>>> = Rc::default();
        let heard = Rc::clone(&sent);
        harness.listen(move |value| {
            heard.borrow_mut().push((value.at, value.module.number(), value.port, value.bytes.to_vec()));
        });
        Self { harness, modules: Vec::new(), wires: Vec::new(), sent }
    }

    /// The present time, in seconds.
    #[getter]
    fn now(&self) -> f64 {
        seconds(self.harness.now())
    }

    /// Adds an idle controller; `arguments` are `name=value`, as from a node. Returns its number.
    fn add(&mut self, declaration: &Bound<'_, PyAny>, arguments: Vec<String>) -> PyResult<usize> {
        let class = Class::of(declaration)?;
        let arguments = Arguments::parse(class.interface.about.parameters, &arguments).map_err(refused)?;
        let instance = Instance::new(&class, &arguments).map_err(PyValueError::new_err)?;
        self.modules.push(self.harness.add(Box::new(instance)));
        Ok(self.modules.len() - 1)
    }

    /// Makes an open wire between `from` and `to`, each a module and a port. Returns the number of the wire.
    fn connect(&mut self, from: (usize, String), to: (usize, String)) -> PyResult<usize> {
        let (out, into) = (self.module(from.0)?, self.module(to.0)?);
        let wire = self.harness.connect((out, &from.1), (into, &to.1)).map_err(refused)?;
        self.harness.open(wire);
        self.wires.push(wire);
        Ok(self.wires.len() - 1)
    }

    /// Opens or closes a wire.
    fn switch(&mut self, wire: usize, is_open: bool) -> PyResult<()> {
        let wire = *self.wires.get(wire).ok_or_else(|| PyIndexError::new_err("there is no such wire"))?;
        if is_open {
            self.harness.open(wire);
        } else {
            self.harness.close(wire);
        }
        Ok(())
    }

    fn activate(&mut self, module: usize, value: &[u8]) -> PyResult<()> {
        let module = self.module(module)?;
        self.harness.activate(module, value);
        Ok(())
    }

    /// Sets other parameters of a controller.
    fn configure(&mut self, module: usize, arguments: Vec<String>) -> PyResult<()> {
        let module = self.module(module)?;
        let parameters = self.harness.module(module).interface().about.parameters;
        let arguments = Arguments::parse(parameters, &arguments).map_err(refused)?;
        self.harness.configure(module, arguments).map_err(PyValueError::new_err)
    }

    fn stop(&mut self, module: usize) -> PyResult<()> {
        let module = self.module(module)?;
        self.harness.stop(module);
        Ok(())
    }

    /// Kills a module like `kill -9`.
    fn crash(&mut self, module: usize) -> PyResult<()> {
        let module = self.module(module)?;
        self.harness.crash(module);
        Ok(())
    }

    /// Sends an encoded value to an input, like over a wire.
    fn send_to(&mut self, module: usize, port: &str, bytes: Vec<u8>) -> PyResult<()> {
        let module = self.module(module)?;
        self.harness.send_to(module, port, bytes).map_err(refused)
    }

    /// Lets time pass until an activation ends, at most `within`.
    fn run<'py>(&mut self, py: Python<'py>, within: &Bound<'_, PyAny>) -> PyResult<Option<Ended<'py>>> {
        let until = self.harness.now() + span(within)?;
        let Some(Report { at, module, ending }) = self.harness.run(until) else { return Ok(None) };
        let (word, value, reason) = match ending {
            Ending::Done(value) => ("done", value, String::new()),
            Ending::Aborted(reason) => ("aborted", Vec::new(), reason),
            Ending::Stopped => ("stopped", Vec::new(), String::new()),
            Ending::Unconfirmed(why) => ("unconfirmed", Vec::new(), why),
        };
        Ok(Some((module.number(), seconds(at), word, PyBytes::new(py, &value), reason)))
    }

    fn is_active(&self, module: usize) -> PyResult<bool> {
        Ok(self.harness.is_active(self.module(module)?))
    }

    /// Returns the values that have left outputs since the last call: the time in seconds, the module, the output, and the encoded
    /// value.
    fn take_sent<'py>(&self, py: Python<'py>) -> Vec<(f64, usize, &'static str, Bound<'py, PyBytes>)> {
        let sent = std::mem::take(&mut *self.sent.borrow_mut());
        sent.into_iter()
            .map(|(at, module, port, bytes)| (seconds(at), module, port, PyBytes::new(py, &bytes)))
            .collect()
    }
}

impl NativeHarness {
    fn module(&self, number: usize) -> PyResult<ModuleId> {
        self.modules.get(number).copied().ok_or_else(|| PyIndexError::new_err("there is no such module"))
    }
}

fn refused(error: impl std::fmt::Display) -> PyErr {
    PyValueError::new_err(error.to_string())
}
