//! Messages between programs and activities, with real processes on two hosts.

use dca_tests::cluster::{Cluster, Network, Program, SOON, executable, wait_until};
use rustix::process::Signal;
use std::time::Duration;

/// The time for a mission. It includes waiting for a busy machine.
const MISSION: Duration = Duration::from_secs(120);

/// Returns a mission with an activity on the other host that repeats each word.
fn mission(cluster: &Cluster, count: usize, has_receipts: bool) -> String {
    let file = cluster.folder().join("heard.txt").display().to_string();
    let way = if has_receipts { "talker.Orders -> echo.words;" } else { "talker.Words -> echo.words queue 1000;" };
    let text = format!(
        "activity Echo(there: Host) {{
            host{{there}}
            in words: Text queue 1000;
            out say: Text;
            initial state listening {{ on message words {{ say.send(words); }} }}
        }}
        process main() {{
            host{{c1}}
            instantiated_processes {{
                echo instof Echo(c2);
                talker instof Talker(c1, file = \"{file}\", count = {count}, receipts = {has_receipts});
            }}
            internal_connections {{ {way} echo.say -> talker.Heard queue 1000; }}
            internal_event_actions {{ talker # echo }}
        }}"
    );
    cluster.file("talk.dca", &text)
}

/// Returns what the talker has written about its words.
fn heard(cluster: &Cluster) -> String {
    std::fs::read_to_string(cluster.folder().join("heard.txt")).expect("the talker has written its file")
}

/// Sends 1,000 words at 100 Hz between two hosts, over wires. No word is lost.
#[test]
fn a_thousand_words_go_to_another_host_and_back() {
    let cluster = Cluster::new();
    let Some(network) = Network::new(2) else { return };
    let hosts = [1, 2].map(|number| cluster.host(&network, number));
    let talking = executable("dca-talking").display().to_string();
    let arguments = ["--lan", "--controllers", &talking];
    let _nodes = [hosts[0].node("c1", &arguments), hosts[1].node("c2", &arguments)];
    let spec = mission(&cluster, 1000, false);
    let ended = hosts[0].dca(&["deploy", "--no-record", "--controllers", &talking, &spec]).ended(MISSION);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert_eq!(heard(&cluster), "accepted 0\nrejected []\nmissing []\ntwice {}\n", "{ended}");
}

/// The node of the activity is repeatedly killed and restarted. Each word with a receipt is answered once.
#[test]
fn a_killed_node_loses_no_word_that_it_has_confirmed() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let talking = executable("dca-talking").display().to_string();
    let node = |name: &str| here.node(name, &["--controllers", &talking]);
    let (_first, mut second) = (node("c1"), node("c2"));
    let spec = mission(&cluster, 300, true);
    let deploy = here.dca(&["deploy", "--no-record", "--controllers", &talking, &spec]);
    for word in [20, 100, 180] {
        // The terminal leaves lines out if there are many.
        let is_said = || here.ask(&["events", "talk"]).out.contains(&format!("sends through `say`: {word}"));
        wait_until(SOON, is_said).expect("it is said");
        kill(second);
        second = node("c2");
    }
    let ended = deploy.ended(MISSION);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert_eq!(heard(&cluster), "accepted 300\nrejected []\nmissing []\ntwice {}\n", "{ended}");
}

fn kill(node: Program) {
    node.signal(Signal::KILL);
    assert_eq!(node.ended(SOON).signal, Some(9));
}
