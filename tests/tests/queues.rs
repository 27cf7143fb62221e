//! Queues of running programs, and `dca queue`.

use dca_tests::cluster::{Cluster, Host, Program, SOON, Stream, executable};
use rustix::process::Signal;
use serde_json::Value;

/// A clerk that takes an hour for an order: its queue fills up, and the customer hands in for as long as it may.
const POST: &str = "
process main() {
    host { c1 }
    instantiated_processes {
        clerk instof Clerk(c1, pace = 1 h);
        other instof Clerk(c1, pace = 1 h);
        calm instof Customer(c1, name = \"calm\", count = 100);
    }
    internal_connections { calm, Orders -> clerk, Orders; }
    internal_event_actions { clerk, other, calm }
}
";

fn deployed(cluster: &Cluster) -> (Host, [Program; 2]) {
    let here = cluster.here();
    let program = executable("dca-examples").display().to_string();
    let node = here.node("c1", &["--controllers", &program]);
    let file = cluster.file("post.dca", POST);
    let deploy = here.dca(&["deploy", "--no-record", "--controllers", &program, &file]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    (here, [node, deploy])
}

fn json(text: &str) -> Value {
    serde_json::from_str(text.trim()).unwrap_or_else(|why| panic!("{why}: {text}"))
}

/// The queue fills up, and says how many it has rejected and who sent last. Who is suspended is told, and the rest is shown.
#[test]
fn queues_are_shown_from_the_command_line() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let watch = here.dca(&["queue", "post:clerk.orders", "--watch", "--within", "60"]);
    watch.wait_for(Stream::Out, "8 of 8", SOON);
    drop(watch);
    let asked = here.ask(&["queue", "clerk", "--json", "--within", "60"]);
    assert_eq!(asked.code, Some(0), "{asked}");
    let queue = &json(&asked.out)[0];
    assert_eq!((&queue["process"], &queue["name"]), (&"post:main/clerk".into(), &"orders".into()), "{asked}");
    assert_eq!((&queue["waiting"], &queue["capacity"]), (&8.into(), &8.into()), "{asked}");
    assert_eq!((&queue["full"], &queue["last_sender"]), (&"reject".into(), &"calm".into()), "{asked}");
    let count = |what: &str| queue[what].as_u64().unwrap_or_else(|| panic!("no {what}: {asked}"));
    assert_eq!(count("accepted"), count("taken") + count("dropped") + count("waiting"), "{asked}");
    for (arguments, code, why) in [
        (&["queue", "nobody"][..], 1, "no process `nobody` is running"),
        (&["queue", "calm"], 1, "no queue `calm`: it shows none"),
        (&["queue", "clerk.letters"], 1, "no queue `clerk.letters`: it shows `orders`"),
        (&["queue", "clerk."], 1, "names nothing"),
        (&["queue", "--within", "no"], 2, "this is no number of seconds"),
    ] {
        let asked = here.ask(arguments);
        assert!(asked.code == Some(code) && asked.err.contains(why), "{arguments:?}: {asked}");
    }
    let all = here.ask(&["queue", "--within", "60"]);
    let rows: Vec<&str> = all.out.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert_eq!(rows, ["QUEUE", "post:main/clerk.orders", "post:main/other.orders"], "{all}");
    let clerk = cluster.leaf("main/clerk").expect("it runs");
    clerk.signal(Signal::STOP);
    let partly = here.ask(&["queue", "--within", "2"]);
    assert!(partly.code == Some(3) && partly.err.contains("`post:main/clerk` did not answer"), "{partly}");
    assert!(partly.out.contains("post:main/other.orders"), "{partly}");
    clerk.signal(Signal::CONT);
}
