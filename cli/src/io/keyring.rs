//! The folder with the keys of teams on an operator's machine, and passphrases.
//!
//! ```text
//! KEYS/                 $XDG_CONFIG_HOME/dca or ~/.config/dca, or `--keys`
//!   own.key             a user's own keys, behind a passphrase
//!   number              the number of the last request that was signed with them
//!   acme/               one team
//!     root.key          its key, behind a passphrase; only on this machine
//!     team              its certificates and revocations
//!     renewed           the user's own credential, renewed by a node
//! ```
//!
//! Folders have mode 0700 and files 0600. Files with wider permissions are rejected rather than fixed, because another
//! user may already have read them.

use crate::io::named_file;
use crate::io::whole_file::WholeFile;
use anyhow::{Context as _, anyhow, bail, ensure};
use node::console;
use rustix::fs::{Access, FlockOperation, access, flock};
use rustix::termios::{LocalModes, OptionalActions, tcgetattr, tcsetattr};
use std::fs::{self, DirBuilder};
use std::io::{self, BufRead, IsTerminal as _, Read as _};
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::path::{Path, PathBuf};
use trust::bundle::{BUNDLE_MAX, Bundle};
use trust::identity::KeyId;
use trust::locked::{LOCKED_MAX, LockedKeys, PASSPHRASE_MAX};
use trust::name::{Name, UnixTime};
use trust::request::AHEAD_MAX;
use trust::team::{CREDENTIAL_MAX, Credential};
use zeroize::Zeroizing;

const TEAM: &str = "team";
const ROOT: &str = "root.key";
const OWN: &str = "own.key";
const NUMBER: &str = "number";
const RENEWED: &str = "renewed";
/// The longest file with a number, in bytes.
const NUMBER_MAX: u64 = 32;

/// The folder with the keys of teams.
#[derive(Debug)]
pub(crate) struct Keyring(PathBuf);

impl Keyring {
    /// Returns the keyring in this folder, or in the default folder of this user. The folder need not exist yet.
    pub(crate) fn at(folder: Option<&Path>) -> anyhow::Result<Self> {
        let folder = match folder {
            Some(folder) => folder.to_owned(),
            None => default_folder().context("there is no folder for keys; choose one with `--keys`")?,
        };
        Ok(Self(std::path::absolute(&folder)?))
    }

    /// Returns the sorted names of the teams in the keyring.
    pub(crate) fn teams(&self) -> anyhow::Result<Vec<Name>> {
        let entries = match fs::read_dir(&self.0) {
            Ok(entries) => entries,
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
            Err(error) => return Err(error).with_context(|| format!("reading `{}`", self.0.display())),
        };
        let mut names = Vec::new();
        for entry in entries {
            let entry = entry.with_context(|| format!("reading `{}`", self.0.display()))?;
            let name = entry.file_name().to_str().and_then(|name| name.parse::<Name>().ok());
            names.extend(name.filter(|_| entry.path().join(TEAM).exists()));
        }
        names.sort();
        Ok(names)
    }

    /// Returns the requested team name, or else the name of the only team.
    pub(crate) fn only(&self, asked: Option<Name>) -> anyhow::Result<Name> {
        if let Some(name) = asked {
            return Ok(name);
        }
        let mut teams = self.teams()?;
        match (teams.pop(), teams.len()) {
            (Some(name), 0) => Ok(name),
            (None, _) => bail!("`{}` has no team; `dca team init NAME` begins one", self.0.display()),
            (Some(_), _) => bail!("there are several teams in `{}`; choose one with `--team`", self.0.display()),
        }
    }

    /// Checks that the keyring can take a team of this name.
    pub(crate) fn check_free(&self, name: &Name) -> anyhow::Result<()> {
        if let Some(there) = self.0.ancestors().find(|folder| is_there(folder)) {
            access(there, Access::WRITE_OK).with_context(|| format!("making a folder in `{}`", there.display()))?;
        }
        let folder = self.0.join(name.as_str());
        ensure!(!folder.join(TEAM).exists(), "there is a team `{name}` in `{}` already", self.0.display());
        // An empty folder is left over from an interrupted command.
        let is_empty = |folder: &Path| fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
        ensure!(
            !is_there(&folder) || is_empty(&folder),
            "`{}` was left by an interrupted `dca team init`: remove that folder, then begin the team",
            folder.display()
        );
        Ok(())
    }

