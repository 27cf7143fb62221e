//! `dca team invite` and `dca team join`: add a robot to a team.
//!
//! While `invite` waits, it listens on the network. No other part of a team listens for a node that is not in a team yet.

use super::{KeysArgs, now, random};
use crate::io::keyring::Asked;
use anyhow::{Context as _, anyhow, ensure};
use comms::io::{clock, entropy, session};
use comms::logic::key::HostName;
use dbmanager::logic::view::date;
use node::console::{self, Failure, block_on};
use node::io::state_dir;
use qrcode::render::unicode::Dense1x2;
use qrcode::{EcLevel, QrCode};
use std::io::IsTerminal as _;
use std::net::{IpAddr, SocketAddr};
use std::path::PathBuf;
use std::time::Duration;
use team::folder::Reserve;
use team::join::{self, Event};
use team::member::{BEGIN_SIZE_MAX, Member};
use tokio::net::TcpListener;
use tokio::sync::mpsc;
use tokio::task::JoinSet;
use trust::bundle::Bundle;
use trust::certificate::Certificate;
use trust::identity::SecretKeys;
use trust::invite::{ADDRESSES_MAX, Invite, Inviter, OpenInvite};
use trust::name::{Name, UnixTime};
use trust::role::Role;
use trust::team::Team;
use zeroize::Zeroizing;

/// The most refusals that are reported.
const TOLD_MAX: usize = 20;

/// The arguments of `dca team invite`.
#[derive(Debug, clap::Args)]
pub(super) struct InviteArgs {
    /// The name of the robot, as `dca-node --name` has it there
    #[arg(value_parser = HostName::parse)]
    name: HostName,
    /// The robot may renew the certificates of other nodes, so that the team keeps working while this machine is off
    #[arg(long)]
    renewer: bool,
    #[command(flatten)]
    door: DoorArgs,
}

/// The address for the robot, and how long to wait for it.
#[derive(Debug, clap::Args)]
pub(super) struct DoorArgs {
    /// For how many minutes the invitation is valid and this command waits
    #[arg(long, value_name = "MINUTES", default_value_t = 15, value_parser = clap::value_parser!(u64).range(1..=24 * 60))]
    minutes: u64,
    /// The address of this machine that the robot calls; may be given four times [default: the
    /// addresses of its network interfaces]
    #[arg(long = "address", value_name = "IP")]
    addresses: Vec<IpAddr>,
    /// The TCP port for the connection of the robot [default: any free port]
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    port: u16,
}

/// The arguments of `dca team join`.
#[derive(Debug, clap::Args)]
pub(super) struct JoinArgs {
    /// The line that `dca team invite` has printed [default: the first line of standard input]
    line: Option<String>,
    /// Folder for the state of this machine's nodes, as `dca-node --state` has it
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
}

impl InviteArgs {
    /// Runs the verb.
    pub(super) fn run(&self, keys: &KeysArgs) -> Result<(), Failure> {
        let (keyring, bundle) = keys.bundle()?;
        let name: Name = self.name.as_str().parse()?;
        ensure_free(&bundle, &name)?;
        let root = keyring.root(&bundle)?.unlock(&keys.passphrase(Asked::Known)?)?;
        let (of_team, robot) = (bundle.team().name().clone(), name.clone());
        let add = move |certificate: &Certificate| {
            let add = |bundle: &mut Bundle| {
                ensure_free(bundle, &robot)?;
                Ok(bundle.add(certificate.clone())?)
            };
            keyring.change(&of_team, add).map(drop)
        };
        let role = if self.renewer { Role::Renewer } else { Role::Member };
        block_on(self.door.wait(&name, role, &bundle, root, add))
    }
}

impl DoorArgs {
    /// Waits for one robot, which gets a certificate with this name and role. `keep` writes the certificate to the disk
    /// before the robot may join.
    pub(super) async fn wait(
        &self,
        name: &Name,
        role: Role,
        bundle: &Bundle,
        root: SecretKeys,
        keep: impl Fn(&Certificate) -> anyhow::Result<()> + Send + Sync + 'static,
    ) -> Result<(), Failure> {
        let listeners = self.listen().await?;
        let addresses = listeners.iter().map(TcpListener::local_addr).collect::<Result<Vec<_>, _>>()?;
        let expires = now().plus(self.minutes * 60);
        let secret = Zeroizing::new(entropy::bytes().context("cannot get random bytes from the system")?);
        let team = bundle.team().clone();
        let founds = !bundle.has_nodes();
        let invite = Invite { team: team.id(), secret, expires, addresses: addresses.clone(), founds };
        let mut inviter = Inviter::new(team.clone(), root, None);
        inviter.open(invite.hash(), OpenInvite { expires, role, name: Some(name.clone()) }, now())?;
        console::say(&format!("dca team join {}", *invite.to_line()));
        if let Some(code) = code(&invite) {
            console::note(&code);
        }
        console::note(&waits(&addresses, expires));
        let (events_tx, mut events) = mpsc::channel(64);
        let mut tasks = JoinSet::new();
        tasks.spawn(join::invite(listeners, inviter, keep, events_tx));
        let ends = clock::now() + Duration::from_secs(self.minutes * 60);
        let mut refused = 0;
        loop {
            let event = tokio::select! {
                event = events.recv() => event,
                () = clock::sleep_until(ends) => None,
            };
            match event {
                Some(Event::Joined(certificate)) => {
                    console::say(&joined(&team, &certificate));
                    return Ok(());
                }
                Some(Event::Refused(from, why)) => {
                    refused += 1;
                    if refused <= TOLD_MAX {
                        console::note(&format!("refused {from}: {why}"));
                    }
                }
                Some(Event::Failed(why)) => {
                    return Err(anyhow!(
                        "{why}; no host has joined, and the invitation is spent: invite `{name}` again"
                    )
                    .into());
                }
                None => return Err(anyhow!("no host has come in time; the invitation has ended").into()),
            }
        }
    }

