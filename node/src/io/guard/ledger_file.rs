//! The ledger of a gate on the disk. Accepted requests are appended, so each needs one write. Requests that come at the
//! same time share a write.

use crate::logic::gate::{ENTRIES_MAX, Found, Gate, LEDGER_MAX, Ledger};
use anyhow::Context as _;
use comms::io::file::{self, Privacy};
use std::fs::File;
use std::io::Write as _;
use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};
use team::folder;
use trust::revocation::Revocations;

/// The file of a ledger.
#[derive(Debug)]
pub(super) struct LedgerFile {
    path: PathBuf,
    /// Nothing before the first write if the existing file cannot be continued, and after a failed write. Then it is
    /// not known which part is on the disk, so the next write makes a new file.
    file: Option<File>,
    /// How many more bytes of records fit before a new file is begun.
    room: usize,
}

impl LedgerFile {
    /// Reads a ledger; a missing file is an empty ledger.
    ///
    /// # Errors
    /// The ledger cannot be read or is damaged. So it is not known which requests were accepted before.
    pub(super) fn open(path: PathBuf, revoked: &Revocations) -> anyhow::Result<(Self, Ledger)> {
        let none = |path| Self { path, file: None, room: 0 };
        let Some(bytes) = folder::read(&path, LEDGER_MAX)? else { return Ok((none(path), Ledger::default())) };
        let Found { ledger, is_whole } = Ledger::from_bytes(&bytes, revoked).with_context(|| {
            format!(
                "`{}` is broken, so it is not known which requests were used before: take this node into its team again",
                path.display()
            )
        })?;
        // If the disk refuses now, it may accept a new file later.
        let file = if is_whole { file::appended(&path, Privacy::Own).ok() } else { None };
        Ok((Self { file, room: ENTRIES_MAX, ..none(path) }, ledger))
    }

    /// Writes all requests that the gate has accepted. They are on the disk when this returns. Blocks.
    ///
    /// # Errors
    /// The disk refuses. The accepted requests are written together with the next file.
    pub(super) fn keep(&mut self, gate: &Mutex<Gate>) -> anyhow::Result<()> {
        // The file is taken out: if the write fails, the next write makes a new file.
        let file = self.file.take().filter(|file| file::is_in_place(file, &self.path));
        let mut gate = gate.lock().unwrap_or_else(PoisonError::into_inner);
        let news = gate.take_news();
        if let Some(mut file) = file.filter(|_| news.len() <= self.room) {
            drop(gate);
            if !news.is_empty() {
                let written = file.write_all(&news).and_then(|()| file.sync_data());
                written.with_context(|| format!("writing `{}`", self.path.display()))?;
            }
            self.room -= news.len();
            self.file = Some(file);
            return Ok(());
        }
        let whole = gate.ledger().to_bytes();
        drop(gate);
        folder::write(&self.path, &whole)?;
        self.room = ENTRIES_MAX;
        self.file = file::appended(&self.path, Privacy::Own).ok();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::protocol::{Request, Signed};
    use comms::logic::codec;
    use std::path::Path;
    use trust::certificate::{Certificate, Claims, DAY};
    use trust::identity::{Entropy, SecretKeys};
    use trust::name::UnixTime;
    use trust::request::{self, Audience};
    use trust::role::{Action, Role};
    use trust::team::{Credential, Judge, Team};

    const NOW: UnixTime = UnixTime(1_800_000_000);

    /// Returns a gate that has accepted this many requests.
    fn gate(requests: u64) -> Mutex<Gate> {
        let [root, keys] = [[1; 32], [2; 32]].map(|seed| SecretKeys::generate(&mut Entropy::new(&seed)));
        let founded = Team::found("acme".parse().unwrap(), &root);
        let claims = Claims {
            team: founded.id(),
            name: "dan".parse().unwrap(),
            role: Role::Operator,
            keys: *keys.public(),
            not_before: NOW,
            not_after: NOW.plus(DAY),
            renewable_until: NOW.plus(DAY),
            serial: [8; 16],
        };
        let credential = Credential::new(Certificate::issue(claims, &root).unwrap(), None);
        let mut gate = Gate::new(root.public().id(), "r1".parse().unwrap(), Ledger::default());
        let body = codec::encode(&Request::ReleaseEstop).unwrap();
        for sequence in 1..=requests {
            let (audience, action, not_after) = (Audience::Team, Action::Start, NOW.plus(60));
            let (team, id, epoch, not_before) = (founded.id(), [1; 16], 0, NOW);
            let asked = request::Request { team, audience, action, id, sequence, epoch, not_before, not_after };
            let signed = Signed { head: asked.sign(&body, &keys, &credential), body: body.clone() };
            let judge = Judge { team: &founded, revoked: &Revocations::default(), now: NOW, grace: 0 };
            gate.call(Request::Signed(Box::new(signed)), &judge, |_| 0).unwrap();
        }
        Mutex::new(gate)
    }

    fn read(path: &Path) -> Ledger {
        LedgerFile::open(path.to_owned(), &Revocations::default()).unwrap().1
    }

    #[test]
    fn what_was_accepted_is_on_the_disk_whatever_became_of_the_file() {
        let folder = std::env::temp_dir().join(format!("dca-ledger-{}", std::process::id()));
        folder::make(&folder).unwrap();
        let path = folder.join("accepted");
        let (mut file, empty) = LedgerFile::open(path.clone(), &Revocations::default()).unwrap();
        assert_eq!(empty, Ledger::default());
        let one = gate(1);
        file.keep(&one).unwrap();
        assert_eq!(read(&path), *one.lock().unwrap().ledger());
        // The ledger continues the existing file.
        let (mut file, _) = LedgerFile::open(path.clone(), &Revocations::default()).unwrap();
        let before = std::fs::read(&path).unwrap();
        let two = gate(2);
        file.keep(&two).unwrap();
        assert!(std::fs::read(&path).unwrap().starts_with(&before), "records are added");
        assert_eq!(read(&path), *two.lock().unwrap().ledger());
        // The file has been removed. A new file contains everything.
        std::fs::remove_file(&path).unwrap();
        file.keep(&two).unwrap();
        assert_eq!(read(&path), *two.lock().unwrap().ledger());
        // The disk refuses for a while.
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(file.keep(&gate(3)).is_err());
        folder::make(&folder).unwrap();
        file.keep(&two).unwrap();
        assert_eq!(read(&path), *two.lock().unwrap().ledger());
        // A power cut has left half of a record. A new file is made, because no record may follow this half.
        let mut bytes = std::fs::read(&path).unwrap();
        bytes.extend([9, 0]);
        std::fs::write(&path, bytes).unwrap();
        let (mut file, _) = LedgerFile::open(path.clone(), &Revocations::default()).unwrap();
        file.keep(&two).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), two.lock().unwrap().ledger().to_bytes());
        // The file has room for only this many more bytes. Then it is rewritten.
        file.room = 10;
        file.keep(&gate(1)).unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), gate(1).lock().unwrap().ledger().to_bytes());
        assert_eq!(file.room, ENTRIES_MAX);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
