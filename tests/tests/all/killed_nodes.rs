//! A node is killed and restarted, and adopts the running programs. The mission continues, and no program is started
//! twice.

use comms::io::clock::now;
use comms::logic::random::Random;
use dca_tests::cluster::{Cluster, Host, Network, Process, Program, SOON, Stream, Turn, pass, spec, wait_until};
use rustix::process::{Pid, Signal, kill_process};
use std::collections::BTreeMap;
use std::ops::Range;
use std::process::{Child, Command};
use std::time::Duration;

/// The time until a restarted node has adopted everything.
const ADOPTED_WITHIN: Duration = Duration::from_secs(1);
/// The same on a machine that runs other tests at the same time. With a scan of all processes for each program, it
/// took at least 4.8 s.
const ADOPTED_WITHIN_BUSY: Duration = Duration::from_secs(4);
const PROGRAMS: usize = 200;
/// The number of programs that end while no node runs.
const ENDING: usize = 100;

/// Kills a node. Returns once the kernel has removed it.
fn kill(node: Program) {
    node.signal(Signal::KILL);
    assert_eq!(node.ended(SOON).signal, Some(9));
}

/// Returns the process id of each program of a deployment, by its instance path.
fn programs(cluster: &Cluster) -> BTreeMap<String, i32> {
    let path = |process: &Process| {
        let mark = process.environment.iter().find_map(|entry| entry.strip_prefix("DCA_INSTANCE="));
        mark.filter(|_| process.command.first().is_none_or(|name| name != "sleep")).map(str::to_owned)
    };
    cluster.left().into_iter().filter_map(|process| Some((path(&process)?, process.pid))).collect()
}

/// Stops the programs with these numbers, each with a different exit code.
fn end(programs: &BTreeMap<String, i32>, numbers: Range<usize>) {
    for number in numbers {
        let pid = Pid::from_raw(programs[&format!("main/p{number}")]).expect("it is a number");
        kill_process(pid, Signal::USR1).expect("it runs");
    }
}

fn states(host: &Host) -> BTreeMap<String, String> {
    host.processes(&[]).into_iter().map(|(_, process)| (process.path.clone(), process.state.clone())).collect()
}

/// Kills each node of the door in turn, including its home, at a moment with many events.
#[test]
#[ignore = "long: a real door, the next test opens one on a network"]
fn the_door_opens_although_every_node_is_killed() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let here = cluster.here();
    let mut nodes: BTreeMap<&str, Program> = ["c1", "c2", "c3"].map(|name| (name, here.node(name, &[]))).into();
    let mission = here.dca(&["deploy", &spec("door_opening")]);
    let phases = ["▸ (visualserv # distdetect)", "▸ closegrip", "▸ presshandle", "▸ dooropen"];
    for (phase, host) in phases.into_iter().zip(["c3", "c2", "c1", "c3"]) {
        mission.wait_for(Stream::Err, phase, SOON);
        let before = programs(&cluster);
        kill(nodes.remove(host).expect("it runs"));
        nodes.insert(host, here.node(host, &[]));
        assert_eq!(programs(&cluster), before, "no program was started or ended with the node of {host}");
    }
    let ended = mission.ended(2 * SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert!(ended.out.starts_with("door_opening: done after"), "{ended}");
    let left = || {
        cluster
            .left()
            .into_iter()
            .filter(|process| process.command.first().is_some_and(|name| name.ends_with("dca-shim")))
            .count()
    };
    wait_until(SOON, || left() == 0).unwrap_or_else(|| panic!("left: {:#?}", cluster.left()));
}

/// On three hosts of a network, each node is killed once, at a moment drawn from the seed. `DCA_DOORS` is the number
/// of doors (20 doors take a quarter of an hour).
#[test]
fn the_door_opens_on_a_network_although_every_node_is_killed() {
    let _turn = Turn::take();
    let doors: u64 = std::env::var("DCA_DOORS").ok().and_then(|count| count.parse().ok()).unwrap_or(1);
    for seed in 0..doors {
        let Some(network) = Network::new(3) else { return };
        let cluster = Cluster::new();
        let hosts: Vec<Host> = network.hosts().map(|number| cluster.host(&network, number)).collect();
        let names = ["c1", "c2", "c3"];
        let mut nodes: Vec<Option<Program>> =
            hosts.iter().zip(names).map(|(host, name)| Some(host.node(name, &["--lan"]))).collect();
        let mission = hosts[2].dca(&["deploy", &spec("door_opening")]);
        mission.wait_for(Stream::Err, "▸ (visualserv # distdetect)", SOON);
        let mut random = Random::new(seed);
        let orders = [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]];
        let order = orders.into_iter().nth(usize::try_from(random.below(6)).unwrap_or(0)).unwrap_or_default();
        for number in order {
            pass(Duration::from_millis(random.below(8000)));
            let before = programs(&cluster);
            kill(nodes[number].take().expect("it runs"));
            pass(Duration::from_millis(random.below(1500)));
            nodes[number] = Some(hosts[number].node(names[number], &["--lan"]));
            let after = programs(&cluster);
            assert!(mission.is_running(), "seed {seed}: {}", mission.text(Stream::Err));
            assert_eq!(
                after,
                before,
                "seed {seed}: no program was started or ended with the node of {}\n{}",
                names[number],
                mission.text(Stream::Err)
            );
        }
        let ended = mission.ended(2 * SOON);
        assert_eq!(ended.code, Some(0), "seed {seed}: {ended}");
        assert!(ended.out.starts_with("door_opening: done after"), "seed {seed}: {ended}");
    }
}

