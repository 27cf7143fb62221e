//! Attackers on a wire in a team. An attacker has links to both ends of a wire, with all rights of a zenoh peer. It
//! changes no value on the wire, reads nothing, and answers nothing for others. The attempt is one line of the audit
//! log, and the wire keeps its rate.

use comms::io::clock::now;
use comms::io::data::{CallWay, Cover, DataSession, Opener, Priority, SealCounter, SealKey, Sealer, Visitor};
use comms::io::direct::DirectPath;
use comms::io::session::{Reach, Session};
use comms::logic::bytes::Bytes;
use comms::logic::codec;
use comms::logic::control::Dial;
use comms::logic::direct::Place;
use comms::logic::key;
use comms::logic::object::{CallId, ObjectCall, ObjectError, Signature, TypeForm};
use comms::logic::seal::OTHER_KEY_WITHIN;
use dca_tests::cluster::{
    Cluster, Host, Network, Program, SOON, Stream, Trace, alone, best_second, executable, pass, rate, wait_until,
    window,
};
use node::logic::protocol::{Answer, Deployment, Request};
use rustix::process::Signal;
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::Duration;
use team::program::ProgramIdentity;
use team::visitor::VisitorIdentity;
use trust::delegation::Delegation;
use trust::identity::SecretKeys;
use trust::team::Credential;
use zeroize::Zeroizing;

/// Returns a key that exists only in this test.
fn seal_key(secret: u8) -> SealKey {
    SealKey::new(&Zeroizing::new([secret; 32]), Cover::Bytes)
}

const RATES: &str = "
process main() {
    host { c1 }
    instantiated_processes { source instof RateSource(c2, 1 kB); monitor instof RateMonitor(c3); }
    internal_connections(source, lbl1) { source, Out -> monitor, In; }
    internal_event_actions { source[lbl1], monitor }
}
";

/// A team on four hosts. The last host is a member, and runs nothing.
struct Team {
    // The fields are dropped in this order.
    _nodes: Vec<Program>,
    cluster: Cluster,
    network: Network,
    keys: Vec<String>,
}

const MEMBERS: [&str; 4] = ["c1", "c2", "c3", "c4"];

impl Team {
    /// Begins the team. Its nodes have these options.
    fn new(options: &[&str]) -> Option<Self> {
        let (cluster, network) = (Cluster::new(), Network::new(MEMBERS.len())?);
        let passphrase = cluster.file("passphrase", "correct horse battery\n");
        fs::set_permissions(&passphrase, Permissions::from_mode(0o600)).expect("a file of ours");
        let keys = cluster.folder().join("keys").display().to_string();
        let keys = ["--keys".to_owned(), keys, "--passphrase".to_owned(), passphrase].to_vec();
        let mut team = Self { _nodes: Vec::new(), cluster, network, keys };
        assert_eq!(team.ask(&["team", "init", "acme"]), 0);
        for (number, name) in (1..).zip(MEMBERS) {
            let invitation = team.host(1).dca(&team.with(&["team", "invite", name]));
            invitation.wait_for(Stream::Out, "\n", SOON);
            let said = invitation.text(Stream::Out);
            let line = said.trim().strip_prefix("dca team join ").expect("it prints what to type");
            let state = team.host(number).state().display().to_string();
            assert_eq!(team.host(number).ask(&["team", "join", line, "--state", &state]).code, Some(0));
            assert_eq!(invitation.ended(SOON).code, Some(0));
        }
        team._nodes = (1..).zip(MEMBERS).map(|(number, name)| team.host(number).node(name, options)).collect();
        let all_there = || {
            let nodes = team.host(1).ask(&["nodes"]);
            MEMBERS.iter().all(|name| nodes.out.lines().any(|line| line.starts_with(name)))
        };
        assert!(wait_until(SOON, all_there).is_some(), "{}", team.host(1).ask(&["nodes"]));
        Some(team)
    }

    fn host(&self, number: usize) -> Host {
        self.cluster.host(&self.network, number)
    }