    /// Stores a new team. Fails if the keyring already has a team of this name.
    pub(crate) fn begin(&self, root: &LockedKeys, bundle: &Bundle) -> anyhow::Result<()> {
        let folder = self.0.join(bundle.team().name().as_str());
        private_folder(&self.0, true)?;
        // If several commands begin this team, the command that makes the folder may use the name.
        if private_folder(&folder, false).is_err() {
            self.check_free(bundle.team().name())?;
        }
        let written = write_private(&folder.join(ROOT), &root.to_bytes()).and_then(|()| self.keep(bundle));
        if written.is_err() {
            // The team has no other member yet, so its key can be removed.
            drop(fs::remove_file(folder.join(ROOT)));
        }
        written
    }

    /// Changes the stored state of a team, including changes by other commands, and stores the result. Returns the
    /// result of `change`, and the team. If two commands change a team, one waits for the other.
    pub(crate) fn change<T>(
        &self,
        name: &Name,
        change: impl FnOnce(&mut Bundle) -> anyhow::Result<T>,
    ) -> anyhow::Result<(T, Bundle)> {
        let folder = self.0.join(name.as_str());
        let reading = || format!("reading `{}`", folder.display());
        let turn = fs::File::open(&folder).with_context(reading)?;
        flock(&turn, FlockOperation::LockExclusive).map_err(io::Error::from).with_context(reading)?;
        let mut bundle = self.team(name)?;
        let changed = change(&mut bundle)?;
        self.keep(&bundle)?;
        Ok((changed, bundle))
    }

    /// Stores the changes of a team.
    fn keep(&self, bundle: &Bundle) -> anyhow::Result<()> {
        let text = bundle.to_text();
        ensure!(text.len() <= BUNDLE_MAX, "the team would have more than {BUNDLE_MAX} bytes");
        write_private(&self.0.join(bundle.team().name().as_str()).join(TEAM), text.as_bytes())
    }

    /// Returns a team.
    pub(crate) fn team(&self, name: &Name) -> anyhow::Result<Bundle> {
        let path = self.0.join(name.as_str()).join(TEAM);
        ensure!(path.exists(), "there is no team `{name}` in `{}`", self.0.display());
        let text = String::from_utf8(read_private(&path, BUNDLE_MAX)?.to_vec());
        let text = text.map_err(|_no_text| anyhow!("`{}` is not text", path.display()))?;
        let bundle = Bundle::from_text(&text).with_context(|| format!("reading `{}`", path.display()))?;
        ensure!(bundle.team().name() == name, "`{}` is of the team `{}`", path.display(), bundle.team().name());
        Ok(bundle)
    }

    /// Returns the key of a team, still locked by its passphrase.
    pub(crate) fn root(&self, bundle: &Bundle) -> anyhow::Result<LockedKeys> {
        let path = self.0.join(bundle.team().name().as_str()).join(ROOT);
        ensure!(path.exists(), "the key of the team is not on this machine: there is no `{}`", path.display());
        let locked = locked(&path)?;
        ensure!(locked.public() == bundle.team().root(), "`{}` is the key of another team", path.display());
        Ok(locked)
    }

    /// Stores a user's own keys. Fails if there are keys already.
    pub(crate) fn keep_own(&self, own: &LockedKeys) -> anyhow::Result<PathBuf> {
        private_folder(&self.0, true)?;
        let path = self.0.join(OWN);
        ensure!(!is_there(&path), "`{}` is there already; `dca team key` shows it", path.display());
        write_private(&path, &own.to_bytes())?;
        Ok(path)
    }

    /// Returns the number of the next request, and stores it. No earlier request of this machine had this number. It is
    /// the time in seconds, or a higher number if that one is used. So if the folder was restored from an old copy, the
    /// numbers still exceed those that were used since the copy. An empty file is replaced, and so is a number that no
    /// node would accept.
    pub(crate) fn next_number(&self, now: UnixTime) -> anyhow::Result<u64> {
        let path = self.0.join(NUMBER);
        let reading = || format!("reading `{}`", path.display());
        let turn = fs::File::open(&self.0).with_context(reading)?;
        flock(&turn, FlockOperation::LockExclusive).map_err(io::Error::from).with_context(reading)?;
        let next = match path.symlink_metadata() {
            Ok(there) if there.len() > NUMBER_MAX => next_after(b"", now),
            Ok(_) => next_after(&read_private(&path, usize::try_from(NUMBER_MAX)?)?, now),
            Err(_) => Ok(now.0),
        };
        if next.is_err() {
            console::note(&format!(
                "`{}` had no valid number of a request; a new number is derived from the time",
                path.display()
            ));
        }
        let next = next.unwrap_or(now.0);
        write_private(&path, format!("{next}\n").as_bytes())?;
        Ok(next)
    }

