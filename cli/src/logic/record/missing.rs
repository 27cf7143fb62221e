//! Counts the values of wires that a record lacks.
//!
//! The numbers of the values show which of them have not arrived. Values that have arrived, but did not fit into a
//! queue, are counted where they are dropped. The record contains the counts on `/missing`.

use comms::logic::switch::{Boundary, Gaps, Sequence};
use node::logic::table::counted;
use std::collections::BTreeMap;
use std::ops::AddAssign;

/// The most wires that are named in messages. Further wires are only counted.
const NAMED_MAX: usize = 6;

/// The output and the input of a wire, each with the path of its process: `main/force/Out`.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct WireName {
    /// The output.
    pub from: String,
    /// The input.
    pub to: String,
}

/// How many values of a wire are not in the record.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MissingValues {
    /// The first values of each start of the program, before the recorder was linked to it.
    pub early: u64,
    /// Later values.
    pub lost: u64,
    /// How often the values broke off before the wire was closed. It is not known how many values followed.
    pub breaks: u64,
}

impl MissingValues {
    const fn is_none(self) -> bool {
        self.early == 0 && self.lost == 0 && self.breaks == 0
    }

    const fn counted(self) -> u64 {
        self.early.saturating_add(self.lost)
    }
}

impl AddAssign for MissingValues {
    fn add_assign(&mut self, more: Self) {
        self.early = self.early.saturating_add(more.early);
        self.lost = self.lost.saturating_add(more.lost);
        self.breaks = self.breaks.saturating_add(more.breaks);
    }
}

/// The counts of all wires.
#[derive(Debug, Default)]
pub(crate) struct Missing {
    wires: BTreeMap<WireName, WireCount>,
}

#[derive(Debug, Default)]
struct WireCount {
    gaps: Gaps,
    /// The last message. A program that was started again has another publisher.
    last: Option<Sequence>,
    /// Whether the last message was not the end mark.
    is_open: bool,
    all: MissingValues,
    /// The part of `all` that is not in the record yet.
    pending: MissingValues,
}

impl WireCount {
    /// Notes a message. If it is the first one of its publisher, `before` values were sent before it.
    fn arrived(&mut self, sequence: Sequence, before: u32, lost: u32) {
        let last = self.last.replace(sequence);
        let is_first = last.is_none_or(|last| last.publisher != sequence.publisher);
        if is_first {
            self.end();
        }
        let early = if is_first { before.into() } else { 0 };
        self.add(MissingValues { early, lost: lost.into(), breaks: 0 });
    }

    /// Notes that the last publisher sends nothing more.
    fn end(&mut self) {
        let breaks = std::mem::take(&mut self.is_open).into();
        self.add(MissingValues { early: 0, lost: 0, breaks });
    }

    fn add(&mut self, more: MissingValues) {
        self.all += more;
        self.pending += more;
    }
}

impl Missing {
    /// Notes that a value has arrived.
    pub(crate) fn value(&mut self, wire: &WireName, sequence: Option<Sequence>) {
        let Some(sequence) = sequence else { return };
        let count = self.count(wire);
        let lost = count.gaps.value(sequence);
        count.arrived(sequence, sequence.number.saturating_sub(1), lost);
        count.is_open = true;
    }

    /// Notes that a boundary between values has arrived. It has the number of the previous value.
    pub(crate) fn boundary(&mut self, wire: &WireName, sequence: Option<Sequence>, boundary: &Boundary) {
        let Some(sequence) = sequence else { return };
        let count = self.count(wire);
        let lost = count.gaps.boundary(sequence);
        count.arrived(sequence, sequence.number, lost);
        count.is_open = match boundary {
            Boundary::Opened { .. } => true,
            Boundary::Closed { .. } => false,
        };
    }

    /// Notes that the mission is over, and so each wire is closed.
    pub(crate) fn end(&mut self) {
        self.wires.values_mut().for_each(WireCount::end);
    }

