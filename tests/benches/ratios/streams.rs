//! Compares a controller that sends to 20 others, and a controller that sends as fast as it can, with zenoh alone and
//! with Unix sockets.

use crate::figures::{Round, Subject, Table, cell};
use crate::raw_streams::{self, Transport};
use crate::sdk;
use anyhow::{Context, ensure};
use comms::logic::time::Time;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

/// The number of measurements of each subject, in turn.
const ROUNDS: u32 = 3;
/// The messages from one to 20: their bytes, and their number in a round.
const FAN: Load = Load { listeners: 20, size: 64, count: 300, pause: Duration::from_millis(2) };
/// The sizes of the messages that are sent as fast as possible.
const SIZES: [(&str, u32); 6] =
    [("16 B", 16), ("64 B", 64), ("1 KiB", 1 << 10), ("64 KiB", 64 << 10), ("1 MiB", 1 << 20), ("8 MiB", 8 << 20)];
/// The greatest number of bytes of such messages in a round, and the greatest number of messages.
const BYTES_MAX: u32 = 64 << 20;
const COUNT_MAX: u32 = 20_000;
/// The greatest allowed cost of both, as a multiple of zenoh alone.
const TARGET: f64 = 1.15;

/// The values to send.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Load {
    /// The number of listeners.
    pub(crate) listeners: u32,
    /// Bytes.
    pub(crate) size: u32,
    pub(crate) count: u32,
    /// The time between two messages. It is zero for messages as fast as possible.
    pub(crate) pause: Duration,
}

/// The samples of one listener. In the encoded form, each number has eight bytes.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    count: u64,
    /// When the first message was sent, and when the last one arrived, in nanoseconds.
    first: u64,
    last: u64,
    /// The numbers and ages of the first thousand messages.
    ages: Vec<(u64, u64)>,
}

impl Tally {
    /// Takes a message. Its first 16 bytes are its number and the time when it was sent.
    pub(crate) fn take(&mut self, bytes: &[u8], now: Time) {
        let number = |at: usize| Some(u64::from_le_bytes(bytes.get(at..at + 8)?.try_into().ok()?));
        let (Some(number), Some(sent)) = (number(0), number(8)) else { return };
        if self.count == 0 {
            self.first = sent;
        }
        (self.count, self.last) = (self.count + 1, now.nanos());
        if self.ages.len() < 1000 {
            self.ages.push((number, now.nanos().saturating_sub(sent)));
        }
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.count == 0
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        let ages = self.ages.iter().flat_map(|(number, age)| [*number, *age]);
        [self.count, self.first, self.last].into_iter().chain(ages).flat_map(u64::to_le_bytes).collect()
    }

    pub(crate) fn of(bytes: &[u8]) -> anyhow::Result<Self> {
        let numbers = bytes.chunks_exact(8).map(|bytes| Ok(u64::from_le_bytes(bytes.try_into()?)));
        let numbers: Vec<u64> = numbers.collect::<anyhow::Result<_>>()?;
        let [count, first, last, ages @ ..] = &numbers[..] else { anyhow::bail!("three numbers are needed") };
        let ages = ages.chunks_exact(2).map(|pair| (pair[0], pair[1])).collect();
        Ok(Self { count: *count, first: *first, last: *last, ages })
    }
}

/// Returns message `number`, at least 16 bytes long.
pub(crate) fn message(number: u64, now: Time, size: u32) -> Vec<u8> {
    let mut bytes = [number.to_le_bytes(), now.nanos().to_le_bytes()].concat();
    bytes.resize(bytes.len().max(size as usize), 1);
    bytes
}

