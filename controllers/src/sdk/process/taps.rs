//! The outputs of a program as people look at them while it works: each value goes to whoever listens, over no wire.

use crate::sdk::interface::{Direction, Interface};
use comms::io::clock::now;
use comms::io::data::{DataError, DataSession, Priority, Publisher, Responder};
use comms::logic::tap::{OutputType, Outputs, Tapped};
use comms::logic::{codec, key};

/// The taps of a program, from its first links on.
#[derive(Debug, Default)]
pub(super) struct Taps {
    taps: Vec<Tap>,
    _describing: Option<Responder>,
}

#[derive(Debug)]
struct Tap {
    output: &'static str,
    publisher: Publisher,
    /// How many values have left the output.
    number: u64,
}

impl Taps {
    pub(super) fn make(
        session: &DataSession,
        interface: &Interface,
        (robot, instance): (&str, &str),
    ) -> Result<Self, DataError> {
        let outputs = || interface.ports.iter().filter(|port| port.direction == Direction::Out);
        let tap = |output: &'static str| {
            let publisher = session.publisher(&key::tap(robot, instance, output), Priority::Background)?;
            Ok(Tap { output, publisher, number: 0 })
        };
        let taps = outputs().map(|port| tap(port.name)).collect::<Result<_, DataError>>()?;
        let described = outputs().map(|port| OutputType {
            name: port.name.to_owned(),
            type_name: port.type_name.to_owned(),
            fields: port.fields.trim_end_matches([',', ' ']).to_owned(),
        });
        let described = codec::encode(&Outputs { outputs: described.collect() }).ok();
        let describing = session.answer(&key::outputs(robot, instance), move || described.clone())?;
        Ok(Self { taps, _describing: Some(describing) })
    }

    /// Returns whether somebody looks at an output.
    pub(super) fn is_heard(&self, output: &str) -> bool {
        self.taps.iter().any(|tap| tap.output == output && tap.publisher.is_heard())
    }

    /// Counts a value of an output at which nobody looks.
    pub(super) fn count(&mut self, output: &str) {
        self.taps.iter_mut().filter(|tap| tap.output == output).for_each(|tap| tap.number += 1);
    }

    /// Counts a value of an output, and shows it to whoever listens. One that is too long to be shown is counted all the same.
    pub(super) fn pass(&mut self, output: &str, bytes: &[u8]) {
        let Some(tap) = self.taps.iter_mut().find(|tap| tap.output == output) else { return };
        tap.number += 1;
        if !tap.publisher.is_heard() {
            return;
        }
        let tapped = Tapped { number: tap.number, stamp: now(), bytes: bytes.to_vec() };
        if let Err(error) = codec::encode(&tapped)
            .map_err(|error| error.to_string())
            .and_then(|bytes| tap.publisher.put(bytes).map_err(|error| error.to_string()))
        {
            tracing::debug!(output, error, "a value is not shown");
        }
    }
}
