//! `dca-node install`: makes systemd keep a node running.

use super::arguments::Arguments;
use crate::console::{self, Failure};
use crate::io::run_dir::RunDir;
use crate::logic::printable::printable;
use crate::logic::unit_file::{self, UnitFile};
use anyhow::{Context, anyhow};
use std::fs;
use std::io::{self, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::Path;
use std::process::Command;

/// The folder for the units of an administrator. Source: systemd.unit(5), "Unit File Load Path".
const UNITS: &str = "/etc/systemd/system";
/// The name of the unit.
const UNIT: &str = "dca-node.service";
/// The folder that exists if systemd runs the machine. Source: sd_booted(3).
const BOOTED: &str = "/run/systemd/system";

/// The arguments of `dca-node install`, without the options for the node.
#[derive(Debug, clap::Args)]
pub(super) struct Install {
    /// Print the unit, and write nothing
    #[arg(long)]
    print: bool,
    /// Write over a unit that a person has changed
    #[arg(long)]
    force: bool,
    /// The user that the node and its programs run as [default: root]
    #[arg(long, value_name = "USER")]
    user: Option<String>,
    #[command(flatten)]
    node: Arguments,
}

/// The result of writing the file.
#[derive(Debug, PartialEq, Eq)]
enum Written {
    New,
    Again,
    /// A unit of another node was replaced. That node had another name, another user, another boot id or other folders.
    Other,
    Same,
}

/// Runs the verb.
pub(super) fn run(install: &Install) -> Result<(), Failure> {
    let executable = std::env::current_exe().context("finding the executable of this command")?;
    if let Some(path) = install.node.paths().chain([&*executable]).find(|path| path.to_str().is_none()) {
        let path = printable(&path.display().to_string());
        return Err(anyhow!("a unit cannot hold the path `{path}`, which is not UTF-8 text").into());
    }
    if !executable.is_file() {
        let path = executable.display();
        return Err(anyhow!(
            "the executable of this command was removed in the meantime: `{path}`; run the new executable"
        )
        .into());
    }
    let command: Vec<String> = std::iter::once(executable.display().to_string()).chain(install.node.words()).collect();
    if let Some(word) = command.iter().chain(&install.user).find(|word| word.contains(char::is_control)) {
        let word = printable(word);
        return Err(anyhow!("a unit cannot hold the line breaks and control characters of `{word}`").into());
    }
    if let Some(user) = install.user.as_ref().filter(|user| user.is_empty() || user.contains([' ', ':', '/'])) {
        return Err(anyhow!("`{user}` is not the name of a user").into());
    }
    let unit = UnitFile { name: install.node.name.as_str().to_owned(), command, user: install.user.clone() };
    RunDir::path_of(&install.node.base(), install.node.name.as_str())?;
    if install.print {
        console::say(&unit.text());
        return Ok(());
    }
    let is_root = rustix::process::geteuid().is_root();
    if let Some(why) = refusal(is_root, Path::new(BOOTED).is_dir()) {
        return Err(anyhow!("{why}; `--print` prints the unit, and writes nothing").into());
    }
    if let Some(user) = install.user.as_ref().filter(|user| !is_known(user)) {
        return Err(anyhow!("this machine has no user `{user}`; `useradd --system {user}` makes one").into());
    }
    let path = Path::new(UNITS).join(UNIT);
    let written = write(&path, &unit, install.force)?;
    let (path, command) = (path.display(), ["systemctl daemon-reload", "systemctl enable --now dca-node"].join("\n"));
    console::say(&match written {
        Written::New => format!("wrote `{path}`; to start the node now and at each boot:\n{command}"),
        Written::Again => format!(
            "wrote `{path}` again; to start the node with it while its programs continue:\nsystemctl daemon-reload\n\
             systemctl kill --signal=KILL dca-node"
        ),
        Written::Other => format!(
            "wrote `{path}` again, for a node that takes over nothing of the previous node (another name, user or folder); to stop \
             the programs of the previous node, and start this node:\nsystemctl daemon-reload\nsystemctl restart dca-node"
        ),
        Written::Same => {
            format!("`{path}` already has this content; to start the node now and at each boot:\n{command}")
        }
    });
    Ok(())
}

/// Returns why the service cannot be installed here. Nothing if it can be installed.
fn refusal(is_root: bool, has_systemd: bool) -> Option<String> {
    if !has_systemd {
        return Some(format!("systemd does not run this machine (there is no `{BOOTED}`)"));
    }
    (!is_root).then(|| format!("only root may write to `{UNITS}`: `sudo dca-node install …`"))
}

/// Returns whether the machine has a user of this name in any of its sources of users. Source: id(1).
fn is_known(user: &str) -> bool {
    let asked = Command::new("id").args(["-u", "--", user]).output();
    asked.is_ok_and(|output| output.status.success())
}

/// Writes a unit, completely or not at all. It is not written if a person has changed the present unit.
fn write(path: &Path, unit: &UnitFile, is_forced: bool) -> anyhow::Result<Written> {
    let text = unit.text();
    if fs::metadata(path).is_ok_and(|there| !there.is_file()) {
        return Err(anyhow!("`{}` is not a regular file", path.display()));
    }
    let before = match fs::read_to_string(path) {
        Ok(before) => Some(before),
        Err(error) if error.kind() == io::ErrorKind::NotFound => None,
        Err(error) => return Err(error).with_context(|| format!("reading `{}`", path.display())),
    };
    if before.as_ref() == Some(&text) {
        return Ok(Written::Same);
    }
    anyhow::ensure!(
        is_forced || before.as_deref().is_none_or(unit_file::is_untouched),
        "another program has changed `{}`; `--force` writes over it. Keep settings of only this machine in \
         `systemctl edit dca-node`",
        path.display()
    );
    put(path, &text).with_context(|| format!("writing `{}`", path.display()))?;
    Ok(match before {
        None => Written::New,
        Some(before) if unit_file::takes_over(&text, &before) => Written::Again,
        Some(_) => Written::Other,
    })
}

fn put(path: &Path, text: &str) -> io::Result<()> {
    let beside = path.with_extension("service.new");
    let mut file = fs::OpenOptions::new().create(true).truncate(true).write(true).mode(0o644).open(&beside)?;
    let written = file.write_all(text.as_bytes()).and_then(|()| file.sync_all());
    written.and_then(|()| fs::rename(&beside, path)).inspect_err(|_disk_full| drop(fs::remove_file(&beside)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_person_has_changed_stays() {
        let folder = std::env::temp_dir().join(format!("dca-install-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join(UNIT);
        let unit = |name: &str| {
            let command = ["/usr/bin/dca-node", "--name", name].map(str::to_owned).to_vec();
            UnitFile { name: name.into(), command, user: None }
        };
        assert_eq!(write(&path, &unit("c1"), false).unwrap(), Written::New);
        assert_eq!(write(&path, &unit("c1"), false).unwrap(), Written::Same);
        let newer =
            UnitFile { command: ["/opt/dca-node", "--name", "c1", "--lan"].map(str::to_owned).to_vec(), ..unit("c1") };
        assert_eq!(write(&path, &newer, false).unwrap(), Written::Again);
        assert_eq!(write(&path, &unit("c2"), false).unwrap(), Written::Other);
        let changed = format!("{}Nice=-5\n", unit("c2").text());
        fs::write(&path, &changed).unwrap();
        let why = write(&path, &unit("c3"), false).unwrap_err().to_string();
        assert!(why.starts_with("another program has changed `") && why.contains("`--force`"), "{why}");
        assert_eq!(fs::read_to_string(&path).unwrap(), changed);
        assert_eq!(write(&path, &unit("c3"), true).unwrap(), Written::Other);
        assert_eq!(fs::read_to_string(&path).unwrap(), unit("c3").text());
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "nothing is left beside it");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn what_is_no_file_is_not_written_over() {
        let folder = std::env::temp_dir().join(format!("dca-install-folder-{}", std::process::id()));
        let path = folder.join(UNIT);
        fs::create_dir_all(&path).unwrap();
        let unit = UnitFile { name: "c1".into(), command: vec!["/usr/bin/dca-node".into()], user: None };
        let why = write(&path, &unit, true).unwrap_err().to_string();
        assert!(why.ends_with("is not a regular file"), "{why}");
        assert_eq!(fs::read_dir(&folder).unwrap().count(), 1, "nothing is left beside it");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn a_user_is_looked_for_on_the_machine() {
        assert!(is_known("root") && !is_known("no-such-user") && !is_known("--help"));
    }

    #[test]
    fn without_systemd_or_root_nothing_is_written() {
        assert!(refusal(true, false).unwrap().starts_with("systemd does not run this machine"));
        assert!(refusal(false, true).unwrap().starts_with("only root may write to"));
        assert_eq!(refusal(true, true), None);
    }
}
