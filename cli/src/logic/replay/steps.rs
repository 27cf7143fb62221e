//! The steps of a stand-in: the activations of its process in the record, and the values that were sent in each of them.

use super::StandIn;
use super::encode::{Encoded, encode};
use crate::logic::record::{Entry, RecordedValue, Run};
use comms::logic::layout::Message;
use comms::logic::replay::{STEPS_MAX, Stamp, Step, append};
use node::logic::protocol::{Change, Ending, Report};
use node::logic::table::counted;
use std::collections::BTreeMap;
use std::time::Duration;

/// The largest number of activations for which the message lists the number of values of each activation.
const ACTIVATIONS_MAX: usize = 8;

/// The recorded values of the outputs of a process.
#[derive(Debug)]
pub(crate) struct Recorded {
    /// The steps, in the form of a stand-in's file.
    pub(crate) steps: Vec<u8>,
    /// How many values of each output can be played, and how many cannot be played.
    pub(crate) counts: BTreeMap<String, Counts>,
    /// How many activations there are.
    activations: usize,
    /// How many values of each output are played in each activation.
    by_activation: BTreeMap<String, BTreeMap<usize, u64>>,
}

/// The number of values of an output.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Counts {
    /// Values that are played.
    pub(crate) played: u64,
    /// Values that are not complete in the record, or whose type differs from the type in the spec.
    pub(crate) lost: u64,
}

/// A part of the record in which a process was active.
#[derive(Debug)]
struct Activation {
    began: Duration,
    ended: Option<Step>,
}

/// Returns the steps of the process with this path. `message` returns the type of an output.
///
/// # Errors
/// A sentence for a person: there are too many values.
pub(crate) fn steps<'a>(
    run: &Run,
    path: &str,
    stand_in: &StandIn,
    message: impl Fn(&str) -> Option<&'a Message>,
) -> Result<Recorded, String> {
    let mut activations = activations(&run.entries, path).into_iter().peekable();
    let mut recorded =
        Recorded { steps: Vec::new(), counts: BTreeMap::new(), activations: 0, by_activation: BTreeMap::new() };
    let mut current: Option<Activation> = None;
    for Sent { port, output, at, encoded, origin } in sent(run, path, stand_in, message) {
        while activations.peek().is_some_and(|next| current.is_none() || next.began <= at) {
            recorded.end(current.take())?;
            recorded.begin()?;
            current = activations.next();
        }
        if recorded.steps.is_empty() {
            // The beginning of the activation is missing in the record.
            recorded.begin()?;
        }
        let began = current.as_ref().map_or(Duration::ZERO, |activation| activation.began);
        let counts = recorded.counts.entry(output.to_owned()).or_default();
        match encoded {
            None => counts.lost += 1,
            Some(encoded) => {
                counts.played += 1;
                let of_output = recorded.by_activation.entry(output.to_owned()).or_default();
                *of_output.entry(recorded.activations).or_default() += 1;
                let stamp = stamp(&encoded, origin, began);
                let at = at.saturating_sub(began);
                recorded.add(&Step::Value { at, port, bytes: encoded.bytes, stamp })?;
            }
        }
    }
    recorded.end(current)?;
    for activation in activations {
        recorded.begin()?;
        recorded.end(Some(activation))?;
    }
    Ok(recorded)
}

impl Recorded {
    /// Returns in words how many values of an output are played. If there are several activations, the mission decides
    /// how many of them are played: it activates the process as often as it needs.
    pub(crate) fn plays(&self, output: &str) -> String {
        let played = self.counts.get(output).map_or(0, |counts| counts.played);
        let all = counted(played, "value");
        if self.activations < 2 {
            return all;
        }
        let of_output = self.by_activation.get(output);
        let count = |number| of_output.and_then(|counts| counts.get(&number)).copied().unwrap_or_default().to_string();
        let mut each: Vec<String> = (1..=self.activations.min(ACTIVATIONS_MAX)).map(count).collect();
        each.extend((self.activations > ACTIVATIONS_MAX).then(|| "…".to_owned()));
        let (times, each) = (self.activations, each.join(", "));
        format!(
            "{all} of {times} activations ({each}); each activation of the process plays the values of the next recorded activation, so all values are played only \
             if the mission activates it {times} times"
        )
    }

    fn begin(&mut self) -> Result<(), String> {
        self.activations += 1;
        self.add(&Step::Begin)
    }

