//! A result with a name starts several programs, also after a change of the spec and after a kill of the node.

use dca_tests::cluster::{Cluster, SOON, Stream, executable, wait_until};
use rustix::fs::{Mode, OFlags};
use rustix::process::Signal;
use std::process::Command;

#[test]
fn a_result_outlives_a_change_and_a_kill_of_the_node() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let file = |name: &str| cluster.folder().join(name).display().to_string();
    let (gate, first, last) = (file("gate"), file("first"), file("last"));
    assert!(Command::new("mkfifo").arg(&gate).status().expect("the system has it").success());
    let program = executable("dca-noting").display().to_string();
    let text = format!(
        "module Counter(host: Host) {{ exec \"'{program}' Counter\"; done(number: Count); }}
         module Noter(host: Host, file: Text) {{ exec \"'{program}' Noter\"; init start: Count; done; }}
         module Wait(host: Host) {{ exec \"cat {gate}\"; plain; done; }}
         process main(){{
             host{{c1}}
             instantiated_processes{{
                 counter instof Counter(c1);
                 first instof Noter(c1, \"{first}\");
                 wait instof Wait(c1);
                 last instof Noter(c1, \"{last}\");
             }}
             internal_event_actions{{
                 each i in 0..2 (counter : match {{ number n => (first with n ; wait ; last with n) }})
             }}
         }}"
    );
    let node = here.node("c1", &[]);
    let mission = here.dca(&["deploy", &cluster.file("results.dca", &text)]);
    let noted = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    cluster.expect_leaf("main/wait");
    assert_eq!((noted(&first), noted(&last)), ("1\n".to_owned(), String::new()), "{}", mission.text(Stream::Err));

    // The value has another name, and one more program starts with it.
    let changed = text.replace("number n", "number m").replace("with n", "with m");
    let changed = changed.replace("last with m)", "last with m ; first with m)");
    let change = here.ask(&["deploy", "--probation", "0", &cluster.file("results.dca", &changed)]);
    assert!(change.code == Some(0) && change.out.contains("revision 1"), "{change}");

    node.signal(Signal::KILL);
    assert_eq!(node.ended(SOON).signal, Some(9));
    let _node = here.node("c1", &[]);
    // When the writer closes the gate, the reader is done. Without a reader, the gate cannot be opened for writing.
    let open = || rustix::fs::open(&gate, OFlags::WRONLY | OFlags::NONBLOCK, Mode::empty()).is_ok();
    wait_until(SOON, open).expect("the first program reads");
    wait_until(SOON, || noted(&first) == "1\n1\n2\n").expect("the second round has begun");
    assert_eq!(noted(&last), "1\n", "{}", mission.text(Stream::Err));
    wait_until(SOON, open).expect("the second program reads");
    let ended = mission.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    assert_eq!((noted(&first).as_str(), noted(&last).as_str()), ("1\n1\n2\n2\n", "1\n2\n"));
}
