//! The values of an output, for `dca echo` and `dca hz`: which outputs match, the fields of a value, losses on the way, and rates.

use crate::logic::process_name::ProcessName;
use crate::logic::record::{decoded, messages};
use comms::logic::human::span;
use comms::logic::layout::Message;
use comms::logic::tap::{OutputType, Outputs, Tapped};
use comms::logic::time::Time;
use language::Source;
use serde_json::{Value, json};
use std::fmt::{self, Display, Formatter};
use std::time::Duration;

/// The outputs that a user names: `Out`, `force.Out`, `door:hit/force.Out`, `plant.arm/state`, inside a group `filter.smooth.Out`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Wanted {
    process: ProcessName,
    output: String,
}

impl Wanted {
    /// Reads `[[DEPLOYMENT:]INSTANCE.]OUTPUT`. If the text is not valid, returns the mistake.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let (process, output) = match ProcessName::with_name(text) {
            (process, Some(output)) => (process, output),
            // Without a process, outputs of all processes match.
            (_, None) => {
                let output = text.rfind(':').map_or(0, |colon| colon + 1);
                (ProcessName::new(&text[..output]), &text[output..])
            }
        };
        if output.is_empty() {
            return Err(format!(
                "`{text}` names no output: expected [[DEPLOYMENT:]INSTANCE.]OUTPUT, such as `hit/force.Out`"
            ));
        }
        Ok(Self { process, output: output.to_owned() })
    }

    /// Returns the name without the deployment.
    pub(crate) fn bare(&self) -> String {
        let process = self.process.process().map(|process| format!("{process}.")).unwrap_or_default();
        format!("{process}{}", self.output)
    }

    /// Returns the processes that the name matches.
    pub(crate) fn process(&self) -> &ProcessName {
        &self.process
    }

    /// Returns whether an output of this name matches, if its process matches.
    pub(crate) fn is_output(&self, name: &str) -> bool {
        self.output == name
    }
}

impl Display for Wanted {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let dot = if self.process.process().is_some() { "." } else { "" };
        write!(f, "{}{dot}{}", self.process, self.output)
    }
}

/// Returns the type of an output's values, as far as the program names their fields. `all` contains the types that it may consist of.
pub(crate) fn message(output: &OutputType, all: &Outputs) -> Option<Message> {
    // The output's own type comes first: two members of a group may have different types of the same name.
    let types = std::iter::once(output).chain(all.all());
    let mut types: Vec<&OutputType> = types.filter(|one| !one.fields.is_empty()).collect();
    types.sort_by_key(|one| &one.type_name);
    types.dedup_by_key(|one| &one.type_name);
    let mut text: String =
        types.iter().map(|one| format!("type {} = {{ {} }};\n", one.type_name, one.fields)).collect();
    text += &format!("module Program(host: Host) {{ out Out: {}; done; }}\n", output.type_name);
    messages(&[Source::new("outputs", text)]).remove("Program")?.remove("Out")
}

/// Returns a value as JSON. If its type is unknown or does not fit the bytes, returns only its size.
pub(crate) fn value(message: Option<&Message>, bytes: &[u8]) -> Value {
    message.and_then(|message| decoded(message, bytes)).unwrap_or_else(|| json!({ "size": bytes.len() }))
}

/// The gap before a value, according to its number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Gap {
    None,
    /// This many values were lost on the way here.
    Lost(u64),
    /// The program was restarted, so its numbers begin again.
    Restarted,
}

/// Compares the numbers of an output's values.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Numbers {
    last: Option<u64>,
}

impl Numbers {
    pub(crate) fn take(&mut self, number: u64) -> Gap {
        match self.last.replace(number) {
            Some(last) if number <= last => Gap::Restarted,
            Some(last) if number > last + 1 => Gap::Lost(number - last - 1),
            Some(_) | None => Gap::None,
        }
    }
}

/// The rate at which an output sends values, by the clock of the program's host. Values that were lost on the way count as well.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rate {
    /// The number and the time of the first and of the last value.
    first: Option<(u64, Time)>,
    last: Option<(u64, Time)>,
    shortest: Option<Duration>,
    longest: Option<Duration>,
    /// How many values arrived, and how many bytes.
    count: u64,
    size: u64,
    lost: u64,
}