    fn add(&mut self, step: &Step) -> Result<(), String> {
        let bytes = std::mem::take(&mut self.steps);
        self.steps = append(step, bytes).map_err(|error| error.to_string())?;
        let is_fit = u64::try_from(self.steps.len()).is_ok_and(|size| size <= STEPS_MAX);
        if is_fit { Ok(()) } else { Err(format!("its values have more than {} MiB", STEPS_MAX >> 20)) }
    }

    fn end(&mut self, activation: Option<Activation>) -> Result<(), String> {
        activation.and_then(|activation| activation.ended).map_or(Ok(()), |step| self.add(&step))
    }
}

/// A recorded value of a process.
#[derive(Debug)]
struct Sent<'a> {
    /// The position and the name of the output.
    port: u32,
    output: &'a str,
    /// The time since GO.
    at: Duration,
    /// Nothing if the value cannot be played.
    encoded: Option<Encoded>,
    /// The time of GO on the clock that measured the values, in seconds.
    origin: Option<f64>,
}

/// Returns the time of measurement in a value, relative to the beginning of the activation.
#[expect(clippy::cast_possible_truncation, reason = "a conversion to whole numbers has limits of its own")]
fn stamp(encoded: &Encoded, origin: Option<f64>, began: Duration) -> Option<Stamp> {
    let place = u32::try_from(encoded.stamp?).ok()?;
    let since = encoded.measured()? - origin? - began.as_secs_f64();
    Some(Stamp { place, nanos: (since * 1e9).round() as i64 })
}

/// Returns the values of a process in the order of time. If an output has several wires, each wire
/// was recorded. The wire with the most values is used. The value that reached the recorder fastest
/// shows when GO was on the clock of its host.
fn sent<'a, 'm>(
    run: &Run,
    path: &str,
    stand_in: &'a StandIn,
    message: impl Fn(&str) -> Option<&'m Message>,
) -> Vec<Sent<'a>> {
    let mut all = Vec::new();
    for (port, output) in (0..).zip(stand_in.outputs.iter().take(stand_in.recorded)) {
        let from = format!("{path}/{output}");
        let mut wires: BTreeMap<&str, Vec<&RecordedValue>> = BTreeMap::new();
        for value in run.values.iter().filter(|value| value.from == from) {
            wires.entry(&value.to).or_default().push(value);
        }
        let most = wires.into_values().max_by_key(Vec::len).unwrap_or_default();
        let message = message(output);
        let encoded: Vec<Option<Encoded>> = most.iter().map(|value| encode(value, message)).collect();
        let measured = std::iter::zip(&most, &encoded).filter_map(|(value, encoded)| {
            let measured = encoded.as_ref()?.measured()?;
            Some(measured - value.at.as_secs_f64())
        });
        let origin = measured.max_by(f64::total_cmp);
        let sent = |(value, encoded): (&RecordedValue, _)| Sent { port, output, at: value.at, encoded, origin };
        all.extend(std::iter::zip(most, encoded).map(sent));
    }
    all.sort_by_key(|sent| sent.at);
    all
}

