//! Compares one hop from controller to controller with zenoh alone, a Unix socket, shared memory, and with dora if it
//! is installed.

use crate::dora;
use crate::figures::{Round, Subject, Table, cell};
use crate::raw::{self, Transport};
use crate::sdk;
use anyhow::Context;
use std::path::Path;

/// The number of measurements of each subject, in turn.
const ROUNDS: u32 = 9;
/// The messages: bytes, timed round trips, and the round trips before them.
const SIZES: [(&str, u32, u32, u32); 6] = [
    ("8 B", 8, 2000, 300),
    ("64 B", 64, 2000, 300),
    ("1 KiB", 1 << 10, 2000, 300),
    ("64 KiB", 64 << 10, 400, 60),
    ("1 MiB", 1 << 20, 60, 10),
    ("8 MiB", 8 << 20, 12, 2),
];
/// The greatest allowed cost of a hop, as a multiple of zenoh alone and of a Unix socket.
const TARGET: f64 = 1.15;
const TARGET_OF_SOCKET: f64 = 3.0;
/// The greatest allowed cost, as a multiple of shared memory. It applies from this number of bytes on.
const TARGET_OF_MEMORY: f64 = 1.2;
const MEMORY_FROM: u32 = 1 << 20;

/// Measures, and adds lines to the table.
pub(crate) async fn measure(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let mut controllers = sdk::Pair::start(dir).await?;
    let mut socket = raw::Pair::start(Transport::Socket, dir)?;
    let mut zenoh = raw::Pair::start(Transport::Zenoh, dir)?;
    let mut bytes = raw::Pair::start(Transport::ZenohBytes, dir)?;
    let mut shared = raw::Pair::start(Transport::ZenohShared, dir)?;
    let mut callback = raw::Pair::start(Transport::ZenohCallback, dir)?;
    let mut memory = raw::Pair::start(Transport::Memory, dir)?;
    let mut dora = dora::Pair::start(dir)?;
    for (name, size, count, warm_up) in SIZES {
        let (mut subjects, mut of_dora): ([Subject; 7], _) = (Default::default(), Subject::default());
        for _ in 0..ROUNDS {
            let [ours, plain, owned, batched, quick, raw, mapped] = &mut subjects;
            raw.push(socket.measure(size, count, warm_up)?.halved());
            plain.push(zenoh.measure(size, count, warm_up)?.halved());
            let times = controllers.measure(size, count, warm_up).await?;
            ours.push(Round::of(times).context("no samples")?.halved());
            owned.push(bytes.measure(size, count, warm_up)?.halved());
            batched.push(shared.measure(size, count, warm_up)?.halved());
            quick.push(callback.measure(size, count, warm_up)?.halved());
            mapped.push(memory.measure(size, count, warm_up)?.halved());
            if let Some(dora) = &mut dora {
                of_dora.push(dora.measure(size, count, warm_up)?.halved());
            }
        }
        let [ours, plain, owned, batched, quick, raw, mapped] = &subjects;
        table.heading(&format!("one hop, {name}, two processes"), "of zenoh", "of socket");
        let of_socket = |subject: &Subject| cell(subject.ratio(raw), None);
        let asked = [cell(ours.ratio(plain), Some(TARGET)), cell(ours.ratio(raw), Some(TARGET_OF_SOCKET))];
        table.line("controller to controller", ours, asked);
        table.line("zenoh alone, thread to thread", plain, ["1".into(), of_socket(plain)]);
        table.line("the same, bytes of one's own", owned, [cell(owned.ratio(plain), None), of_socket(owned)]);
        table.line(
            "zenoh alone, batches shared, not express",
            batched,
            [cell(batched.ratio(plain), None), of_socket(batched)],
        );
        table.line("zenoh alone, answered in its callback", quick, [cell(quick.ratio(plain), None), of_socket(quick)]);
        table.line("Unix socket", raw, [String::new(), "1".into()]);
        let target = (size >= MEMORY_FROM).then_some(TARGET_OF_MEMORY);
        let of_memory = format!("controller: {} of it", cell(ours.ratio(mapped), target));
        table.line("shared memory, copied in and out", mapped, [of_memory, of_socket(mapped)]);
        if dora.is_some() {
            table.line("dora, nodes in Python", &of_dora, [cell(of_dora.ratio(plain), None), of_socket(&of_dora)]);
        }
    }
    for pair in [socket, zenoh, bytes, shared, callback, memory] {
        pair.end()?;
    }
    dora.map_or(Ok(()), dora::Pair::end)?;
    controllers.end().await
}
