//! The programs of a [`World`]: their notices, durations and ends; and the callers, and the disk.

use super::world::{Coming, World};
use comms::logic::codec::WIRE_VERSION;
use comms::logic::control::{Location, Notice, Order};
use language::plan::LeafKind;
use node::logic::agent::Input;
use node::logic::effect::{ProcessId, SpawnOrder};
use node::logic::protocol::{Answer, Estop};
use shim::protocol::ShimReport;
use std::collections::BTreeSet;

impl World {
    pub(super) fn finish(&mut self, host: &str, process: ProcessId, activation: u32) {
        if self.modules[&process] == "Script" {
            return self.die(host, &process, ShimReport::Exited { code: 0 });
        }
        self.running.remove(&(host.to_owned(), process.clone()));
        let notice = Notice::Done { activation, value: vec![] };
        self.give(host, Input::Control { process, notice });
    }

    pub(super) fn notice(&mut self, millis: u64, host: &str, process: &ProcessId, notice: Notice) {
        if self.alive.contains(&(host.to_owned(), process.clone())) {
            let life = self.lives[process];
            self.at(millis, host, Coming::Notice(process.clone(), life, notice));
        }
    }

    pub(super) fn answer(&mut self, call: u64, answer: Answer) {
        assert!(!self.answered.contains(&call), "nobody waits for it any more: {answer:?}");
        self.answers.entry(call).or_default().push(answer);
    }

    /// The disk's answer to a write.
    pub(super) fn written(&self) -> Result<(), String> {
        self.disk_refuses.clone().map_or(Ok(()), Err)
    }

    pub(super) fn keep_estop(&mut self, host: &str, number: u64, estop: Option<Estop>) {
        let written = self.written();
        if written.is_ok() {
            self.estops.insert(host.into(), estop);
        }
        self.at(self.disk_ms, host, Coming::Input(Input::EstopKept { number, written }));
    }

    pub(super) fn report(&mut self, host: &str, process: &ProcessId, report: ShimReport) {
        let ended = report.end().is_some();
        let output = if ended { self.output.clone() } else { Vec::new() };
        let input = Input::Shim { process: process.clone(), report, output };
        self.at(1, host, Coming::Input(input));
    }

    /// Kills a program like `kill -9`.
    pub(super) fn kill(&mut self, host: &str, leaf: u32) {
        self.end(host, leaf, ShimReport::Signalled { signal: 9 });
    }

    /// Lets a program end with this report of its shim.
    pub(super) fn end(&mut self, host: &str, leaf: u32, how: ShimReport) {
        let found = self.alive.iter().find(|(on, process)| on == host && process.leaf == leaf);
        let (_, process) = found.expect("the program is alive").clone();
        self.die(host, &process, how);
    }

    /// Ends a program, unless it is between two lives.
    pub(super) fn kill_if_alive(&mut self, host: &str, leaf: u32) {
        if self.alive.iter().any(|(on, process)| on == host && process.leaf == leaf) {
            self.kill(host, leaf);
        }
    }

    pub(super) fn die(&mut self, host: &str, process: &ProcessId, how: ShimReport) {
        if !self.alive.remove(&(host.to_owned(), process.clone())) {
            return;
        }
        self.running.remove(&(host.to_owned(), process.clone()));
        self.traffic.forget(process.leaf);
        // The wires of a program die with it: a new one has them closed.
        self.wires_open.retain(|wire| self.openers.get(wire) != Some(process));
        self.report(host, process, how);
        self.report(host, process, ShimReport::Gone);
    }

    /// Counts an order to a program or its shim; returns whether it exists.
    pub(super) fn took(&mut self, process: &ProcessId, is_control: bool) -> bool {
        let Some((orders, shim_orders)) = self.took.get_mut(process) else { return false };
        *(if is_control { orders } else { shim_orders }) += 1;
        true
    }

    pub(super) fn order(&mut self, host: &str, process: &ProcessId, order: Order) {
        if !self.alive.contains(&(host.to_owned(), process.clone())) {
            return;
        }
        let module = self.modules[process].clone();
        match order {
            Order::Connect { incoming, outgoing, .. } => {
                self.linked(host, process, &incoming, &outgoing);
                let sessions = incoming.into_iter().map(|incoming| incoming.producer.session).collect();
                self.make_links(host, process, &sessions);
                self.dialled.insert(process.clone(), sessions);
            }
            Order::Relink { lost, found } => {
                let sessions = self.dialled.entry(process.clone()).or_default();
                sessions.remove(&lost);
                sessions.insert(found.session);
            }
            Order::Open { wires, generation } => {
                self.openers.extend(wires.iter().map(|wire| (*wire, process.clone())));
                self.wires_open.extend(wires);
                self.notice(2, host, process, Notice::Switched { generation });
            }
            Order::Close { wires, generation } => {
                self.wires_open.retain(|wire| !wires.contains(wire));
                self.notice(2, host, process, Notice::Switched { generation });
            }
            Order::Flip { ticket, flip } => self.flip(host, process, ticket, flip),
            Order::Expect { ticket, expect, then } => self.expect(host, process, ticket, (expect, then)),
            Order::Activate { activation, .. } => {
                let hangs = self.commands[process].get(2).is_some_and(|way| way == "way=hangs");
                if !hangs {
                    self.notice(1, host, process, Notice::Running { activation });
                }
                self.run(host, process, activation);
            }
            Order::Stop { activation } => {
                self.running.remove(&(host.to_owned(), process.clone()));
                if module != "Stubborn" {
                    let notice = self.stopped(process, activation);
                    self.notice(4, host, process, notice);
                }
            }
            Order::Configure { .. }
            | Order::Shape { .. }
            | Order::Calls { .. }
            | Order::Resumed { .. }
            | Order::Database { .. }
            | Order::Keys { .. }
            | Order::Partners { .. }
            | Order::Secret { .. }
            | Order::Vouch { .. }
            | Order::Judged { .. } => {}
            Order::Received { number, fate } => self.fates.push((number, fate)),
            Order::Send { number, port, value } => {
                self.sent.push((port, value));
                self.notice(1, host, process, Notice::Sent { number });
            }
            Order::Rejoin => {
                self.rejoining.insert(process.clone());
            }
            Order::Exit if self.lingers => {}
            Order::Exit => {
                if let Some(activation) = self.running.get(&(host.to_owned(), process.clone())) {
                    let notice = self.stopped(process, *activation);
                    self.at(0, host, Coming::Input(Input::Control { process: process.clone(), notice }));
                }
                self.die(host, process, ShimReport::Exited { code: 0 });
            }
        }
    }

