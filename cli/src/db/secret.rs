//! `dca db put --secret`: seals a value for some robots. Only the sealed value leaves this process.

use super::databases::{ANSWER_WITHIN, Databases, refusal};
use super::readers;
use super::write::CommitArgs;
use crate::client::signer;
use crate::io::keyring::{Keyring, typed_secret};
use crate::io::named_file;
use anyhow::{Context as _, anyhow, ensure};
use comms::io::clock;
use dbmanager::logic::key::Key;
use dbmanager::logic::txn::{VALUE_SIZE_MAX, Value, Write};
use dbmanager::logic::view::value::Datum;
use node::console::{self, Failure};
use node::logic::database::question::{AsOf, Question, Reply};
use node::logic::parameters;
use node::logic::protocol::TeamOfNode;
use std::fs::File;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use trust::bundle::Bundle;
use trust::identity::{KeyId, PublicKeys};
use trust::name::Name;
use trust::role::Kind;
use trust::seal::{Place, Sealed, Secret};
use zeroize::Zeroizing;

/// The arguments of a secret.
#[derive(Debug, clap::Args)]
pub struct SecretArgs {
    /// A secret: the value is standard input, without the end of its last line, or typed at a terminal, and sealed for `--for`
    #[arg(long, requires = "readers")]
    secret: bool,
    /// The robots that may read the secret, such as `r2,r7`
    #[arg(long = "for", value_name = "ROBOTS", value_delimiter = ',', requires = "secret")]
    readers: Vec<Name>,
    /// Read the secret from this file, unchanged
    #[arg(long, value_name = "FILE", requires = "secret")]
    file: Option<PathBuf>,
}

impl SecretArgs {
    /// Seals a secret and commits it.
    pub(crate) fn put(self, key: Key, commit: &CommitArgs) -> Result<(), Failure> {
        if parameters::robot_of(key.as_str()).is_some() {
            return Err(anyhow!(
                "a parameter cannot be a secret: put it at a key such as `team/NAME`, and name it in the spec: `secret(\"team/NAME\")`"
            )
            .into());
        }
        let keyring = Keyring::at(commit.database.key_place().folder.as_deref())?;
        let secret = value(self.file.as_deref())?;
        let (sealed, said) = commit.database.with(async |databases| {
            let team =
                databases.team().await?.context("the robot is in no team: only robots of a team can read a secret")?;
            let readers = keys_of(&keyring, &team, &self.readers)?;
            let before = stored(databases, &key).await?;
            Ok(sealed(&secret, &key, &readers, before.as_ref(), KeyId(team.id))?)
        })?;
        drop(secret);
        commit.commit(vec![], vec![Write { key, value: Some(sealed) }])?;
        console::note(&said);
        Ok(())
    }
}

/// Reads the value of a secret.
fn value(file: Option<&Path>) -> anyhow::Result<Secret> {
    let bytes = match file {
        Some(path) => {
            let bytes = named_file::bytes(path, VALUE_SIZE_MAX);
            Zeroizing::new(bytes.with_context(|| format!("reading `{}`", path.display()))?)
        }
        None => match typed_secret()? {
            Some(typed) => Zeroizing::new(typed.as_bytes().to_vec()),
            None => standard_input()?,
        },
    };
    ensure!(!bytes.is_empty(), "the secret is empty; nothing was written");
    Ok(Secret::new(bytes)?)
}

/// Returns the content of standard input, without the line end at its end.
fn standard_input() -> anyhow::Result<Zeroizing<Vec<u8>>> {
    // The buffer has its full size from the start: a buffer that grows leaves copies in the memory.
    let mut bytes = Zeroizing::new(Vec::with_capacity(VALUE_SIZE_MAX + 1));
    let limit = u64::try_from(VALUE_SIZE_MAX)?;
    let input = File::from(rustix::io::dup(io::stdin())?);
    input.take(limit + 1).read_to_end(&mut bytes).context("reading the secret")?;
    ensure!(bytes.len() <= VALUE_SIZE_MAX, "a secret has at most {VALUE_SIZE_MAX} bytes");
    if bytes.last() == Some(&b'\n') {
        bytes.pop();
    }
    Ok(bytes)
}

