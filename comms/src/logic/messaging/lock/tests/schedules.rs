//! Seeded schedules: clients, a server and two resources, with crashes, pauses, partitions, delays, losses and
//! duplicates.
//!
//! One resource is in the server's program and asks its lock; the other resource is elsewhere and only compares
//! numbers. The judge keeps the simplest record: a list of all grants, and of all commands that were let through. It
//! looks for violations in this record.
//!
//! To run more schedules: `DCA_SCHEDULES=100000 cargo test -p comms --lib lock::tests::schedules -- --nocapture`.

use super::super::super::lock_client::{ClientEffect, ClientInput, LockClient};
use super::super::*;
use crate::logic::random::Random;
use std::collections::BTreeSet;

const CLIENTS: usize = 4;
/// How many milliseconds the disturbances last, and how long after them everything must settle.
const STORMY: u64 = 1500;
const CALM: u64 = 1500;

/// A bug in how the state machines are driven, not in the machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Misuse {
    /// A restarted server begins again with its very first number.
    ForgetsNumbers,
    /// The resource lets everything through.
    OpenResource,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Bug {
    fault: Option<Fault>,
    misuse: Option<Misuse>,
}

#[derive(Debug)]
enum Parcel {
    Request {
        from: usize,
        life: u64,
        call: u64,
        request: LockRequest,
    },
    Answer {
        to: usize,
        life: u64,
        call: u64,
        answer: LockAnswer,
    },
    /// A command to the resource in another program.
    Command {
        client: u64,
        fence: u64,
        local: bool,
    },
    Written {
        boot: u64,
        number: u64,
    },
}

struct Client {
    machine: LockClient,
    life: u64,
    /// The client does nothing before this time: it is suspended, or dead.
    asleep: u64,
    /// The number that the client looked up before it was suspended, and sends when it resumes.
    in_hand: Option<u64>,
    wants: bool,
    got: u64,
}

struct World {
    random: Random,
    bug: Bug,
    settings: LockSettings,
    server: Option<ResourceLock>,
    server_back: u64,
    boot: u64,
    disk: u64,
    clients: Vec<Client>,
    elsewhere: FencingCheck,
    flying: Vec<(u64, Parcel)>,
    /// For each client, the time until which it is cut off from the server.
    cut: Vec<u64>,
    lives: u64,
    judge: Judge,
}

#[derive(Default)]
struct Judge {
    /// The client of each number.
    owners: BTreeMap<u64, u64>,
    /// The greatest number that was let through, at each resource.
    through: [u64; 2],
    commands: u64,
    refused: u64,
    wrong: BTreeSet<&'static str>,
}

impl Judge {
    fn granted(&mut self, client: u64, fence: u64) {
        if *self.owners.entry(fence).or_insert(client) != client {
            self.wrong.insert("two clients had one number");
        }
    }

    fn acted(&mut self, client: u64, fence: u64, resource: usize, holder: Option<(u64, u64)>) {
        self.commands += 1;
        if fence < self.through[resource] {
            self.wrong.insert("an older grant acted after a newer one");
        }
        self.through[resource] = self.through[resource].max(fence);
        if self.owners.get(&fence).is_some_and(|owner| *owner != client) {
            self.wrong.insert("a client acted with the number of another one");
        }
        if resource == 0 && holder != Some((client, fence)) {
            self.wrong.insert("somebody acted who does not hold the lock");
        }
    }
}

fn at(ms: u64) -> Time {
    Time::ZERO + Duration::from_millis(ms)
}

impl World {
    fn new(seed: u64, bug: Bug) -> Self {
        let mut random = Random::new(seed);
        let preempt_after = match random.below(3) {
            0 => None,
            1 => Some(Duration::ZERO),
            _ => Some(Duration::from_millis(10)),
        };
        let lease = Duration::from_millis(40 + random.below(80));
        let settings = LockSettings { lease, preempt_after, waiting_max: 8 };
        let clients = (0..CLIENTS).map(|_| Client {
            machine: LockClient::new(0, String::new()),
            life: 0,
            asleep: 0,
            in_hand: None,
            wants: false,
            got: 0,
        });
        let mut world = Self {
            random,
            bug,
            settings,
            server: None,
            server_back: 0,
            boot: 0,
            disk: 1,
            clients: clients.collect(),
            elsewhere: FencingCheck::learning(),
            flying: Vec::new(),
            cut: vec![0; CLIENTS],
            lives: 0,
            judge: Judge::default(),
        };
        (0..CLIENTS).for_each(|client| world.begin_life(client));
        world
    }

