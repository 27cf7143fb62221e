//! Compares a call to an exported procedure with its answer, and a message to a queue with its receipt, with a query
//! of zenoh alone and with a Unix socket.

use crate::figures::{Round, Subject, Table, cell};
use crate::raw::{self, Transport};
use crate::sdk;
use anyhow::Context;
use std::path::Path;

/// The number of measurements of each subject, in turn.
const ROUNDS: u32 = 9;
/// The messages: bytes, timed calls, and the calls before them.
const SIZES: [(&str, u32, u32, u32); 2] = [("64 B", 64, 1000, 150), ("64 KiB", 64 << 10, 200, 30)];
/// The greatest allowed cost of a call, as a multiple of zenoh alone.
const TARGET: f64 = 1.5;

/// Measures, and adds lines to the table.
pub(crate) async fn measure(dir: &Path, table: &mut Table) -> anyhow::Result<()> {
    let mut callee = sdk::Callee::start(dir).await?;
    let mut socket = raw::Pair::start(Transport::Socket, dir)?;
    let mut query = raw::Pair::start(Transport::ZenohQuery, dir)?;
    for (name, size, count, warm_up) in SIZES {
        let mut subjects: [Subject; 4] = Default::default();
        for _ in 0..ROUNDS {
            let [ours, plain, raw, queue] = &mut subjects;
            raw.push(socket.measure(size, count, warm_up)?);
            plain.push(query.measure(size, count, warm_up)?);
            let times = tokio::task::block_in_place(|| callee.measure(size, count, warm_up))?;
            ours.push(Round::of(times).context("no samples")?);
            let times = tokio::task::block_in_place(|| callee.measure_queue(size, count, warm_up))?;
            queue.push(Round::of(times).context("no samples")?);
        }
        let [ours, plain, raw, queue] = &subjects;
        table.heading(&format!("a call there and back, {name}, two processes"), "of zenoh", "of socket");
        let of_socket = |subject: &Subject| cell(subject.ratio(raw), None);
        table.line("call between two calculations", ours, [cell(ours.ratio(plain), Some(TARGET)), of_socket(ours)]);
        let asked = [cell(queue.ratio(plain), Some(TARGET)), of_socket(queue)];
        table.line("message to a queue, up to its receipt", queue, asked);
        table.line("query of zenoh, thread to thread", plain, ["1".into(), of_socket(plain)]);
        table.line("Unix socket", raw, [String::new(), "1".into()]);
    }
    socket.end()?;
    query.end()?;
    callee.end().await
}