    /// Notes that values have arrived, but are not recorded.
    pub(crate) fn lose(&mut self, wire: &WireName, lost: u64) {
        if lost > 0 {
            self.count(wire).add(MissingValues { lost, ..MissingValues::default() });
        }
    }

    /// Returns the counts that are not in the record yet.
    pub(crate) fn pending(&self) -> Vec<(WireName, MissingValues)> {
        let pending = self.wires.iter().filter(|(_, count)| !count.pending.is_none());
        pending.map(|(wire, count)| (wire.clone(), count.pending)).collect()
    }

    /// Notes that counts which were pending are now in the record.
    pub(crate) fn recorded(&mut self, wire: &WireName, part: MissingValues) {
        let pending = &mut self.count(wire).pending;
        pending.early = pending.early.saturating_sub(part.early);
        pending.lost = pending.lost.saturating_sub(part.lost);
        pending.breaks = pending.breaks.saturating_sub(part.breaks);
    }

    /// Returns a sentence for each wire without some of its values.
    pub(crate) fn sentences(&self) -> Vec<String> {
        sentences(self.wires.iter().map(|(wire, count)| (wire, count.all)))
    }

    /// Returns the number of the last message of a wire.
    #[cfg(test)]
    pub(crate) fn last(&self, wire: &WireName) -> Option<u32> {
        Some(self.wires.get(wire)?.last?.number)
    }

    fn count(&mut self, wire: &WireName) -> &mut WireCount {
        if !self.wires.contains_key(wire) {
            self.wires.insert(wire.clone(), WireCount::default());
        }
        self.wires.entry(wire.clone()).or_default()
    }
}

/// Returns a sentence for each wire without some of its values: `5 values of main/a.Out to main/b.In are not in the record`.
pub(crate) fn sentences<'a>(counts: impl Iterator<Item = (&'a WireName, MissingValues)>) -> Vec<String> {
    let lacking: Vec<_> = counts.filter(|(_, count)| !count.is_none()).collect();
    let named = lacking.iter().take(NAMED_MAX).map(|(wire, count)| sentence(wire, *count));
    let rest = &lacking[lacking.len().min(NAMED_MAX)..];
    let values = rest.iter().fold(0, |all: u64, (_, count)| all.saturating_add(count.counted()));
    let wires = counted(rest.len(), "more wire");
    let rest = (!rest.is_empty()).then(|| match values {
        0 => format!("the last values of {wires} may not be in the record"),
        values => format!("{} of {wires} are not in the record", counted(values, "value")),
    });
    named.chain(rest).collect()
}