    async fn listen(&self) -> anyhow::Result<Vec<TcpListener>> {
        let addresses = if self.addresses.is_empty() { session::addresses() } else { self.addresses.clone() };
        ensure!(!addresses.is_empty(), "this machine has no network; name an address with `--address`");
        let mut listeners = Vec::new();
        for address in addresses.into_iter().take(ADDRESSES_MAX) {
            let listener = TcpListener::bind((address, self.port)).await;
            listeners.push(listener.with_context(|| format!("listening on {address}, port {}", self.port))?);
        }
        Ok(listeners)
    }
}

impl JoinArgs {
    /// Runs the verb.
    pub(super) fn run(&self) -> Result<(), Failure> {
        let line = match &self.line {
            Some(line) => Zeroizing::new(line.clone()),
            None => crate::io::keyring::first_line(&mut std::io::stdin().lock())?,
        };
        // The user may have copied the line together with the command.
        let line = Zeroizing::new(line.trim().trim_start_matches("dca team join ").to_owned());
        let base = self.state.clone().or_else(state_dir::default_base);
        let base = base.context("there is no folder to keep the keys in; choose one with `--state`")?;
        let founds = Invite::from_line(&line).is_ok_and(|invite| invite.founds);
        // An invitation can be used only once. So space on the disk is reserved for the files that are written then.
        let reserve = Reserve::take(&std::path::absolute(&base)?, BEGIN_SIZE_MAX)?;
        let made = SecretKeys::generate(&mut random()?);
        let wanted: Name = "robot".parse()?;
        let (keys, team, credential) = block_on(async { Ok(join::join(&line, wanted, made).await?) })?;
        let certificate = credential.certificate();
        let name = &certificate.claims().name;
        let spent = || {
            format!(
                "the invitation is spent; on the operator's machine: `dca team revoke {name}`, then invite it again"
            )
        };
        let state = state_dir::take(Some(&base), name.as_str()).with_context(spent)?;
        if Member::is_there(&state) {
            console::note(&format!("`{name}` was in a team before, and leaves that team"));
        }
        drop(reserve);
        Member::begin(&state, &keys, &team, founds, &credential).with_context(spent)?;
        console::say(&joined(&team, certificate));
        console::note(&format!(
            "Now start `dca-node --name {name}`, or start it again: it accepts connections from its team only."
        ));
        if founds {
            console::note(&format!("`{name}` is the first of the team: its node begins the team's database."));
        }
        Ok(())
    }
}

fn ensure_free(bundle: &Bundle, name: &Name) -> anyhow::Result<()> {
    let is_taken = bundle.named(name).any(|known| !bundle.has_revoked(&known.subject()));
    ensure!(
        !is_taken,
        "the team already has a member `{name}`; revoke it with `dca team revoke {name}` before another takes its place"
    );
    Ok(())
}

/// Returns the lines that both ends print. Two people compare the words in them.
fn joined(team: &Team, certificate: &Certificate) -> String {
    let (name, words) = (&certificate.claims().name, certificate.subject().fingerprint());
    format!("{name} is in team {} ({}); key: {words}", team.name(), team.id().fingerprint())
}

/// Returns the line as a QR code for a person at a terminal; nothing for other output.
fn code(invite: &Invite) -> Option<String> {
    let code = QrCode::with_error_correction_level(invite.to_line().as_bytes(), EcLevel::L).ok()?;
    let drawn = || code.render::<Dense1x2>().dark_color(Dense1x2::Dark).light_color(Dense1x2::Light).build();
    std::io::stderr().is_terminal().then(drawn)
}

fn waits(addresses: &[SocketAddr], expires: UnixTime) -> String {
    let places: Vec<String> = addresses.iter().map(ToString::to_string).collect();
    format!("waiting until {} on {}; Ctrl-C ends it", date::text(expires.0.saturating_mul(1000)), places.join(", "))
}
