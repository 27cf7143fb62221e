//! `dca team user add` and `dca team user remove`: give rights to users and take them away. The team's key signs both.

use super::{KeysArgs, now, random, revoke};
use crate::io::keyring::Asked;
use anyhow::{bail, ensure};
use clap::Subcommand;
use dbmanager::logic::view::date;
use node::console::{self, Failure};
use trust::TextError;
use trust::bundle::Bundle;
use trust::certificate::{Certificate, Claims, DAY, LIFE_MAX, RENEWABLE_MAX};
use trust::identity::{KeyId, PublicKeys, SecretKeys};
use trust::name::{Name, UnixTime};
use trust::role::{Kind, Role};

/// The default number of days during which a user's certificate can be renewed.
const DAYS: u64 = 365;

/// The arguments of `dca team user`.
#[derive(Debug, clap::Args)]
pub(super) struct UserArgs {
    #[command(subcommand)]
    verb: UserVerb,
}

#[derive(Debug, Subcommand)]
enum UserVerb {
    /// Give a user a certificate, or a new one for the same key
    Add(Add),
    /// Revoke the keys of a user permanently
    Remove(Remove),
}

#[derive(Debug, clap::Args)]
struct Add {
    /// The name of the user
    name: Name,
    /// viewer, operator, deployer, admin or ci
    #[arg(long, value_parser = user_role)]
    role: Role,
    /// The line that `dca team key` prints on the user's machine
    #[arg(long, value_name = "KEY", value_parser = key)]
    key: Box<PublicKeys>,
    /// For how many days the certificate can be renewed
    #[arg(long, default_value_t = DAYS, value_parser = clap::value_parser!(u64).range(1..=RENEWABLE_MAX / DAY))]
    days: u64,
}

#[derive(Debug, clap::Args)]
struct Remove {
    /// The name of the user
    name: Name,
    /// Also remove the only admin, because another person has the key
    #[arg(long)]
    last_admin: bool,
}

impl UserArgs {
    /// Runs the verb.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let (keyring, bundle) = keys.bundle()?;
        let bundle = revoke::learn(keys, &keyring, bundle)?;
        let root = keyring.root(&bundle)?;
        let check = |bundle: &Bundle| match &self.verb {
            UserVerb::Add(add) => add.check(bundle),
            UserVerb::Remove(remove) => remove.check(bundle),
        };
        // The passphrase is asked for only after the request was found to be possible.
        check(&bundle)?;
        let root = root.unlock(&keys.passphrase(Asked::Known)?)?;
        let before = match &self.verb {
            UserVerb::Add(add) => add.other_role(&bundle, now()),
            UserVerb::Remove(_) => None,
        };
        let (said, bundle) = keyring.change(bundle.team().name(), |bundle| {
            check(bundle)?;
            match &self.verb {
                UserVerb::Add(add) => add.carry_out(bundle, &root, now()),
                UserVerb::Remove(remove) => remove.carry_out(bundle, &root, now()),
            }
        })?;
        console::say(&said);
        before.into_iter().for_each(|note| console::note(&note));
        match self.verb {
            UserVerb::Add(_) => {
                console::note(
                    "Give the output of `dca team export` to the user. The user runs `dca team import` with it.",
                );
                Ok(())
            }
            UserVerb::Remove(_) => revoke::tell(keys, &keyring, &bundle),
        }
    }
}

/// Refuses a key that cannot belong to a user: the key of the team, or a revoked key.
pub(super) fn ensure_usable(bundle: &Bundle, key: &KeyId) -> anyhow::Result<()> {
    ensure!(*key != bundle.team().id(), "this is the key of the team itself");
    ensure!(!bundle.has_revoked(key), "this key is revoked, for ever: the user makes another one");
    Ok(())
}

impl Add {
    fn check(&self, bundle: &Bundle) -> anyhow::Result<()> {
        let id = self.key.id();
        ensure_usable(bundle, &id)?;
        let mut same_name = bundle.named(&self.name).filter(|known| !bundle.has_revoked(&known.subject()));
        if same_name.any(|known| known.subject() != id) {
            bail!(
                "the team already has a user `{0}` with another key; `dca team user remove {0}` revokes that key",
                self.name
            );
        }
        Ok(())
    }

    /// If the user has a certificate with another role, says that this certificate stays valid.
    fn other_role(&self, bundle: &Bundle, now: UnixTime) -> Option<String> {
        let before = bundle.credential_of(&self.key.id())?;
        let claims = before.certificate().claims();
        let until = date::text(claims.not_after.0.saturating_mul(1000));
        (claims.role != self.role && claims.not_after > now).then(|| {
            format!(
                "A kept copy of the certificate as {} stays valid until {until}: `dca team user remove {}` ends \
                 its validity at once, by revoking the key.",
                claims.role, claims.name
            )
        })
    }

    fn carry_out(&self, bundle: &mut Bundle, root: &SecretKeys, now: UnixTime) -> anyhow::Result<String> {
        let renewable_until = now.plus(self.days * DAY);
        let certificate = issue(bundle, self.name.clone(), self.role, *self.key, root, now, renewable_until)?;
        let (role, until) = (self.role, date::text(certificate.claims().not_after.0.saturating_mul(1000)));
        bundle.add(certificate)?;
        Ok(format!("{} is {role} until {until}; key: {}", self.name, self.key.id().fingerprint()))
    }
}

/// Returns the certificate of a user. It is valid for the usual time.
pub(super) fn certificate(
    bundle: &Bundle,
    name: Name,
    role: Role,
    keys: PublicKeys,
    root: &SecretKeys,
    now: UnixTime,
) -> anyhow::Result<Certificate> {
    issue(bundle, name, role, keys, root, now, now.plus(DAYS * DAY))
}

fn issue(
    bundle: &Bundle,
    name: Name,
    role: Role,
    keys: PublicKeys,
    root: &SecretKeys,
    now: UnixTime,
    renewable_until: UnixTime,
) -> anyhow::Result<Certificate> {
    let claims = Claims {
        team: bundle.team().id(),
        name,
        role,
        keys,
        not_before: now,
        not_after: now.plus(LIFE_MAX).min(renewable_until),
        renewable_until,
        serial: random()?.bytes(),
    };
    Ok(Certificate::issue(claims, root)?)
}

impl Remove {
    fn check(&self, bundle: &Bundle) -> anyhow::Result<()> {
        let mut named = bundle.named(&self.name).peekable();
        ensure!(named.peek().is_some(), "the team has no user `{}`", self.name);
        let is_robot = bundle.named(&self.name).any(|known| known.kind() == Kind::Node);
        ensure!(!is_robot, "`{0}` is a robot, not a user; to revoke it, run `dca team revoke {0}`", self.name);
        let is_left = named.any(|known| known.kind() == Kind::User && !bundle.has_revoked(&known.subject()));
        ensure!(is_left, "`{}` is revoked already", self.name);
        revoke::ensure_other_admin(bundle, &self.name, self.last_admin)
    }

    fn carry_out(&self, bundle: &mut Bundle, root: &SecretKeys, now: UnixTime) -> anyhow::Result<String> {
        revoke::revoke(bundle, &self.name, root, now)
    }
}

fn user_role(text: &str) -> Result<Role, String> {
    Role::named(Kind::User, text)
}

pub(super) fn key(text: &str) -> Result<Box<PublicKeys>, TextError> {
    PublicKeys::from_text(text).map(Box::new)
}
