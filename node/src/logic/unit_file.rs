//! The text of the systemd unit that keeps a node running.
//!
//! The first line has a checksum of the rest. If the checksum fits, the file is unchanged, and may be overwritten.

use std::fmt::Write as _;

/// The beginning of the first line.
const MARK: &str = "# Written by `dca-node install`. Until it is edited, `dca-node install` may write it again: ";

/// The settings from which a unit is made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UnitFile {
    /// The node's name.
    pub name: String,
    /// The full path of `dca-node`, and its arguments.
    pub command: Vec<String>,
    /// The user as whom the node runs; root if no user is given.
    pub user: Option<String>,
}

impl UnitFile {
    /// Returns the text of the file.
    pub fn text(&self) -> String {
        let command = self.command.iter().map(|word| quoted(word)).collect::<Vec<_>>().join(" ");
        let mut text = format!(
            "\
[Unit]
Description=DCA node {name}
Documentation=man:dca-node(1)
After=network.target
# No limit on restarts, because no node supervises the programs until the node runs again.
StartLimitIntervalSec=0

[Service]
Type=notify
ExecStart={command}
# After the node was killed, its programs continue. The next node takes them over.
Restart=always
RestartSec=200ms
KillMode=process
# The node gets its own control group, so that it finds all processes that its programs start.
Delegate=yes
# A node on a network is ready only after a network interface is up, and this can take any time.
TimeoutStartSec=infinity
# Time for the programs to stop: their specs say how long they may take.
TimeoutStopSec=5min
# The node gives a sign of life every 10 s.
WatchdogSec=30s
# For programs with `realtime` and `memory` in their specs.
LimitRTPRIO=99
LimitMEMLOCK=infinity
# Sockets and records of running programs, which the next node needs, and the database.
RuntimeDirectory=dca
RuntimeDirectoryMode=0700
RuntimeDirectoryPreserve=yes
StateDirectory=dca
StateDirectoryMode=0700
",
            name = specifiers(&self.name)
        );
        if let Some(user) = &self.user {
            writeln!(text, "User={}", specifiers(user)).unwrap_or_default();
        }
        text.push_str("\n[Install]\nWantedBy=multi-user.target\n");
        format!("{MARK}{:08x}\n{text}", crc32fast::hash(text.as_bytes()))
    }
}

/// Returns whether a file is unchanged since `dca-node install` wrote it.
pub fn is_untouched(text: &str) -> bool {
    let Some((sum, rest)) = text.strip_prefix(MARK).and_then(|text| text.split_once('\n')) else { return false };
    u32::from_str_radix(sum, 16) == Ok(crc32fast::hash(rest.as_bytes()))
}

/// Returns whether the node of `unit` takes over everything that the node of `before` leaves. The two must have the
/// same name, user, folders and boot id.
pub fn takes_over(unit: &str, before: &str) -> bool {
    identity(unit) == identity(before)
}

/// Returns the properties in the unit by which a node differs from others on its machine.
fn identity(unit: &str) -> [Option<&str>; 5] {
    let line = |name: &str| unit.lines().find_map(|line| line.strip_prefix(name));
    let command = line("ExecStart=").unwrap_or_default();
    let value = |option: &str| command.split_once(option).and_then(|(_, rest)| rest.split(" --").next());
    [value(" --name "), value(" --run-dir "), value(" --state "), value(" --boot-id "), line("User=")]
}

/// Returns a word in a form that systemd uses literally. Source: systemd.service(5), "Command lines"; systemd.syntax(7), "Quoting".
fn quoted(word: &str) -> String {
    let word = specifiers(word).replace('\\', "\\\\").replace('"', "\\\"").replace('$', "$$");
    let is_plain = !word.is_empty() && !word.contains([' ', '\t', ';', '\'', '"', '\\']);
    if is_plain { word } else { format!("\"{word}\"") }
}

fn specifiers(text: &str) -> String {
    text.replace('%', "%%")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit(arguments: &[&str]) -> UnitFile {
        let command =
            std::iter::once("/usr/bin/dca-node").chain(arguments.iter().copied()).map(str::to_owned).collect();
        UnitFile { name: "c1".into(), command, user: None }
    }

    #[test]
    fn a_file_that_somebody_has_changed_is_known() {
        let text = unit(&["--name", "c1"]).text();
        assert!(is_untouched(&text), "{text}");
        let changed = [
            text.replace("WatchdogSec=30s", "WatchdogSec=60s"),
            format!("{text}Nice=-5\n"),
            text.split_once('\n').unwrap().1.to_owned(),
            String::new(),
            format!("{MARK}zz\nrest"),
        ];
        for text in changed {
            assert!(!is_untouched(&text), "{text}");
        }
    }

    #[test]
    fn a_node_takes_over_from_one_of_its_name_user_and_folders() {
        let text = |arguments: &[&str]| unit(arguments).text();
        let one = text(&["--name", "c1", "--run-dir", "/run/a b", "--lan"]);
        assert!(takes_over(&text(&["--name", "c1", "--port", "7", "--run-dir", "/run/a b"]), &one));
        let user = UnitFile { user: Some("robot".into()), ..unit(&["--name", "c1", "--run-dir", "/run/a b"]) }.text();
        for other in [text(&["--name", "c2", "--run-dir", "/run/a b"]), text(&["--name", "c1"]), user] {
            assert!(!takes_over(&other, &one), "{other}");
        }
        assert!(!takes_over(&text(&["--name", "c1", "--state", "/a"]), &text(&["--name", "c1", "--state", "/b"])));
    }

    #[test]
    fn words_reach_the_node_as_they_are() {
        let check = |word: &str, expected: &str| assert_eq!(quoted(word), expected);
        check("--name", "--name");
        check("tcp/[fe80::1%eth0]:7000", "tcp/[fe80::1%%eth0]:7000");
        check("/opt/my robot/x", "\"/opt/my robot/x\"");
        check("a\"b\\c", "\"a\\\"b\\\\c\"");
        check("$HOME", "$$HOME");
        check("", "\"\"");
    }

    #[test]
    fn a_user_is_named_where_there_is_one() {
        let unit = unit(&["--name", "c1", "--lan"]);
        let text = unit.text();
        assert!(text.contains("\nExecStart=/usr/bin/dca-node --name c1 --lan\n") && !text.contains("User="), "{text}");
        for line in ["Type=notify", "Delegate=yes", "KillMode=process", "Restart=always", "WantedBy=multi-user.target"]
        {
            assert!(text.lines().any(|other| other == line), "{line}: {text}");
        }
        let text = UnitFile { user: Some("robot".into()), ..unit }.text();
        assert!(text.contains("\nUser=robot\n"), "{text}");
    }
}
