//! `dca team renew`: makes a node with the right to renew prolong the user's certificate.

use super::{KeysArgs, now};
use crate::client::{ANSWER_WITHIN, Client};
use crate::io::keyring::Asked;
use anyhow::{Context as _, anyhow};
use dbmanager::logic::view::date;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{Answer, Request};
use trust::bundle::Bundle;
use trust::renewal;
use trust::team::{Credential, Judge, OFFLINE_GRACE};

/// The arguments of `dca team renew`.
#[derive(Debug, clap::Args)]
pub(super) struct RenewArgs {}

impl RenewArgs {
    /// Runs the verb.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let (keyring, bundle) = keys.bundle()?;
        let locked = keyring.own()?.context("you have no key: `dca team key` makes one")?;
        let own = keyring.credential(&bundle, &locked.public().id()).with_context(|| {
            format!(
                "your key has no certificate in the team `{}`; `dca team key` prints the line for it",
                bundle.team().name()
            )
        })?;
        let user = locked.unlock(&keys.passphrase(Asked::Known)?)?;
        let request = Request::RenewUser { ask: renewal::ask(&own, &user, now()) };
        let (renewed, by) = block_on(renewed(keys, &bundle, &own, &request))?;
        keyring.keep_renewed(bundle.team().name(), &renewed)?;
        let until = with_judge(&bundle, |judge| renewal::end(&renewed, judge));
        let (name, until) = (&own.certificate().claims().name, date::text(until.0.saturating_mul(1000)));
        console::say(&format!("{name} is valid until {until}, renewed by `{by}`"));
        Ok(())
    }
}

fn with_judge<T>(bundle: &Bundle, work: impl FnOnce(&Judge<'_>) -> T) -> T {
    work(&Judge { team: bundle.team(), revoked: bundle.revocations(), now: now(), grace: OFFLINE_GRACE })
}

/// Asks one node after the other. Returns the first good answer, and the node that gave it.
async fn renewed(
    keys: &KeysArgs,
    bundle: &Bundle,
    own: &Credential,
    request: &Request,
) -> Result<(Credential, String), Failure> {
    let client = Client::here(keys.run_dir.as_deref()).await?;
    let mut refusals = Vec::new();
    let mut found = None;
    for host in client.all().await? {
        let why = match client.ask(&host, request, ANSWER_WITHIN).await {
            Ok(Answer::Credentials(renewed)) => match taken(bundle, own, &renewed) {
                Ok(renewed) => {
                    found = Some((renewed, host));
                    break;
                }
                Err(why) => format!("{why:#}"),
            },
            Ok(Answer::Refused(why)) => why,
            Ok(_) => "it sent an unexpected answer".to_owned(),
            Err(failure) => crate::client::words(&failure),
        };
        refusals.push(format!("`{host}`: {why}"));
    }
    client.close().await;
    let none = || {
        anyhow!(
            "the certificate was not renewed: {}; `dca team invite NAME --renewer` makes a node that may renew certificates",
            if refusals.is_empty() { "no node answers".to_owned() } else { refusals.join("; ") }
        )
    };
    found.ok_or_else(|| none().into())
}

fn taken(bundle: &Bundle, own: &Credential, renewed: &[Vec<u8>]) -> anyhow::Result<Credential> {
    let [renewed] = renewed else { return Err(anyhow!("its answer has no credential")) };
    let renewed = Credential::from_bytes(renewed)?;
    with_judge(bundle, |judge| renewal::accept(own, &renewed, judge))?;
    Ok(renewed)
}
