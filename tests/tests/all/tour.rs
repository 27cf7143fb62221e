//! `specs/tour_guide.dca`, the flagship: two tour guides that share a desk, a camera and a speech service. On virtual time in one
//! thread, from a seed; and with real processes.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use comms::logic::time::Time;
use controllers::sdk::harness::Disturbance;
use dca_tests::cluster::{Cluster, Host, Network, SOON, Stream, Turn, executable, pass, spec, wait_until};
use dca_tests::simulation::{Finish, Simulation, files_of, plan_with};
use language::Source;
use language::plan::Notice;
use rustix::process::Signal;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

/// The time of a mission, on virtual time.
const MISSION: Duration = Duration::from_secs(240);
/// The greatest error of a localisation, in m. At the ends of the inner walls, where few tags are in view, it may be large for a moment.
const LOST_MAX: f64 = 0.6;
/// The robots, each with its host.
const ROBOTS: [(&str, &str); 2] = [("ann", "r1"), ("bob", "r2")];

fn simulation(seed: u64) -> Simulation {
    let text = std::fs::read_to_string(spec("tour_guide")).unwrap();
    assert!(text.contains("seed: Number = 1"), "{text}");
    let text = text.replace("seed: Number = 1", &format!("seed: Number = {seed}"));
    let source = Source::new(spec("tour_guide"), text);
    let plan = plan_with(&source, &files_of(&source)).unwrap_or_else(|why| panic!("{why}"));
    Simulation::with(plan, Disturbance::busy(seed), dca_examples::registry()).unwrap_or_else(|why| panic!("{why}"))
}

/// Something that happens to a mission.
type Act = fn(&mut Simulation);

/// The story of a mission.
#[derive(Debug, Default, PartialEq)]
struct Story {
    /// The states of each robot, with the times in ms at which they began.
    states: BTreeMap<&'static str, Vec<(u128, String)>>,
    /// The greatest error of a localisation, in m, and its time in ms.
    lost: f64,
    lost_at: u128,
    tours: f64,
    pictures: f64,
    sentences: f64,
}

impl Story {
    fn visited(&self, robot: &str) -> BTreeSet<&str> {
        self.states[robot].iter().map(|(_, state)| state.as_str()).collect()
    }

    /// Looks at the mission, and checks what must hold at each moment.
    fn look(&mut self, simulation: &Simulation) {
        let millis = simulation.now().since(Time::ZERO).as_millis();
        let mut holders = 0.0;
        for (robot, _) in ROBOTS {
            let state = simulation.states(&format!("main/{robot}/guide")).join(" ");
            let states = self.states.entry(robot).or_default();
            if !state.is_empty() && states.last().is_none_or(|(_, last)| *last != state) {
                states.push((millis, state));
            }
            let at = |part: &str, axis| simulation.signal(&format!("main/{robot}/{part}"), axis);
            let error = (at("base", "x") - at("localisation", "x")).hypot(at("base", "y") - at("localisation", "y"));
            if error > self.lost {
                (self.lost, self.lost_at) = (error, millis);
            }
            assert!(at("base", "charge") > 5.0 || at("base", "charge").is_nan(), "{robot} has no power left: {self:?}");
            let holds = at("guide/look", "has the camera");
            holders += if simulation.is_active(&format!("main/{robot}/guide/look")) { holds } else { 0.0 };
        }
        assert!(holders < 1.5, "both robots have the camera: {self:?}");
        let count = |service: &str, name| simulation.signal(&format!("main/services/{service}"), name);
        self.tours = self.tours.max(count("desk", "tours done"));
        self.pictures = self.pictures.max(count("camera", "pictures"));
        self.sentences = self.sentences.max(count("speech", "sentences"));
    }
}

/// Runs a mission in which everything goes wrong that may: a person suspends ann and lets her continue, the speech service is
/// killed in the middle of a sentence, and bob loses his link for 20 s.
fn run(seed: u64) -> (Finish, Story) {
    let (mut simulation, mut story) = (simulation(seed), Story::default());
    let (mut killed, mut step) = (false, 0);
    let finish = simulation.run(Time::ZERO + MISSION, &mut |simulation| {
        story.look(simulation);
        let now = simulation.now().since(Time::ZERO);
        if !killed && now > Duration::from_secs(15) && simulation.is_active("main/bob/guide/say") {
            killed = simulation.kill_and_restart("main/services/speech");
        }
        let orders: [(u64, Act); 4] = [
            (10, |simulation| assert!(simulation.tell("main/ann/guide", &Notice::Suspend))),
            (13, |simulation| assert!(simulation.tell("main/ann/guide", &Notice::Resume))),
            (30, |simulation| simulation.cut(Some("r2"))),
            (50, |simulation| simulation.cut(None)),
        ];
        while let Some((_, act)) = orders.get(step).filter(|(at, _)| now >= Duration::from_secs(*at)) {
            act(simulation);
            step += 1;
        }
    });
    (finish, story)
}

fn check(seed: u64) {
    let (finish, story) = run(seed);
    assert_eq!(finish, Finish::Done, "seed {seed}: {story:#?}");
    assert!(story.tours > 3.5 && story.lost < LOST_MAX, "seed {seed}: {story:#?}");
    let all: BTreeSet<&str> = ROBOTS.iter().flat_map(|(robot, _)| story.visited(robot)).collect();
    for state in ["waiting", "planning", "driving", "showing", "speaking", "charging", "halted", "paused", "returning"]
    {
        assert!(all.contains(state), "seed {seed}: no robot was in `{state}`: {story:#?}");
    }
}

