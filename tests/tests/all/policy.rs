//! The execution policy of a node, with real programs. Admitted programs run within their limits. Other programs are
//! refused before anything runs, with the rule, the file and the line.

use dca_tests::cluster::{Cluster, Ended, Host, Network, SOON, Stream, Trace, executable, wait_until};
use rustix::process::Signal;
use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt as _, PermissionsExt as _, symlink};
use std::path::PathBuf;
use std::process::Command;

/// Returns a spec with one program on `c1`. The arguments are its command, and additions to its module and its
/// instance.
fn spec(command: &str, module: &str, instance: &str) -> String {
    format!(
        "module Tool(host) {{ exec \"{command}\"; plain; done; {module} }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{ tool instof Tool(c1) {{ {instance} }} }}
            internal_event_actions {{ tool }}
        }}"
    )
}

/// Returns the rule that a test running as root needs to start anything.
fn own_user() -> &'static str {
    if rustix::process::getuid().is_root() { "root = true" } else { "root = false" }
}

/// Gives a policy to the node, and returns its path.
fn put(host: &Host, name: &str, text: &str) -> PathBuf {
    let folder = host.state().join(name);
    fs::create_dir_all(&folder).expect("a folder of ours");
    let file = folder.join("policy.toml");
    fs::write(&file, text).expect("a folder of ours");
    file
}

/// Returns the path of a program, as a policy sees it.
fn real(program: &str) -> PathBuf {
    fs::canonicalize(program).expect("it is there")
}

fn deploy(cluster: &Cluster, spec: &str) -> Ended {
    cluster.here().ask(&["deploy", &cluster.file("tool.dca", spec)])
}

#[track_caller]
fn expect_refused(ended: &Ended, why: &str) {
    assert!(ended.code == Some(1) && format!("{ended}").contains(why), "{why}: {ended}");
}

#[test]
fn a_program_runs_as_the_policy_of_its_node_says_or_is_refused_in_a_sentence() {
    let cluster = Cluster::new();
    let host = cluster.here();
    let shell = real("/bin/sh");
    let folder = shell.parent().expect("it is in a folder").display();
    let policy = [
        own_user(),
        &format!("folders = [\"{folder}\"]"),
        "realtime = 10",
        "memory = 4_000_000_000",
        "files = 77",
        "devices = [\"arm\"]",
    ];
    let file = put(&host, "c1", &policy.join("\n"));
    let _node = host.node("c1", &[]);
    let place = |line: usize| format!("`{}` line {line})", file.display());

    let limits = cluster.folder().join("limits").display().to_string();
    let admitted =
        deploy(&cluster, &spec(&format!("sh -c 'ulimit -n > {limits}; ulimit -v >> {limits}'"), "claims arm;", ""));
    assert_eq!(admitted.code, Some(0), "{admitted}");
    let told = fs::read_to_string(&limits).expect("it ran");
    // If this host lets a program have a control group, the group limits its memory.
    let expected = [format!("77\n{}\n", 4_000_000_000_u64 / 1024), "77\nunlimited\n".to_owned()];
    assert!(expected.contains(&told), "what the spec does not limit, the node does: {told}");

    let ran = cluster.folder().join("ran");
    let touch = format!("touch {}", ran.display());
    let own = executable("dca-shim");
    let elsewhere = deploy(&cluster, &spec(&format!("{} --version", own.display()), "", ""));
    let own = real(&own.display().to_string());
    let why = "the policy of this node refuses it: ";
    let none = format!("{why}`{}` is not in a folder of allowed programs (rule `folders`, {}", own.display(), place(2));
    expect_refused(&elsewhere, &none);
    let limit = |limit: &str| deploy(&cluster, &spec(&touch, "", limit));
    expect_refused(
        &limit("realtime 11;"),
        &format!("{why}its real-time priority of 11 is above 10 (rule `realtime`, {}", place(3)),
    );
    expect_refused(
        &limit("memory 5000 MB;"),
        &format!("its memory of 5000000000 B is above 4000000000 B (rule `memory`, {}", place(4)),
    );
    let camera = deploy(&cluster, &spec(&touch, "claims camera;", ""));
    expect_refused(&camera, &format!("{why}no program may claim `camera` on this node (rule `devices`, {}", place(6)));
    assert!(!ran.exists(), "nothing has run");

    // The file is read at each start. A file with an error admits nothing.
    put(&host, "c1", "hurry = true");
    expect_refused(&deploy(&cluster, &spec(&touch, "", "")), "cannot be used: line 1: unknown field `hurry`");
    assert!(!ran.exists(), "nothing has run");
    let touched = fs::read(real("/usr/bin/touch")).expect("it can be read");
    put(&host, "c1", &format!("{}\nhashes = [\"{}\"]", own_user(), hash_of(&touched)));
    let listed = deploy(&cluster, &spec(&touch, "", ""));
    assert!(listed.code == Some(0) && ran.exists(), "{listed}");
    expect_refused(&deploy(&cluster, &spec("true", "", "")), "is not listed (rule `hashes`, ");

    let shown = host.ask(&["status"]);
    assert!(shown.out.contains(&format!("policy {}, sandbox standard", file.display())), "{shown}");
    let in_use = host.statuses(&[])[0].policy.clone().expect("one holds");
    // The node's programs run as the user that owns it.
    let weak = format!("standard; `{}`, as whom programs run, could change it", own_name());
    assert_eq!((in_use.file, in_use.sandbox), (file.display().to_string(), weak));
    fs::remove_file(&file).expect("a file of ours");
    assert_eq!(deploy(&cluster, &spec("true", "", "")).code, Some(0), "without a policy anything runs, as before");
    assert_eq!(host.statuses(&[])[0].policy, None);
}

