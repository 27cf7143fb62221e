//! `dca team init` and `dca team key`: make new keys.

use super::{KeysArgs, now, random, user};
use crate::io::keyring::Asked;
use node::console::{self, Failure};
use trust::bundle::Bundle;
use trust::identity::SecretKeys;
use trust::locked::{Cost, LockedKeys};
use trust::name::Name;
use trust::role::Role;
use trust::team::Team;

/// The arguments of `dca team init`.
#[derive(Debug, clap::Args)]
pub(super) struct Init {
    /// The name of the team
    name: Name,
}

/// The arguments of `dca team key`.
#[derive(Debug, clap::Args)]
pub(super) struct Key {}

impl Init {
    /// Runs the verb. The user who begins a team becomes its first admin, with the existing key of this machine or a new one.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let keyring = keys.keyring()?;
        // This is checked before the passphrase is asked for, and before the keys are made, which takes a while.
        keyring.check_free(&self.name)?;
        let own = keyring.own()?;
        let passphrase = keys.passphrase(Asked::New)?;
        let (root, locked) = new_keys(&passphrase)?;
        let admin = match &own {
            Some(own) => *own.public(),
            None => {
                let (made, locked) = new_keys(&passphrase)?;
                keyring.keep_own(&locked)?;
                *made.public()
            }
        };
        let mut bundle = Bundle::new(Team::found(self.name.clone(), &root));
        bundle.add(user::certificate(&bundle, admin_name(), Role::Admin, admin, &root, now())?)?;
        keyring.begin(&locked, &bundle)?;
        super::tell(&bundle, &[]);
        console::note(
            "Keep a copy of the folder with the keys. Keep the passphrase at another place, so that you cannot lose both.",
        );
        Ok(())
    }
}

/// Returns the user's name in the form of certificates, or `admin` if it cannot have this form.
fn admin_name() -> Name {
    let user = crate::io::user::name();
    user.parse().unwrap_or_else(|_no_name| "admin".parse().expect("it is a name"))
}

impl Key {
    /// Runs the verb.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let keyring = keys.keyring()?;
        let own = match keyring.own()? {
            Some(own) => own,
            None => {
                let (_, locked) = new_keys(&keys.passphrase(Asked::New)?)?;
                let path = keyring.keep_own(&locked)?;
                console::note(&format!("made `{}`", path.display()));
                locked
            }
        };
        console::say(&own.public().to_text());
        console::note(&format!("fingerprint: {}", own.public().id().fingerprint()));
        Ok(())
    }
}

/// Makes keys. Returns them open, and also locked by a passphrase.
fn new_keys(passphrase: &str) -> anyhow::Result<(SecretKeys, LockedKeys)> {
    let mut entropy = random()?;
    let made = SecretKeys::generate(&mut entropy);
    let locked = LockedKeys::lock(&made, passphrase, Cost::STANDARD, &mut entropy)?;
    Ok((made, locked))
}
