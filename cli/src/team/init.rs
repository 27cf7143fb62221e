//! `dca team init`, `key`: new keys.

use super::{KeysArgs, now, random};
use crate::io::keyring::Asked;
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
        let (root, locked) = new_keys(keys)?;
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
                let (_, locked) = new_keys(keys)?;
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

/// Makes keys, open and behind a new passphrase.
fn new_keys(keys: &KeysArgs) -> anyhow::Result<(SecretKeys, LockedKeys)> {
    let mut entropy = random()?;
    let made = SecretKeys::generate(&mut entropy);
    let locked = LockedKeys::lock(&made, &keys.passphrase(Asked::New)?, Cost::STANDARD, &mut entropy)?;
    Ok((made, locked))
}