/// Measures one sender with 20 listeners, and adds lines to the table.
pub(crate) async fn measure_fan(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let [mut ours, mut zenoh, mut socket] = <[Subject; 3]>::default();
    let mut lost = [0; 3];
    for _ in 0..ROUNDS {
        let tallies = [
            raw_streams::measure(Transport::Socket, dir, FAN)?,
            raw_streams::measure(Transport::Zenoh, dir, FAN)?,
            sdk::stream(dir, FAN).await?,
        ];
        for ((subject, lost), tallies) in [&mut socket, &mut zenoh, &mut ours].into_iter().zip(&mut lost).zip(tallies) {
            subject.push(Round::of(until_the_last(&tallies)).context("nothing came to all")?);
            *lost += tallies.iter().map(|tally| u64::from(FAN.count).saturating_sub(tally.count)).sum::<u64>();
        }
    }
    table.heading("one to 20, 64 B at 500 Hz, until the last has it", "of zenoh", "of socket");
    let text = |name: &str, lost: u64| format!("{name}, {lost} lost");
    let of_socket = |subject: &Subject| cell(subject.ratio(&socket), None);
    table.line(
        &text("controller to controllers", lost[2]),
        &ours,
        [cell(ours.ratio(&zenoh), Some(TARGET)), of_socket(&ours)],
    );
    table.line(&text("zenoh alone, thread to threads", lost[1]), &zenoh, ["1".into(), of_socket(&zenoh)]);
    table.line(&text("Unix sockets, one after the other", lost[0]), &socket, [String::new(), "1".into()]);
    Ok(())
}

/// Returns for each message that all listeners received how long it took.
fn until_the_last(tallies: &[Tally]) -> Vec<Duration> {
    let mut last: BTreeMap<u64, (usize, u64)> = BTreeMap::new();
    for (number, age) in tallies.iter().flat_map(|tally| &tally.ages) {
        let (count, oldest) = last.entry(*number).or_default();
        (*count, *oldest) = (*count + 1, (*oldest).max(*age));
    }
    let of_all = last.into_values().filter(|(count, _)| *count == tallies.len());
    of_all.map(|(_, age)| Duration::from_nanos(age)).collect()
}

/// Measures messages that are sent as fast as possible, and adds lines to the table.
pub(crate) async fn measure_rate(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    for (name, size) in SIZES {
        let count = (BYTES_MAX / size).clamp(8, COUNT_MAX);
        let load = Load { listeners: 1, size, count, pause: Duration::ZERO };
        let [mut ours, mut zenoh, mut socket] = <[Subject; 3]>::default();
        let mut came = [0; 3];
        for _ in 0..ROUNDS {
            let tallies = [
                raw_streams::measure(Transport::Socket, dir, load)?,
                raw_streams::measure(Transport::Zenoh, dir, load)?,
                sdk::stream(dir, load).await?,
            ];
            let subjects = [&mut socket, &mut zenoh, &mut ours];
            for ((subject, came), tallies) in subjects.into_iter().zip(&mut came).zip(tallies) {
                let tally = tallies.first().filter(|tally| tally.count > 0).context("nothing came")?;
                let each = Duration::from_nanos(tally.last.saturating_sub(tally.first) / tally.count);
                ensure!(!each.is_zero(), "it took no time");
                subject.push(Round::single(each));
                *came += tally.count;
            }
        }
        table.heading(&format!("{name}, as fast as it goes: time for each that comes"), "of zenoh", "of socket");
        let text = |name: &str, subject: &Subject, came: u64| {
            let each = subject.figures().p50.as_secs_f64();
            let (bytes, all) = (f64::from(size.max(16)) / each / 1e6, u64::from(count * ROUNDS));
            format!("{name}: {bytes:.0} MB/s, {came} of {all} came")
        };
        let of_socket = |subject: &Subject| cell(subject.ratio(&socket), None);
        let own = [cell(ours.ratio(&zenoh), Some(TARGET)), of_socket(&ours)];
        table.line(&text("controller", &ours, came[2]), &ours, own);
        table.line(&text("zenoh alone", &zenoh, came[1]), &zenoh, ["1".into(), of_socket(&zenoh)]);
        table.line(&text("Unix socket", &socket, came[0]), &socket, [String::new(), "1".into()]);
    }
    Ok(())
}
