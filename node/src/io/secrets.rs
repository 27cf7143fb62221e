//! The secrets of programs. When a program is started, its secrets are read from the database and opened with the keys
//! of this node. The shim gets them over a pipe. No file, argument, environment, message or log of a node contains
//! them.

use crate::io::caller;
use crate::io::database::Handle;
use crate::logic::database::question::{Question, Reply};
use crate::logic::protocol::Answer;
use anyhow::{Context, anyhow, bail};
use comms::io::clock;
use comms::logic::bytes::SecretBytes;
use dbmanager::logic::key::Key;
use dbmanager::logic::view::value::Datum;
use shim::protocol;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use team::member::Member;
use trust::seal::{SealError, Sealed, Secret};
use zeroize::Zeroizing;

/// How long the database may take to answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);

/// Opens the values that are sealed for this node in the database.
#[derive(Debug)]
pub(crate) struct Secrets {
    member: Option<Arc<Member>>,
    database: Handle,
    host: String,
    /// The number of its next request. The counter goes downwards, so that its numbers differ from the numbers of other
    /// callers of the node.
    next: AtomicU64,
}

impl Secrets {
    pub(crate) fn new(member: Option<Arc<Member>>, database: Handle, host: &str) -> Self {
        Self { member, database, host: host.to_owned(), next: AtomicU64::new(u64::MAX) }
    }

    /// Returns the secrets of these keys, in the form that a shim reads.
    ///
    /// # Errors
    /// This node cannot read one of the secrets. The error has the reason and advice.
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn open(&self, keys: &[String]) -> anyhow::Result<SecretBytes> {
        let mut secrets = Vec::new();
        for key in keys {
            secrets.push(self.secret(key).await?);
        }
        // The buffer has its full size from the start: a buffer that grows leaves copies in the memory.
        let size = secrets.iter().map(|secret| secret.expose().len() + size_of::<u32>()).sum();
        let mut bytes = Zeroizing::new(Vec::with_capacity(size));
        secrets.iter().for_each(|secret| protocol::secret(secret.expose(), &mut bytes));
        Ok(SecretBytes::from(bytes))
    }

    /// Returns the secret of a key.
    ///
    /// # Errors
    /// The same as for [`Secrets::open`].
    ///
    /// # Cancellation
    /// Safe.
    pub(crate) async fn secret(&self, key: &str) -> anyhow::Result<Secret> {
        let host = &self.host;
        let Some(member) = &self.member else {
            bail!(
                "`{host}` is in no team, so it cannot open the secret `{key}`: let it join a team with `dca team join`"
            );
        };
        let sealed = match self.stored(Key::new(key)?).await? {
            Some(Datum::Sealed(bytes)) => bytes,
            Some(_) => bail!("`{key}` is not a secret: `dca db put --secret {key} --for {host}` writes one"),
            None => bail!("the database of `{host}` has no secret `{key}`: `dca db put --secret {key} --for {host}`"),
        };
        let sealed = Sealed::from_bytes(&sealed).with_context(|| format!("reading the secret `{key}`"))?;
        member.unseal(key, &sealed).map_err(|error| match error {
            SealError::NotForUs => anyhow!(
                "the secret `{key}` is not for `{host}`: `dca db put --secret {key} --for ...,{host}` also seals it for that robot"
            ),
            SealError::TooLong | SealError::Path | SealError::Readers | SealError::Generation | SealError::Damaged => {
                anyhow!("the secret `{key}` cannot be opened: {error}")
            }
        })
    }

    /// Returns the stored value of a key.
    async fn stored(&self, key: Key) -> anyhow::Result<Option<Datum>> {
        let (caller, mut answers) = caller::answers();
        self.database.call(self.next.fetch_sub(1, Ordering::Relaxed), Question::Get { key }, Some(caller));
        loop {
            let answer = tokio::select! {
                answer = answers.next() => answer,
                () = clock::sleep_until(clock::now() + ANSWER_WITHIN) => None,
            };
            match answer {
                Some(Answer::Database(Reply::Entries(entries))) => {
                    let versions = entries.into_iter().next().map(|(_, versions)| versions).unwrap_or_default();
                    return Ok(versions.last().and_then(|version| version.value.as_ref()).map(Datum::of));
                }
                Some(Answer::Database(Reply::Note(_))) => {}
                Some(Answer::Database(Reply::Refused(why))) => bail!("{why}"),
                Some(_) | None => bail!("the database of `{}` does not answer", self.host),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn debug_shows_no_secret() {
        let bytes = SecretBytes::from(Zeroizing::new(b"hunter2".to_vec()));
        assert_eq!((format!("{bytes:?}").as_str(), bytes.expose()), ("SecretBytes(..)", &b"hunter2"[..]));
    }
}
