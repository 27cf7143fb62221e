//! Signs a user's requests to nodes in a team, with the user's key. A passphrase is asked for once per command.

use super::{ANSWER_WITHIN, Answers, Client, unasked};
use crate::io::keyring::{Asked, Keyring, passphrase};
use anyhow::{Context as _, anyhow};
use comms::logic::codec;
use node::console::Failure;
use node::logic::gate;
use node::logic::protocol::{Answer, Deployment, Request, Signed, TeamOfNode};
use std::io::IsTerminal as _;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};
use trust::bundle::Bundle;
use trust::identity::{KeyId, SecretKeys};
use trust::name::Name;
use trust::request::{self, INTERACTIVE_MAX};
use trust::team::Credential;

/// Where the key of the user is.
#[derive(Clone, Debug, Default)]
pub(crate) struct KeyPlace {
    pub(crate) folder: Option<PathBuf>,
    pub(crate) passphrase: Option<PathBuf>,
}

/// A command's knowledge of its user, and of the teams of nodes.
#[derive(Debug, Default)]
pub(crate) struct Signing {
    place: KeyPlace,
    state: Mutex<State>,
}

#[derive(Debug, Default)]
struct State {
    teams: Vec<(String, Option<TeamOfNode>)>,
    signer: Option<Arc<Signer>>,
}

/// A user with an unlocked key.
#[derive(Debug)]
struct Signer {
    team: KeyId,
    keyring: Keyring,
    keys: SecretKeys,
    credential: Credential,
}

impl Signing {
    pub(crate) fn of(place: KeyPlace) -> Self {
        Self { place, state: Mutex::default() }
    }

    fn team(&self, host: &str) -> Option<Option<TeamOfNode>> {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.teams.iter().find(|(known, _)| known == host).map(|(_, team)| team.clone())
    }

    fn note(&self, host: &str, team: Option<TeamOfNode>) {
        self.state.lock().unwrap_or_else(PoisonError::into_inner).teams.push((host.to_owned(), team));
    }

    fn is_unlocked(&self, team: &TeamOfNode) -> bool {
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        self.place.passphrase.is_some() || state.signer.as_ref().is_some_and(|signer| signer.team == KeyId(team.id))
    }

    /// Returns the user; the first call unlocks the key.
    fn signer(&self, team: &TeamOfNode) -> anyhow::Result<Arc<Signer>> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(signer) = state.signer.as_ref().filter(|signer| signer.team == KeyId(team.id)) {
            return Ok(Arc::clone(signer));
        }
        let signer = Arc::new(Signer::open(&self.place, team)?);
        state.signer = Some(Arc::clone(&signer));
        Ok(signer)
    }
}

impl Signer {
    fn open(place: &KeyPlace, team: &TeamOfNode) -> anyhow::Result<Self> {
        let name = &team.name;
        let keyring = Keyring::at(place.folder.as_deref())?;
        let locked = keyring.own()?.with_context(|| {
            format!(
                "the team `{name}` accepts only signed requests, and you have no key: `dca team key` makes a key, and prints the line for \
                 `dca team user add` on the operator's machine"
            )
        })?;
        let (own, bundle) = (locked.public().id(), bundle(&keyring, KeyId(team.id))?);
        let bundle = bundle.with_context(|| {
            format!(
                "this machine does not know the members of the team `{name}`: ask the operator to run `dca team export`, and give its \
                 output to `dca team import` here"
            )
        })?;
        let credential = keyring.credential(&bundle, &own).with_context(|| {
            format!(
                "your key has no certificate in the team `{name}`: on the operator's machine `dca team user add NAME --role \
                 deployer --key {}`, then `dca team export` for `dca team import` here",
                locked.public().to_text()
            )
        })?;
        if place.passphrase.is_none() && !std::io::stdin().is_terminal() {
            return Err(anyhow!(
                "the team `{name}` accepts only signed requests, and your key needs a passphrase: give the passphrase with `--passphrase \
                 FILE`, or at a terminal"
            ));
        }
        let keys = locked.unlock(&passphrase(place.passphrase.as_deref(), Asked::Known)?)?;
        Ok(Self { team: KeyId(team.id), keyring, keys, credential })
    }

