//! `dca team`: manages the team's key, its robots and its users, on the operator's machine.

mod import;
mod init;
mod invite;
mod renew;
mod revoke;
mod rotate;
mod user;

use crate::io::keyring::{Asked, Keyring, passphrase};
use ::team::{now, random};
use clap::{Args, Subcommand};
use dbmanager::logic::view::{date, table};
use node::console::{self, Failure};
use node::logic::protocol::{Answer, Request};
use serde_json::{Value, json};
use std::path::PathBuf;
use std::time::Duration;
use trust::bundle::{Bundle, Holder};
use trust::name::{Name, UnixTime};
use trust::renewal;
use trust::team::{Credential, Judge, OFFLINE_GRACE, Standing, TrustError};
use zeroize::Zeroizing;

/// How long the node of this machine may take to list the renewed certificates.
const SOON: Duration = Duration::from_secs(2);

/// The arguments of `dca team`.
#[derive(Debug, Args)]
pub struct Arguments {
    #[command(subcommand)]
    verb: Option<Verb>,
    #[command(flatten)]
    keys: KeysArgs,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Begin a team: make its key, which stays on this machine behind a passphrase
    Init(init::Init),
    /// Show your own key, which is made the first time; hand the line to the operator
    Key(init::Key),
    /// Add and remove users
    User(user::UserArgs),
    /// Invite a robot: prints the line with which it joins, and waits for it
    Invite(invite::InviteArgs),
    /// Take this machine into the team of an invitation
    Join(invite::JoinArgs),
    /// Revoke the keys of a robot or a user permanently
    Revoke(revoke::RevokeArgs),
    /// Give a robot or a user new keys under the same name, and revoke the old ones
    Rotate(rotate::RotateArgs),
    /// Have a node that may renew prolong your own certificate, without the operator
    Renew(renew::RenewArgs),
    /// Print the public part of the team: its certificates and revocations
    Export,
    /// Import the output of `dca team export` from elsewhere: this brings your own certificate to this machine
    Import(import::ImportArgs),
}

/// The options for finding the keys.
#[derive(Clone, Debug, Args)]
struct KeysArgs {
    /// The folder with the keys [default: $XDG_CONFIG_HOME/dca or ~/.config/dca]
    #[arg(id = "key_folder", long = "keys", value_name = "DIR", global = true)]
    keys: Option<PathBuf>,
    /// The team, if there are several teams
    #[arg(long, value_name = "NAME", global = true)]
    team: Option<Name>,
    /// A file of mode 0600 whose first line is the passphrase [env: DCA_PASSPHRASE_FILE] [default: standard input]
    #[arg(id = "key_passphrase", long = "passphrase", value_name = "FILE", global = true)]
    passphrase: Option<PathBuf>,
    /// Folder with the sockets of this machine's nodes, which get the revocations
    #[arg(long, value_name = "DIR", global = true)]
    run_dir: Option<PathBuf>,
}

impl KeysArgs {
    fn keyring(&self) -> anyhow::Result<Keyring> {
        Keyring::at(self.keys.as_deref())
    }

    fn passphrase(&self, asked: Asked) -> anyhow::Result<Zeroizing<String>> {
        passphrase(self.passphrase.as_deref(), asked)
    }

    fn bundle(&self) -> anyhow::Result<(Keyring, Bundle)> {
        let keyring = self.keyring()?;
        let bundle = keyring.team(&keyring.only(self.team.clone())?)?;
        Ok((keyring, bundle))
    }
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    let keys = &arguments.keys;
    match &arguments.verb {
        None => list(keys),
        Some(Verb::Init(init)) => init.run(keys),
        Some(Verb::Key(key)) => key.run(keys),
        Some(Verb::User(user)) => user.run(keys),
        Some(Verb::Invite(invite)) => invite.run(keys),
        Some(Verb::Join(join)) => join.run(),
        Some(Verb::Revoke(revoke)) => revoke.run(keys),
        Some(Verb::Import(import)) => import.run(keys),
        Some(Verb::Renew(renew)) => renew.run(keys),
        Some(Verb::Rotate(rotate)) => rotate.run(keys),
        Some(Verb::Export) => {
            console::say(&keys.bundle()?.1.to_text());
            Ok(())
        }
    }
}

fn list(keys: &KeysArgs) -> Result<(), Failure> {
    let (keyring, bundle) = keys.bundle()?;
    let bundle = revoke::look(keys, bundle);
    let own = keyring.own()?.and_then(|own| keyring.credential(&bundle, &own.public().id()));
    let renewed: Vec<Credential> = own.into_iter().chain(renewed(keys)).collect();
    tell(&bundle, &renewed);
    Ok(())
}