fn sentence(wire: &WireName, count: MissingValues) -> String {
    let port =
        |path: &str| path.rsplit_once('/').map_or_else(|| path.to_owned(), |(path, port)| format!("{path}.{port}"));
    let values = format!("of {} to {}", port(&wire.from), port(&wire.to));
    let are = |count| if count == 1 { "is" } else { "are" };
    let broken = "the program was killed, or the link to it broke";
    let counts = match (count.early, count.lost) {
        (0, 0) => return format!("the last values {values} may not be in the record: {broken}"),
        (1, 0) => format!("the first value {values} is not in the record: the recorder was not linked yet"),
        (early, 0) => {
            format!("the first {early} values {values} are not in the record: the recorder was not linked yet")
        }
        (0, lost) => format!("{} {values} {} not in the record", counted(lost, "value"), are(lost)),
        (early, lost) => format!(
            "{} {values} {} not in the record, and neither are the first {early}: the recorder was not linked yet",
            counted(lost, "value"),
            are(lost)
        ),
    };
    if count.breaks == 0 { counts } else { format!("{counts}. The last ones may be missing too: {broken}") }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;

    const OPENED: Boundary = Boundary::Opened { generation: 0, after: Vec::new() };
    const CLOSED: Boundary = Boundary::Closed { generation: 0, sent: 0 };

    fn wire(from: &str) -> WireName {
        WireName { from: format!("main/{from}/Out"), to: "main/b/In".to_owned() }
    }

    fn of(publisher: u32, number: u32) -> Option<Sequence> {
        Some(Sequence { publisher: (7, publisher), number })
    }

    /// The numbers that arrive, and the values that are dropped afterwards, give the number of values that were sent
    /// and are not in the record, whatever is lost and whenever the program is started again.
    #[test]
    fn each_value_is_recorded_or_counted() {
        for seed in 0..100 {
            let (mut random, mut missing, wire) = (Random::new(seed), Missing::default(), wire("a"));
            let (mut sent, mut kept, mut written) = (0_u64, 0_u64, MissingValues::default());
            for publisher in 0..4 {
                let mut number = 0;
                for _ in 0..random.below(60) {
                    number += 1;
                    sent += 1;
                    match random.below(4) {
                        0 => {}
                        1 => {
                            missing.value(&wire, of(publisher, number));
                            missing.lose(&wire, 1);
                        }
                        _ => {
                            missing.value(&wire, of(publisher, number));
                            kept += 1;
                        }
                    }
                    if random.below(5) == 0 {
                        missing.boundary(&wire, of(publisher, number), &OPENED);
                    }
                    if random.below(9) == 0 {
                        for (name, part) in missing.pending() {
                            written += part;
                            missing.recorded(&name, part);
                        }
                    }
                }
                // The last message before the program ends, or is started again.
                missing.boundary(&wire, of(publisher, number), &CLOSED);
            }
            missing.end();
            let all = missing.wires.get(&wire).map_or(MissingValues::default(), |count| count.all);
            assert_eq!((kept + all.counted(), all.breaks), (sent, 0), "seed {seed}");
            missing.pending().into_iter().for_each(|(_, part)| written += part);
            assert_eq!(written, all, "seed {seed}");
        }
    }

    #[test]
    fn what_is_missing_is_said_of_each_wire() {
        let mut missing = Missing::default();
        missing.value(&wire("a"), of(1, 1));
        missing.value(&wire("c"), of(1, 81));
        missing.value(&wire("c"), of(1, 83));
        missing.value(&wire("d"), of(1, 3));
        missing.value(&wire("e"), of(1, 1));
        missing.boundary(&wire("e"), of(1, 650), &CLOSED);
        // Without numbers nothing is known.
        missing.value(&wire("f"), None);
        assert_eq!(
            missing.sentences(),
            [
                "1 value of main/c.Out to main/b.In is not in the record, and neither are the first 80: the recorder was not linked yet",
                "the first 2 values of main/d.Out to main/b.In are not in the record: the recorder was not linked yet",
                "649 values of main/e.Out to main/b.In are not in the record",
            ]
        );
        (0..9).for_each(|number| missing.lose(&wire(&format!("x{number}")), 2));
        let sentences = missing.sentences();
        assert_eq!((sentences.len(), sentences[6].as_str()), (7, "12 values of 6 more wires are not in the record"));
    }

    #[test]
    fn a_wire_without_its_end_mark_is_told() {
        let mut missing = Missing::default();
        for (from, last) in [("a", CLOSED), ("b", OPENED)] {
            missing.boundary(&wire(from), of(1, 0), &OPENED);
            missing.value(&wire(from), of(1, 1));
            missing.boundary(&wire(from), of(1, 1), &last);
        }
        // The program was killed, started again, and killed again.
        missing.value(&wire("c"), of(1, 1));
        missing.value(&wire("c"), of(2, 3));
        assert_eq!(missing.sentences().len(), 1, "only the wire to the killed program is known to lack values");
        missing.end();
        missing.end();
        assert_eq!(
            missing.sentences(),
            [
                "the last values of main/b.Out to main/b.In may not be in the record: the program was killed, or the link to it broke",
                "the first 2 values of main/c.Out to main/b.In are not in the record: the recorder was not linked yet. The last ones may be missing too: the program was killed, or the link to it broke",
            ]
        );
        let breaks: Vec<_> = missing.pending().into_iter().map(|(_, count)| count.breaks).collect();
        assert_eq!(breaks, [1, 2]);
    }
}