    /// Returns the credential of the member with this key, with its renewal if this machine has one. Returns nothing if
    /// the key has no certificate.
    pub(crate) fn credential(&self, bundle: &Bundle, key: &KeyId) -> Option<Credential> {
        let own = bundle.credential_of(key)?;
        let path = self.0.join(bundle.team().name().as_str()).join(RENEWED);
        let renewed = read_private(&path, CREDENTIAL_MAX).ok().and_then(|bytes| Credential::from_bytes(&bytes).ok());
        // A renewal of an earlier certificate is of no use any more.
        Some(renewed.filter(|renewed| renewed.chain == own.chain).unwrap_or(own))
    }

    /// Stores the renewed credential of the user.
    pub(crate) fn keep_renewed(&self, team: &Name, renewed: &Credential) -> anyhow::Result<()> {
        write_private(&self.0.join(team.as_str()).join(RENEWED), &renewed.to_bytes())
    }

    /// Merges certificates and revocations into the stored team. Returns whether the team was new.
    pub(crate) fn import(&self, bundle: &Bundle) -> anyhow::Result<bool> {
        let name = bundle.team().name();
        let folder = self.0.join(name.as_str());
        private_folder(&self.0, true)?;
        if !folder.join(TEAM).exists() {
            private_folder(&folder, true)?;
            self.keep(bundle)?;
            return Ok(true);
        }
        self.change(name, |known| {
            ensure!(
                known.team().id() == bundle.team().id(),
                "`{}` has another team of the name `{name}`; choose another folder with `--keys`",
                self.0.display()
            );
            known.merge(bundle)?;
            // This checks that the result can be read again.
            Bundle::from_text(&known.to_text())
                .context("the imported part does not fit the part of the team that is known here")?;
            Ok(())
        })?;
        Ok(false)
    }

    /// Returns a user's own keys, still locked by their passphrase; nothing if there are none.
    pub(crate) fn own(&self) -> anyhow::Result<Option<LockedKeys>> {
        let path = self.0.join(OWN);
        if is_there(&path) { locked(&path).map(Some) } else { Ok(None) }
    }
}

/// Returns whether the path exists. A dangling link is also included, for example a link to a USB stick that is not plugged in.
fn is_there(path: &Path) -> bool {
    path.symlink_metadata().is_ok()
}

fn default_folder() -> Option<PathBuf> {
    let folder = |name| std::env::var_os(name).map(PathBuf::from).filter(|folder| folder.is_absolute());
    folder("XDG_CONFIG_HOME").or_else(|| Some(folder("HOME")?.join(".config"))).map(|base| base.join("dca"))
}

fn private_folder(folder: &Path, may_be_there: bool) -> anyhow::Result<()> {
    let made = DirBuilder::new().recursive(may_be_there).mode(0o700).create(folder);
    made.with_context(|| format!("making the folder `{}`", folder.display()))
}

fn write_private(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    let mut file = WholeFile::create_private(path)?;
    file.write(bytes)?;
    file.finish()
}

fn locked(path: &Path) -> anyhow::Result<LockedKeys> {
    let bytes = read_private(path, LOCKED_MAX)?;
    LockedKeys::from_bytes(&bytes).with_context(|| format!("reading `{}`", path.display()))
}

/// Returns the number after the last one; an error if the last one is not valid. Nodes accept no number far ahead of the time.
fn next_after(last: &[u8], now: UnixTime) -> Result<u64, ()> {
    let last: u64 = std::str::from_utf8(last).ok().and_then(|text| text.trim().parse().ok()).ok_or(())?;
    let next = last.saturating_add(1).max(now.0);
    if next > now.plus(AHEAD_MAX / 2).0 { Err(()) } else { Ok(next) }
}

