//! Plays a row about a host on three nodes in namespaces, with stand-ins for the door's controllers.

use super::play::{First, Game, door};
use super::row::Row;
use super::seen::{Seen, expect_dead_wires, expect_running};
use comms::io::clock::now;
use comms::logic::time::Time;
use dca_tests::cluster::{Fakes, Hosts, NAMES, Program, SOON, spec, wait_until};
use rustix::process::Signal;

/// The ways in which a host is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Loss {
    /// All processes on the host die.
    Death,
    /// The link of the host is down.
    Cut,
    /// The two hosts with these numbers do not reach each other.
    Between(usize, usize),
}

/// Plays a row on three hosts, with commands from a fourth. Plays nothing if namespaces are not allowed.
pub(crate) fn play_on_hosts(row: &Row, loss: Loss) {
    let controllers = Fakes::program();
    let Some(hosts) = Hosts::start_with(4, None, &["--controllers", &controllers]) else { return };
    let number = NAMES.iter().position(|name| Some(*name) == row.host.as_deref()).map_or(0, |index| index + 1);
    let (_, steps) = door();
    let game = Game { row, fakes: Fakes::new(&hosts.cluster), steps };
    let mission = hosts.host(4).dca(&["deploy", "--lan", &spec("door_opening"), "--controllers", &controllers]);
    game.before(&row.before);
    game.expect_phase();
    let began = now();
    match loss {
        Loss::Cut => hosts.network.cut(number),
        Loss::Death => {
            hosts.network.cut(number);
            kill_all(&hosts, number);
        }
        Loss::Between(one, other) => hosts.network.keep_apart(&[one, other]),
    }
    match row.verdict.as_str() {
        "safe" => expect_safe(&game, began),
        "goes on without" => expect_running(row, &game.fakes, SOON),
        "goes on blind" => {
            expect_dead_wires(row, &game.fakes);
            expect_running(row, &game.fakes, SOON);
        }
        other => panic!("{}: no test for `{other}`", row.name),
    }
    expect_mission(&game, &hosts, mission);
    println!("{}: {}", row.name, row.verdict);
}

/// Kills a host, with its node and its programs.
fn kill_all(hosts: &Hosts, number: usize) {
    let folder = hosts.host(number).run_dir().display().to_string();
    let is_its = |text: &String| text.contains(&folder);
    for process in hosts.cluster.left() {
        // Programs of a node have the node's folder in their environment or arguments. Commands from elsewhere have
        // another folder.
        if process.command.iter().any(is_its) || process.environment.iter().any(is_its) {
            process.signal(Signal::KILL);
        }
    }
}

/// Checks that nothing is active any more, and that the last active process stopped in time.
fn expect_safe(game: &Game<'_>, began: Time) {
    let (row, within) = (game.row, game.row.safe_within.expect("a row that is safe has a time"));
    let is_idle = || game.fakes.active().is_empty();
    wait_until(SOON, is_idle).unwrap_or_else(|| panic!("{}: still runs {:?}", row.name, game.fakes.active()));
    let stops = game.fakes.said().into_values().filter(|said| said.word != "active").map(|said| said.at);
    let took = stops.max().unwrap_or(began).since(began);
    println!("{}: safe after {took:.2?}, the row says {within:?}", row.name);
    assert!(took <= within && row.running.is_empty(), "{}: safe after {took:?}, {within:?}", row.name);
}

fn expect_mission(game: &Game<'_>, hosts: &Hosts, mission: Program) {
    let row = game.row;
    match row.mission.as_str() {
        "is lost" => {}
        "fails" => {
            let ended = mission.ended(SOON);
            assert_eq!(ended.code, Some(1), "{}: {ended}", row.name);
            let trace = hosts.trace("door_opening-1");
            for name in row.follows().1 {
                Seen::all(&trace).expect_failure(row, &name);
            }
        }
        "can be done" => {
            game.go_on(&mission, First::Detector);
            let ended = mission.ended(SOON);
            assert_eq!(ended.code, Some(0), "{}: {ended}", row.name);
        }
        other => panic!("{}: no test for a mission that {other}", row.name),
    }
}
