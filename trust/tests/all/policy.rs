//! The programs that a node starts, and those that it refuses.

use std::path::Path;
use trust::policy::{Denied, Limits, Policy, PolicyError, Sandbox, Start};

const FILE: &str = r#"
folders = ["/opt/robot/bin"]
user = "dca-run"
devices = ["arm"]
secrets = ["team/camera/", "team/one"]
realtime = 40
memory = 1_000_000
cores = 1.5
"#;

fn start<'a>(devices: &'a [String], secrets: &'a [String]) -> Start<'a> {
    Start {
        program: Path::new("/opt/robot/bin/servo"),
        hash: None,
        user: "dca-run",
        is_root: false,
        only: "",
        devices,
        secrets,
        variables: &[],
        limits: Limits { realtime: Some(40), memory: Some(1_000_000), ..Limits::default() },
    }
}

#[test]
fn what_the_file_allows_is_started_within_its_limits() {
    let policy = Policy::parse(FILE).unwrap();
    let (devices, secrets) = (["arm".to_owned()], ["team/camera/password", "team/one"].map(str::to_owned));
    let asked = start(&devices, &secrets);
    let cores = Some(1500);
    assert_eq!(policy.admit(&asked), Ok(Limits { cores, ..asked.limits }));
    // A program that requests nothing gets the limits of the node, and no priority.
    let modest = Start { limits: Limits::default(), ..asked };
    assert_eq!(policy.admit(&modest), Ok(Limits { memory: Some(1_000_000), cores, ..Limits::default() }));
    assert_eq!(
        Policy::parse("").unwrap().admit(&asked),
        Ok(asked.limits),
        "a rule that is not there restricts nothing"
    );
}

/// A variable such as `LD_PRELOAD` would make a listed program run any other code.
#[test]
fn where_only_some_programs_run_specs_set_only_listed_variables() {
    let variables = ["LD_PRELOAD", "ROS_DOMAIN_ID", "ROS_*"].map(str::to_owned);
    let said = |file: &str| {
        let asked = Start { variables: &variables, ..start(&[], &[]) };
        let asked = Start { limits: Limits::default(), ..asked };
        let denied = Policy::parse(file).unwrap().admit(&asked).err().unwrap_or_default();
        denied.iter().map(|one| one.sentence(Path::new("/p"))).collect::<Vec<_>>()
    };
    let folders = "folders = [\"/opt/robot/bin\"]\n";
    assert_eq!(said(""), Vec::<String>::new(), "anything runs anyway");
    assert_eq!(said(folders).len(), 3);
    assert_eq!(
        said(folders)[0],
        "no spec may set or inherit the variable `LD_PRELOAD` on this node (there is no rule `environment` in `/p`)"
    );
    let listed = format!("{folders}environment = [\"ROS_*\"]");
    assert_eq!(
        said(&listed),
        ["no spec may set or inherit the variable `LD_PRELOAD` on this node (rule `environment`, `/p` line 2)"]
    );
}

#[test]
fn all_reasons_are_said_at_once_each_with_its_rule_and_line() {
    let policy = Policy::parse(FILE).unwrap();
    let (devices, secrets) = (["camera".to_owned()], ["team/one/more".to_owned()]);
    let limits = Limits { realtime: Some(41), memory: Some(2_000_000), cores: Some(1600), ..Limits::default() };
    let (user, only) = ("root", ": it is so");
    let wrong =
        Start { program: Path::new("/tmp/servo"), user, only, is_root: true, limits, ..start(&devices, &secrets) };
    let denied = policy.admit(&wrong).unwrap_err();
    let said: Vec<String> = denied.iter().map(|one| one.sentence(Path::new("/p"))).collect();
    let expected = [
        "`/tmp/servo` is not in a folder of allowed programs (rule `folders`, `/p` line 2)",
        "no program runs as root on this node (there is no rule `root` in `/p`)",
        "programs run as `dca-run` on this node, and this program would run as `root`: it is so (rule `user`, `/p` line 3)",
        "no program may claim `camera` on this node (rule `devices`, `/p` line 4)",
        "no program may read the secret `team/one/more` on this node (rule `secrets`, `/p` line 5)",
        "its real-time priority of 41 is above 40 (rule `realtime`, `/p` line 6)",
        "its memory of 2000000 B is above 1000000 B (rule `memory`, `/p` line 7)",
        "its cores of 1.600 is above 1.500 (rule `cores`, `/p` line 8)",
    ];
    assert_eq!(said, expected);
}