fn activations(entries: &[Entry], path: &str) -> Vec<Activation> {
    let (mut all, mut open) = (Vec::new(), None::<Activation>);
    for entry in entries {
        let Entry::Report(Report::Process { path: of, at, change }) = entry else { continue };
        if of != path {
            continue;
        }
        // If a program was restarted, its activation continues.
        if *change == Change::Activated && open.is_none() {
            open = Some(Activation { began: *at, ended: None });
        }
        if let Change::Ended(how) = change
            && let Some(mut activation) = open.take()
        {
            let at = at.saturating_sub(activation.began);
            activation.ended = match how {
                Ending::Done(value) => Some(Step::Done { at, value: value.clone() }),
                Ending::Aborted(failure) => Some(Step::Aborted { at, reason: failure.cause.to_string() }),
                Ending::Stopped | Ending::Unconfirmed => None,
            };
            all.push(activation);
        }
    }
    all.into_iter().chain(open).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::mission::tests::door;
    use crate::logic::record::{Header, ValueForm};
    use comms::logic::layout::{Field, Layout};
    use comms::logic::replay::take;
    use node::logic::protocol::{Failure, FailureCause};

    fn ms(ms: u64) -> Duration {
        Duration::from_millis(ms)
    }

    fn process(at: u64, change: Change) -> Entry {
        Entry::Report(Report::Process { path: "main/a".to_owned(), change, at: ms(at) })
    }

    fn value(at: u64, to: &str) -> RecordedValue {
        let bytes = ["AA==", "AQ==", "Ag=="][usize::try_from(at % 3).unwrap()];
        let data = format!("{{\"size\":1,\"bytes\":\"{bytes}\"}}").into_bytes();
        RecordedValue { from: "main/a/Out".to_owned(), to: to.to_owned(), at: ms(at), form: ValueForm::Json, data }
    }

    fn check(entries: Vec<Entry>, values: Vec<RecordedValue>, expected: &[Step]) -> Recorded {
        let header = Header { file: "a.dca".to_owned(), text: String::new(), plan: door(), started: None };
        let run = Run { header, go: None, entries, values, damage: None };
        let stand_in = StandIn { leaf: 0, outputs: vec!["Out".to_owned()], recorded: 1 };
        let recorded = steps(&run, "main/a", &stand_in, |_| None).unwrap();
        let (mut rest, mut found) = (&recorded.steps[..], Vec::new());
        while let Some((step, behind)) = take(rest) {
            found.push(step);
            rest = behind;
        }
        assert_eq!(found, expected);
        recorded
    }

    #[test]
    fn values_are_those_of_their_activation() {
        let failure = Failure { origin: "main/a".to_owned(), cause: FailureCause::Exit(3), at: ms(70) };
        let entries = vec![
            process(10, Change::Activated),
            process(40, Change::Ended(Ending::Done(vec![7]))),
            process(50, Change::Activated),
            process(55, Change::Activated),
            process(70, Change::Ended(Ending::Aborted(failure))),
            process(80, Change::Activated),
            process(90, Change::Ended(Ending::Stopped)),
            process(95, Change::Activated),
        ];
        // The other wire was open for a shorter time, so it has fewer values.
        let values = vec![value(9, "b"), value(21, "b"), value(22, "c"), value(51, "b"), value(98, "b")];
        let step = |at, byte| Step::Value { at: ms(at), port: 0, bytes: vec![byte], stamp: None };
        let expected = [
            Step::Begin,
            step(0, 0),
            step(11, 0),
            Step::Done { at: ms(30), value: vec![7] },
            Step::Begin,
            step(1, 0),
            Step::Aborted { at: ms(20), reason: FailureCause::Exit(3).to_string() },
            Step::Begin,
            Step::Begin,
            step(3, 2),
        ];
        let recorded = check(entries, values, &expected);
        assert_eq!(recorded.counts["Out"], Counts { played: 4, lost: 0 });
        let text = recorded.plays("Out");
        assert!(text.starts_with("4 values of 4 activations (2, 1, 0, 1); "), "{text}");
        assert!(text.ends_with("only if the mission activates it 4 times"), "{text}");
    }

    #[test]
    fn a_record_without_its_beginning_is_one_activation() {
        let mut broken = value(4, "b");
        broken.data = b"{}".to_vec();
        let step = |at, byte| Step::Value { at: ms(at), port: 0, bytes: vec![byte], stamp: None };
        let recorded =
            check(Vec::new(), vec![value(3, "b"), broken, value(5, "b")], &[Step::Begin, step(3, 0), step(5, 2)]);
        assert_eq!(recorded.counts["Out"], Counts { played: 2, lost: 1 });
        assert_eq!(recorded.plays("Out"), "2 values");
    }

    #[test]
    fn measurements_are_as_old_as_they_were() {
        let field =
            |name: &str, of: &str| Field { name: name.to_owned(), layout: Layout::Number { of: of.to_owned() } };
        let layout = Layout::Record(vec![field("stamp", "Time"), field("x", "Length")]);
        let message = Message { name: "Range".to_owned(), layout };
        let value = |at: u64, stamp: f64| {
            let data = format!("{{\"stamp\":{stamp},\"x\":1}}").into_bytes();
            RecordedValue { data, ..value(at, "b") }
        };
        let header = Header { file: "a.dca".to_owned(), text: String::new(), plan: door(), started: None };
        let entries = vec![process(10, Change::Activated)];
        // GO was at 7000 s. The second value reached the recorder without delay.
        let values = vec![value(20, 7000.018), value(30, 7000.030), value(40, 7000.009)];
        let run = Run { header, go: None, entries, values, damage: None };
        let stand_in = StandIn { leaf: 0, outputs: vec!["Out".to_owned()], recorded: 1 };
        let recorded = steps(&run, "main/a", &stand_in, |_| Some(&message)).unwrap();
        let (mut rest, mut found) = (&recorded.steps[..], Vec::new());
        while let Some((step, behind)) = take(rest) {
            if let Step::Value { stamp: Some(Stamp { place: 0, nanos }), .. } = step {
                found.push(nanos / 1000);
            }
            rest = behind;
        }
        assert_eq!(found.iter().map(|micros| (micros + 500_i64).div_euclid(1000)).collect::<Vec<_>>(), [8, 20, -1]);
    }
}