#[test]
fn tours_end_and_twice_the_same() {
    check(1);
    assert_eq!(run(1), run(1));
}

#[test]
#[ignore = "long: ten seeds"]
fn tours_end_with_each_seed() {
    (1..=10).for_each(check);
}

/// Writes the specs of the tour guides into the folder of a test, with the whole path of their programs.
fn files(cluster: &Cluster) {
    let program = executable("dca-examples").display().to_string();
    let write = |name: &str, text: &str| cluster.file(name, &text.replace("target/debug/dca-examples", &program));
    std::fs::create_dir_all(cluster.folder().join("parts")).unwrap();
    let example = |name: &str| {
        std::fs::read_to_string(format!("{}/../examples/tour/{name}", env!("CARGO_MANIFEST_DIR"))).unwrap()
    };
    let parts = ["parts/museum.dca", "parts/programs.dca", "parts/robot.dca"];
    for name in parts.into_iter().chain(["tour_museum.dca", "tour_robot.dca"]) {
        write(name, &example(name));
    }
    write("tour_bob.dca", &example("tour_robot.dca"));
    let whole = std::fs::read_to_string(spec("tour_guide")).unwrap();
    assert!(whole.contains("../examples/tour/parts"), "{whole}");
    write("tour_guide.dca", &whole.replace("../examples/tour/parts", "parts"));
}

/// Both robots on one machine. A tour begins, and shows its first exhibit; then the mission is stopped.
#[test]
fn a_tour_begins_with_real_processes() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    files(&cluster);
    let run = cluster.here().dca(&["run", "--set", "tours=1", "tour_guide.dca"]);
    run.wait_for(Stream::Err, "speaking", MISSION);
    run.signal(Signal::INT);
    let ended = run.ended(SOON);
    assert!(ended.code == Some(1) && ended.out.contains("tour_guide: stopped"), "{ended}");
    cluster.expect_nothing_left(SOON);
}

/// Returns the page of the report of a robot.
fn report(cluster: &Cluster, deployment: &str) -> String {
    std::fs::read_to_string(cluster.folder().join(format!("runs/{deployment}-1/report.html"))).unwrap()
}

/// Returns how many sentences the speech service has accepted since it was started. 0 while it cannot be asked.
fn sentences(museum: &Host) -> u64 {
    let asked = museum.ask(&["queue", "speech.sentences", "--json"]);
    let rows: Value = serde_json::from_str(asked.out.trim()).unwrap_or_default();
    rows[0]["accepted"].as_u64().unwrap_or_default()
}

/// The museum and two robots, each in a network namespace of its own. The speech service is killed in the middle of a sentence, bob
/// loses his link for 20 s, and both want the camera. All tours are given.
#[test]
#[ignore = "long: a mission of two minutes"]
fn tours_end_on_three_machines() {
    let _turn = Turn::take();
    let cluster = Cluster::new();
    let Some(network) = Network::new(3) else { return };
    files(&cluster);
    let hosts = [1, 2, 3].map(|number| cluster.host(&network, number));
    let _nodes = [0, 1, 2].map(|number| hosts[number].node(["museum", "r1", "r2"][number], &["--lan"]));
    let museum = hosts[0].dca(&["deploy", "--lan", "tour_museum.dca"]);
    museum.wait_for(Stream::Err, "started in", SOON);
    let ann = hosts[1].dca(&["deploy", "--lan", "tour_robot.dca"]);
    let bob = ["robot=r2", "name=bob", "x=2.3 m", "charge=90"].iter().flat_map(|value| ["--set", *value]);
    let bob = hosts[2].dca(&["deploy", "--lan", "tour_bob.dca"].into_iter().chain(bob).collect::<Vec<_>>());
    // A killed service that had not taken the sentence yet gets it again, and no robot notices. So the test kills it until one does.
    let is_silent = || [&ann, &bob].iter().any(|robot| robot.text(Stream::Err).contains("going on silently"));
    let kill = || cluster.leaf("main/services/speech").iter().for_each(|speech| speech.signal(Signal::KILL));
    let noticed = wait_until(MISSION, || {
        if sentences(&hosts[0]) > 0 {
            kill();
        }
        is_silent()
    });
    assert!(noticed.is_some(), "no robot was silent: {}", ann.text(Stream::Err));
    network.cut(3);
    pass(Duration::from_secs(20));
    assert!(bob.is_running(), "bob has stopped: {}", bob.text(Stream::Err));
    network.heal(3);
    for (robot, name) in [(ann, "tour_robot"), (bob, "tour_bob")] {
        let ended = robot.ended(MISSION);
        assert!(ended.code == Some(0) && ended.out.contains(&format!("{name}: done")), "{ended}");
        let page = report(&cluster, name);
        assert!(["driving", "speaking", "returning"].iter().all(|state| page.contains(state)), "no bands for {name}");
    }
    let stopped = hosts[0].ask(&["stop", "tour_museum"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    let ended = museum.ended(SOON);
    let done = ended.out.lines().find(|line| line.contains("at the end")).unwrap_or_default();
    assert!(done.contains("4.00"), "not all tours were given: {ended}");
    assert!(wait_until(SOON, || cluster.leaf("main/services/desk").is_none()).is_some(), "{ended}");
}