    /// Signs a request for a host.
    fn sign(&self, host: &str, team: &TeamOfNode, asked: &Request, epoch: u64) -> anyhow::Result<Request> {
        let action = gate::action(asked).context("this request needs no signature")?;
        let node: &Name = &team.node.parse().with_context(|| format!("the node `{host}` has no name"))?;
        let audience = gate::audience(asked, node.as_str())?;
        let now = ::team::now();
        let request = request::Request {
            team: self.team,
            audience,
            action,
            id: ::team::random()?.bytes(),
            sequence: self.keyring.next_number(now)?,
            epoch,
            not_before: now,
            not_after: now.plus(INTERACTIVE_MAX),
        };
        let body = codec::encode(asked)?;
        let head = request.sign(&body, &self.keys, &self.credential);
        Ok(Request::Signed(Box::new(Signed { head, body })))
    }
}

/// Returns the team with this key, if this machine knows it.
pub(crate) fn bundle(keyring: &Keyring, team: KeyId) -> anyhow::Result<Option<Bundle>> {
    for name in keyring.teams()? {
        let bundle = keyring.team(&name)?;
        if bundle.team().id() == team {
            return Ok(Some(bundle));
        }
    }
    Ok(None)
}

impl Client {
    /// Asks a node to start, stop or change something. If the node is in a team, the user signs the
    /// request. `epoch` is the epoch of the intended deployment; 0 means any epoch.
    pub(crate) async fn order_on(&self, host: &str, request: Request, epoch: u64) -> Result<Answers, Failure> {
        let request = self.signed(host, request, epoch).await?;
        self.ask_on(host, &request)
    }

    /// Asks the home of a deployment to stop it. `which` is the exact deployment, if it is known.
    pub(crate) async fn stop_on(&self, host: &str, name: &str, which: Option<&Deployment>) -> Result<Answers, Failure> {
        let epoch = which.map_or(0, |deployment| deployment.epoch);
        self.order_on(host, Request::Stop { name: name.to_owned() }, epoch).await
    }

    /// Returns the team of a node; nothing if the node is in no team.
    pub(crate) async fn team_of(&self, host: &str) -> Result<Option<TeamOfNode>, Failure> {
        if let Some(team) = self.signing.team(host) {
            return Ok(team);
        }
        let answer = self.ask(host, &Request::Team, ANSWER_WITHIN).await?;
        let Answer::Team(team) = answer else { return Err(unasked(host, &answer)) };
        self.signing.note(host, team.clone());
        Ok(team)
    }

    /// Uses the unlocked key of another connection of this command.
    pub(crate) fn take_keys(&self, other: &Self) {
        let signer = other.signing.state.lock().unwrap_or_else(PoisonError::into_inner).signer.clone();
        if signer.is_some() {
            self.signing.state.lock().unwrap_or_else(PoisonError::into_inner).signer = signer;
        }
    }

    /// Returns whether a request that has to be signed for this node would ask for the passphrase at the terminal.
    pub(crate) async fn asks_for_passphrase(&self, host: &str) -> Result<bool, Failure> {
        let team = self.team_of(host).await?;
        Ok(team.is_some_and(|team| !self.signing.is_unlocked(&team)))
    }

    /// Unlocks the key of the user, so that requests to this node can be signed.
    pub(crate) async fn unlock(&self, host: &str) -> Result<(), Failure> {
        if let Some(team) = self.team_of(host).await? {
            self.signing.signer(&team)?;
        }
        Ok(())
    }

    /// Returns the request, with a signature if the node requires one.
    pub(crate) async fn signed(&self, host: &str, request: Request, epoch: u64) -> Result<Request, Failure> {
        if gate::action(&request).is_none() {
            return Ok(request);
        }
        let Some(team) = self.team_of(host).await? else { return Ok(request) };
        let signer = self.signing.signer(&team)?;
        Ok(signer.sign(host, &team, &request, epoch)?)
    }
}
