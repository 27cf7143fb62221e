//! The cost of a team's keys, compared with a network without keys: `cargo run --release -p dca-tests --example costs`,
//! as root. One run prints all figures. Measurements with and without keys alternate.

use anyhow::{Context as _, Result, bail, ensure};
use comms::io::clock::now;
use comms::io::data::{Cover, DataSession, Opener, Priority, Publisher, SealCounter, SealKey, Sealer, Subscription};
use comms::io::file::{self, Privacy};
use comms::io::session::{Reach, Role as SessionRole, prepare_process};
use comms::logic::codec;
use comms::logic::control::Dial;
use comms::logic::switch::Arrival;
use dca_tests::cluster::{Cluster, Ended, Host, Network, Program, SOON, Stream, wait_until};
use dca_tests::direct_hop;
use dca_tests::made_team::{MadeTeam, keys};
use node::logic::gate::{self, Gate, Ledger, Passed};
use node::logic::protocol::{Request, Signed};
use std::borrow::Cow;
use std::fs;
use std::io::Write as _;
use std::os::unix::fs::PermissionsExt as _;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;
use trust::request;
use trust::revocation::Revocations;
use trust::role::{Action, Role};
use trust::team::Judge;
use zeroize::Zeroizing;

/// The number of requests that are signed and checked.
const REQUESTS: u64 = 500;
/// The number of measurements of each kind of hop, in turn.
const ROUNDS: usize = 7;
/// The messages: bytes, timed round trips, and the round trips before them.
const SIZES: [(&str, usize, usize, usize); 2] = [("64 B", 64, 1500, 200), ("64 KiB", 64 << 10, 300, 40)];
/// The number of starts of 50 programs with and without keys, in turn.
const STARTS: usize = 20;

fn main() -> ExitCode {
    prepare_process(SessionRole::End);
    match costs() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            say(&format!("FAILED: {error:#}"));
            ExitCode::FAILURE
        }
    }
}

fn costs() -> Result<()> {
    let network = Network::new(2).context("there is no network of namespaces")?;
    let load = fs::read_to_string("/proc/loadavg")?;
    say(&format!("load average before: {}", load.trim()));
    requests()?;
    let hops = network.inside(1, hops).join();
    hops.map_err(|_panic| anyhow::anyhow!("the thread of the hops has panicked"))??;
    direct_hops()?;
    starts(&network)
}

fn say(line: &str) {
    writeln!(std::io::stdout(), "{line}").unwrap_or_default();
}

fn median(mut of: Vec<Duration>) -> Duration {
    of.sort();
    of.get(of.len() / 2).copied().unwrap_or_default()
}

fn micros(time: Duration) -> String {
    format!("{:.0} µs", time.as_secs_f64() * 1e6)
}

/// Signs requests like a command, and checks and records them like a node.
fn requests() -> Result<()> {
    let team = MadeTeam::default();
    let (user, node, cluster) = (keys(), keys(), Cluster::new());
    let credential = team.certify("dan", Role::Deployer, &user);
    let mut gate = Gate::new(node.public().id(), "c1".parse()?, Ledger::default());
    let asked = Request::Stop { name: "door_opening".into() };
    let mut ledger = file::appended(&cluster.folder().join("accepted"), Privacy::Own)?;
    let (mut signing, mut checking, mut keeping) = (Vec::new(), Vec::new(), Vec::new());
    for sequence in 1..=REQUESTS {
        let at = now();
        let time = team::now();
        let request = request::Request {
            team: team.team.id(),
            audience: gate::audience(&asked, "c1")?,
            action: Action::Stop,
            id: [1; 16],
            sequence,
            epoch: 0,
            not_before: time,
            not_after: time.plus(60),
        };
        let body = codec::encode(&asked)?;
        let signed = Signed { head: request.sign(&body, &user, &credential), body };
        signing.push(now() - at);
        let at = now();
        let revoked = Revocations::default();
        let judge = Judge { team: &team.team, revoked: &revoked, now: time, grace: 0 };
        let passed = gate.call(Request::Signed(Box::new(signed)), &judge, |_| 0);
        checking.push(now() - at);
        ensure!(matches!(passed, Ok(Passed::Signed(..))), "it is refused: {passed:?}");
        let at = now();
        ledger.write_all(&gate.take_news())?;
        ledger.sync_data()?;
        keeping.push(now() - at);
    }
    let [signing, checking, keeping] = [signing, checking, keeping].map(median);
    say(&format!(
        "a signed request, median of {REQUESTS}: sign {}, check {}, together {} (at most 1 ms); write down on this disk {}",
        micros(signing),
        micros(checking),
        micros(signing + checking),
        micros(keeping)
    ));
    Ok(())
}