    fn begin_life(&mut self, client: usize) {
        self.lives += 1;
        let one = &mut self.clients[client];
        (one.life, one.in_hand, one.wants) = (self.lives, None, false);
        one.machine = LockClient::new(self.lives, format!("c{client}"));
    }

    fn send(&mut self, ms: u64, client: usize, parcel: impl Fn() -> Parcel) {
        if ms < self.cut[client] || (ms < STORMY && self.random.below(20) == 0) {
            return;
        }
        let copies = if ms < STORMY && self.random.below(12) == 0 { 2 } else { 1 };
        for _ in 0..copies {
            let longest = if ms < STORMY && self.random.below(10) == 0 { 400 } else { 8 };
            self.flying.push((ms + 1 + self.random.below(longest), parcel()));
        }
    }

    fn client(&mut self, ms: u64, client: usize, input: ClientInput) {
        let mut effects = Vec::new();
        self.clients[client].machine.handle(at(ms), input, &mut effects);
        for effect in effects {
            match effect {
                ClientEffect::Call { call, request, .. } => {
                    let life = self.clients[client].life;
                    self.send(ms, client, || Parcel::Request { from: client, life, call, request: request.clone() });
                }
                ClientEffect::Held { .. } => self.clients[client].got += 1,
                ClientEffect::Lost(_) => self.clients[client].wants = false,
            }
        }
    }

    fn serve(&mut self, ms: u64, input: LockInput, asker: Option<(usize, u64, u64)>) {
        let Some(server) = &mut self.server else { return };
        let mut effects = Vec::new();
        server.handle(at(ms), input, &mut effects);
        for effect in effects {
            match effect {
                LockEffect::Persist(number) => {
                    let due = ms + self.random.below(10);
                    self.flying.push((due, Parcel::Written { boot: self.boot, number }));
                }
                LockEffect::Answer { client, answer } => {
                    if let LockAnswer::Granted { fence, .. } = &answer {
                        self.judge.granted(client, *fence);
                    }
                    // Only the present caller can be answered; the others ask again.
                    let Some((to, life, call)) = asker.filter(|(_, life, _)| *life == client) else { continue };
                    self.send(ms, to, || Parcel::Answer { to, life, call, answer: answer.clone() });
                }
            }
        }
    }

    fn arrive(&mut self, ms: u64, parcel: Parcel) {
        match parcel {
            Parcel::Request { from, life, call, request } if ms >= self.cut[from] => {
                self.serve(ms, LockInput::Request(request), Some((from, life, call)));
            }
            Parcel::Answer { to, life, call, answer } if ms >= self.cut[to] && self.clients[to].life == life => {
                if self.clients[to].asleep > ms {
                    // The answer waits in the socket while the client sleeps.
                    let awake = self.clients[to].asleep;
                    self.flying.push((awake, Parcel::Answer { to, life, call, answer }));
                } else {
                    self.client(ms, to, ClientInput::Answer { call, answer: Some(answer) });
                }
            }
            Parcel::Command { client, fence, local } => self.command(ms, client, fence, local),
            Parcel::Written { boot, number } if boot == self.boot && self.server.is_some() => {
                self.disk = self.disk.max(number);
                self.serve(ms, LockInput::Persisted(number), None);
            }
            Parcel::Request { .. } | Parcel::Answer { .. } | Parcel::Written { .. } => {}
        }
    }

    fn command(&mut self, ms: u64, client: u64, fence: u64, local: bool) {
        let trusts = self.bug.misuse == Some(Misuse::OpenResource);
        let admitted = match (&mut self.server, local) {
            (Some(server), true) => server.admit(at(ms), Some(fence)).is_ok() || trusts,
            (None, true) => return,
            (_, false) => self.elsewhere.admit(Some(fence)).is_ok() || trusts,
        };
        if !admitted {
            self.judge.refused += 1;
            return;
        }
        let holder = self.server.as_ref().and_then(|server| server.holder.as_ref());
        let holder = holder.filter(|holder| at(ms) < holder.until).map(|holder| (holder.client, holder.fence));
        self.judge.acted(client, fence, usize::from(!local), holder);
    }

    /// A random disturbance.
    fn disturb(&mut self, ms: u64) {
        let client = usize::try_from(self.random.below(CLIENTS as u64)).unwrap();
        let span = 20 + self.random.below(300);
        match self.random.below(400) {
            0..=3 => self.clients[client].asleep = ms + span,
            4 => {
                self.begin_life(client);
                self.clients[client].asleep = ms + span;
            }
            5..=7 => self.cut[client] = ms + span,
            8 => {
                self.server = None;
                self.server_back = ms + span;
            }
            _ => {}
        }
    }

