//! A team on a network: namespaces on a bridge with one node each. They are invited and join with the usual commands,
//! with strangers beside them.

mod split;

use comms::io::clock::now;
use dca_tests::cluster::{
    Cluster, Ended, Host, NAMES, Network, Program, SOON, Stream, Trace, Turn, alone, best_second, pass, rate, spec,
    wait_until, window,
};
use std::fs::{self, Permissions};
use std::io::Write as _;
use std::net::TcpStream;
use std::os::unix::fs::PermissionsExt as _;
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;

const MISSION_MAX: Duration = Duration::from_secs(180);

/// The operator's desk on host 1, and the robots of the team, one on each of the first hosts.
struct Team {
    // The fields are dropped in this order.
    nodes: Vec<Program>,
    cluster: Cluster,
    network: Network,
    /// The options with the keys.
    keys: Vec<String>,
    /// Lets only one of these tests run at a time, since they measure the machine.
    _alone: MutexGuard<'static, ()>,
}

impl Team {
    /// Begins a team on a network of `hosts` hosts.
    fn new(hosts: usize) -> Option<Self> {
        static ALONE: Mutex<()> = Mutex::new(());
        let alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        let (cluster, network) = (Cluster::new(), Network::new(hosts)?);
        let keys = desk(&cluster, &cluster.host(&network, 1), "acme");
        Some(Self { nodes: Vec::new(), cluster, network, keys, _alone: alone })
    }

    /// Begins a team with a robot on each of the first three hosts.
    fn of_three(hosts: usize) -> Option<Self> {
        let mut team = Self::new(hosts)?;
        for (number, name) in (1..).zip(NAMES) {
            join(&team.host(1), &team.keys, &team.host(number), name);
            team.nodes.push(team.host(number).node(name, &[]));
        }
        let all_there = |number: usize| {
            let nodes = team.host(number).ask(&["nodes"]);
            NAMES.iter().all(|name| nodes.out.lines().any(|line| line.starts_with(name)))
        };
        let found = wait_until(SOON, || (1..=3).all(all_there));
        assert!(found.is_some(), "{}", team.host(1).ask(&["nodes"]));
        Some(team)
    }

    fn host(&self, number: usize) -> Host {
        self.cluster.host(&self.network, number)
    }

    /// Returns where the node of a host listens to the network.
    fn listens(&self, number: usize) -> Vec<String> {
        listening(&self.network, number)
    }
}

/// Begins a team on a host, and returns the options with the team's keys.
fn desk(cluster: &Cluster, host: &Host, name: &str) -> Vec<String> {
    let passphrase = cluster.file(&format!("{name}.passphrase"), "correct horse battery\n");
    fs::set_permissions(&passphrase, Permissions::from_mode(0o600)).expect("a file of ours");
    let keys = cluster.folder().join(format!("{name}.keys")).display().to_string();
    let keys = ["--keys".to_owned(), keys, "--passphrase".to_owned(), passphrase].to_vec();
    let begun = host.ask(&with(&["team", "init", name], &keys));
    assert_eq!(begun.code, Some(0), "{begun}");
    keys
}

fn with<'a>(arguments: &[&'a str], more: &'a [String]) -> Vec<&'a str> {
    arguments.iter().copied().chain(more.iter().map(String::as_str)).collect()
}

/// Invites a robot and lets it join. Both ends print the same words.
fn join(operator: &Host, keys: &[String], robot: &Host, name: &str) {
    let invitation = operator.dca(&with(&["team", "invite", name], keys));
    invitation.wait_for(Stream::Err, "Ctrl-C ends it", SOON);
    invitation.wait_for(Stream::Out, "\n", SOON);
    let said = invitation.text(Stream::Out);
    let line = said.trim().strip_prefix("dca team join ").expect("it prints what to type");
    let state = robot.state().display().to_string();
    let joined = robot.ask(&["team", "join", line, "--state", &state]);
    assert_eq!(joined.code, Some(0), "{joined}");
    let invited = invitation.ended(SOON);
    assert_eq!(invited.code, Some(0), "{invited}");
    let last = |text: &str| text.lines().last().map(str::to_owned);
    assert_eq!(last(&invited.out), last(&joined.out), "both ends print the same words");
    assert!(
        joined.out.starts_with(&format!("{name} is in team acme")) || joined.out.contains("is in team other"),
        "{joined}"
    );
}