/// There are 200 programs, and 100 of them end while no node runs.
#[test]
fn every_program_is_found_again_and_every_end_is_told() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let script = cluster.file("script.sh", "trap \"exit ${1#code=}\" USR1; sleep 1000 & wait\n");
    let instances: String =
        (0..PROGRAMS).map(|number| format!("p{number} instof P(\"c1\", \"{}\");\n", number % 7 + 1)).collect();
    let members: Vec<String> = (0..PROGRAMS).map(|number| format!("(p{number} else skip)")).collect();
    let text = format!(
        "module P(host, code) {{ exec \"sh {script}\"; plain; done; }}\nprocess main() {{\n host {{ \"c1\" }}\n instantiated_processes {{\n{instances}}}\n internal_event_actions {{ {} }}\n}}\n",
        members.join(" , ")
    );
    let spec = cluster.file("many.dca", &text);
    let node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", &spec]);
    let running = |host: &Host| states(host).values().filter(|state| *state == "running").count();
    wait_until(SOON, || running(&here) == PROGRAMS + 1).expect("all run");
    let before = programs(&cluster);
    kill(node);
    end(&before, 0..ENDING);
    wait_until(SOON, || programs(&cluster).len() == PROGRAMS - ENDING).expect("half of them end without a node");
    let node = here.node("c1", &[]);
    // The time of one query on this machine under its present load.
    let began = now();
    running(&here);
    let asked = 4 * (now() - began);
    let took = wait_until(SOON, || running(&here) == PROGRAMS - ENDING + 1).expect("all are found again");
    // On a busy machine, the first answer to a query comes later than that. The test learns from the node which
    // programs have been found.
    assert!(took <= ADOPTED_WITHIN_BUSY.max(asked), "{took:?}");
    println!("{PROGRAMS} programs, {ENDING} of them ended: known {took:.1?} after the node was ready");
    let told = states(&here);
    for number in 0..ENDING {
        let state = &told[&format!("main/p{number}")];
        assert!(state.contains(&format!("exit code {}", number % 7 + 1)), "p{number}: {state}");
    }
    let after = programs(&cluster);
    assert!(after.iter().all(|(path, process)| before.get(path) == Some(process)), "a program was started again");
    end(&before, ENDING..PROGRAMS);
    // A watching command gives up the node after 5 s. On a busy machine all of this may take as long. The mission
    // continues.
    let watched = mission.ended(SOON);
    assert!(matches!(watched.code, Some(0 | 3)), "{watched}");
    let finished = || here.ask(&["events", "many"]).out.contains("finished: done");
    wait_until(SOON, finished).unwrap_or_else(|| panic!("{watched}{}", here.ask(&["events", "many"])));
    drop(node);
}

/// The number of deployments of [`PROGRAMS`] that have ended before the node is killed. So many deployments keep
/// their output.
const ENDED: usize = 8;
/// The number of other processes on the machine.
const OTHERS: usize = 100;

/// Programs that have ended cost the next node nothing, even if the machine has many processes.
#[test]
#[ignore = "long: 1,800 programs are started"]
fn a_node_is_soon_back_beside_many_programs_that_have_ended() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let instances: String = (0..PROGRAMS).map(|number| format!("p{number} instof P(\"c1\");\n")).collect();
    let members: Vec<String> = (0..PROGRAMS).map(|number| format!("p{number}")).collect();
    let text = format!(
        "module P(host) {{ exec \"sleep 3600\"; plain; done; }}\nprocess main() {{\n host {{ \"c1\" }}\n instantiated_processes {{\n{instances}}}\n internal_event_actions {{ {} }}\n}}\n",
        members.join(" , ")
    );
    let other = |_| Command::new("sleep").arg("600").spawn().expect("it is everywhere");
    let others: Vec<Child> = (0..OTHERS).map(other).collect();
    let deploy = |name: &str| {
        let mission = here.dca(&["deploy", "--no-record", &cluster.file(&format!("{name}.dca"), &text)]);
        mission.wait_for(Stream::Err, "200 programs on 1 host, started in", 2 * SOON);
        mission
    };
    let back = |node: Program| {
        kill(node);
        let began = now();
        let node = here.node("c1", &[]);
        let ready = now() - began;
        let runs = || states(&here).values().filter(|state| *state == "running").count() == PROGRAMS + 1;
        wait_until(SOON, runs).expect("all are found again");
        (node, ready, now() - began)
    };
    let mut node = here.node("c1", &[]);
    for number in 0..ENDED {
        let mission = deploy(&format!("ended{number}"));
        let stopped = here.dca(&["stop", &format!("ended{number}")]).ended(2 * SOON);
        assert_eq!(stopped.code, Some(0), "{stopped}");
        drop(mission.ended(SOON));
    }
    let _mission = deploy("running");
    let mut took = Vec::new();
    for _ in 0..3 {
        let (next, ready, known) = back(node);
        println!(
            "{PROGRAMS} run, {ENDED} deployments of {PROGRAMS} have ended: ready after {ready:.2?}, all known after {known:.2?}"
        );
        took.push(ready);
        node = next;
    }
    for mut other in others {
        other.kill().expect("it is ours");
        other.wait().expect("it is ours");
    }
    let best = took.into_iter().min().expect("there are three");
    assert!(best <= ADOPTED_WITHIN, "{best:?}");
    drop(node);
}