impl Rate {
    pub(crate) fn take(&mut self, tapped: &Tapped) {
        let this = (tapped.number, tapped.stamp);
        match self.last {
            Some((number, _)) if tapped.number <= number => {
                *self = Self { lost: self.lost, ..Self::default() };
            }
            Some((number, at)) => {
                self.lost += tapped.number - number - 1;
                if tapped.number == number + 1 {
                    let interval = tapped.stamp.since(at);
                    self.shortest = Some(self.shortest.map_or(interval, |shortest| shortest.min(interval)));
                    self.longest = Some(self.longest.map_or(interval, |longest| longest.max(interval)));
                }
            }
            None => {}
        }
        self.first.get_or_insert(this);
        self.last = Some(this);
        self.count += 1;
        self.size += u64::try_from(tapped.bytes.len()).unwrap_or(u64::MAX);
    }

    /// Returns a new rate that begins with the last value. Earlier values are no longer counted.
    pub(crate) fn next(&self) -> Self {
        Self { first: self.last, last: self.last, ..Self::default() }
    }

    /// Returns whether no value came.
    pub(crate) fn is_empty(&self) -> bool {
        self.count == 0
    }

    /// Returns the values per second (Hz); nothing while there are fewer than two values.
    pub(crate) fn hertz(&self) -> Option<f64> {
        let ((first, begin), (last, end)) = (self.first?, self.last?);
        let took = end.since(begin).as_secs_f64();
        #[expect(clippy::cast_precision_loss, reason = "a count for people")]
        (last > first && took > 0.0).then(|| (last - first) as f64 / took)
    }

    /// Returns the bytes per second; nothing while there are fewer than two values.
    pub(crate) fn bytes(&self) -> Option<f64> {
        #[expect(clippy::cast_precision_loss, reason = "a count for people")]
        let size = (self.count > 0).then(|| self.size as f64 / self.count as f64)?;
        Some(self.hertz()? * size)
    }

    /// Returns the rate in words.
    pub(crate) fn text(&self) -> String {
        let (Some(hertz), Some(bytes)) = (self.hertz(), self.bytes()) else {
            return if self.is_empty() { "no value".to_owned() } else { "1 value".to_owned() };
        };
        let interval = match (self.shortest, self.longest) {
            (Some(shortest), Some(longest)) => format!(", {} to {} apart", span(shortest), span(longest)),
            _ => String::new(),
        };
        format!("{hertz:.1} Hz{interval}, {}, {} lost on the way here", a_second(bytes), self.lost)
    }

    /// Returns the rate as JSON: Hz, seconds, bytes per second.
    pub(crate) fn json(&self) -> Value {
        let seconds = |time: Option<Duration>| time.map(|time| time.as_secs_f64());
        json!({
            "values": self.count, "hertz": self.hertz(), "shortest": seconds(self.shortest),
            "longest": seconds(self.longest), "bytes_a_second": self.bytes(), "lost": self.lost,
        })
    }
}

