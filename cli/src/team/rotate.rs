//! `dca team rotate`: gives a robot or a user new keys, with the same name and the same role. The old keys are valid
//! until the new ones exist. Then they are revoked.

use super::invite::DoorArgs;
use super::{KeysArgs, now, revoke, user};
use crate::io::keyring::Asked;
use anyhow::{Context as _, anyhow, bail, ensure};
use dbmanager::logic::view::date;
use node::console::{self, Failure, block_on};
use trust::bundle::Bundle;
use trust::certificate::Certificate;
use trust::identity::{KeyId, PublicKeys, SecretKeys};
use trust::name::Name;
use trust::role::{Kind, Role};

/// The arguments of `dca team rotate`.
#[derive(Debug, clap::Args)]
pub(super) struct RotateArgs {
    /// The name of the robot or user
    name: Name,
    /// Of a user: the line that `dca team key` prints with the new keys
    #[arg(long, value_name = "KEY", value_parser = user::key)]
    key: Option<Box<PublicKeys>>,
    #[command(flatten)]
    door: DoorArgs,
}

impl RotateArgs {
    /// Runs the verb.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let (keyring, bundle) = keys.bundle()?;
        let bundle = revoke::learn(keys, &keyring, bundle)?;
        let (role, old) = holder(&bundle, &self.name)?;
        let team = bundle.team().name().clone();
        match (role.kind(), &self.key) {
            (Kind::Node, None) => {
                let (locked, passphrase) = (keyring.root(&bundle)?, keys.passphrase(Asked::Known)?);
                let [root, signer] = [locked.unlock(&passphrase)?, locked.unlock(&passphrase)?];
                let (name, of_team) = (self.name.clone(), team.clone());
                let exchange = move |certificate: &Certificate| {
                    keyring.change(&of_team, |bundle| exchange(bundle, &name, certificate.clone(), &signer)).map(drop)
                };
                block_on(self.door.wait(&self.name, role, &bundle, root, exchange))?;
            }
            (Kind::User, Some(key)) => {
                ensure_new(&bundle, &key.id())?;
                let root = keyring.root(&bundle)?.unlock(&keys.passphrase(Asked::Known)?)?;
                let (until, _) = keyring.change(&team, |bundle| {
                    ensure_new(bundle, &key.id())?;
                    let name = self.name.clone();
                    let certificate = user::certificate(bundle, name, role, **key, &root, now())?;
                    let until = certificate.claims().not_after;
                    exchange(bundle, &self.name, certificate, &root)?;
                    Ok(until)
                })?;
                let until = date::text(until.0.saturating_mul(1000));
                console::say(&format!("{} is {role} until {until}; key: {}", self.name, key.id().fingerprint()));
                console::note(
                    "Give the output of `dca team export` to the user. The user runs `dca team import` with it.",
                );
            }
            (Kind::Node, Some(_)) => {
                return Err(
                    anyhow!("`{}` is a robot, which makes its keys itself: leave out `--key`", self.name).into()
                );
            }
            (Kind::User | Kind::Program, _) => {
                return Err(anyhow!(
                    "`{}` is a user: `dca team key` on the user's machine, with another `--keys` folder, makes new keys and prints the line \
                     for `--key`",
                    self.name
                )
                .into());
            }
        }
        let (keyring, bundle) = keys.bundle()?;
        revoke::tell(keys, &keyring, &bundle)?;
        console::note(&format!("the old keys of `{}` are revoked", self.name));
        revoke::could_read(keys, &self.name, &old)
    }
}

/// Returns the role of a member, and its keys that are not revoked.
fn holder(bundle: &Bundle, name: &Name) -> anyhow::Result<(Role, Vec<KeyId>)> {
    let is_valid = |known: &&Certificate| !bundle.has_revoked(&known.subject());
    let valid: Vec<&Certificate> = bundle.named(name).filter(is_valid).collect();
    let role = valid.first().map(|known| known.claims().role);
    let role = role.with_context(|| format!("the team has no `{name}` whose keys are not revoked"))?;
    if role == Role::Admin && valid.iter().any(|known| known.subject() == bundle.team().id()) {
        bail!("the key of the team cannot be exchanged: begin another team");
    }
    Ok((role, valid.into_iter().map(Certificate::subject).collect()))
}

fn ensure_new(bundle: &Bundle, key: &KeyId) -> anyhow::Result<()> {
    user::ensure_usable(bundle, key)?;
    ensure!(bundle.credential_of(key).is_none(), "this key is in the team already: rotation needs a new one");
    Ok(())
}

/// Adds the new certificate of a name, and revokes the keys of its other certificates.
fn exchange(bundle: &mut Bundle, name: &Name, new: Certificate, root: &SecretKeys) -> anyhow::Result<()> {
    let (_, old) = holder(bundle, name)?;
    bundle.add(new)?;
    revoke::revoke_keys(bundle, old, root, now()).map(drop)
}
