//! Queues and routers of running programs, `dca queue` and `dca router`.

use dca_tests::cluster::{Cluster, Host, Program, SOON, Stream, executable, wait_until};
use rustix::process::Signal;
use serde_json::Value;

/// A clerk needs an hour for an order, so its queue fills up. The customer sends orders for as long as it may.
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
    deploy(cluster, POST)
}

fn deploy(cluster: &Cluster, text: &str) -> (Host, [Program; 2]) {
    let here = cluster.here();
    let program = executable("dca-examples").display().to_string();
    let node = here.node("c1", &["--controllers", &program]);
    let file = cluster.file("post.dca", text);
    let deploy = here.dca(&["deploy", "--no-record", "--controllers", &program, &file]);
    deploy.wait_for(Stream::Err, "▸", SOON);
    (here, [node, deploy])
}

fn json(text: &str) -> Value {
    serde_json::from_str(text.trim()).unwrap_or_else(|why| panic!("{why}: {text}"))
}

/// The queue fills up, and reports the number of rejected messages and the last sender. The command reports a suspended
/// reader, and shows the rest.
#[test]
fn queues_are_shown_from_the_command_line() {
    let cluster = Cluster::new();
    let (here, _running) = deployed(&cluster);
    let is_known = || here.ask(&["queue", "clerk", "--within", "60"]).code == Some(0);
    assert!(wait_until(SOON, is_known).is_some(), "{}", here.ask(&["queue", "clerk"]));
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
        (&["queue", "calm.letters"], 1, "no queue `calm.letters`: it shows `news`"),
        (&["queue", "clerk.letters"], 1, "no queue `clerk.letters`: it shows `orders`"),
        (&["queue", "clerk."], 2, "names nothing"),
        (&["queue", "--within", "no"], 2, "expected a number of seconds"),
    ] {
        let asked = here.ask(arguments);
        assert!(asked.code == Some(code) && asked.err.contains(why), "{arguments:?}: {asked}");
    }
    let all = here.ask(&["queue", "--within", "60"]);
    let rows: Vec<&str> = all.out.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert_eq!(rows, ["QUEUE", "post:main/calm.news", "post:main/clerk.orders", "post:main/other.orders"], "{all}");
    let clerk = cluster.expect_leaf("main/clerk");
    clerk.signal(Signal::STOP);
    let partly = here.ask(&["queue", "--within", "2"]);
    assert!(partly.code == Some(3) && partly.err.contains("`post:main/clerk` did not answer"), "{partly}");
    assert!(partly.out.contains("post:main/other.orders"), "{partly}");
    clerk.signal(Signal::CONT);
}

/// A router informs each customer about its own orders. After 5 s, a suspended or killed customer is removed from the
/// register, and this is counted. It delays no other customer, and is informed again after its restart.
#[test]
fn a_router_drops_who_is_gone_and_delays_nobody() {
    let cluster = Cluster::new();
    let text = POST
        .replace("clerk instof Clerk(c1, pace = 1 h)", "clerk instof Clerk(c1, pace = 10 ms)")
        .replace("calm instof", "hasty instof Customer(c1, name = \"hasty\", count = 100000); calm instof")
        .replace("count = 100)", "count = 100000)")
        .replace(
            "calm, Orders",
            "hasty, Orders -> clerk, Orders; hasty, Ready -> clerk, Ready; calm, Ready -> clerk, Ready; calm, Orders",
        )
        .replace("other, calm", "other, hasty, retry(5) calm");
    let (here, _running) = deploy(&cluster, &text);
    let look = || {
        let asked = here.ask(&["router", "clerk.ready", "--json", "--within", "60"]);
        assert_eq!(asked.code, Some(0), "{asked}");
        json(&asked.out)[0].clone()
    };
    let delivered = |router: &Value, name: &str| {
        let all = router["subscribers"].as_array().expect("it is an array");
        let one = all.iter().filter(|one| one["name"] == name).max_by_key(|one| one["delivered"].as_u64());
        one.and_then(|one| one["delivered"].as_u64())
    };
    let wait_for = |what: &str, is_so: &dyn Fn(&Value) -> bool| {
        let found = (0..3000).map(|_| look()).find(is_so);
        found.unwrap_or_else(|| panic!("no {what}: {}", look()))
    };
    let both = |router: &Value| ["calm", "hasty"].iter().all(|name| delivered(router, name) > Some(3));
    let router = wait_for("news to both", &both);
    assert_eq!((&router["gone"], &router["type"]), (&0.into(), &"Order".into()), "{router}");
    let filters: Vec<&str> =
        router["subscribers"].as_array().into_iter().flatten().filter_map(|one| one["filters"][0].as_str()).collect();
    assert_eq!(filters, ["category calm", "category hasty"], "{router}");
    let calm = cluster.expect_leaf("main/calm");
    calm.signal(Signal::STOP);
    let gone = wait_for("end of who is suspended", &|router| router["gone"] == 1);
    let others = delivered(&gone, "hasty");
    wait_for("news to the other one", &|router| delivered(router, "hasty") > others);
    // Its node has ended the customer, since the customer's loop did not return. `retry` has started it again.
    wait_for("news to the next one", &|router| delivered(router, "calm") > Some(3));
    let calm = cluster.expect_leaf("main/calm");
    calm.signal(Signal::KILL);
    wait_for("end of who was killed", &|router| router["gone"] == 2);
    wait_for("news to the third one", &both);
    let table = here.ask(&["router", "--within", "60"]);
    assert!(table.code == Some(0) && table.out.contains("category hasty"), "{table}");
    let none = here.ask(&["router", "hasty"]);
    assert!(none.code == Some(1) && none.err.contains("no router `hasty`: it shows none"), "{none}");
}

/// `specs/news.dca`: each customer hears of its own orders, and is then done.
#[test]
fn the_spec_with_a_router_runs() {
    let cluster = Cluster::new();
    let program = executable("dca-examples").display().to_string();
    let text = include_str!("../../../specs/news.dca").replace("target/debug/dca-examples", &program);
    let ended = cluster.here().ask(&["run", &cluster.file("news.dca", &text)]);
    assert!(ended.code == Some(0) && ended.out.starts_with("news: done"), "{ended}");
}

/// The module in a spec can differ from the program. A customer whose router accepts a different type says so, and
/// ends.
#[test]
fn who_subscribes_to_no_router_says_so() {
    let cluster = Cluster::new();
    let program = executable("dca-examples").display().to_string();
    let text = include_str!("../../../specs/news.dca")
        .replace("module Customer", "module Other(host: Host, pace: Time) { exec \"target/debug/dca-examples Clerk\"; proc Orders(Subscription) -> Delivery; service; }\nmodule Customer")
        .replace("target/debug/dca-examples", &program)
        .replace("ann instof", "other instof Other(c1, pace = 5 ms); ann instof")
        .replace("ann, Ready -> clerk, Ready", "ann, Ready -> other, Orders")
        .replace("clerk, (ann, bob)", "clerk, other, (ann, bob)");
    let ended = cluster.here().ask(&["run", &cluster.file("news.dca", &text)]);
    let told = format!("{}{}", ended.out, ended.err);
    assert!(ended.code == Some(1) && told.contains("Subscription") && told.contains("QueueMessage"), "{ended}");
}
