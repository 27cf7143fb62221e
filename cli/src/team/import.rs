//! `dca team import`: adds certificates and revocations of a team that come from the operator's machine.

use super::KeysArgs;
use crate::io::named_file;
use anyhow::{Context as _, anyhow};
use node::console::{self, Failure};
use std::io::Read as _;
use std::path::PathBuf;
use trust::bundle::{BUNDLE_MAX, Bundle};

/// The arguments of `dca team import`.
#[derive(Debug, clap::Args)]
pub(super) struct ImportArgs {
    /// The file with the output of `dca team export` [default: standard input]
    file: Option<PathBuf>,
}

impl ImportArgs {
    /// Runs the verb.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let (bytes, from) = match &self.file {
            Some(path) => {
                let from = format!("`{}`", path.display());
                (named_file::bytes(path, BUNDLE_MAX).with_context(|| format!("reading {from}"))?, from)
            }
            None => {
                let mut bytes = Vec::new();
                let read = std::io::stdin().lock().take(BUNDLE_MAX as u64 + 1).read_to_end(&mut bytes);
                read.context("reading standard input")?;
                (bytes, "standard input".to_owned())
            }
        };
        let text = String::from_utf8(bytes).map_err(|_no_text| anyhow!("{from} is not text"))?;
        let bundle = Bundle::from_text(&text).with_context(|| format!("reading {from}"))?;
        let keyring = keys.keyring()?;
        let is_new = keyring.import(&bundle)?;
        let team = bundle.team();
        let (name, words) = (team.name(), team.id().fingerprint());
        console::say(&format!("team {name}: {words}"));
        if is_new {
            console::note("Compare the six words with the operator's: `dca team` prints them there.");
        }
        let own = keyring.own()?.and_then(|own| bundle.credential_of(&own.public().id()));
        console::note(&match own {
            Some(own) => {
                let claims = own.certificate().claims();
                format!("you are `{}`, {}", claims.name, claims.role)
            }
            None => {
                "your key has no certificate in it; `dca team key` prints the line for `dca team user add`".to_owned()
            }
        });
        Ok(())
    }
}