/// Two data sessions like those of programs. The second session sends its samples back.
struct Pair {
    ping: DataSession,
    echo: DataSession,
    name: &'static str,
    /// In a team, the bytes under the seals of both directions.
    cover: Option<Cover>,
}

/// Returns both ends of a direction. The direction has its own key.
fn seals(secret: u8, cover: Cover) -> (Arc<Sealer>, Arc<Opener>) {
    let key = || Some(SealKey::new(&Zeroizing::new([secret; 32]), cover));
    let (sealer, opener) = (Sealer::new(&SealCounter::default()), Opener::new(|_, _| ()));
    sealer.set(key());
    opener.set(key());
    (Arc::new(sealer), Arc::new(opener))
}

impl Pair {
    fn open(
        (name, cover): (&'static str, Option<Cover>),
        [ping, echo]: [PathBuf; 2],
        [reach, other]: [Reach; 2],
    ) -> Result<Self> {
        let (ping, echo) = (DataSession::open(&ping, reach)?, DataSession::open(&echo, other)?);
        let pair = Self { ping, echo, name, cover };
        let place = pair.echo.location();
        let locators = if name == "Unix socket" { place.local } else { place.remote };
        ensure!(!locators.is_empty(), "nothing to dial");
        pair.ping.dial(&Dial { session: place.session, locators }, SOON)?;
        Ok(pair)
    }

    /// Returns the median time of a way.
    fn measure(&self, (size, count, warm_up): (usize, usize, usize)) -> Result<Duration> {
        let (heard, to_echo) = sync_channel(4);
        let (back, to_ping) = sync_channel(4);
        let hears_ping = hear(&self.echo, "hop/0", self.cover, move |bytes| drop(heard.try_send(bytes)))?;
        let hears_echo =
            hear(&self.ping, "hop/1", self.cover, move |bytes| back.try_send(bytes.len()).unwrap_or_default())?;
        let (out, answer) = (send(&self.ping, "hop/0", self.cover)?, send(&self.echo, "hop/1", self.cover)?);
        ensure!(wait_until(SOON, || out.is_heard() && answer.is_heard()).is_some(), "nobody hears");
        let mut times = Vec::new();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                while let Ok(bytes) = to_echo.recv() {
                    if answer.put_numbered(bytes, 1).is_err() {
                        return;
                    }
                }
            });
            for number in 0..count + warm_up {
                let at = now();
                out.put_numbered(vec![1; size], 1)?;
                ensure!(to_ping.recv_timeout(SOON) == Ok(size), "nothing comes back over {}", self.name);
                if number >= warm_up {
                    times.push((now() - at) / 2);
                }
            }
            // This ends the thread that answers.
            drop(hears_ping);
            Ok(())
        })?;
        drop(hears_echo);
        Ok(median(times))
    }
}

/// Returns the seals of a key. Each direction has different seals.
fn of_way(key: &str, cover: Cover) -> (Arc<Sealer>, Arc<Opener>) {
    seals(if key == "hop/0" { 1 } else { 2 }, cover)
}

fn send(session: &DataSession, key: &str, cover: Option<Cover>) -> Result<Publisher> {
    let publisher = session.publisher(key, Priority::Wire)?;
    Ok(cover.into_iter().fold(publisher, |publisher, cover| publisher.sealed(of_way(key, cover).0)))
}

fn hear(
    session: &DataSession,
    key: &str,
    cover: Option<Cover>,
    heard: impl Fn(Vec<u8>) + Send + Sync + 'static,
) -> Result<Subscription> {
    let on_arrival = move |arrival: Arrival<Cow<'_, [u8]>>, _| {
        if let Arrival::Value(bytes) = arrival {
            heard(bytes.into_owned());
        }
    };
    Ok(match cover {
        None => session.on_wire(key, on_arrival)?,
        Some(cover) => session.on_sealed_wire(key, of_way(key, cover).1, on_arrival)?,
    })
}

