//! `dca team revoke`: revokes the keys of a robot or a user. The node of this machine is told at once, and tells the others.

use super::{KeysArgs, now};
use crate::client::{ANSWER_WITHIN, Client, unasked};
use crate::db::databases::Databases;
use crate::db::secret::readable;
use crate::io::keyring::{Asked, Keyring};
use anyhow::{anyhow, ensure};
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Answer, Request};
use std::collections::{BTreeMap, BTreeSet};
use trust::bundle::{Bundle, Holder};
use trust::certificate::Certificate;
use trust::identity::{KeyId, SecretKeys};
use trust::name::{Name, UnixTime};
use trust::revocation::{REVOKED_MAX, Received, Revocations, RevokedSet};
use trust::role::Role;

/// The arguments of `dca team revoke`.
#[derive(Debug, clap::Args)]
pub(super) struct RevokeArgs {
    /// The name of the robot or user; without it the nodes of this machine are told again of all revoked keys
    name: Option<Name>,
    /// Also revoke the only admin, because another person has the key
    #[arg(long, requires = "name")]
    last_admin: bool,
}

impl RevokeArgs {
    /// Runs the verb.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let (keyring, bundle) = keys.bundle()?;
        let mut bundle = learn(keys, &keyring, bundle)?;
        if let Some(name) = &self.name {
            // The passphrase is asked for only after the request was found to be possible.
            let check = |bundle: &Bundle| {
                ensure_to_revoke(bundle, name)?;
                ensure_other_admin(bundle, name, self.last_admin)
            };
            check(&bundle)?;
            let root = keyring.root(&bundle)?.unlock(&keys.passphrase(Asked::Known)?)?;
            let said;
            (said, bundle) = keyring.change(bundle.team().name(), |bundle| {
                check(bundle)?;
                revoke(bundle, name, &root, now())
            })?;
            console::say(&said);
        }
        tell(keys, &keyring, &bundle)?;
        match &self.name {
            Some(name) => could_read(keys, name, &bundle.named(name).map(Certificate::subject).collect::<Vec<_>>()),
            None => Ok(()),
        }
    }
}

fn ensure_to_revoke(bundle: &Bundle, name: &Name) -> anyhow::Result<()> {
    let mut named = bundle.named(name).peekable();
    ensure!(named.peek().is_some(), "the team has no `{name}`");
    ensure!(named.any(|known| !bundle.has_revoked(&known.subject())), "`{name}` is revoked already");
    Ok(())
}

/// Refuses to revoke the only admin whose keys are trusted, unless `is_wanted`.
pub(super) fn ensure_other_admin(bundle: &Bundle, name: &Name, is_wanted: bool) -> anyhow::Result<()> {
    let holders = bundle.holders(now());
    let is_trusted = |holder: &&Holder<'_>| holder.standing.is_ok();
    let claims = holders.iter().filter(is_trusted).map(|holder| holder.certificate.claims());
    let (own, others): (Vec<_>, Vec<_>) =
        claims.filter(|claims| claims.role == Role::Admin).partition(|claims| claims.name == *name);
    ensure!(
        is_wanted || own.is_empty() || !others.is_empty(),
        "`{name}` is the only admin of the team: first add another admin with `dca team user add NAME --role admin --key KEY`; if another \
         person has the key of `{name}`, `--last-admin` revokes it nevertheless"
    );
    Ok(())
}

/// Signs a set that revokes all keys of a member, in addition to the earlier revocations.
pub(super) fn revoke(bundle: &mut Bundle, name: &Name, root: &SecretKeys, now: UnixTime) -> anyhow::Result<String> {
    let gone: Vec<_> = bundle.named(name).map(Certificate::subject).collect();
    let number = revoke_keys(bundle, gone, root, now)?;
    Ok(format!("{name} is revoked: number {number}"))
}

/// Signs a set that revokes some keys, and returns the number of the set. The set contains the keys of all sets that
/// are known here, and replaces them.
pub(super) fn revoke_keys(
    bundle: &mut Bundle,
    gone: Vec<KeyId>,
    root: &SecretKeys,
    now: UnixTime,
) -> anyhow::Result<u64> {
    let known = bundle.revocations();
    let number = known.number_of(&bundle.team().id());
    let mut keys: BTreeMap<KeyId, UnixTime> = BTreeMap::new();
    let revoked = known.sets().iter().flat_map(RevokedSet::keys).map(|(key, since)| (*key, *since));
    for (key, since) in revoked.chain(gone.into_iter().map(|key| (key, now))) {
        let first = keys.entry(key).or_insert(since);
        *first = since.min(*first);
    }
    ensure!(keys.len() <= REVOKED_MAX, "at most {REVOKED_MAX} keys can be revoked");
    let number = number.checked_add(1).ok_or_else(|| anyhow!("the numbers for revocations are used up"))?;
    bundle.revoke(RevokedSet::sign(bundle.team(), number, keys, root, None)?)?;
    Ok(number)
}

/// Does some work with the node of this machine; `work` gets its name. Returns nothing if no node runs.
pub(super) fn with_node<T>(
    keys: &KeysArgs,
    work: impl AsyncFnOnce(&Client, &str) -> Result<T, Failure>,
) -> Result<Option<T>, Failure> {
    block_on(async {
        let client = match Client::here(keys.run_dir.as_deref()).await {
            Ok(client) => client,
            Err(Failure::Unreachable(_)) => return Ok(None),
            Err(failure) => return Err(failure),
        };
        let done = work(&client, client.local().unwrap_or_default()).await;
        client.close().await;
        done.map(Some)
    })
}