/// Returns the TCP sockets of a host that listen outside of loopback, as the kernel lists them.
fn listening(network: &Network, number: usize) -> Vec<String> {
    let list = || {
        let tables = ["/proc/thread-self/net/tcp", "/proc/thread-self/net/tcp6"]
            .map(|path| fs::read_to_string(path).unwrap_or_default());
        let rows = tables.iter().flat_map(|table| table.lines().skip(1));
        // The second field is the address, and the fourth is the state: 0A is LISTEN.
        let listens = rows.filter(|row| row.split_whitespace().nth(3) == Some("0A"));
        let places = listens.filter_map(|row| row.split_whitespace().nth(1)).map(str::to_owned);
        let is_loopback =
            |place: &String| place.starts_with("0100007F:") || place.starts_with("00000000000000000000000001000000:");
        places.filter(|place| !is_loopback(place)).collect()
    };
    network.inside(number, list).join().expect("the tables of a namespace can be read")
}

/// Returns the port of a listener from [`listening`].
fn port(place: &str) -> u16 {
    u16::from_str_radix(place.rsplit(':').next().unwrap_or_default(), 16).expect("the kernel writes ports in hex")
}

/// The door on three hosts of a team. A fourth host without keys sees nothing, and starts nothing.
#[test]
fn a_team_opens_the_door_and_a_stranger_sees_nothing() {
    let _turn = Turn::take();
    if !alone("team_network::a_team_opens_the_door_and_a_stranger_sees_nothing") {
        return;
    }
    let Some(team) = Team::of_three(4) else { return };
    let stranger = team.host(4);
    // A user without a key on this machine is told that the key is missing, and nothing is started.
    let empty = team.cluster.folder().join("no.keys").display().to_string();
    let nobody = team.host(1).ask(&["deploy", &spec("door_opening"), "--keys", &empty]);
    assert_eq!(nobody.code, Some(1), "{nobody}");
    assert!(nobody.err.contains("you have no key: `dca team key` makes a key"), "{nobody}");
    let mission = team.host(1).dca(&with(&["deploy", &spec("door_opening")], &team.keys));
    mission.wait_for_times(Stream::Err, "▸ (visualserv # distdetect)", 2, SOON);
    let status = team.host(2).ask(&["status"]);
    assert!(status.out.matches("team acme").count() == 3, "{status}");
    // One stranger only looks. Another has a node that is open to everyone.
    let looked = stranger.ask(&["nodes", "--lan"]);
    assert_eq!(looked.code, Some(3), "{looked}");
    assert!(!NAMES.iter().any(|name| looked.out.contains(name) || looked.err.contains(name)), "{looked}");
    let open = stranger.node("c4", &["--insecure-lan"]);
    let status = stranger.ask(&["status"]);
    assert!(status.out.contains("open to everybody on the network: --insecure-lan"), "{status}");
    let heard = sniff(&team.network, 4);
    assert_eq!(heard, Vec::<String>::new(), "what a stranger hears");
    let nodes = stranger.ask(&["nodes"]);
    let own: Vec<&str> = nodes.out.lines().filter(|line| NAMES.iter().any(|name| line.starts_with(name))).collect();
    assert!(own.is_empty(), "{nodes}");
    let deployed = stranger.ask(&["deploy", &spec("door_opening")]);
    assert_ne!(deployed.code, Some(0), "{deployed}");
    let stopped = stranger.ask(&["stop", "door_opening"]);
    assert_ne!(stopped.code, Some(0), "{stopped}");
    let ended = mission.ended(MISSION_MAX);
    assert_eq!(ended.code, Some(0), "{ended}");
    let trace = Trace::read(&team.cluster.folder().join("runs/door_opening-1"));
    let angle_deg = trace.signal("main/world", "door angle").last().expect("signals of other hosts are seen").value;
    assert!(angle_deg >= 60.0);
    drop(open);
}