/// Measures a hop over TCP with TLS and without, with seals, and over a Unix socket. A Unix socket never has TLS.
fn hops() -> Result<()> {
    let (cluster, team) = (Cluster::new(), MadeTeam::default());
    let socket = |name: &str| cluster.folder().join(name);
    let [one, two] = ["m1", "m2"].map(|name| team.member(&socket(name), name));
    let in_team = || [Reach::Team(one.clone()), Reach::Team(two.clone())];
    let pairs = [
        Pair::open(("TCP", None), [socket("a"), socket("b")], [Reach::Lan, Reach::Lan])?,
        Pair::open(("TCP with TLS", None), [socket("c"), socket("d")], in_team())?,
        Pair::open(("Unix socket", None), [socket("e"), socket("f")], [Reach::Host, Reach::Host])?,
        Pair::open(("Unix socket", None), [socket("g"), socket("h")], in_team())?,
        Pair::open(("TCP with TLS and seals", Some(Cover::Bytes)), [socket("i"), socket("j")], in_team())?,
        Pair::open(("Unix socket", Some(Cover::Sender)), [socket("k"), socket("l")], in_team())?,
    ];
    for (name, size, count, warm_up) in SIZES {
        let mut times: [Vec<Duration>; 6] = Default::default();
        for _ in 0..ROUNDS {
            for (pair, times) in pairs.iter().zip(&mut times) {
                times.push(pair.measure((size, count, warm_up))?);
            }
        }
        let ratio = |over: usize, under: usize| {
            let ratios = times[over].iter().zip(&times[under]);
            let mut ratios: Vec<f64> = ratios.map(|(over, under)| over.as_secs_f64() / under.as_secs_f64()).collect();
            ratios.sort_by(f64::total_cmp);
            ratios[ratios.len() / 2]
        };
        let (tls, local) = (ratio(1, 0), ratio(3, 2));
        let (sealed, sealed_local) = (ratio(4, 1), ratio(5, 3));
        let [tcp, with_tls, unix, in_team, with_seals, local_seals] = times.map(median).map(micros);
        say(&format!(
            "a hop of {name}, two sessions: TCP {tcp}, with TLS {with_tls}, ratio {tls:.2}; on one host {unix}, in a team {in_team}, \
             ratio {local:.2} (at most 1.02)"
        ));
        say(&format!(
            "the same with the seals of wires: with TLS {with_seals}, ratio to TLS alone {sealed:.2}; on one host {local_seals}, \
             ratio {sealed_local:.2}"
        ));
    }
    for Pair { ping, echo, .. } in pairs {
        ping.close();
        echo.close();
    }
    Ok(())
}

/// Measures a hop over a direct wire, which programs of one host have. It does so with a team and without.
fn direct_hops() -> Result<()> {
    let cluster = Cluster::new();
    let pair = |name: &str, guards| {
        direct_hop::pair(["ping", "echo"].map(|end| cluster.folder().join(format!("{name}-{end}"))), guards)
    };
    let mut pairs = [pair("plain", [None, None])?, pair("team", direct_hop::guards().map(Some))?];
    let sizes = SIZES.into_iter().chain([("1 MiB", 1 << 20, 60, 10)]);
    for (name, size, count, warm_up) in sizes {
        let mut times: [Vec<Duration>; 2] = Default::default();
        for _ in 0..ROUNDS {
            for (pair, times) in pairs.iter_mut().zip(&mut times) {
                times.push(median(direct_hop::measure(pair, (size, count, warm_up))?));
            }
        }
        let [without, in_team] = &times;
        let ratios = in_team.iter().zip(without).map(|(over, under)| over.as_secs_f64() / under.as_secs_f64());
        let mut ratios: Vec<f64> = ratios.collect();
        ratios.sort_by(f64::total_cmp);
        let ratio = ratios.get(ROUNDS / 2).copied().unwrap_or_default();
        let [without, in_team] = times.map(median).map(micros);
        say(&format!("a direct hop of {name}: {without}, in a team {in_team}, ratio {ratio:.2} (at most 1.02)"));
    }
    Ok(())
}

/// Two hosts, in a team or not.
struct Robots<'a> {
    cluster: Cluster,
    network: &'a Network,
    /// The options with the operator's keys. There are none without a team.
    keys: Vec<String>,
}

impl<'a> Robots<'a> {
    fn host(&self, number: usize) -> Host {
        self.cluster.host(self.network, number)
    }

    fn ask(&self, arguments: &[&str]) -> Result<Ended> {
        let all: Vec<&str> = arguments.iter().copied().chain(self.keys.iter().map(String::as_str)).collect();
        let ended = self.host(1).ask(&all);
        ensure!(ended.code == Some(0), "{ended}");
        Ok(ended)
    }

    fn alone(network: &'a Network) -> Self {
        Self { cluster: Cluster::new(), network, keys: Vec::new() }
    }