    fn act(&mut self, ms: u64, client: usize) {
        let one = &mut self.clients[client];
        let (life, choice) = (one.life, self.random.below(40));
        // The client was suspended after its look at `held`, and continues from there.
        if let Some(fence) = one.in_hand.take() {
            return self.order(ms, client, life, fence);
        }
        if !one.wants {
            if choice < 2 || (ms >= STORMY && one.got == 0) {
                one.wants = true;
                let priority = u8::try_from(self.random.below(4)).unwrap();
                self.client(ms, client, ClientInput::Want(priority));
            }
            return;
        }
        if choice == 0 && ms < STORMY || (ms >= STORMY && one.got > 0) {
            one.wants = false;
            self.client(ms, client, ClientInput::Drop);
        } else if let Some(fence) = one.machine.held(at(ms))
            && choice < 12
        {
            if ms < STORMY && self.random.below(20) == 0 {
                one.in_hand = Some(fence);
                one.asleep = ms + self.random.below(400);
            } else {
                self.order(ms, client, life, fence);
            }
        }
    }

    fn order(&mut self, ms: u64, client: usize, life: u64, fence: u64) {
        for local in [true, false] {
            self.send(ms, client, || Parcel::Command { client: life, fence, local });
        }
    }

    fn boot(&mut self, ms: u64) {
        if self.server.is_some() || ms < self.server_back {
            return;
        }
        self.boot += 1;
        let forgets = self.bug.misuse == Some(Misuse::ForgetsNumbers);
        let mut server = ResourceLock::new(self.settings, if forgets { 1 } else { self.disk }, at(ms));
        server.fault = self.bug.fault;
        self.server = Some(server);
    }

    fn run(mut self) -> Result<(u64, u64), String> {
        for ms in 0..STORMY + CALM {
            if ms < STORMY {
                self.disturb(ms);
            } else if ms == STORMY {
                self.cut.fill(0);
                self.server_back = self.server_back.min(ms);
                for one in &mut self.clients {
                    (one.asleep, one.got) = (one.asleep.min(ms), u64::from(one.machine.held(at(ms)).is_some()));
                }
            }
            self.boot(ms);
            let (due, flying) = self.flying.drain(..).partition(|(due, _)| *due <= ms);
            self.flying = flying;
            let due: Vec<(u64, Parcel)> = due;
            due.into_iter().for_each(|(_, parcel)| self.arrive(ms, parcel));
            if self.server.as_ref().and_then(ResourceLock::deadline).is_some_and(|due| due <= at(ms)) {
                self.serve(ms, LockInput::Tick, None);
            }
            for client in 0..CLIENTS {
                if self.clients[client].asleep > ms {
                    continue;
                }
                if self.clients[client].machine.deadline().is_some_and(|due| due <= at(ms)) {
                    self.client(ms, client, ClientInput::Tick);
                }
                self.act(ms, client);
            }
        }
        if self.clients.iter().any(|client| client.got == 0) {
            self.judge.wrong.insert("somebody did not get the lock although all was well again");
        }
        match self.judge.wrong.into_iter().next() {
            None => Ok((self.judge.commands, self.judge.refused)),
            Some(wrong) => Err(wrong.to_owned()),
        }
    }
}

fn schedules() -> u64 {
    std::env::var("DCA_SCHEDULES").ok().and_then(|count| count.parse().ok()).unwrap_or(2000)
}

#[test]
fn no_two_clients_ever_share_a_resource() {
    let (mut commands, mut refused) = (0, 0);
    for seed in 0..schedules() {
        match World::new(seed, Bug::default()).run() {
            Ok((through, turned_away)) => {
                commands += through;
                refused += turned_away;
            }
            Err(wrong) => panic!("seed {seed}: {wrong}"),
        }
    }
    println!("{} schedules: {commands} commands came through, {refused} were refused", schedules());
    // A schedule in which nothing is refused would prove nothing.
    assert!(commands > 40 * schedules() && refused > 4 * schedules(), "{commands} {refused}");
}

#[test]
fn bugs_are_found() {
    let faults = [Fault::StaysOpen, Fault::GrantsUnwritten, Fault::RenewsAnybody, Fault::PreemptsOnPaper];
    let misuses = [Misuse::ForgetsNumbers, Misuse::OpenResource];
    let bugs = faults.iter().map(|&fault| Bug { fault: Some(fault), misuse: None });
    let bugs = bugs.chain(misuses.iter().map(|&misuse| Bug { fault: None, misuse: Some(misuse) }));
    for bug in bugs {
        let found = (0..400).find_map(|seed| Some((seed, World::new(seed, bug).run().err()?)));
        println!("{bug:?}: {found:?}");
        assert!(found.is_some(), "{bug:?} is not found");
    }
}