/// Returns everything that a zenoh session on a host receives from the sessions to whose ports it can link.
fn sniff(network: &Network, number: usize) -> Vec<String> {
    let places: Vec<String> = (1..=3)
        .flat_map(|other| {
            listening(network, other).into_iter().map(move |place| format!("tcp/10.77.0.{other}:{}", port(&place)))
        })
        .collect();
    assert!(places.len() >= 3, "{places:?}");
    let listen = move || {
        let runtime =
            tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().expect("threads");
        runtime.block_on(async move {
            let mut config = zenoh::Config::default();
            let places: Vec<String> = places.iter().map(|place| format!("{place:?}")).collect();
            for (key, value) in [
                ("mode", "\"peer\"".to_owned()),
                ("scouting/multicast/enabled", "false".to_owned()),
                ("listen/endpoints", "[]".to_owned()),
                ("connect/endpoints", format!("[{}]", places.join(","))),
                ("connect/timeout_ms", "-1".to_owned()),
                ("connect/exit_on_failure", "false".to_owned()),
            ] {
                config.insert_json5(key, &value).expect("zenoh knows it");
            }
            #[expect(clippy::disallowed_methods, reason = "a stranger's session is none of ours")]
            let session = zenoh::open(config).await.expect("a session opens");
            let samples = session.declare_subscriber("**").await.expect("it is open");
            let tokens = session.liveliness().declare_subscriber("**").history(true).await.expect("it is open");
            let replies = session.get("**").timeout(Duration::from_secs(3)).await.expect("it is open");
            let mut heard = Vec::new();
            let until = tokio::time::sleep(Duration::from_secs(4));
            tokio::pin!(until);
            loop {
                tokio::select! {
                    Ok(sample) = samples.recv_async() => heard.push(sample.key_expr().to_string()),
                    Ok(sample) = tokens.recv_async() => heard.push(sample.key_expr().to_string()),
                    Ok(reply) = replies.recv_async() => heard.push(format!("{reply:?}")),
                    () = &mut until => break,
                }
            }
            let linked: Vec<String> =
                session.info().peers_zid().await.map(|peer| format!("linked to {peer}")).collect();
            heard.extend(linked);
            drop(session.close().await);
            heard
        })
    };
    network.inside(number, listen).join().expect("the stranger's thread ends")
}

const RATES: &str = "
process main() {
    host { c1 }
    instantiated_processes { source instof RateSource(c2, 1 kB); monitor instof RateMonitor(c3); }
    internal_connections(source, lbl1) { source, Out -> monitor, In; }
    internal_event_actions { source[lbl1], monitor }
}
";

/// Another team, nonsense, and silent connections at the ports of nodes and programs. Nothing is started, and the
/// traffic of the team keeps its rate.
#[test]
fn attacks_start_nothing_and_slow_nothing_down() {
    let Some(team) = Team::of_three(4) else { return };
    let other = desk(&team.cluster, &team.host(4), "other");
    join(&team.host(4), &other, &team.host(4), "c4");
    let rates = team.cluster.file("rates.dca", RATES);
    let deployed = team.host(1).dca(&with(&["deploy", &rates], &team.keys));
    deployed.wait_for(Stream::Err, "▸", SOON);
    pass(Duration::from_secs(1));
    let quiet = window(|| pass(Duration::from_secs(3)));
    let c4 = team.host(4).node("c4", &[]);
    let places: Vec<String> = (1..=3)
        .flat_map(|number| {
            team.listens(number).into_iter().map(move |place| format!("10.77.0.{number}:{}", port(&place)))
        })
        .collect();
    let attack = move || {
        let (mut open, until) = (Vec::new(), now() + Duration::from_secs(3));
        while now() < until {
            for (place, number) in places.iter().zip(0..) {
                let Ok(mut stream) = TcpStream::connect(place) else { continue };
                let bytes: &[u8] = match number % 3 {
                    0 => b"",
                    1 => &[0x16, 3, 1, 2, 0, 1, 0],
                    _ => &[0xff; 700],
                };
                drop(stream.write_all(bytes));
                open.push(stream);
            }
            pass(Duration::from_millis(5));
        }
        open.len()
    };
    let attacked = window(|| {
        let opened = team.network.inside(4, attack).join().expect("the attack ends");
        println!("{opened} connections");
        assert!(opened > 100, "{opened}");
    });
    let nodes = team.host(4).ask(&["nodes"]);
    assert!(!nodes.out.lines().any(|line| NAMES.iter().any(|name| line.starts_with(name))), "another team: {nodes}");
    let stop = team.host(1).ask(&with(&["stop", "rates"], &team.keys));
    assert_eq!(stop.code, Some(0), "{stop}");
    drop(deployed.ended(SOON));
    let trace = Trace::read(&team.cluster.folder().join("runs/rates-1"));
    let received = trace.signal("main/monitor", "received");
    let (before, meanwhile) = (rate(&received, quiet), best_second(&received, attacked));
    println!("{before:.1} beats/s, with attacks up to {meanwhile:.1} beats/s");
    assert!(meanwhile > 0.9 * before, "{before} {meanwhile}");
    drop(c4);
}