fn hash_of(bytes: &[u8]) -> String {
    format!("blake3:{}", blake3::hash(bytes).to_hex())
}

#[test]
fn a_node_with_a_damaged_policy_does_not_begin_and_the_doctor_says_why() {
    let cluster = Cluster::new();
    let host = cluster.here();
    let file = put(&host, "c1", "root = true\nrealtime = 50\n");
    let why = format!(
        "the policy `{}` cannot be used: line 2: `50` is not allowed in `realtime`: write a number from 0 to 49",
        file.display()
    );
    let ended = host.start_node("c1", &[]).ended(SOON);
    assert!(ended.code == Some(1) && ended.err.contains(&why), "{ended}");
    let state = host.state().display().to_string();
    let doctor = || {
        let folder = host.run_dir().display().to_string();
        let shown = Command::new(executable("dca")).args(["doctor", "--run-dir", &folder, "--state", &state]).output();
        String::from_utf8_lossy(&shown.expect("it can be started").stdout).into_owned()
    };
    let said = doctor();
    assert!(said.contains("FAILED   policy") && said.contains(&why), "{said}");
    put(&host, "c1", "root = true\nrealtime = 49\n");
    let said = doctor();
    let weak =
        format!("warning  policy       `{}`, as whom programs run, could change `{}`", own_name(), file.display());
    assert!(said.contains(&weak), "{said}");
    if rustix::process::getuid().is_root() {
        put(&host, "c1", "user = \"nobody\"");
        let said = doctor();
        assert!(said.contains(&format!("ok       policy       `{}` limits the programs", file.display())), "{said}");
    }
    // A file that is too long to be handwritten is reported, with the limit.
    put(&host, "c1", &"# much\n".repeat(5_000_000));
    let said = doctor();
    assert!(said.contains("cannot be used: it is longer than 256 KiB"), "{said}");
}

/// Returns the name of the user of this test.
fn own_name() -> String {
    let name = Command::new("id").arg("-un").output().expect("it is part of every system");
    String::from_utf8_lossy(&name.stdout).trim().to_owned()
}

/// A node with root rights starts programs as a user without rights. A program is refused if this is impossible.
#[test]
fn programs_run_as_the_user_of_the_policy_without_rights() {
    if !rustix::process::getuid().is_root() {
        println!("skipped: needs root");
        return;
    }
    let (cluster, open) = (Cluster::new(), Cluster::new());
    let host = cluster.here();
    put(&host, "c1", "user = \"nobody\"");
    let _node = host.node("c1", &[]);
    let mode = Permissions::from_mode(0o777);
    fs::set_permissions(open.folder(), mode).expect("a folder of ours");
    let told = open.folder().join("told");
    let script =
        format!("(id -un; echo $USER; grep -E '^(CapEff|NoNewPrivs):' /proc/self/status) > {}", told.display());
    let ran = deploy(&cluster, &spec(&format!("sh -c \\\"{script}\\\""), "", ""));
    assert_eq!(ran.code, Some(0), "{ran}");
    let expected = "nobody\nnobody\nCapEff:\t0000000000000000\nNoNewPrivs:\t1\n";
    assert_eq!(fs::read_to_string(&told).expect("it ran"), expected);
    put(&host, "c1", "sandbox = \"none\"\nroot = true");
    let script = format!("grep NoNewPrivs: /proc/self/status > {}", told.display());
    let ran = deploy(&cluster, &spec(&format!("sh -c \\\"{script}\\\""), "", ""));
    assert_eq!(ran.code, Some(0), "{ran}");
    assert_eq!(fs::read_to_string(&told).expect("it ran"), "NoNewPrivs:\t0\n", "who says so gets no sandbox");
    let sandbox = host.statuses(&[])[0].policy.as_ref().map(|policy| policy.sandbox.clone());
    assert_eq!(sandbox.as_deref(), Some("none; `root`, as whom programs run, could change it"));
}