    /// Makes a team of both hosts. Returns how long each took to join.
    fn team(network: &'a Network) -> Result<(Self, Vec<Duration>)> {
        let cluster = Cluster::new();
        let passphrase = cluster.file("passphrase", "correct horse battery\n");
        fs::set_permissions(&passphrase, fs::Permissions::from_mode(0o600))?;
        let keys = cluster.folder().join("keys").display().to_string();
        let keys = ["--keys".to_owned(), keys, "--passphrase".to_owned(), passphrase].to_vec();
        let robots = Self { cluster, network, keys };
        robots.ask(&["team", "init", "acme"])?;
        let mut took = Vec::new();
        for (number, name) in [(1, "c1"), (2, "c2")] {
            let invite = ["team", "invite", name].into_iter().chain(robots.keys.iter().map(String::as_str));
            let invitation = robots.host(1).dca(&invite.collect::<Vec<_>>());
            invitation.wait_for(Stream::Out, "\n", SOON);
            let said = invitation.text(Stream::Out);
            let Some(line) = said.trim().strip_prefix("dca team join ") else { bail!("no line but {said}") };
            let state = robots.host(number).state().display().to_string();
            let at = now();
            let joined = robots.host(number).ask(&["team", "join", line, "--state", &state]);
            took.push(now() - at);
            ensure!(joined.code == Some(0) && invitation.ended(SOON).code == Some(0), "{joined}");
        }
        Ok((robots, took))
    }

    /// Starts both nodes, and waits until they see each other.
    fn start(&self) -> Result<Vec<Program>> {
        let options: &[&str] = if self.keys.is_empty() { &["--insecure-lan"] } else { &[] };
        let nodes: Vec<Program> =
            [(1, "c1"), (2, "c2")].map(|(number, name)| self.host(number).node(name, options)).into();
        let both = || {
            ["c1", "c2"]
                .iter()
                .all(|name| self.host(1).ask(&["nodes"]).out.lines().filter(|line| line.contains(name)).count() == 2)
        };
        ensure!(wait_until(SOON, both).is_some(), "they do not see each other: {}", self.host(1).ask(&["nodes"]));
        Ok(nodes)
    }

    /// Deploys 50 programs. Returns the time from PREPARE to GO.
    fn deploy(&self, number: usize) -> Result<Duration> {
        let name = format!("fifty{number}");
        let spec = self.cluster.file(&format!("{name}.dca"), &spec());
        let ended = self.ask(&["deploy", &spec, "--no-record"])?;
        let events = self.host(1).ask(&["events", "--json"]);
        let go = events.out.lines().find_map(|line| {
            let event: serde_json::Value = serde_json::from_str(line).ok()?;
            let is_own = event["deployment"] == name.as_str();
            event["report"]["Go"]["took"].as_f64().filter(|_| is_own)
        });
        let go = go.with_context(|| format!("no GO in {events}, after {ended}"))?;
        Ok(Duration::from_secs_f64(go))
    }
}

/// Returns a spec of 50 programs on two hosts that end at once.
fn spec() -> String {
    let names: Vec<String> = (0..50).map(|number| format!("p{number}")).collect();
    let host = |number: usize| if number.is_multiple_of(2) { "\"c1\"" } else { "\"c2\"" };
    let instances: String =
        names.iter().enumerate().map(|(number, name)| format!("{name} instof Short({}); ", host(number))).collect();
    format!(
        "module Short(host) {{ exec \"true\"; plain; done; }}
        process main() {{ host {{ \"c1\" }} instantiated_processes {{ {instances} }} internal_event_actions {{ {} }} }}",
        names.join(" , ")
    )
}

fn starts(network: &Network) -> Result<()> {
    let (robots, joined) = Robots::team(network)?;
    let slowest = joined.into_iter().max().unwrap_or_default();
    say(&format!("`dca team join`, the slower of 2: {:.2} s (at most 2 s)", slowest.as_secs_f64()));
    let alone = Robots::alone(network);
    let nodes = [robots.start()?, alone.start()?];
    let mut took: [Vec<Duration>; 2] = Default::default();
    for number in 0..=STARTS {
        for (robots, took) in [&robots, &alone].into_iter().zip(&mut took) {
            let go = robots.deploy(number)?;
            // The first deployment reads the programs from the disk, so it does not count.
            took.extend((number > 0).then_some(go));
        }
    }
    for node in nodes.into_iter().flatten() {
        node.signal(rustix::process::Signal::TERM);
        let ended = node.ended(SOON);
        ensure!(ended.code == Some(0), "{ended}");
    }
    let load = fs::read_to_string("/proc/loadavg")?;
    let ratios = took[0].iter().zip(&took[1]).map(|(with, without)| with.as_secs_f64() / without.as_secs_f64());
    let mut ratios: Vec<f64> = ratios.collect();
    ratios.sort_by(f64::total_cmp);
    let [lower, middle, upper] = [1, 2, 3].map(|quarter| ratios[ratios.len() * quarter / 4]);
    let [with, without] = took.map(median).map(|time| time.as_secs_f64() * 1e3);
    say(&format!(
        "PREPARE to GO of 50 plain programs on two hosts, {STARTS} times in turn: {with:.0} ms in a team, {without:.0} ms without (medians); \
         ratio {middle:.2}, half of them {lower:.2} to {upper:.2} (at most 1.3); load average after: {}",
        load.trim()
    ));
    Ok(())
}