/// Reads a file that only its owner may read or write. The owner must be this user or root.
fn read_private(path: &Path, bytes_max: usize) -> anyhow::Result<Zeroizing<Vec<u8>>> {
    let there = fs::metadata(path).with_context(|| format!("reading `{}`", path.display()))?;
    let (mode, own) = (there.mode() & 0o077, rustix::process::getuid().as_raw());
    ensure!(
        mode == 0,
        "other users can read or write `{0}`, so it is not used; find out whether another user has read it, and then run `chmod 600 {0}`",
        path.display()
    );
    ensure!(there.uid() == own || there.uid() == 0, "`{}` belongs to another user", path.display());
    let bytes = named_file::bytes(path, bytes_max).with_context(|| format!("reading `{}`", path.display()))?;
    Ok(Zeroizing::new(bytes))
}

/// The source of a passphrase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Asked {
    /// An existing passphrase: the user types it once.
    Known,
    /// A new passphrase: the user types it twice.
    New,
}

/// Reads a passphrase: the first line of a private file or of standard input. A terminal does not show it.
pub(crate) fn passphrase(file: Option<&Path>, asked: Asked) -> anyhow::Result<Zeroizing<String>> {
    if let Some(path) = file {
        let text = read_private(path, PASSPHRASE_MAX + 2)?;
        return first_line(&mut &text[..]);
    }
    let stdin = io::stdin();
    if !stdin.is_terminal() {
        return first_line(&mut stdin.lock());
    }
    let first = typed("Passphrase: ")?;
    if asked == Asked::New {
        let second = typed("The same again: ")?;
        ensure!(first == second, "the two passphrases differ");
    }
    Ok(first)
}

/// Reads a secret that the user types twice at a terminal; nothing if standard input is not a terminal.
pub(crate) fn typed_secret() -> anyhow::Result<Option<Zeroizing<String>>> {
    if !io::stdin().is_terminal() {
        return Ok(None);
    }
    let first = typed("Secret: ")?;
    ensure!(first == typed("The same again: ")?, "the two secrets differ");
    Ok(Some(first))
}

/// Asks a question at a terminal, which does not show the answer. The interrupt key is read as a character and cancels
/// the question, so that the terminal always shows typed text again afterwards.
fn typed(question: &str) -> anyhow::Result<Zeroizing<String>> {
    let stdin = io::stdin();
    let before = tcgetattr(&stdin).context("asking the terminal")?;
    let mut silent = before.clone();
    silent.local_modes -= LocalModes::ECHO | LocalModes::ISIG;
    crate::output::Output::standard().prompt(question);
    tcsetattr(&stdin, OptionalActions::Flush, &silent).context("asking the terminal")?;
    let line = first_line(&mut stdin.lock());
    tcsetattr(&stdin, OptionalActions::Flush, &before).context("asking the terminal")?;
    crate::output::Output::standard().prompt("\n");
    let line = line?;
    ensure!(!line.chars().any(char::is_control), "no passphrase was given");
    Ok(line)
}

/// Returns the first line of a source that contains a secret.
pub(crate) fn first_line(from: &mut dyn BufRead) -> anyhow::Result<Zeroizing<String>> {
    let mut bytes = Zeroizing::new(Vec::with_capacity(PASSPHRASE_MAX + 2));
    from.take(PASSPHRASE_MAX as u64 + 2).read_until(b'\n', &mut bytes).context("reading the passphrase")?;
    while bytes.last().is_some_and(|last| *last == b'\n' || *last == b'\r') {
        bytes.pop();
    }
    let text = std::str::from_utf8(&bytes).map_err(|_no_text| anyhow!("the passphrase is not UTF-8 text"))?;
    Ok(Zeroizing::new(text.to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_file_that_is_nonsense_locks_nobody_out() {
        let now = UnixTime(1_800_000_000);
        let next = |last: &[u8]| next_after(last, now);
        assert_eq!(next(b"1799999990\n"), Ok(1_800_000_000));
        assert_eq!(next(b"1800000000\n"), Ok(1_800_000_001));
        for nonsense in [&b""[..], b"-1", b"a", b"18446744073709551615\n", b"1800100000\n", b"\xff", b"1 2"] {
            assert_eq!(next(nonsense), Err(()), "{nonsense:?}");
        }
    }
}