/// All others cut off a revoked member, even those that the operator has never told. The member cannot return.
#[test]
fn a_revoked_robot_is_cut_off() {
    let Some(team) = Team::of_three(3) else { return };
    // Returns the hosts whose status another host receives, or none while that is not settled.
    let seen = |from: usize| {
        let status = team.host(from).ask(&["status", "--json"]);
        let nodes: Vec<serde_json::Value> = serde_json::from_str(&status.out).ok()?;
        let name = |node: &serde_json::Value| Some(node.get("host")?.as_str()?.to_owned());
        Some(nodes.iter().filter_map(name).collect::<Vec<_>>())
    };
    let sees = |from: usize, name: &str| seen(from).is_none_or(|names| names.iter().any(|other| other == name));
    assert!(sees(2, "c3") && sees(3, "c2"));
    // Host 1 cannot reach host 3, so only host 2 can inform host 3.
    team.network.keep_apart(&[1, 3]);
    let run_dir = team.host(1).run_dir().display().to_string();
    let revoked = team.host(1).ask(&with(&["team", "revoke", "c3", "--run-dir", &run_dir], &team.keys));
    assert_eq!(revoked.code, Some(0), "{revoked}");
    assert!(revoked.err.contains("the node `c1` knows"), "{revoked}");
    assert!(wait_until(SOON, || !sees(2, "c3")).is_some(), "host 2 hears of it from host 1");
    // The command does not wait for it, but reports this.
    let nothing = team.host(2).ask(&with(&["stop", "nothing"], &team.keys));
    assert!(nothing.code == Some(1) && nothing.err.contains("no deployment `nothing` is running"), "{nothing}");
    let stopped = team.host(2).ask(&["estop", "test"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    let expected = ["c1: stopped; no program runs", "c2: stopped; no program runs", "c3: its keys are revoked"];
    assert!(expected.iter().all(|line| stopped.out.contains(line)), "{stopped}");
    let onto_c3 = "module Idle(host) { exec \"sleep 9\"; plain; }
        process main() { host { c2 } instantiated_processes { a instof Idle(c3); } internal_event_actions { a } }";
    let deploy = with(&["deploy", "-", "--no-record"], &team.keys);
    let deployed = team.host(2).ask_given(&deploy, onto_c3.as_bytes());
    assert!(deployed.code == Some(1) && deployed.err.contains("the keys of the host `c3` are revoked"), "{deployed}");
    let is_alone = wait_until(SOON, || !sees(3, "c2"));
    assert!(is_alone.is_some(), "{}{}", team.host(3).ask(&["status"]), team.host(3).ask(&["nodes"]));
    team.nodes[2].kill();
    let back = team.host(3).start_node("c3", &[]);
    back.wait_for(Stream::Out, "node `c3` is ready", SOON);
    pass(Duration::from_secs(2));
    assert!(!sees(2, "c3") && !sees(3, "c2"), "who comes back is refused");
    drop(back);
}

/// The operator's machine tells one robot and is switched off. That robot tells another one and is switched off. The
/// last robot never met the operator after the revocation, but refuses the revoked member.
#[test]
fn a_revocation_travels_over_two_meetings_without_the_operator() {
    let Some(mut team) = Team::of_three(4) else { return };
    join(&team.host(1), &team.keys, &team.host(4), "c4");
    team.nodes.push(team.host(4).node("c4", &[]));
    let log = |number: usize| {
        let folder = team.host(number).state().join(format!("c{number}")).join("team/audit");
        fs::read_to_string(folder).expect("there is an audit log")
    };
    let knows = |number: usize| wait_until(SOON, || log(number).contains("\trevoke: number 1")).is_some();
    let sees_c4 = || {
        let nodes = team.host(3).ask(&["nodes"]);
        let is_away = |line: &str| line.contains("lost") || line.contains("revoked");
        nodes.out.lines().any(|line| line.starts_with("c4") && !is_away(line))
    };
    assert!(wait_until(SOON, sees_c4).is_some(), "{}", team.host(3).ask(&["nodes"]));
    [3, 4].into_iter().for_each(|number| team.network.cut(number));
    let run_dir = team.host(1).run_dir().display().to_string();
    let revoked = team.host(1).ask(&with(&["team", "revoke", "c4", "--run-dir", &run_dir], &team.keys));
    assert_eq!(revoked.code, Some(0), "{revoked}");
    assert!(knows(2), "the first meeting: {}", log(2));
    team.nodes[0].kill();
    team.network.cut(1);
    assert!(!log(3).contains("revoke"), "nobody has told it yet");
    team.network.heal(3);
    assert!(knows(3), "the second meeting: {}", log(3));
    team.nodes[1].kill();
    team.network.cut(2);
    team.network.heal(4);
    let is_refused = || log(3).contains("the key of `c4` is revoked");
    assert!(wait_until(2 * SOON, is_refused).is_some(), "{}", log(3));
    assert!(wait_until(SOON, || !sees_c4()).is_some(), "{}", team.host(3).ask(&["nodes"]));
}

const IDLE: &str = "
module Idle(host) { exec \"sleep 3600\"; plain; }
process main() { host { c1 } instantiated_processes { a instof Idle(c2); } internal_event_actions { a } }
";

/// A user makes a key on another machine and receives a certificate. The user may do what this role allows.
#[test]
fn a_user_does_what_the_role_says() {
    let Some(team) = Team::of_three(3) else { return };
    let (operator, desk) = (team.host(1), team.host(2));
    let own = team.cluster.folder().join("dan.keys").display().to_string();
    let own = ["--keys".to_owned(), own, team.keys[2].clone(), team.keys[3].clone()];
    let idle = team.cluster.file("idle.dca", IDLE);
    let deploy = || desk.ask(&with(&["deploy", &idle, "--no-record"], &own));
    let refused = |ended: Ended, part: &str| {
        assert_eq!(ended.code, Some(1), "{ended}");
        assert!(ended.err.contains(part), "{ended}");
    };
    let key = desk.ask(&with(&["team", "key"], &own));
    refused(deploy(), "ask the operator to run `dca team export`");
    let give = |role: &str| {
        let add = ["team", "user", "add", "dan", "--role", role, "--key", key.out.trim()];
        assert_eq!(operator.ask(&with(&add, &team.keys)).code, Some(0));
        let exported = operator.ask(&with(&["team", "export"], &team.keys));
        let file = team.cluster.file("exported", &exported.out);
        let imported = desk.ask(&with(&["team", "import", &file], &own));
        assert!(imported.err.contains(&format!("you are `dan`, {role}")), "{imported}");
    };
    give("viewer");
    refused(deploy(), "`dan` has the role viewer, which may not deploy");
    assert!(team.cluster.leaf("main/a").is_none());
    give("deployer");
    let mission = desk.dca(&with(&["deploy", &idle, "--no-record"], &own));
    assert!(wait_until(SOON, || team.cluster.leaf("main/a").is_some()).is_some(), "{}", mission.text(Stream::Err));
    give("viewer");
    refused(desk.ask(&with(&["stop", "idle"], &own)), "`dan` has the role viewer, which may not stop");
    give("operator");
    let stopped = desk.ask(&with(&["stop", "idle"], &own));
    assert_eq!(stopped.code, Some(0), "{stopped}");
    drop(mission.ended(SOON));
    refused(
        desk.ask(&with(&["db", "put", "team/gain", "1.5"], &own)),
        "`dan` has the role operator, which may not write",
    );
    let removed = operator.ask(&with(
        &["team", "user", "remove", "dan", "--run-dir", &operator.run_dir().display().to_string()],
        &team.keys,
    ));
    assert_eq!(removed.code, Some(0), "{removed}");
    refused(deploy(), "the key of `dan` is revoked");
    let log = |number: usize, name: &str| {
        fs::read_to_string(team.host(number).state().join(name).join("team/audit")).expect("there is an audit log")
    };
    let of_home = log(1, "c1");
    let [accepted, denied] = ["\tdone\tdan\tdeploy `idle`", "\trefused\tdan\tdeploy `idle`"];
    assert_eq!((of_home.matches(accepted).count(), of_home.matches(denied).count()), (1, 2), "{of_home}");
    assert_eq!(log(2, "c2").matches("\tdone\tdan\tstart `idle@1` for `c1`").count(), 1, "each host has judged it");
}

/// Without a team, nothing listens outside of loopback. A node of a team is not open to everybody.
#[test]
fn nothing_listens_without_a_team() {
    let Some(team) = Team::new(2) else { return };
    let (first, second) = (team.host(1), team.host(2));
    let node = first.node("c1", &[]);
    assert_eq!(team.listens(1), Vec::<String>::new());
    drop(node);
    join(&first, &team.keys, &second, "c2");
    assert_eq!(team.listens(1), Vec::<String>::new(), "the invitation has ended");
    let refused = second.start_node("c2", &["--insecure-lan"]).ended(SOON);
    assert_eq!(refused.code, Some(1), "{refused}");
    assert!(
        refused.err.contains("this node is in the team `acme`, and accepts connections from its team only"),
        "{refused}"
    );
    let node = second.node("c2", &[]);
    assert_eq!(team.listens(2).len(), 1);
    drop(node);
}