/// Controllers, and programs that report to the watchdog, also run as the user of the policy. They talk to their node
/// and to each other, return to a restarted node, and read nothing of the node.
#[test]
fn controllers_run_as_the_user_of_the_policy() {
    if !rustix::process::getuid().is_root() {
        println!("skipped: needs root");
        return;
    }
    let (cluster, open) = (Cluster::new(), Cluster::new());
    let host = cluster.here();
    for folder in [cluster.folder(), open.folder()] {
        fs::set_permissions(folder, Permissions::from_mode(0o711)).expect("a folder of ours");
    }
    // In this place `nobody` may execute it, wherever it was built.
    let library = open.folder().join("dca-controller");
    fs::copy(executable("dca-controller"), &library).expect("a folder of ours");
    put(&host, "c1", "user = \"nobody\"");
    let library = library.display().to_string();
    let node = host.node("c1", &["--controllers", &library]);
    let text = "
        process main() {
            host { c1 }
            instantiated_processes { source instof RateSource(c1); monitor instof RateMonitor(c1); }
            internal_connections(source, lbl1) { source, Out -> monitor, In; }
            internal_event_actions { source[lbl1], monitor }
        }";
    let spec = cluster.file("beats.dca", text);
    let mission = host.dca(&["deploy", &spec, "--controllers", &library]);
    mission.wait_for(Stream::Err, "▸", SOON);
    let runs = cluster.folder().join("runs/beats-1");
    let beats = |count: f64| {
        let received = || Trace::so_far(&runs).signal("main/monitor", "received").last().map_or(0.0, |last| last.value);
        let began = received();
        assert!(wait_until(SOON, || received() > began + count).is_some(), "{}", mission.text(Stream::Err));
    };
    beats(50.0);
    let nobody = fs::read_to_string("/etc/passwd").expect("every system has it");
    let nobody = nobody.lines().find_map(|line| line.strip_prefix("nobody:")?.split(':').nth(1)?.parse::<u32>().ok());
    for path in ["main/source", "main/monitor"] {
        let pid = cluster.expect_leaf(path).pid;
        let found = fs::metadata(format!("/proc/{pid}")).expect("it runs").uid();
        assert_eq!(Some(found), nobody, "{path}");
    }
    // The node's own folders are private, and the folder of its programs belongs to the programs' user.
    let mode = |name: &str| fs::metadata(host.run_dir().join(name)).expect("it is there").mode() & 0o777;
    assert_eq!([mode("c1"), mode("c1+u"), mode("c1+u/beats.1")], [0o700, 0o710, 0o710]);
    // A program that dies is restarted as the same user, and all programs return to a restarted node.
    node.kill();
    let _again = host.node("c1", &["--controllers", &library]);
    beats(50.0);
    let stopped = host.ask(&["stop", "beats"]);
    assert_eq!(stopped.code, Some(0), "{stopped}");
    drop(mission.ended(SOON));
}

/// When the policy becomes stricter, a running program continues to run, but it is not restarted.
#[test]
fn a_stricter_policy_counts_from_the_next_start_on() {
    let cluster = Cluster::new();
    let host = cluster.here();
    put(&host, "c1", own_user());
    let _node = host.node("c1", &[]);
    let text = spec("sleep 600", "", "restart transient;");
    let mission = host.dca(&["deploy", &cluster.file("tool.dca", &text)]);
    assert!(wait_until(SOON, || cluster.leaf("main/tool").is_some()).is_some(), "it runs");
    let file = put(&host, "c1", &format!("{}\nfolders = []", own_user()));
    cluster.expect_leaf("main/tool").signal(Signal::KILL);
    let ended = mission.ended(SOON);
    let why = format!("(rule `folders`, `{}` line 2)", file.display());
    assert!(ended.code == Some(1) && format!("{ended}").contains(&why), "{ended}");
}