    /// Returns how a program ends that was told to.
    fn stopped(&self, process: &ProcessId, activation: u32) -> Notice {
        if self.commands[process].get(2).is_some_and(|way| way == "way=loose") {
            return Notice::StopUnconfirmed { activation, reason: "the goal may go on".to_owned() };
        }
        Notice::Stopped { activation }
    }

    pub(super) fn spawn(&mut self, host: &str, order: SpawnOrder) {
        let process = order.process;
        assert!(self.alive.insert((host.into(), process.clone())), "two programs of `{}`", order.path);
        *self.lives.entry(process.clone()).or_default() += 1;
        self.begins.push((self.now, host.to_owned(), order.path.clone()));
        self.took.insert(process.clone(), (0, 0));
        self.rejoining.remove(&process);
        self.dialled.remove(&process);
        self.spawned.entry(order.path.clone()).or_default().push(order.policy);
        self.modules.insert(process.clone(), order.command[1].clone());
        self.commands.insert(process.clone(), order.command.clone());
        if order.kind == LeafKind::Plain {
            return self.report(host, &process, ShimReport::Ready);
        }
        self.report(host, &process, ShimReport::Started { pid: 100 + process.leaf });
        if self.fails_at_start {
            return self.die(host, &process, ShimReport::Exited { code: 1 });
        }
        if self.hangs_at_start {
            return;
        }
        let local = vec!["unix".into()];
        let (session, remote) = (self.session(&process), vec!["tcp".into()]);
        let location = Some(Location { session, local, remote, keys: vec![] });
        let owns = if order.command[1] == "Owner" { vec!["arm".to_owned()] } else { vec![] };
        let needs = vec![];
        let version = self.version.unwrap_or(WIRE_VERSION);
        let hello = Notice::Hello { version, instance: order.path, location, owns, needs, signals: false };
        self.notice(5, host, &process, hello);
    }

    /// Has a program make its links. A producer that is gone is waited for at first, and for long only if all programs start together.
    fn make_links(&mut self, host: &str, process: &ProcessId, sessions: &BTreeSet<String>) {
        let there: BTreeSet<String> = self.alive.iter().map(|(_, other)| self.session(other)).collect();
        let reason = "a producer has not come within 18 s".to_owned();
        let is_first = !self.dialled.contains_key(process);
        match sessions.difference(&there).next().filter(|_| is_first) {
            None => self.notice(3, host, process, Notice::Connected),
            Some(_) if self.rejoining.contains(process) => self.notice(1000, host, process, Notice::Connected),
            Some(_) => self.notice(18_000, host, process, Notice::ConnectFailed { reason }),
        }
    }

    /// Returns the present session of a program.
    pub(super) fn session(&self, process: &ProcessId) -> String {
        format!("leaf {} life {}", process.leaf, self.lives[process])
    }

    pub(super) fn run(&mut self, host: &str, process: &ProcessId, activation: u32) {
        let module = self.modules[process].clone();
        self.log.push(format!("{module} with wires {:?}", self.wires_open));
        self.running.insert((host.into(), process.clone()), activation);
        self.begins.push((self.now, host.to_owned(), module.clone()));
        self.begun.entry(process.clone()).or_insert(self.now);
        self.source_begins(host, process, &module);
        match self.commands[process].get(2).map(String::as_str) {
            Some("way=dies") => return self.die(host, process, ShimReport::Exited { code: 3 }),
            Some("way=aborts") => {
                let reason = "it is not well".to_owned();
                return self.notice(20, host, process, Notice::Aborted { activation, reason });
            }
            Some("way=sticks") => return self.notice(20, host, process, Notice::Stopping { activation }),
            Some("way=ends") => {
                return self.notice(20, host, process, Notice::Done { activation, value: Vec::new() });
            }
            _ => {}
        }
        let lasts = match module.as_str() {
            "Step" | "Script" | "Arm" | "Eye" | "Owner" => 50,
            "Long" | "Walker" => 10_000,
            _ => return,
        };
        self.at(lasts, host, Coming::Finish(process.clone(), self.lives[process], activation));
    }
}