/// Returns the keys of robots, as this machine knows them.
fn keys_of(keyring: &Keyring, team: &TeamOfNode, names: &[Name]) -> anyhow::Result<Vec<PublicKeys>> {
    let bundle = signer::bundle(keyring, KeyId(team.id))?.with_context(|| {
        format!(
            "this machine does not know who is in the team `{}`: have the operator run `dca team export`, and give what it prints \
             to `dca team import`",
            team.name
        )
    })?;
    let mut readers: Vec<PublicKeys> = Vec::new();
    for name in names {
        let keys = robot(&bundle, name)?;
        if readers.iter().all(|known| known.id() != keys.id()) {
            readers.push(keys);
        }
    }
    Ok(readers)
}

/// Returns the present keys of a robot. If several robots have its name, returns the newest keys.
fn robot(bundle: &Bundle, name: &Name) -> anyhow::Result<PublicKeys> {
    let holders = bundle.holders(::team::now());
    let robots = holders.iter().filter(|holder| {
        holder.certificate.claims().name == *name && holder.certificate.kind() == Kind::Node && holder.standing.is_ok()
    });
    let newest = robots.max_by_key(|holder| holder.certificate.claims().not_before).with_context(|| {
        format!(
            "`{name}` is not a robot that the team trusts now, as far as this machine knows; `dca team` lists the known robots; to update \
             this list, give the output of the operator's `dca team export` to `dca team import` here"
        )
    })?;
    Ok(newest.certificate.claims().keys)
}

/// Returns the sealed value of a key.
async fn stored(databases: &Databases<'_>, key: &Key) -> Result<Option<Sealed>, Failure> {
    let reply = databases.ask_one(databases.robot(), Question::Get { key: key.clone() }).await?;
    let Reply::Entries(entries) = reply else { return Err(refusal(&reply)) };
    let versions = entries.into_iter().next().map(|(_, versions)| versions).unwrap_or_default();
    let value = versions.last().and_then(|version| version.value.as_ref()).map(Datum::of);
    Ok(value.as_ref().and_then(readers::sealed))
}

/// Seals a secret. Returns the value to write, and the text about it.
fn sealed(
    secret: &Secret,
    key: &Key,
    readers: &[PublicKeys],
    before: Option<&Sealed>,
    team: KeyId,
) -> anyhow::Result<(Value, String)> {
    let (place, mut entropy) = (Place { team, path: key.as_str() }, ::team::random()?);
    let sealed = match before {
        Some(before) => before.rotate(secret, &place, readers, &mut entropy)?,
        None => Sealed::seal(secret, &place, readers, &mut entropy)?,
    };
    let said = format!("sealed for {} as generation {}", count(readers.len()), sealed.number());
    let bytes = sealed.to_bytes();
    ensure!(
        bytes.len() <= VALUE_SIZE_MAX,
        "sealed for {} it takes {} bytes, more than the {VALUE_SIZE_MAX} of a key",
        count(readers.len()),
        bytes.len()
    );
    Ok((Datum::Sealed(bytes).encode()?, said))
}

fn count(readers: usize) -> String {
    if readers == 1 { "1 robot".to_owned() } else { format!("{readers} robots") }
}

/// Returns the names of all secrets in the asked database that one of these `keys` can open.
pub(crate) async fn readable(databases: &Databases<'_>, keys: &[KeyId]) -> Result<Vec<String>, Failure> {
    let question = Question::List { prefix: String::new(), at: AsOf::Now };
    let mut replies = databases.ask(databases.robot(), question).await?;
    let mut found = Vec::new();
    while let Some(reply) = replies.next(clock::now() + ANSWER_WITHIN).await? {
        let Reply::Entries(entries) = reply else { return Err(refusal(&reply)) };
        // All writes of a conflict are looked at, and not only the write that a read shows.
        let is_readable = |value: &Value| {
            let sealed = readers::sealed(&Datum::of(value));
            sealed.is_some_and(|sealed| sealed.readers().any(|reader| keys.contains(&reader)))
        };
        found.extend(entries.into_iter().filter_map(|(key, versions)| {
            versions.iter().filter_map(|version| version.value.as_ref()).any(is_readable).then(|| key.to_string())
        }));
    }
    Ok(found)
}
