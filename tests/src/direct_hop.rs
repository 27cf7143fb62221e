//! A hop over a direct wire between two programs of one host, with and without a team.

use anyhow::{Context as _, Result, ensure};
use comms::io::clock::now;
use comms::io::data::{DataSession, Priority, Publisher};
use comms::io::direct::{DirectPath, Guard, Inlet, Memory, Outlet, Parcel, Value, WireSecrets};
use comms::logic::direct::Place;
use comms::logic::object::TypeForm;
use comms::logic::switch::Arrival;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::time::Duration;
use zeroize::Zeroizing;

/// How long anything may take.
const WITHIN: Duration = Duration::from_secs(20);

/// One end of two wires, one in each direction.
#[derive(Debug)]
pub struct End {
    path: DirectPath,
    outlet: Outlet,
    came: Receiver<Vec<u8>>,
    came_tx: SyncSender<Vec<u8>>,
    inlet: Option<Inlet>,
    _publisher: Publisher,
    _session: DataSession,
}

/// Returns the guards of two programs of a team that have wires to each other.
pub fn guards() -> [Guard; 2] {
    [[1, 2], [2, 1]].map(|[shown, expected]| {
        let secret = |byte| Zeroizing::new([byte; 32]);
        let secrets = move |_: &str| Some(WireSecrets { shown: secret(shown), expected: secret(expected) });
        Guard::new(secrets, |_| ())
    })
}

/// Connects two ends that listen on these sockets.
///
/// # Errors
/// Fails if the sockets cannot be used, or if one end does not accept the other.
pub fn pair(sockets: [PathBuf; 2], guards: [Option<Guard>; 2]) -> Result<[End; 2]> {
    let ([of_ping, of_echo], [guard, other]) = (sockets, guards);
    let (mut ping, mut echo) = (End::open(&of_ping, "hop/0", guard)?, End::open(&of_echo, "hop/1", other)?);
    ping.hear(&echo, "hop/1")?;
    echo.hear(&ping, "hop/0")?;
    // A consumer is welcome before the producer's end has added it.
    let until = now() + WITHIN;
    while !(ping.outlet.is_connected() && echo.outlet.is_connected()) {
        ensure!(now() < until, "the ends do not meet");
        std::thread::yield_now();
    }
    Ok([ping, echo])
}

/// Returns the time of each hop, as half of a round trip. There are `count` round trips, after `warm_up` that do not
/// count.
///
/// # Errors
/// Fails if nothing comes back.
pub fn measure([ping, echo]: &mut [End; 2], (size, count, warm_up): (usize, usize, usize)) -> Result<Vec<Duration>> {
    let inlets = Arc::clone(echo.path.inlets());
    let (is_over, mut times, value) = (AtomicBool::new(false), Vec::new(), vec![1; size]);
    std::thread::scope(|scope| {
        let is_over = &is_over;
        scope.spawn(move || {
            while let Some(bytes) = echo.next(|| is_over.load(Ordering::SeqCst)) {
                echo.outlet.send(&mut Parcel::new(&bytes), 1);
            }
        });
        for number in 0..count + warm_up {
            let (at, until) = (now(), now() + WITHIN);
            ping.outlet.send(&mut Parcel::new(&value), 1);
            if ping.next(|| now() > until).is_none() {
                break;
            }
            if number >= warm_up {
                times.push((now() - at) / 2);
            }
        }
        is_over.store(true, Ordering::SeqCst);
        inlets.wake();
    });
    ensure!(times.len() == count, "nothing comes back over a direct wire");
    Ok(times)
}

impl End {
    fn open(socket: &Path, key: &str, guard: Option<Guard>) -> Result<Self> {
        let (path, session) = (DirectPath::open(socket, guard)?, DataSession::open_observer(None)?);
        let publisher = session.publisher(key, Priority::Wire)?;
        let outlet = path.outlet(key, &Memory::default(), &publisher);
        let (came_tx, came) = sync_channel(4);
        Ok(Self { path, outlet, came, came_tx, inlet: None, _publisher: publisher, _session: session })
    }

    fn hear(&mut self, other: &Self, key: &str) -> Result<()> {
        let (place, came_tx) = (Place::of(&other.path.locator()).context("it has no place")?, self.came_tx.clone());
        let on_arrival = move |arrival: Arrival<Value>, _| {
            if let Arrival::Value(value) = arrival {
                drop(came_tx.try_send(value.into_vec()));
            }
        };
        let form = TypeForm { name: "W".into(), fields: String::new() };
        self.inlet = Some(self.path.inlet(&place, WITHIN, key, form, None, on_arrival)?);
        Ok(())
    }

    /// Waits like a loop. Returns none if `is_over` holds before a value arrives.
    fn next(&self, is_over: impl Fn() -> bool) -> Option<Vec<u8>> {
        while !is_over() {
            if let Ok(bytes) = self.came.try_recv() {
                return Some(bytes);
            }
            if !self.path.inlets().wait(Some(now() + WITHIN / 100)) {
                self.path.inlets().read();
            }
        }
        None
    }
}
