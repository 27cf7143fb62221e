//! Quantities and durations in the form of Python: a number in SI units, or a text with a unit.

use comms::logic::time::Time;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::time::Duration;

/// Returns a quantity of this type in SI units: 0.2 for `"20 cm"`; a number is returned unchanged.
#[pyfunction]
pub(crate) fn si(value: &Bound<'_, PyAny>, type_name: &str) -> PyResult<f64> {
    if let Ok(number) = value.extract::<f64>() {
        return Ok(number);
    }
    let text: String = value.extract()?;
    let refused = || PyValueError::new_err(format!("`{text}` is not a {type_name}"));
    if type_name == "Number" {
        return text.trim().parse().map_err(|_no_number| refused());
    }
    language::quantity(&text, type_name).ok_or_else(refused)
}

/// Returns a duration: from a text such as `"20 ms"`, or from a number of seconds.
pub(crate) fn span(value: &Bound<'_, PyAny>) -> PyResult<Duration> {
    let seconds = si(value, "Time")?;
    let refused = |_out_of_range| PyValueError::new_err(format!("{seconds} s is not a span of time"));
    Duration::try_from_secs_f64(seconds).map_err(refused)
}

/// Returns a time of this host's clock, in seconds.
pub(crate) fn seconds(time: Time) -> f64 {
    time.since(Time::ZERO).as_secs_f64()
}

/// Returns the time of this host's clock for a number of seconds; none if it cannot be a time.
pub(crate) fn time(seconds: f64) -> Option<Time> {
    Duration::try_from_secs_f64(seconds).ok().map(|since| Time::ZERO + since)
}