/// Lists the secrets that a member could read. They are known to the holder of the member's keys.
pub(super) fn could_read(keys: &KeysArgs, name: &Name, own: &[KeyId]) -> Result<(), Failure> {
    let found = with_node(keys, async |client, host| readable(&Databases::through(client, host.to_owned()), own).await);
    match found {
        Ok(Some(found)) if found.is_empty() => {
            console::note(&format!("the database of this machine has no secret for `{name}`"));
        }
        Ok(Some(found)) => {
            console::note(&format!(
                "`{name}` could read these secrets: change each secret, and put it again for the members that may read it now"
            ));
            found.iter().for_each(|key| console::say(key));
        }
        Ok(None) => console::note(&format!(
            "cannot list the secrets that `{name}` could read: no node runs on this machine. `dca db get` shows the readers of each secret"
        )),
        Err(Failure::Refused(why) | Failure::Usage(why) | Failure::Unreachable(why)) => {
            console::note(&format!("cannot list the secrets that `{name}` could read: {why:#}"));
        }
        Err(failure @ (Failure::Reported | Failure::ReportedUnreachable | Failure::Limited)) => return Err(failure),
    }
    Ok(())
}

/// Asks the node of this machine for the team's revocations, and stores the new ones. A command with another copy of
/// this folder may have revoked a member in the meantime. Without an answer, nothing changes.
pub(super) fn learn(keys: &KeysArgs, keyring: &Keyring, bundle: Bundle) -> anyhow::Result<Bundle> {
    take(keyring, bundle, &held(keys))
}

/// Adds the revocations of the node of this machine, without storing them.
pub(super) fn look(keys: &KeysArgs, mut bundle: Bundle) -> Bundle {
    let held = held(keys);
    add(&mut bundle, &held);
    bundle
}

fn held(keys: &KeysArgs) -> Vec<RevokedSet> {
    let request = Request::Revocations(Vec::new());
    match with_node(keys, async |client, host| client.ask(host, &request, ANSWER_WITHIN).await) {
        Ok(Some(Answer::Revocations(held))) => sets(&held),
        Ok(_) | Err(_) => Vec::new(),
    }
}

fn sets(held: &[Vec<u8>]) -> Vec<RevokedSet> {
    held.iter().filter_map(|set| RevokedSet::from_bytes(set).ok()).collect()
}

/// Adds the sets of the team's key. Returns whether any set was new, and how many keys were new.
fn add(bundle: &mut Bundle, held: &[RevokedSet]) -> (bool, usize) {
    // Sets of admins and of another team cannot be added to the sets of the team's key.
    let taken = held.iter().filter_map(|set| bundle.revoke(set.clone()).ok());
    taken.fold((false, 0), |(is_new, keys), taken| match taken {
        Received::Known => (is_new, keys),
        Received::New(count) => (true, keys + count),
    })
}

fn take(keyring: &Keyring, bundle: Bundle, held: &[RevokedSet]) -> anyhow::Result<Bundle> {
    if !add(&mut bundle.clone(), held).0 {
        return Ok(bundle);
    }
    let ((_, count), bundle) = keyring.change(bundle.team().name(), |bundle| Ok(add(bundle, held)))?;
    if count > 0 {
        console::note(&format!("learned of {count} keys that were revoked on other machines"));
    }
    Ok(bundle)
}

/// Sends the revocations to the node of this machine. The node passes them on to all nodes, now and
/// whenever it meets another node. Stores further revocations that the node knows.
pub(super) fn tell(keys: &KeysArgs, keyring: &Keyring, bundle: &Bundle) -> Result<(), Failure> {
    let known = bundle.revocations();
    if known.sets().is_empty() {
        return Ok(());
    }
    let request = Request::Revocations(known.sets().iter().map(RevokedSet::to_bytes).collect());
    let told = with_node(keys, async |client, host| {
        let answer = client.ask(host, &request, ANSWER_WITHIN).await?;
        let Answer::Revocations(held) = &answer else { return Err(unasked(host, &answer)) };
        Ok((host.to_owned(), sets(held)))
    })?;
    let Some((host, held)) = told else {
        console::note(
            "No node of the team knows the revocations yet, because no node runs on this machine. Later, `dca team revoke` without a name \
             tells a node.",
        );
        return Ok(());
    };
    let there: BTreeSet<&KeyId> = held.iter().flat_map(|set| set.keys().keys()).collect();
    let missing = known.keys().iter().filter(|key| !there.contains(key)).count();
    if missing > 0 {
        return Err(anyhow!(
            "the node `{host}` does not know of {missing} revoked keys: run `dca team revoke` again without a name"
        )
        .into());
    }
    console::note(&format!("the node `{host}` knows the revocations, and tells them to every node that it meets"));
    take(keyring, bundle.clone(), &held)?;
    Ok(())
}

/// Describes the revocations in a line for a person.
pub(super) fn summary(revoked: &Revocations, team: &KeyId) -> String {
    let (number, keys) = (revoked.number_of(team), revoked.keys().len());
    match revoked.sets().len() {
        0 => "no key is revoked".to_owned(),
        1 => format!("revocations: number {number}, keys {keys}"),
        count => {
            format!("revocations: number {number}, keys {keys}, in {count} sets; the next revocation joins these sets")
        }
    }
}