fn a_second(bytes: f64) -> String {
    match bytes {
        large if large >= 1e6 => format!("{:.1} MB/s", large / 1e6),
        middle if middle >= 1e3 => format!("{:.1} kB/s", middle / 1e3),
        small => format!("{small:.0} B/s"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::tap::InnerOutput;
    use node::logic::protocol::Deployment;

    fn tapped(number: u64, millis: u64) -> Tapped {
        Tapped { number, stamp: Time::from_nanos(millis * 1_000_000), bytes: vec![0; 50] }
    }

    #[test]
    fn outputs_are_meant_by_the_end_of_their_path() {
        let check = |text: &str, path: &str, output: &str, expected: bool| {
            let wanted = Wanted::parse(text).unwrap();
            let deployment = Deployment { name: "door".into(), epoch: 2 };
            let is_meant = wanted.process().is_process(&deployment, path) && wanted.is_output(output);
            assert_eq!((is_meant, wanted.to_string()), (expected, text.to_owned()), "{text}: {path}.{output}");
        };
        check("Out", "main/hit/force", "Out", true);
        check("force.Out", "main/hit/force", "Out", true);
        check("hit/force.Out", "main/hit/force", "Out", true);
        check("door:main/hit/force.Out", "main/hit/force", "Out", true);
        check("door@2:Out", "main/hit/force", "Out", true);
        check("gate:force.Out", "main/hit/force", "Out", false);
        check("orce.Out", "main/hit/force", "Out", false);
        check("force.In", "main/hit/force", "Out", false);
        check("plant.arm/state", "main/plant", "arm/state", true);
        check("arm/state", "main/plant", "arm/state", true);
        check("filter.smooth.Out", "main/filter", "smooth.Out", true);
        check("arm/filter.smooth.Out", "main/arm/filter", "smooth.Out", true);
        check("smooth.Out", "main/filter", "smooth.Out", false);
        check("filter.Out", "main/filter", "smooth.Out", false);
    }

    #[test]
    fn what_names_no_output_is_refused() {
        assert!(["", "force.", "door:"].into_iter().all(|text| Wanted::parse(text).is_err()));
    }

    #[test]
    fn values_are_read_by_what_the_program_says_of_its_types() {
        let output = |name: &str, type_name: &str, fields: &str| OutputType {
            name: name.into(),
            type_name: type_name.into(),
            fields: fields.into(),
        };
        let inner = |member: &str, fields: &str| InnerOutput {
            output: output(&format!("{member}.Out"), "Wrench", fields),
            inputs: vec!["end.In".into()],
        };
        let inner = vec![inner("one", "force: Force[2], soft: Truth"), inner("two", "soft: Truth")];
        let all = Outputs {
            outputs: vec![output("Out", "Wrench", "force: Force[2], soft: Truth"), output("N", "Odd", "")],
            inner,
        };
        let known = message(&all.outputs[0], &all).unwrap();
        let bytes: Vec<u8> = [1.5_f64.to_le_bytes(), 2.0_f64.to_le_bytes()].concat().into_iter().chain([1]).collect();
        assert_eq!(value(Some(&known), &bytes), json!({ "force": [1.5, 2.0], "soft": true }));
        assert_eq!(value(Some(&known), &bytes[1..]), json!({ "size": 16 }));
        assert_eq!((message(&all.outputs[1], &all), value(None, b"abc")), (None, json!({ "size": 3 })));
        // Each member of a group knows only its own types.
        let of = |at: usize| message(&all.inner[at].output, &all);
        assert_eq!(value(of(0).as_ref(), &bytes), json!({ "force": [1.5, 2.0], "soft": true }));
        assert_eq!(value(of(1).as_ref(), &[1]), json!({ "soft": true }));
    }

    #[test]
    fn a_gap_in_the_numbers_is_what_was_lost() {
        let mut numbers = Numbers::default();
        let gaps: Vec<Gap> = [7, 8, 11, 1, 2].into_iter().map(|number| numbers.take(number)).collect();
        assert_eq!(gaps, [Gap::None, Gap::None, Gap::Lost(2), Gap::Restarted, Gap::None]);
    }

    #[test]
    fn a_rate_counts_what_was_lost_on_the_way() {
        let mut rate = Rate::default();
        assert_eq!(rate.text(), "no value");
        rate.take(&tapped(5, 1000));
        assert_eq!(rate.text(), "1 value");
        for (number, millis) in [(6, 1010), (8, 1030), (9, 1042)] {
            rate.take(&tapped(number, millis));
        }
        assert_eq!(rate.text(), "95.2 Hz, 10 ms to 12 ms apart, 4.8 kB/s, 1 lost on the way here");
        let mut next = rate.next();
        assert_eq!(next.text(), "no value");
        next.take(&tapped(10, 1052));
        assert_eq!(next.text(), "100.0 Hz, 10 ms to 10 ms apart, 5.0 kB/s, 0 lost on the way here");
        // The program was restarted.
        next.take(&tapped(1, 1100));
        assert_eq!(next.text(), "1 value");
    }

    #[test]
    fn messages_of_ros_have_their_fields() {
        let output =
            OutputType { name: "Cmd".to_owned(), type_name: "ros.geometry.Point".to_owned(), fields: String::new() };
        let outputs = Outputs { outputs: vec![output.clone()], inner: Vec::new() };
        let message = message(&output, &outputs);
        let point = ros::typed::geometry_msgs::Point { x: 1.5, y: f64::NAN, z: 0.0 };
        let bytes = postcard::to_stdvec(&point).unwrap();
        assert_eq!(value(message.as_ref(), &bytes), json!({ "x": 1.5, "y": "NaN", "z": 0.0 }));
        assert_eq!(value(message.as_ref(), &bytes[..9]), json!({ "size": 9 }));
    }
}
