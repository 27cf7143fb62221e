//! Programs that cannot run are refused with the cause, before anything of their deployment runs.

use dca_tests::cluster::{Cluster, Ended, Host};
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

/// Deploys a program that leaves a mark, followed by another program.
fn deploy(cluster: &Cluster, here: &Host, (mark, then): (&Path, &str)) -> Ended {
    let text = format!(
        r#"
module Mark(host: Host) {{ exec "touch {}"; plain; done; }}
module Then(host: Host) {{ exec "{then}"; plain; done; }}
process main() {{
    host {{ c1 }}
    instantiated_processes {{ mark instof Mark(c1); then instof Then(c1); }}
    internal_event_actions {{ mark ; then }}
}}
"#,
        mark.display()
    );
    here.ask(&["deploy", "--no-record", &cluster.file("refused.dca", &text)])
}

#[test]
fn what_the_kernel_cannot_execute_is_refused_before_anything_runs() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let _c1 = here.node("c1", &[]);
    let (program, mark) = (cluster.folder().join("program"), cluster.folder().join("mark"));
    let name = program.display().to_string();
    let mut foreign = fs::read("/bin/true").expect("it is on every system");
    // SPARC.
    (foreign[18], foreign[19]) = (43, 0);
    let cases: [(&[u8], &str); 4] = [
        (b"", "is empty"),
        (b"#!/nonexistent/interp\n", "the interpreter `/nonexistent/interp` in its first line, which is not there"),
        (b"#!/bin/sh\r\ntrue\r\n", "ends its lines as Windows does"),
        (&foreign, "is a program for processor number 43, and this machine has"),
    ];
    for (content, why) in cases {
        fs::write(&program, content).expect("the folder is ours");
        fs::set_permissions(&program, Permissions::from_mode(0o755)).expect("the file is ours");
        let refused = deploy(&cluster, &here, (&mark, &name));
        assert_eq!(refused.code, Some(1), "{why}: {refused}");
        assert!(refused.err.contains(why) || refused.out.contains(why), "{why}: {refused}");
        assert!(!mark.exists(), "{why}: the other program has begun");
    }
}

/// Programs do not run in a new folder at the path of the folder in which the node was started, nor do they run in
/// the root folder.
#[test]
fn nothing_runs_in_place_of_a_folder_that_is_gone() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let (start, mark) = (cluster.folder().join("start"), cluster.folder().join("mark"));
    fs::create_dir(&start).expect("the folder is ours");
    let _c1 = here.node_under(&["-C", "start"], "c1");
    let refused = |here: &Host| deploy(&cluster, here, (&mark, "true"));
    assert_eq!(refused(&here).code, Some(0), "it is there");
    fs::remove_file(&mark).expect("it was made");
    for step in [fs::remove_dir as fn(_) -> _, fs::create_dir] {
        step(start.clone()).expect("the folder is ours");
        let refused = refused(&here);
        assert_eq!(refused.code, Some(1), "{refused}");
        let why = format!("the folder `{}`, in which its node was started, was removed or replaced", start.display());
        assert!(refused.err.contains(&why) || refused.out.contains(&why), "{refused}");
        assert!(!mark.exists(), "it has run");
    }
}
