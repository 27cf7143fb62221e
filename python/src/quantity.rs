//! Quantities and spans of time as Python gives them: a number in SI units, or a text with a unit.

use comms::logic::time::Time;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::time::Duration;

/// Returns a value of this type of quantities in SI units: of `"20 cm"` 0.2, of a number itself.
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

/// Returns a span of time: of `"20 ms"`, or of a number in seconds.
pub(crate) fn span(value: &Bound<'_, PyAny>) -> PyResult<Duration> {
    let seconds = si(value, "Time")?;
    let refused = |_out_of_range| PyValueError::new_err(format!("{seconds} s is not a span of time"));
    Duration::try_from_secs_f64(seconds).map_err(refused)
}

/// Returns a time of this host's clock in seconds.
pub(crate) fn seconds(time: Time) -> f64 {
    time.since(Time::ZERO).as_secs_f64()
}

/// Returns the time that is so many seconds on this host's clock; none if it cannot be.
pub(crate) fn time(seconds: f64) -> Option<Time> {
    Duration::try_from_secs_f64(seconds).ok().map(|since| Time::ZERO + since)
}