/// Returns the certificates that nodes of the team have shown to the node of this machine. They may have been renewed.
/// Returns nothing if no node runs here.
fn renewed(keys: &KeysArgs) -> Vec<Credential> {
    let asked = revoke::with_node(keys, async |client, host| client.ask(host, &Request::Credentials, SOON).await);
    let Ok(Some(Answer::Credentials(shown))) = asked else { return Vec::new() };
    shown.iter().filter_map(|bytes| Credential::from_bytes(bytes).ok()).collect()
}

/// Prints the content of a team.
fn tell(bundle: &Bundle, renewed: &[Credential]) {
    if !console::is_json() {
        return console::say(&listed(bundle, renewed, now()));
    }
    let (team, now) = (bundle.team(), now());
    let judge = Judge { team, revoked: bundle.revocations(), now, grace: OFFLINE_GRACE };
    let member = |holder: &Holder<'_>| {
        let claims = holder.certificate.claims();
        let (until, state) = standing(holder, newest(renewed, holder, &judge), &judge);
        json!({
            "name": claims.name.to_string(), "role": claims.role.to_string(), "until": until.0,
            "renewable_until": claims.renewable_until.0, "key": holder.certificate.subject().fingerprint(),
            "state": state.trim_start_matches("! "),
        })
    };
    let members: Vec<Value> = bundle.holders(now).iter().map(member).collect();
    console::answer(&json!({
        "team": team.name().to_string(), "id": team.id().to_string(), "fingerprint": team.id().fingerprint(), "members": members,
    }));
}

/// Returns the certificate of a member with the latest end, if the member has renewed it.
fn newest<'a>(renewed: &'a [Credential], holder: &Holder<'_>, judge: &Judge<'_>) -> Option<&'a Credential> {
    let newest = renewed.iter().filter(|credential| credential.certificate() == holder.certificate);
    newest.max_by_key(|credential| renewal::end(credential, judge))
}

/// Describes a team for a person. Members in `renewed` are valid for longer than their certificates in the bundle show.
fn listed(bundle: &Bundle, renewed: &[Credential], now: UnixTime) -> String {
    let team = bundle.team();
    let mut text = format!("team {}: {}\nid {}\n", team.name(), team.id().fingerprint(), team.id());
    text += &(revoke::summary(bundle.revocations(), &team.id()) + "\n");
    let head = ["name", "role", "until", "can be renewed until", "key", ""].map(str::to_owned).to_vec();
    let judge = Judge { team: bundle.team(), revoked: bundle.revocations(), now, grace: OFFLINE_GRACE };
    let row = |holder: &Holder<'_>| row(holder, newest(renewed, holder, &judge), &judge);
    let rows: Vec<Vec<String>> = std::iter::once(head).chain(bundle.holders(now).iter().map(row)).collect();
    if rows.len() == 1 { text + "the team has no certificates\n" } else { text + "\n" + &table::table(&rows) + "\n" }
}

/// Returns when the certificate of a member ends, and what is wrong with it.
fn standing(holder: &Holder<'_>, renewed: Option<&Credential>, judge: &Judge<'_>) -> (UnixTime, &'static str) {
    let claims = holder.certificate.claims();
    let until = renewed.map_or(claims.not_after, |renewed| renewal::end(renewed, judge));
    let grace = renewed.map(|renewed| renewed.check(judge));
    let state = match grace.as_ref().unwrap_or(&holder.standing) {
        Ok(Standing::Valid(_)) if until > claims.not_after => "renewed",
        Ok(Standing::Valid(_)) => "",
        Ok(Standing::Grace(_)) => "! has ended; trusted for a while, until it is renewed",
        Err(TrustError::Revoked(_)) => "! revoked",
        Err(TrustError::Expired(_)) => "! has ended",
        Err(TrustError::NotYet(_)) => "! not valid yet",
        Err(
            TrustError::OtherTeam(_)
            | TrustError::Issuer(_)
            | TrustError::Signature(_)
            | TrustError::Renewal(_)
            | TrustError::Role { .. },
        ) => "! not trusted",
    };
    (until, state)
}

fn row(holder: &Holder<'_>, renewed: Option<&Credential>, judge: &Judge<'_>) -> Vec<String> {
    let claims = holder.certificate.claims();
    let (until, state) = standing(holder, renewed, judge);
    let time = |time: UnixTime| date::text(time.0.saturating_mul(1000));
    vec![
        claims.name.to_string(),
        claims.role.to_string(),
        time(until),
        time(claims.renewable_until),
        holder.certificate.subject().fingerprint(),
        state.to_owned(),
    ]
}