    fn with<'a>(&'a self, arguments: &[&'a str]) -> Vec<&'a str> {
        arguments.iter().copied().chain(self.keys.iter().map(String::as_str)).collect()
    }

    fn ask(&self, arguments: &[&str]) -> i32 {
        self.host(1).ask(&self.with(arguments)).code.unwrap_or(-1)
    }

    /// Returns where the programs of a node are reachable, by their paths.
    fn locations(&self, number: usize, (deployment, epoch): (&str, u64)) -> Vec<(String, Dial)> {
        let name = MEMBERS[number - 1];
        let socket = self.host(number).run_dir().join(name).join("node.sock");
        let asked = Request::Locations { deployment: Deployment { name: deployment.to_owned(), epoch } };
        // Zenoh starts its threads in the network of its first use, which is the intruder's.
        let ask = move || {
            let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build();
            runtime.expect("threads").block_on(async {
                let session = Session::open_client(&socket).await.expect("the node is there");
                let asked = codec::encode(&asked).expect("it is short");
                let answer = session.call(&key::rpc(name, "request"), asked, SOON).await;
                session.close().await;
                answer.expect("it answers")
            })
        };
        let answer = self.network.inside(4, ask).join().expect("it answers");
        match codec::decode(&answer) {
            Ok(Answer::Locations(locations)) => locations,
            other => panic!("{other:?}"),
        }
    }

    /// Returns the subject and the reason of each refused wire or call in the audit log of a node.
    fn refusals(&self, number: usize) -> Vec<String> {
        self.audited(number, "refused")
    }

    /// Returns the same for another decision.
    fn audited(&self, number: usize, decision: &str) -> Vec<String> {
        let name = MEMBERS[number - 1];
        let log = fs::read_to_string(self.host(number).state().join(name).join("team/audit")).unwrap_or_default();
        let fields = |line: &str| {
            let fields: Vec<&str> = line.split('\t').collect();
            let is_meant = fields.get(2) == Some(&decision)
                && ["send on", "call", "link to"].iter().any(|what| fields[4].starts_with(what));
            is_meant.then(|| format!("{}|{}", fields[4], fields[6]))
        };
        log.lines().filter_map(fields).collect()
    }
}

/// Opens a session with links to these programs. Its credentials are those that a node gives to clients that watch
/// programs.
fn intrude(file: &Path, folder: &Path, dials: &[Dial]) -> DataSession {
    let identity = Arc::new(VisitorIdentity::open(file).expect("the node has written it"));
    let session = DataSession::open_observer(Some((identity, folder.to_owned()))).expect("it opens");
    for dial in dials {
        let remote = dial.locators.iter().filter(|place| place.starts_with("tcp/")).cloned().collect();
        session.dial(&Dial { session: dial.session.clone(), locators: remote }, SOON).expect("it is in the team");
    }
    session
}

/// Returns the identity of a program that the fourth host has started, as if its node vouched for it.
fn third_program(team: &Team) -> Arc<ProgramIdentity> {
    let host = team.host(4);
    let file = |name: &str| fs::read(host.state().join("c4/team").join(name)).expect("it is a member");
    let keys = SecretKeys::from_bytes(file("keys")[..].try_into().expect("keys"));
    let credential = Credential::from_bytes(&file("credential")).expect("a credential");
    let identity = ProgramIdentity::open(&host.run_dir().join("c4/programs"), |_| ()).expect("the node has written it");
    let key = identity.keys().signing().1;
    let delegation = Delegation::sign(key, "`main/third` of `spy@1`", team::now(), &keys, credential);
    identity.take_delegation(&delegation.to_bytes());
    Arc::new(identity)
}

/// A program of the same team, without a wire to these programs, wants to link to them. It comes no further than the
/// tunnel.
fn links_in_vain(identity: &Arc<ProgramIdentity>, folder: &Path, dials: &[Dial]) {
    let session = DataSession::open(&folder.join("third"), Reach::Team(Arc::clone(identity) as _)).expect("it opens");
    for dial in dials {
        let remote = dial.locators.iter().filter(|place| place.starts_with("tcp/")).cloned().collect();
        let to = Dial { session: dial.session.clone(), locators: remote };
        // A client without a wire waits for 2 s, and is then refused.
        assert!(session.dial(&to, Duration::from_millis(3500)).is_err(), "it has no wire");
    }
    session.close();
}

/// A fourth host is a member of the team. An attacker on it uses the credentials that its node gives to clients that
/// watch programs.
#[test]
fn a_member_speaks_for_other_programs_in_vain() {
    if !alone("team_wires::a_member_speaks_for_other_programs_in_vain") {
        return;
    }
    let [library, program] = ["dca-controller", "dca-examples"].map(|name| executable(name).display().to_string());
    let Some(team) = Team::new(&["--controllers", &library, "--controllers", &program]) else { return };
    sends_on_a_wire_in_vain(&team);
    calls_in_vain(&team, &program);
    wires_within_a_host_are_direct(&team);
}

/// An attacker with credentials of the team sends on the wire of two programs, a thousand times each second. None of
/// these values arrives, and the wire keeps its rate. The node of the consumer has one line in its audit log.
fn sends_on_a_wire_in_vain(team: &Team) {
    let rates = team.cluster.file("rates.dca", RATES);
    let deployed = team.host(1).dca(&team.with(&["deploy", &rates]));
    deployed.wait_for(Stream::Err, "▸", SOON);
    pass(Duration::from_secs(1));
    let quiet = window(|| pass(Duration::from_secs(3)));
    let dials: Vec<Dial> =
        [2, 3].iter().flat_map(|number| team.locations(*number, ("rates", 1))).map(|(_, dial)| dial).collect();
    assert_eq!(dials.len(), 2);
    let (file, folder) = (team.host(4).run_dir().join("c4/visitors"), team.cluster.folder().to_owned());
    let third = third_program(team);
    let attack = move || {
        links_in_vain(&third, &folder, &dials);
        let session = intrude(&file, &folder, &dials);
        let wire = key::wire("rates", 1, 0);
        let (tx, overheard) = sync_channel(1000);
        let _hearing = session.on_sample(&wire, move |bytes| tx.try_send(bytes.into_owned()).unwrap_or_default());
        let plain = session.publisher(&wire, Priority::Wire).expect("it is open");
        let own = Arc::new(Sealer::new(&SealCounter::default()));
        own.set(Some(seal_key(2)));
        let sealed = session.publisher(&wire, Priority::Wire).expect("it is open").sealed(own);
        assert!(plain.wait_heard(SOON) && sealed.wait_heard(SOON), "the monitor listens");
        let until = now() + Duration::from_secs(3);
        let mut number = 1_000_000;
        while now() < until {
            number += 1;
            // A beat of a source: its number, without padding.
            let beat = vec![0xff, 0xff, 0x7f, 0];
            plain.put_numbered(beat.clone(), number).expect("it is open");
            sealed.put_numbered(beat, number).expect("it is open");
            pass(Duration::from_millis(1));
        }
        session.close();
        (number, overheard.try_iter().collect::<Vec<Vec<u8>>>())
    };
    let attacked = window(|| {
        let (number, overheard) = team.network.inside(4, attack).join().expect("the attack ends");
        assert!(number > 1_000_500, "{number}");
        assert!(
            overheard.iter().all(|bytes| !bytes.windows(64).any(|part| part.iter().all(|byte| *byte == 0))),
            "it reads"
        );
    });
    let of = |number: usize, what: &str| {
        let lines = team.refusals(number);
        lines.into_iter().filter(|line| line.starts_with(what)).collect::<Vec<_>>()
    };
    let wire = "send on the wire `main/source, Out -> main/monitor, In` of `rates@1`|";
    let told = wait_until(SOON, || !of(3, wire).is_empty());
    assert!(told.is_some() && of(3, "send on").len() <= 2, "one line a minute: {:#?}", team.refusals(3));
    // Both ends have refused the program that has no wire to them.
    for (number, name) in [(2, "source"), (3, "monitor")] {
        let told = wait_until(SOON, || !of(number, "link to").is_empty());
        let who = "it has no wire with this program: `main/third` of `spy@1` on c4 at 10.77.0.4";
        let expected = format!("link to `main/{name}` of `rates@1`|{who}");
        assert!(told.is_some() && of(number, "link to") == [expected], "{:#?}", team.refusals(number));
    }
    assert_eq!(team.ask(&["stop", "rates"]), 0);
    drop(deployed.ended(SOON));
    let trace = Trace::read(&team.cluster.folder().join("runs/rates-1"));
    let received = trace.signal("main/monitor", "received");
    let [before, meanwhile] = [quiet, attacked].map(|window| rate(&received, window));
    let best = best_second(&received, attacked);
    assert!(best > 0.9 * before && meanwhile < 1.1 * before, "{before}, then {meanwhile}, at best {best}");
    let lost = trace.signal("main/monitor", "lost").last().expect("signals came").value;
    // The attacker's numbers begin with a million. A busy machine itself loses some numbers.
    assert!(lost < 100_000.0, "no number of the intruder was believed: {lost}");
}

const LEVELS: &str = "
process main() {
    host { c1 }
    instantiated_processes {
        wheels instof Wheels(c3);
        guard instof SpeedGuard(c2, limit = 0.5 m/s);
        trip instof Trip(c2, distance = 10000 m, speed = 2 m/s);
    }
    internal_connections { guard, Below -> wheels, Drive; trip, Drive -> guard, Drive; trip, Place -> wheels, place; }
    internal_event_actions { wheels, guard, trip }
}
";

/// Between hosts of a team, calls follow the connections of the spec, and `dca` may call from any of its machines. A
/// client that has a link to a program but has signed nothing calls without success.
fn calls_in_vain(team: &Team, program: &str) {
    let levels = team.cluster.file("levels.dca", LEVELS);
    let deployed = team.host(1).dca(&team.with(&["deploy", &levels, "--no-record", "--controllers", program]));
    deployed.wait_for(Stream::Err, "▸", SOON);
    let place = || {
        let got = team.host(4).ask(&["get", "levels:main/wheels.place", "--within", "60"]);
        assert_eq!(got.code, Some(0), "{got}");
        let place: serde_json::Value =
            serde_json::from_str(got.out.trim()).unwrap_or_else(|why| panic!("{why}: {got}"));
        place["travelled"].as_f64().expect("a length")
    };
    let moves = |from: f64| wait_until(SOON, || place() > from).is_some();
    assert!(moves(place()), "the trip drives the wheels over two hosts");
    let drive = ["call", "wheels.Drive", "speed=0.25 m/s", "--json", "--within", "60"];
    let nobody = team.cluster.folder().join("nobody").display().to_string();
    let unsigned = team.host(4).ask(&[&drive[..], &["--keys", &nobody]].concat());
    assert!(unsigned.code == Some(1) && unsigned.err.contains("you have no key"), "{unsigned}");
    let asked = team.host(4).ask(&team.with(&drive));
    assert_eq!(asked.code, Some(0), "{asked}");
    let accepted = team.audited(3, "accepted");
    assert_eq!(
        accepted.last().map(String::as_str),
        Some("call `Drive` of `main/wheels` of `levels@2`|"),
        "{accepted:?}"
    );
    let locations = team.locations(3, ("levels", 2));
    let dial = locations.into_iter().find(|(path, _)| path == "main/wheels").expect("it is there").1;
    let (file, folder) = (team.host(4).run_dir().join("c4/visitors"), team.cluster.folder().to_owned());
    let attack = move || {
        let visitor = VisitorIdentity::open(&file).expect("the node has written it");
        let session = intrude(&file, &folder, &[dial]);
        let keys = key::object("levels", "main/wheels");
        let call = ObjectCall {
            id: CallId { session: session.id(), number: 1 },
            caller: "dca".to_owned(),
            name: "Drive".to_owned(),
            signature: Signature { argument: TypeForm::new("Go", ""), result: TypeForm::new("Place", "") },
            within: Duration::from_secs(5),
            argument: Bytes(3.0_f64.to_le_bytes().to_vec()),
            warrant: None,
        };
        let own = || {
            let sealer = Arc::new(Sealer::new(&SealCounter::default()));
            sealer.set(Some(seal_key(2)));
            sealer
        };
        let sealed = CallWay::Sealed { call: own(), cancel: own(), answer: Arc::new(Opener::new(|_, _| ())) };
        let signed = CallWay::Signed(Visitor(Arc::new(move |digest| Some(visitor.sign_visit(digest)))));
        let ways = [&CallWay::Open, &sealed, &signed];
        let called = ways.map(|way| session.call_and_wait(&keys, way, &call));
        session.close();
        called
    };
    let called = team.network.inside(4, attack).join().expect("the attack ends");
    let reason = "in a team, a call of `Drive` needs the key of a user who may operate (`dca team key`)".to_owned();
    assert_eq!(called, [Err(ObjectError::Gone), Err(ObjectError::Gone), Err(ObjectError::Refused { reason })]);
    let told = wait_until(SOON, || team.refusals(3).iter().any(|line| line.starts_with("call ")));
    let lines: Vec<String> = team.refusals(3).into_iter().filter(|line| line.starts_with("call ")).collect();
    assert!(told.is_some() && lines.len() == 1, "{lines:#?}");
    assert!(lines[0].starts_with("call `main/wheels` of `levels@2`|"), "{lines:#?}");
    assert!(moves(place()), "it goes on");
    assert_eq!(team.ask(&["stop", "levels"]), 0);
    drop(deployed.ended(SOON));
}

/// Returns the number of consumers connected to the producer that listens at `place`, a socket for direct wires.
fn consumers(team: &Team, number: usize, place: &Path) -> usize {
    let place = place.display().to_string();
    let count = move || {
        let sockets = fs::read_to_string("/proc/thread-self/net/unix").expect("Linux tells its sockets");
        let fields = sockets.lines().map(|line| line.split_whitespace().collect::<Vec<_>>());
        // The sixth field of a connected one is 3, and the last field is the name of the listener.
        fields.filter(|fields| fields.get(5) == Some(&"03") && fields.last() == Some(&place.as_str())).count()
    };
    team.network.inside(number, count).join().expect("it reads")
}

/// Returns where a program accepts consumers of its own host.
fn direct_socket(team: &Team, path: &str) -> PathBuf {
    let leaf = team.cluster.expect_leaf(path);
    let socket = leaf.environment.iter().find_map(|variable| variable.strip_prefix("DCA_DATA_SOCKET="));
    Path::new(socket.expect("it has a data session")).with_extension("wire")
}

/// A wire between two programs of one host works without zenoh, and its values can be watched like others. Another
/// program of the same user has found the socket, but has no keys. It reaches neither end, and the attempt is a line of
/// the audit log.
fn wires_within_a_host_are_direct(team: &Team) {
    let near = team.cluster.file("near.dca", &RATES.replace("RateMonitor(c3)", "RateMonitor(c2)"));
    let deployed = team.host(1).dca(&team.with(&["deploy", &near]));
    deployed.wait_for(Stream::Err, "▸", SOON);
    let place = direct_socket(team, "main/source");
    assert_eq!(consumers(team, 2, &place), 1);
    let runs = team.cluster.folder().join("runs/near-1");
    let received = || Trace::so_far(&runs).signal("main/monitor", "received").last().map_or(0.0, |last| last.value);
    assert!(wait_until(SOON, || received() > 50.0).is_some(), "{}", deployed.text(Stream::Err));
    let echoed = team.host(2).ask(&["echo", "source.Out", "-n", "5", "--json"]);
    assert_eq!((echoed.code, echoed.out.lines().count()), (Some(0), 6), "{echoed}");
    let intruder = DirectPath::open(&team.cluster.folder().join("intruder.wire"), None).expect("it listens");
    let found = Place { path: place.display().to_string(), token: "guessed".to_owned() };
    let form = TypeForm { name: "Beat".to_owned(), fields: String::new() };
    let wire = key::wire("near", 3, 0);
    assert!(intruder.inlet(&found, SOON, &wire, form, None, |_, _| ()).is_err());
    let who = format!("process {} of user {} on this machine", std::process::id(), rustix::process::getuid().as_raw());
    let expected = format!("link to `main/source` of `near@3`|it has no wire with this program: {who}");
    let told = wait_until(SOON, || team.refusals(2).contains(&expected));
    assert!(told.is_some() && consumers(team, 2, &place) == 1, "{:#?}", team.refusals(2));
    let before = received();
    assert!(wait_until(SOON, || received() > before + 50.0).is_some(), "it goes on");
    assert!(
        !team.refusals(2).iter().any(|line| line.contains("near@3") && *line != expected),
        "{:#?}",
        team.refusals(2)
    );
    assert_eq!(team.ask(&["stop", "near"]), 0);
    drop(deployed.ended(SOON));
}

/// A source on one host feeds two monitors on another host, and one monitor on its own host. The source is killed
/// twice, and two of the monitors in between. A restarted program has different keys. The other ends are told, the
/// values continue, and this adds no line to the audit log.
#[test]
fn programs_that_are_started_again_go_on_with_new_keys() {
    if !alone("team_wires::programs_that_are_started_again_go_on_with_new_keys") {
        return;
    }
    let Some(team) = Team::new(&[]) else { return };
    let text = "
        process main() {
            host { c1 }
            instantiated_processes {
                source instof RateSource(c2) { restart transient; }
                monitor instof RateMonitor(c3);
                other instof RateMonitor(c3) { restart transient; }
                near instof RateMonitor(c2) { restart transient; }
            }
            internal_connections(source, lbl1) { source, Out -> monitor, In; source, Out -> other, In; source, Out -> near, In; }
            internal_event_actions { source[lbl1], monitor, other, near }
        }";
    let deployed = team.host(1).dca(&team.with(&["deploy", &team.cluster.file("beats.dca", text)]));
    deployed.wait_for(Stream::Err, "▸", SOON);
    let runs = team.cluster.folder().join("runs/beats-1");
    // Waits until `more` additional values have come.
    let received = |path: &str| Trace::so_far(&runs).signal(path, "received").last().map_or(0.0, |last| last.value);
    let beats = |count: f64| {
        let began = received("main/monitor");
        let have_come = wait_until(SOON, || received("main/monitor") > began + count);
        assert!(have_come.is_some(), "{}", deployed.text(Stream::Err));
    };
    beats(50.0);
    for path in ["main/source", "main/other", "main/source", "main/near"] {
        let near = received("main/near");
        let killed = team.cluster.expect_leaf(path);
        killed.signal(Signal::KILL);
        let is_back = || team.cluster.leaf(path).is_some_and(|leaf| leaf.pid != killed.pid);
        assert!(wait_until(SOON, is_back).is_some(), "{path} is started again");
        beats(50.0);
        let is_direct = || consumers(&team, 2, &direct_socket(&team, "main/source")) == 1;
        assert!(wait_until(SOON, is_direct).is_some(), "after {path} the wire within the host is direct again");
        // The test does not follow the signals of a restarted program.
        let has_come = || path == "main/near" || received("main/near") > near + 50.0;
        assert!(wait_until(SOON, has_come).is_some(), "{}", deployed.text(Stream::Err));
    }
    // This is longer than a different key may remain unnoticed.
    pass(OTHER_KEY_WITHIN + Duration::from_secs(1));
    beats(50.0);
    assert_eq!((team.refusals(2), team.refusals(3)), (vec![], vec![]));
    assert_eq!(team.ask(&["stop", "beats"]), 0);
    drop(deployed.ended(SOON));
}

/// A mission calls another deployment, from two hosts. In each mission, both ends seal for each other, and no call is
/// refused.
#[test]
fn calls_of_another_deployment_are_sealed_too() {
    if !alone("team_wires::calls_of_another_deployment_are_sealed_too") {
        return;
    }
    let program = executable("dca-examples").display().to_string();
    let Some(team) = Team::new(&["--controllers", &program]) else { return };
    let folder = format!("{}/../examples/hardware", env!("CARGO_MANIFEST_DIR"));
    let file = |name: &str, pilot: &str| {
        let text =
            fs::read_to_string(format!("{folder}/{}.dca", if pilot.is_empty() { "hardware" } else { "mission" }));
        let text = text.expect("the example is there").replace("Base(c1", "Base(c3");
        team.cluster.file(&format!("{name}.dca"), &text.replace("Pilot(c1", &format!("Pilot({pilot}")))
    };
    let deploy = |file: &str| {
        let deploy = ["deploy", "--no-record", "--controllers", program.as_str(), file];
        team.host(1).dca(&team.with(&deploy))
    };
    let hardware = deploy(&file("hardware", ""));
    hardware.wait_for(Stream::Err, "▸", SOON);
    for (name, pilot) in [("near", "c3"), ("far", "c2"), ("again", "c2")] {
        let ended = deploy(&file(name, pilot)).ended(2 * SOON);
        assert_eq!(ended.code, Some(0), "{name}: {ended}");
    }
    assert_eq!((team.refusals(2), team.refusals(3)), (vec![], vec![]));
    assert_eq!(team.ask(&["stop", "hardware"]), 0);
    drop(hardware.ended(SOON));
}
