//! What a node starts, and what it does not.

use std::path::{Path, PathBuf};
use trust::policy::{Denied, Network, Policy, PolicyError, Start, denials};
use trust::role::Role;

const FILE: &str = r#"
folders = ["/opt/robot/bin"]
signers = ["deployer", "ci"]
users = ["dca-run"]
devices = ["/dev/ttyUSB0"]
realtime = 40
memory = 1000000
secrets = ["team/camera/", "team/one"]
"#;

fn start<'a>(devices: &'a [PathBuf], secrets: &'a [String]) -> Start<'a> {
    Start {
        program: Path::new("/opt/robot/bin/servo"),
        hash: [1; 32],
        signer: Role::Deployer,
        user: "dca-run",
        devices,
        realtime: 40,
        memory: Some(1_000_000),
        network: Network::Loopback,
        secrets,
    }
}

#[test]
fn what_the_file_allows_is_started() {
    let policy = Policy::parse(FILE).unwrap();
    let devices = [PathBuf::from("/dev/ttyUSB0")];
    let secrets = ["team/camera/password", "team/one"].map(str::to_owned);
    assert_eq!(policy.denials(&start(&devices, &secrets)), []);
}

#[test]
fn all_reasons_are_said_at_once() {
    let policy = Policy::parse(FILE).unwrap();
    let (devices, secrets) = ([PathBuf::from("/dev/mem")], ["team/one/more".to_owned()]);
    let wrong = Start {
        program: Path::new("/tmp/servo"),
        signer: Role::Operator,
        user: "root",
        realtime: 41,
        memory: None,
        network: Network::Any,
        ..start(&devices, &secrets)
    };
    let expected = [
        Denied::Program("/tmp/servo".into()),
        Denied::Signer(Role::Operator),
        Denied::Root,
        Denied::Device("/dev/mem".into()),
        Denied::Realtime { found: 41, limit: 40 },
        Denied::Memory(1_000_000),
        Denied::Network,
        Denied::Secret("team/one/more".to_owned()),
    ];
    assert_eq!(policy.denials(&wrong), expected);
}

#[test]
fn a_folder_is_no_prefix_of_a_name_and_no_way_out() {
    let policy = Policy::parse(FILE).unwrap();
    let paths =
        ["/opt/robot/bin", "/opt/robot/binary/x", "/opt/robot/bin/../x", "opt/robot/bin/x", "/opt/robot/bin/./../x"];
    for path in paths {
        let start = Start { program: Path::new(path), ..start(&[], &[]) };
        assert_eq!(policy.denials(&start), [Denied::Program(path.into())]);
    }
    let by_hash = format!("hashes = [\"blake3:{}\"]\n{FILE}", "01".repeat(32));
    let start = Start { program: Path::new("/tmp/servo"), ..start(&[], &[]) };
    assert_eq!(Policy::parse(&by_hash).unwrap().denials(&start), []);
}

#[test]
fn the_team_can_only_take_away() {
    let local = Policy::parse("folders = [\"/opt\"]\nsigners = [\"ci\"]\nusers = [\"a\"]").unwrap();
    let generous = Policy::parse("folders = [\"/\"]\nsigners = [\"ci\", \"deployer\"]\nusers = [\"a\", \"dca-run\"]\nroot = true\nrealtime = 49\nnetwork = \"any\"").unwrap();
    let asked = start(&[], &[]);
    assert_eq!(denials(&local, Some(&generous), &asked), local.denials(&asked));
    assert_eq!(denials(&generous, None, &asked), []);
    let both = denials(&generous, Some(&local), &asked);
    assert_eq!(both, local.denials(&asked));
}

#[test]
fn a_policy_that_is_not_understood_is_none() {
    let wrong = |text: &str| Policy::parse(text).unwrap_err().to_string();
    assert!(wrong("").contains("signers"), "who may sign is never guessed");
    assert!(wrong("signers = []\nfolder = [\"/opt\"]").contains("unknown field `folder`"));
    assert!(wrong("signers = []\nfolders = [\"opt\"]").contains("`opt` is not allowed in the field `folders`"));
    assert!(wrong("signers = []\nfolders = [\"/opt/../etc\"]").contains("folders"));
    assert!(wrong("signers = [\"king\"]").contains("`king`"));
    assert!(wrong("signers = []\nrealtime = 50").contains("realtime"));
    assert!(wrong("signers = []\nhashes = [\"12\"]").contains("hashes"));
    assert_eq!(Policy::parse(&" ".repeat(300_000)), Err(PolicyError::TooLong));
}
