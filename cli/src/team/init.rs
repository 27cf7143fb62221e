//! `dca team init`, `key`: new keys.

use super::{KeysArgs, now, random};
use crate::io::keyring::{Asked, passphrase};
use node::console::{self, Failure};
use trust::bundle::Bundle;
use trust::identity::SecretKeys;
use trust::locked::{Cost, LockedKeys};
use trust::name::Name;
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
    /// Runs the verb.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let keyring = keys.keyring()?;
        let mut entropy = random()?;
        let root = SecretKeys::generate(&mut entropy);
        let passphrase = passphrase(keys.passphrase.as_deref(), Asked::New)?;
        let locked = LockedKeys::lock(&root, &passphrase, Cost::STANDARD, &mut entropy)?;
        let bundle = Bundle::new(Team::found(self.name.clone(), &root));
        keyring.begin(&locked, &bundle)?;
        console::say(&super::listed(&bundle, now()));
        console::note(
            "Keep a copy of the folder with the keys, and the passphrase, where they cannot be lost together.",
        );
        Ok(())
    }
}

impl Key {
    /// Runs the verb.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let keyring = keys.keyring()?;
        let own = match keyring.own()? {
            Some(own) => own,
            None => {
                let mut entropy = random()?;
                let passphrase = passphrase(keys.passphrase.as_deref(), Asked::New)?;
                let made = SecretKeys::generate(&mut entropy);
                let locked = LockedKeys::lock(&made, &passphrase, Cost::STANDARD, &mut entropy)?;
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