#[test]
fn no_sandbox_has_to_be_said() {
    let check = |text: &str, expected| assert_eq!(Policy::parse(text).unwrap().sandbox(), expected);
    check("", Sandbox::Standard);
    check("sandbox = \"standard\"", Sandbox::Standard);
    check("sandbox = \"none\"", Sandbox::None);
}

#[test]
fn root_has_to_be_said() {
    let asked = Start { user: "root", is_root: true, ..start(&[], &[]) };
    let check = |text: &str, line: Option<usize>| {
        let why = "no program runs as root on this node".to_owned();
        assert_eq!(Policy::parse(text).unwrap().admit(&asked), Err(vec![Denied { rule: "root", line, why }]));
    };
    check("", None);
    check("memory = 1_000_000\nroot = false", Some(2));
    assert!(Policy::parse("root = true").unwrap().admit(&asked).is_ok());
}

#[test]
fn a_folder_is_no_prefix_of_a_name_and_no_way_out() {
    let policy = Policy::parse(FILE).unwrap();
    let paths =
        ["/opt/robot/bin", "/opt/robot/binary/x", "/opt/robot/bin/../x", "opt/robot/bin/x", "/opt/robot/bin/./../x"];
    for path in paths {
        let start = Start { program: Path::new(path), ..start(&[], &[]) };
        let denied = policy.admit(&start).unwrap_err();
        assert_eq!(denied.iter().map(|one| one.rule).collect::<Vec<_>>(), ["folders"], "{path}");
    }
    let by_hash = Policy::parse(&format!("hashes = [\"blake3:{}\"]\n{FILE}", "01".repeat(32))).unwrap();
    let elsewhere = Start { program: Path::new("/tmp/servo"), hash: Some([1; 32]), ..start(&[], &[]) };
    assert!(by_hash.needs_hash(elsewhere.program) && by_hash.admit(&elsewhere).is_ok());
    assert!(!by_hash.needs_hash(Path::new("/opt/robot/bin/servo")));
    for hash in [None, Some([2; 32])] {
        assert!(by_hash.admit(&Start { hash, ..elsewhere }).is_err());
    }
}

#[test]
fn a_policy_that_is_not_understood_is_none() {
    let wrong = |text: &str| Policy::parse(text).unwrap_err().to_string();
    let unknown = wrong("root = true\n\nfolder = [\"/opt\"]");
    assert!(unknown.starts_with("line 3: unknown field `folder`, expected one of `folders`, "), "{unknown}");
    let check = |text: &str, expected: &str| assert_eq!(wrong(text), expected);
    let path = "write an absolute path without `..`";
    check("folders = [\"opt\"]", &format!("line 1: `opt` is not allowed in `folders`: {path}"));
    check("\nfolders = [\"/opt/../etc\"]", &format!("line 2: `/opt/../etc` is not allowed in `folders`: {path}"));
    check("realtime = 50", "line 1: `50` is not allowed in `realtime`: write a number from 0 to 49");
    check("hashes = [\"12\"]", "line 1: `12` is not allowed in `hashes`: write 64 digits from 0 to f");
    check("pids = 0", "line 1: `0` is not allowed in `pids`: write a number above 0");
    check("cores = nan", "line 1: `NaN` is not allowed in `cores`: write a number from 0.001 to 4096");
    check("user = \"\"", "line 1: `` is not allowed in `user`: write a name that is not empty");
    assert!(wrong("root = true\nsandbox = \"strict\"").starts_with("line 2: unknown variant `strict`"));
    assert!(wrong("root = true\nroot = true").starts_with("line 2: duplicate key"), "a rule is said once");
    assert!(wrong("root = true\nmemory = \"much\"").starts_with("line 2: invalid type"));
    assert!(wrong("root = true\n[folders").starts_with("line 2: "), "half a file is none");
    assert_eq!(Policy::parse(&" ".repeat(300_000)), Err(PolicyError::TooLong));
}