/// A link in another folder leads to a listed program while the node checks it, and to another program when the program
/// begins.
#[test]
fn a_link_that_is_turned_after_the_look_changes_nothing() {
    let cluster = Cluster::new();
    let host = cluster.here();
    let [listed, other] = ["listed", "other"].map(|name| cluster.folder().join(name));
    let [good, evil, link] = [listed.join("good"), other.join("evil"), other.join("tool")];
    for (folder, program) in [(&listed, &good), (&other, &evil)] {
        fs::create_dir_all(folder).expect("a folder of ours");
        let script = format!("#!/bin/sh\necho \"$0\" > {}/ran\n", folder.display());
        fs::write(program, script).expect("a folder of ours");
        fs::set_permissions(program, Permissions::from_mode(0o755)).expect("a file of ours");
    }
    symlink(&good, &link).expect("a folder of ours");
    let shell = real("/bin/sh");
    let folders = [listed.display().to_string(), shell.parent().expect("it is in a folder").display().to_string()];
    put(&host, "c1", &format!("{}\nfolders = {folders:?}", own_user()));
    let _node = host.node("c1", &[]);
    let go = cluster.folder().join("go");
    let text = format!(
        "module Hold(host) {{ exec \"sh -c 'until [ -e {} ]; do sleep 0.02; done'\"; plain; done; }}
        module Tool(host) {{ exec \"{}\"; plain; done; }}
        process main() {{
            host {{ c1 }}
            instantiated_processes {{ hold instof Hold(c1); tool instof Tool(c1); }}
            internal_event_actions {{ hold ; tool }}
        }}",
        go.display(),
        link.display()
    );
    let mission = host.dca(&["deploy", &cluster.file("tool.dca", &text)]);
    assert!(wait_until(SOON, || cluster.leaf("main/hold").is_some()).is_some(), "it runs");
    fs::remove_file(&link).expect("a file of ours");
    symlink(&evil, &link).expect("a folder of ours");
    fs::write(&go, "").expect("a folder of ours");
    let ended = mission.ended(SOON);
    assert_eq!(ended.code, Some(0), "{ended}");
    let ran = [&listed, &other].map(|folder| fs::read_to_string(folder.join("ran")).ok());
    assert_eq!(ran, [Some(format!("{}\n", real(&good.display().to_string()).display())), None]);
}

/// In a team, each refusal is a line in the audit log, even if a deployer has signed the deployment.
#[test]
fn each_refusal_is_in_the_audit_log() {
    let (cluster, Some(network)) = (Cluster::new(), Network::new(1)) else { return };
    let host = cluster.host(&network, 1);
    let passphrase = cluster.file("passphrase", "correct horse battery\n");
    let mode = Permissions::from_mode(0o600);
    fs::set_permissions(&passphrase, mode).expect("a file of ours");
    let keys = cluster.folder().join("keys").display().to_string();
    let with = |arguments: &[&str]| {
        let keys = ["--keys", &keys, "--passphrase", &passphrase];
        arguments.iter().copied().chain(keys).map(str::to_owned).collect::<Vec<String>>()
    };
    let ask = |arguments: &[&str]| host.ask(&with(arguments).iter().map(String::as_str).collect::<Vec<_>>());
    let begun = ask(&["team", "init", "acme"]);
    assert_eq!(begun.code, Some(0), "{begun}");
    let invite = with(&["team", "invite", "c1"]);
    let invitation = host.dca(&invite.iter().map(String::as_str).collect::<Vec<_>>());
    invitation.wait_for(Stream::Out, "\n", SOON);
    let said = invitation.text(Stream::Out);
    let line = said.trim().strip_prefix("dca team join ").expect("it prints what to type").to_owned();
    let state = host.state().display().to_string();
    let joined = host.ask(&["team", "join", &line, "--state", &state]);
    assert_eq!((joined.code, invitation.ended(SOON).code), (Some(0), Some(0)), "{joined}");
    let file = put(&host, "c1", "folders = [\"/nowhere\"]");
    let node = host.node("c1", &[]);
    let text = spec("true", "", "");
    let refused = ask(&["deploy", &cluster.file("tool.dca", &text)]);
    expect_refused(&refused, "is not in a folder of allowed programs");
    node.signal(Signal::TERM);
    assert_eq!(node.ended(SOON).code, Some(0));
    let audit = host.ask(&["audit", "c1", "--run-dir", &host.run_dir().display().to_string()]);
    let about: Vec<&str> = audit.out.lines().filter(|line| line.contains("start main/tool")).collect();
    assert_eq!(about.len(), 1, "{audit}");
    let words = ["refused", "deployment tool@", "(rule `folders`", &format!("`{}` line 1)", file.display())];
    assert!(words.iter().all(|word| about[0].contains(word)), "{audit}");
}
