//! The process: the implementation of `dca.run`.

use crate::declaration::Class;
use crate::forked;
use crate::instance::Instance;
use controllers::sdk::process::{Embedding, run_in};
use controllers::sdk::{Module, Registry};
use language::{Diagnostic, Options, Origin, Severity, Source};
use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::process::ExitCode;
use std::sync::Arc;

/// Runs this process as the controller that its arguments name; returns its exit code. Other Python threads run in the meantime.
#[pyfunction]
pub(crate) fn run(py: Python<'_>, declarations: Vec<Py<PyAny>>, arguments: Vec<String>) -> PyResult<u8> {
    let registry = registry(py, &declarations)?;
    forked::remember();
    let code = py.detach(|| run_in(&registry, &Embedding { arguments, around }));
    Ok((0..=2).find(|number| ExitCode::from(*number) == code).unwrap_or(1))
}

/// Returns the interfaces of classes, as `module` blocks of a spec. Names that a spec cannot have are refused.
#[pyfunction]
pub(crate) fn interface(py: Python<'_>, declarations: Vec<Py<PyAny>>) -> PyResult<String> {
    let text = registry(py, &declarations)?.interface_text();
    let (spec, told) = (Source::new("spec", "process main(){\n}\n"), Source::new("interface", text.as_str()));
    let compiled = language::compile(&spec, &[told], &Options::named("spec"));
    let is_wrong = |found: &&Diagnostic| found.severity == Severity::Error && found.primary.span.origin != Origin::Spec;
    let Some(wrong) = compiled.diagnostics.iter().find(is_wrong) else { return Ok(text) };
    let before = text.get(..wrong.primary.span.start as usize).unwrap_or_default();
    let line = text.lines().nth(before.matches('\n').count()).unwrap_or_default().trim().to_owned();
    Err(PyValueError::new_err(format!("`{line}` cannot be in a spec: {}", wrong.message)))
}

fn registry(py: Python<'_>, declarations: &[Py<PyAny>]) -> PyResult<Registry> {
    let mut registry = Registry::default();
    let mut messages = BTreeMap::new();
    for declaration in declarations {
        let class = Class::of(declaration.bind(py))?;
        let interface = class.interface.clone();
        if registry.interface(interface.type_name).is_some() {
            return Err(twice("controllers", interface.type_name));
        }
        let own = interface.messages().map(|(name, fields)| (name.to_owned(), fields.to_owned()));
        for (name, fields) in own.chain(class.inner_types(py)) {
            let is_other = messages.insert(name.clone(), fields.clone()).is_some_and(|before| before != fields);
            if is_other {
                return Err(twice("message types", &name));
            }
        }
        for (name, fields) in class.inner_types(py) {
            registry.add_type(&name, &fields);
        }
        registry.add_module(interface, move |_, arguments| {
            let instance = Instance::new(&Arc::clone(&class), arguments)?;
            Ok(Box::new(instance) as Box<dyn Module>)
        });
    }
    Ok(registry)
}

fn twice(kind: &str, name: &str) -> PyErr {
    PyTypeError::new_err(format!("there are two {kind} `{name}`: give one of them another `name`"))
}

/// Runs the control loop as one Python thread. Without this, Python would treat each calculation as a new thread, with new thread-local
/// values.
fn around(run: &mut (dyn FnMut() + Send)) {
    Python::attach(|py| py.detach(run));
}
