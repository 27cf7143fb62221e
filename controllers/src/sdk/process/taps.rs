//! The outputs of a program, for people who watch the running program: each value is sent to the watching clients,
//! without a wire.

use crate::sdk::interface::{Direction, Interface};
use crate::sdk::module::InnerValue;
use comms::io::clock::now;
use comms::io::data::{DataError, DataSession, Priority, Publisher, Responder};
use comms::logic::tap::{InnerOutput, OutputType, Outputs, Tapped};
use comms::logic::{codec, key};

/// The taps of a program; they exist after its first links were made.
#[derive(Debug, Default)]
pub(super) struct Taps {
    taps: Vec<Tap>,
    /// The taps of the outputs inside a group, in the order of [`Interface::inner`].
    inner: Vec<Tap>,
    _describing: Option<Responder>,
}

#[derive(Debug)]
struct Tap {
    output: String,
    publisher: Publisher,
    /// How many values have left the output. Inside a group, the group counts these values.
    number: u64,
}

impl Tap {
    /// Sends a value to the watching clients.
    fn show(&self, tapped: &Tapped) {
        if let Err(error) = codec::encode(tapped)
            .map_err(|error| error.to_string())
            .and_then(|bytes| self.publisher.put(bytes).map_err(|error| error.to_string()))
        {
            tracing::debug!(output = self.output, error, "a value is not shown");
        }
    }
}

impl Taps {
    pub(super) fn make(
        session: &DataSession,
        interface: &Interface,
        robot: &str,
        instance: &str,
    ) -> Result<Self, DataError> {
        let described = described(interface);
        let tap = |output: &OutputType| {
            let publisher = session.publisher(&key::tap(robot, instance, &output.name), Priority::Background)?;
            Ok(Tap { output: output.name.clone(), publisher, number: 0 })
        };
        let taps = described.outputs.iter().map(tap).collect::<Result<_, DataError>>()?;
        let inner = described.inner.iter().map(|inner| tap(&inner.output)).collect::<Result<_, DataError>>()?;
        let described = codec::encode(&described).ok();
        let describing = session.answer(&key::outputs(robot, instance), move || described.clone())?;
        Ok(Self { taps, inner, _describing: Some(describing) })
    }

    /// Returns whether an output is watched.
    pub(super) fn is_heard(&self, output: &str) -> bool {
        self.taps.iter().any(|tap| tap.output == output && tap.publisher.is_heard())
    }

    /// Counts a value of an output that is not watched.
    pub(super) fn count(&mut self, output: &str) {
        self.taps.iter_mut().filter(|tap| tap.output == output).for_each(|tap| tap.number += 1);
    }

    /// Counts a value of an output, and sends it to the watching clients. A value that is too long to be sent is still
    /// counted.
    pub(super) fn pass(&mut self, output: &str, bytes: &[u8]) {
        let Some(tap) = self.taps.iter_mut().find(|tap| tap.output == output) else { return };
        tap.number += 1;
        if tap.publisher.is_heard() {
            tap.show(&Tapped { number: tap.number, stamp: now(), bytes: bytes.to_vec() });
        }
    }

    /// Sends values of outputs inside a group to the watching clients, and sets which of these outputs are watched from
    /// now on.
    pub(super) fn show_inner(&self, values: &mut Vec<InnerValue>, heard: &mut [bool]) {
        for InnerValue { at, number, bytes } in values.drain(..) {
            if let Some(tap) = self.inner.get(at) {
                tap.show(&Tapped { number, stamp: now(), bytes });
            }
        }
        for (at, is_heard) in heard.iter_mut().enumerate() {
            *is_heard = self.inner.get(at).is_some_and(|tap| tap.publisher.is_heard());
        }
    }
}

/// Returns the program's description of its outputs.
fn described(interface: &Interface) -> Outputs {
    let output = |name: &str, type_name: &str, fields: &str| OutputType {
        name: name.to_owned(),
        type_name: type_name.to_owned(),
        fields: fields.trim_end_matches([',', ' ']).to_owned(),
    };
    let own = interface.ports.iter().filter(|port| port.direction == Direction::Out);
    let own = own.map(|port| output(port.name, port.type_name, port.fields));
    let inner = interface.inner.iter().map(|inner| InnerOutput {
        output: output(&inner.name, inner.type_name, inner.fields),
        inputs: inner.inputs.clone(),
    });
    Outputs { outputs: own.collect(), inner: inner.collect() }
}
