//! Two copies of the operator's folder revoke separately, so different sets have the same number. No revocation is
//! lost: not when nodes meet, not when one is killed, not by an import, and not by a command with an old copy.

use super::{IDLE, Team, with};
use dca_tests::cluster::{Ended, NAMES, SOON, Stream, wait_until};
use std::fs;
use std::process::Command;

impl Team {
    /// Copies the operator's folder, and returns the options with the copy.
    fn copy(&self, name: &str) -> Vec<String> {
        let to = self.cluster.folder().join(name).display().to_string();
        let copied = Command::new("cp").args(["-a", &self.keys[1], &to]).status().expect("there is `cp`");
        assert!(copied.success());
        ["--keys".to_owned(), to, self.keys[2].clone(), self.keys[3].clone()].to_vec()
    }

    /// Runs a command on a host with a folder of the operator. The node of the host is informed.
    fn operator(&self, number: usize, arguments: &[&str], keys: &[String]) -> Ended {
        let run_dir = self.host(number).run_dir().display().to_string();
        let ended = self.host(number).ask(&with(&[arguments, &["--run-dir", &run_dir]].concat(), keys));
        assert_eq!(ended.code, Some(0), "{arguments:?} {ended}");
        ended
    }

    /// Makes a deployer on host 1. Returns the options with the deployer's own keys, and the line of the key.
    fn deployer(&self, name: &str) -> (Vec<String>, String) {
        let folder = self.cluster.folder().join(format!("{name}.keys")).display().to_string();
        let own = ["--keys".to_owned(), folder, self.keys[2].clone(), self.keys[3].clone()].to_vec();
        let key = self.host(1).ask(&with(&["team", "key"], &own)).out.trim().to_owned();
        self.operator(1, &["team", "user", "add", name, "--role", "deployer", "--key", &key], &self.keys);
        let exported = self.operator(1, &["team", "export"], &self.keys);
        let file = self.cluster.file(&format!("{name}.team"), &exported.out);
        assert_eq!(self.host(1).ask(&with(&["team", "import", &file], &own)).code, Some(0));
        (own, key)
    }

    /// Returns the revocations on the disk of a node.
    fn on_disk(&self, number: usize) -> Vec<u8> {
        let folder = self.host(number).state().join(NAMES[number - 1]);
        fs::read(folder.join("team/revoked")).unwrap_or_default()
    }

    /// Returns whether all nodes end up with the same set on their disks, and every command sees this number of keys.
    fn agree(&self, keys: usize) -> bool {
        let wanted = format!(", keys {keys}");
        let agree = || {
            let listed = (1..=3).all(|number| self.operator(number, &["team"], &self.keys).out.contains(&wanted));
            listed && (2..=3).all(|number| self.on_disk(number) == self.on_disk(1))
        };
        wait_until(SOON, agree).is_some()
    }

    fn revoke_records(&self, number: usize) -> usize {
        let log = self.host(number).state().join(NAMES[number - 1]).join("team/audit");
        fs::read_to_string(log).unwrap_or_default().matches("\trevoke: ").count()
    }
}

#[test]
fn two_operators_who_count_on_from_one_number_lose_nothing() {
    let Some(mut team) = Team::of_three(3) else { return };
    let ((vic, key), _dan, _zoe) = (team.deployer("vic"), team.deployer("dan"), team.deployer("zoe"));
    let (second, old) = (team.copy("second"), team.copy("old"));
    let before = team.cluster.file("before.team", &team.operator(1, &["team", "export"], &old).out);
    // Both use the same number, since neither hears of the other.
    team.network.cut(3);
    let first_said = team.operator(1, &["team", "user", "remove", "vic"], &team.keys);
    let second_said = team.operator(3, &["team", "user", "remove", "dan"], &second);
    assert!(first_said.out.contains("vic is revoked: number 1"), "{first_said}");
    assert!(second_said.out.contains("dan is revoked: number 1"), "{second_said}");
    team.network.heal(3);
    assert!(team.agree(2), "{} {}", team.operator(1, &["team"], &team.keys), team.operator(3, &["team"], &second));
    let idle = team.cluster.file("idle.dca", IDLE);
    let refused = |team: &Team| {
        let deployed = team.host(1).ask(&with(&["deploy", &idle, "--no-record"], &vic));
        assert!(deployed.code == Some(1) && deployed.err.contains("the key of `vic` is revoked"), "{deployed}");
    };
    let restart = |team: &mut Team| {
        team.nodes[0].kill();
        let node = team.host(1).start_node("c1", &[]);
        node.wait_for(Stream::Out, "node `c1` is ready", SOON);
        team.nodes[0] = node;
    };
    refused(&team);
    restart(&mut team);
    refused(&team);
    // An operator with a restored old copy first learns, and then continues above the highest known number.
    let late = team.operator(3, &["team", "user", "remove", "zoe"], &old);
    assert!(late.out.contains("zoe is revoked: number 2"), "{late}");
    assert!(late.err.contains("learned of 2 keys that were revoked on other machines"), "{late}");
    assert!(team.agree(3), "{}", team.operator(1, &["team"], &team.keys));
    restart(&mut team);
    refused(&team);
    // An export removes nothing, even if it is old.
    let exported = team.cluster.file("second.team", &team.operator(3, &["team", "export"], &second).out);
    for file in [&before, &exported] {
        team.operator(1, &["team", "import", file], &team.keys);
        let listed = team.operator(1, &["team"], &team.keys);
        assert!(listed.out.lines().any(|line| line.starts_with("vic ") && line.ends_with("! revoked")), "{listed}");
        let again =
            team.host(1).ask(&with(&["team", "user", "add", "vic", "--role", "deployer", "--key", &key], &team.keys));
        assert!(again.code == Some(1) && again.err.contains("this key is revoked, for ever"), "{again}");
    }
    let (disk, records) = (team.on_disk(1), team.revoke_records(1));
    for keys in [&team.keys, &second, &old] {
        let told = team.operator(1, &["team", "revoke"], keys);
        assert!(told.err.contains("the node `c1` knows"), "{told}");
    }
    assert_eq!((team.on_disk(1), team.revoke_records(1)), (disk, records), "nothing is new");
    // Without the network, a folder still knows the sets that it has learned.
    for keys in [&team.keys, &second, &old] {
        let alone = team.host(2).ask(&with(&["team"], keys));
        assert!(alone.out.contains("revocations: number 2, keys 3\n"), "{alone}");
    }
    assert!(team.agree(3));
}

/// A disk that accepts nothing is reported with exit code 1. A node that would forget the set is not listed as
/// knowing it.
#[test]
fn what_is_not_on_the_disk_is_not_known() {
    let Some(team) = Team::new(1) else { return };
    super::join(&team.host(1), &team.keys, &team.host(1), "c1");
    let _vic = team.deployer("vic");
    let node = team.host(1).node("c1", &[]);
    let folder = team.host(1).state().join("c1/team");
    let away = folder.with_file_name("away");
    fs::rename(&folder, &away).expect("a folder of ours");
    let run_dir = team.host(1).run_dir().display().to_string();
    let removed = team.host(1).ask(&with(&["team", "user", "remove", "vic", "--run-dir", &run_dir], &team.keys));
    assert!(removed.code == Some(1) && removed.err.contains("host `c1`: writing `"), "{removed}");
    assert!(!removed.err.contains("knows"), "{removed}");
    fs::rename(&away, &folder).expect("a folder of ours");
    team.operator(1, &["team", "revoke"], &team.keys);
    assert!(!team.on_disk(1).is_empty());
    drop(node);
}
