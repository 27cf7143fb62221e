//! The environment and the folder of a program, with real processes.

use dca_tests::cluster::{Cluster, executable};
use std::fs;
use std::process::Command;

/// Programs of `dca run` have the environment of the command. Programs of a node have only the variables that the node or the module names.
/// Other users cannot read the environment.
#[test]
fn a_program_has_the_environment_that_is_said() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let folder = cluster.folder().join("where");
    fs::create_dir(&folder).expect("the folder is ours");
    let (said, shown) = (folder.join("said"), folder.join("shown"));
    let script = folder.join("say");
    let words = "#!/bin/sh\nprintf '%s,%s,%s,%s,%s' \"$GREETING\" \"$ROS_DOMAIN_ID\" \"$PYTHONPATH\" \"$HIDDEN\" \"$(pwd)\" > said\n\
                 tr '\\0' ' ' < /proc/$PPID/cmdline > shown\n";
    fs::write(&script, words).expect("the folder is ours");
    let text = format!(
        r#"
module Say(host: Host) {{
    exec "sh {}";
    env{{ GREETING = "good morning"; }}
    inherit ROS_*;
    directory "{}";
    plain;
    done;
}}
process main() {{
    host {{ local }}
    instantiated_processes {{ say instof Say(local); }}
    internal_event_actions {{ say }}
}}
"#,
        script.display(),
        folder.display()
    );
    let file = cluster.file("say.dca", &text);
    let own = [("ROS_DOMAIN_ID", "7"), ("PYTHONPATH", "/py"), ("HIDDEN", "secret")];
    let path = |path: &std::path::Path| fs::read_to_string(path).unwrap_or_default();
    let directory = folder.display().to_string();

    let mut run = Command::new(executable("dca"));
    run.args(["run", "--no-record", &file, "--run-dir"]).arg(here.run_dir()).envs(own).current_dir(cluster.folder());
    let run = run.env("TMPDIR", cluster.folder()).output().expect("it starts");
    assert!(run.status.success(), "{run:?}");
    assert_eq!(path(&said), format!("good morning,7,/py,secret,{directory}"));
    assert!(!path(&shown).contains("secret") && path(&shown).contains("dca-shim"), "{}", path(&shown));

    let inherits = "exec \"$@\" --inherit 'PYTHON*'";
    let _node =
        here.node_under(&["ROS_DOMAIN_ID=7", "PYTHONPATH=/py", "HIDDEN=secret", "sh", "-c", inherits, "sh"], "local");
    let deployed = here.ask(&["deploy", "--no-record", &file]);
    assert_eq!(deployed.code, Some(0), "{deployed}");
    assert_eq!(path(&said), format!("good morning,7,/py,,{directory}"));
    fs::remove_dir_all(&folder).expect("the folder is ours");
    let refused = here.ask(&["deploy", "--no-record", &file]);
    assert_eq!(refused.code, Some(1), "{refused}");
    let why = format!("its program cannot run in the folder `{directory}`");
    assert!(refused.err.contains(&why) || refused.out.contains(&why), "{refused}");
}
