//! Counts the values of wires that a record lacks.
//!
//! The numbers of the values show which of them have not arrived. Values that have arrived, but did not fit into a
//! queue, are counted where they are dropped. The record contains the counts on `/missing`.

use comms::logic::switch::{Gaps, Sequence};
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
}

impl MissingValues {
    fn all(self) -> u64 {
        self.early.saturating_add(self.lost)
    }
}

impl AddAssign for MissingValues {
    fn add_assign(&mut self, more: Self) {
        self.early = self.early.saturating_add(more.early);
        self.lost = self.lost.saturating_add(more.lost);
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
    all: MissingValues,
    /// The part of `all` that is not in the record yet.
    pending: MissingValues,
}

impl WireCount {
    fn add(&mut self, more: MissingValues) {
        self.all += more;
        self.pending += more;
    }
}

impl Missing {
    /// Notes that a value has arrived.
    pub(crate) fn value(&mut self, wire: &WireName, sequence: Option<Sequence>) {
        self.arrived(wire, sequence, 1, Gaps::value);
    }

    /// Notes that a boundary between values has arrived. It has the number of the previous value.
    pub(crate) fn boundary(&mut self, wire: &WireName, sequence: Option<Sequence>) {
        self.arrived(wire, sequence, 0, Gaps::boundary);
    }

    fn arrived(&mut self, wire: &WireName, sequence: Option<Sequence>, step: u32, gap: fn(&mut Gaps, Sequence) -> u32) {
        let Some(sequence) = sequence else { return };
        let count = self.count(wire);
        let last = count.last.replace(sequence);
        let is_first = last.is_none_or(|last| last.publisher != sequence.publisher);
        let lost = gap(&mut count.gaps, sequence).into();
        let early = if is_first { sequence.number.saturating_sub(step).into() } else { 0 };
        count.add(MissingValues { early, lost });
    }

    /// Notes that values have arrived, but are not recorded.
    pub(crate) fn lose(&mut self, wire: &WireName, lost: u64) {
        if lost > 0 {
            self.count(wire).add(MissingValues { early: 0, lost });
        }
    }

    /// Returns the counts that are not in the record yet.
    pub(crate) fn pending(&self) -> Vec<(WireName, MissingValues)> {
        let pending = self.wires.iter().filter(|(_, count)| count.pending.all() > 0);
        pending.map(|(wire, count)| (wire.clone(), count.pending)).collect()
    }

    /// Notes that counts which were pending are now in the record.
    pub(crate) fn recorded(&mut self, wire: &WireName, part: MissingValues) {
        let pending = &mut self.count(wire).pending;
        pending.early = pending.early.saturating_sub(part.early);
        pending.lost = pending.lost.saturating_sub(part.lost);
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
    let lacking: Vec<_> = counts.filter(|(_, count)| count.all() > 0).collect();
    let named = lacking.iter().take(NAMED_MAX).map(|(wire, count)| sentence(wire, *count));
    let rest = lacking.iter().skip(NAMED_MAX).fold(MissingValues::default(), |mut rest, (_, count)| {
        rest += *count;
        rest
    });
    let wires = counted(lacking.len().saturating_sub(NAMED_MAX), "more wire");
    let rest = (rest.all() > 0).then(|| format!("{} of {wires} are not in the record", counted(rest.all(), "value")));
    named.chain(rest).collect()
}

fn sentence(wire: &WireName, count: MissingValues) -> String {
    let port =
        |path: &str| path.rsplit_once('/').map_or_else(|| path.to_owned(), |(path, port)| format!("{path}.{port}"));
    let first = if count.lost > 0 { count.lost } else { count.early };
    let are = if first == 1 { "is" } else { "are" };
    let values = format!("of {} to {} {are} not in the record", port(&wire.from), port(&wire.to));
    match count {
        MissingValues { early, lost: 0 } => {
            format!("the first {} {values}: the recorder was not linked yet", counted(early, "value"))
        }
        MissingValues { early: 0, lost } => format!("{} {values}", counted(lost, "value")),
        MissingValues { early, lost } => {
            format!(
                "{} {values}, and neither are the first {early}: the recorder was not linked yet",
                counted(lost, "value")
            )
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::random::Random;

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
                        missing.boundary(&wire, of(publisher, number));
                    }
                    if random.below(9) == 0 {
                        for (name, part) in missing.pending() {
                            written += part;
                            missing.recorded(&name, part);
                        }
                    }
                }
                // The last message before the program ends, or is started again.
                missing.boundary(&wire, of(publisher, number));
            }
            let all = missing.wires.get(&wire).map_or(MissingValues::default(), |count| count.all);
            assert_eq!(kept + all.all(), sent, "seed {seed}");
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
        missing.boundary(&wire("e"), of(1, 650));
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
}
