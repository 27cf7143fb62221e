//! What a node lets others start on it: a file of its own, which nobody can change from afar.
//!
//! ```toml
//! folders = ["/opt/robot/bin"]        # programs below these, or
//! hashes = []                         # programs with these BLAKE3 hashes
//! signers = ["deployer", "ci"]        # roles whose deployments run here
//! users = ["dca-run"]                 # as whom programs may run
//! root = false
//! devices = ["/dev/ttyUSB0"]
//! realtime = 49                       # the highest real-time priority
//! memory = 2147483648                 # bytes a program
//! network = "loopback"                # none, loopback or any
//! secrets = ["team/camera/"]          # paths that programs may be given
//! ```
//!
//! A policy of the team can only take away what the file of the node allows. All reasons of a refusal are said at once.

use crate::role::Role;
use serde::Deserialize;
use std::path::{Component, Path, PathBuf};
use thiserror::Error;

/// The most bytes of the file.
pub const POLICY_MAX: usize = 256 << 10;
/// The most entries of a list.
pub const ENTRIES_MAX: usize = 1024;
/// The highest real-time priority that a program may have: that of the node's own threads is 50.
pub const REALTIME_MAX: u8 = 49;

/// How far a program may talk.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Network {
    /// Not at all.
    None,
    /// Within its machine.
    Loopback,
    /// With anybody.
    Any,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    folders: Vec<PathBuf>,
    #[serde(default)]
    hashes: Vec<String>,
    signers: Vec<String>,
    #[serde(default)]
    users: Vec<String>,
    #[serde(default)]
    root: bool,
    #[serde(default)]
    devices: Vec<PathBuf>,
    #[serde(default)]
    realtime: u8,
    memory: Option<u64>,
    #[serde(default = "loopback")]
    network: Network,
    #[serde(default)]
    secrets: Vec<String>,
}

const fn loopback() -> Network {
    Network::Loopback
}

/// A policy that was read and checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Policy {
    folders: Vec<PathBuf>,
    hashes: Vec<[u8; 32]>,
    signers: Vec<Role>,
    users: Vec<String>,
    root: bool,
    devices: Vec<PathBuf>,
    realtime: u8,
    memory: Option<u64>,
    network: Network,
    secrets: Vec<String>,
}

/// What is to be started.
#[derive(Clone, Copy, Debug)]
pub struct Start<'a> {
    /// The program, without links: the caller has resolved them.
    pub program: &'a Path,
    /// Its BLAKE3 hash.
    pub hash: [u8; 32],
    /// The role of who has signed for it.
    pub signer: Role,
    /// As whom it is to run.
    pub user: &'a str,
    /// Its devices.
    pub devices: &'a [PathBuf],
    /// Its real-time priority; 0 for none.
    pub realtime: u8,
    /// Its limit of memory, in bytes; none for no limit.
    pub memory: Option<u64>,
    /// How far it has to talk.
    pub network: Network,
    /// The paths of the secrets it is to be given.
    pub secrets: &'a [String],
}

/// Why a program is not started.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum Denied {
    /// It is in no folder that is allowed, and its hash is not listed.
    #[error("`{0}` is in no folder that this node allows, and its hash is not listed")]
    Program(PathBuf),
    /// Its signer has a role that is not allowed.
    #[error("this node runs nothing that {0} has signed")]
    Signer(Role),
    /// It would run as somebody who is not listed.
    #[error("this node runs no program as `{0}`")]
    User(String),
    /// It would run as root.
    #[error("this node runs no program as root")]
    Root,
    /// It would use a device that is not listed.
    #[error("this node gives no program the device `{0}`")]
    Device(PathBuf),
    /// Its priority is too high.
    #[error("real-time priority {found} is above {limit}")]
    Realtime {
        /// What was asked for.
        found: u8,
        /// The highest.
        limit: u8,
    },
    /// It has no limit of memory, or one that is too high.
    #[error("a program needs a limit of memory of at most {0} bytes")]
    Memory(u64),
    /// It would talk too far.
    #[error("this node lets no program talk so far")]
    Network,
    /// It would be given a secret that is not listed.
    #[error("this node gives no program the secret `{0}`")]
    Secret(String),
}

/// A policy cannot be used. A node without a valid one starts nothing.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum PolicyError {
    /// It is no TOML, or has a field that does not belong there.
    #[error("the policy cannot be read: {0}")]
    Toml(String),
    /// The file is too long.
    #[error("a policy has at most {POLICY_MAX} bytes, and {ENTRIES_MAX} entries in a list")]
    TooLong,
    /// A value is not allowed.
    #[error("`{0}` is not allowed in the field `{1}` of a policy")]
    Value(String, &'static str),
}

impl Policy {
    /// Reads a policy.
    ///
    /// # Errors
    /// It is no policy. Nothing is guessed.
    pub fn parse(text: &str) -> Result<Self, PolicyError> {
        if text.len() > POLICY_MAX {
            return Err(PolicyError::TooLong);
        }
        let file: File = toml::from_str(text).map_err(|error| PolicyError::Toml(error.message().to_owned()))?;
        let lengths = [file.folders.len(), file.hashes.len(), file.signers.len(), file.users.len()];
        if lengths.into_iter().chain([file.devices.len(), file.secrets.len()]).any(|length| length > ENTRIES_MAX) {
            return Err(PolicyError::TooLong);
        }
        if file.realtime > REALTIME_MAX {
            return Err(PolicyError::Value(file.realtime.to_string(), "realtime"));
        }
        plain_paths(&file.folders, "folders")?;
        plain_paths(&file.devices, "devices")?;
        let hash = |text: &String| hash(text).ok_or_else(|| PolicyError::Value(text.clone(), "hashes"));
        let signer = |text: &String| text.parse().map_err(|_unknown| PolicyError::Value(text.clone(), "signers"));
        Ok(Self {
            hashes: file.hashes.iter().map(hash).collect::<Result<_, _>>()?,
            signers: file.signers.iter().map(signer).collect::<Result<_, _>>()?,
            folders: file.folders,
            users: file.users,
            root: file.root,
            devices: file.devices,
            realtime: file.realtime,
            memory: file.memory,
            network: file.network,
            secrets: file.secrets,
        })
    }

    /// Returns every reason against starting a program; none if it may be started.
    #[must_use]
    pub fn denials(&self, start: &Start<'_>) -> Vec<Denied> {
        let mut denied = Vec::new();
        let is_below = |folder: &PathBuf| start.program.starts_with(folder) && start.program != folder.as_path();
        let is_in_folder = is_plain(start.program) && self.folders.iter().any(is_below);
        if !is_in_folder && !self.hashes.contains(&start.hash) {
            denied.push(Denied::Program(start.program.to_owned()));
        }
        if !self.signers.contains(&start.signer) {
            denied.push(Denied::Signer(start.signer));
        }
        if start.user == "root" || start.user == "0" {
            denied.extend((!self.root).then_some(Denied::Root));
        } else if !self.users.iter().any(|user| user == start.user) {
            denied.push(Denied::User(start.user.to_owned()));
        }
        let devices = start.devices.iter().filter(|device| !self.devices.contains(device));
        denied.extend(devices.map(|device| Denied::Device(device.clone())));
        if start.realtime > self.realtime {
            denied.push(Denied::Realtime { found: start.realtime, limit: self.realtime });
        }
        if let Some(limit) = self.memory
            && start.memory.is_none_or(|memory| memory > limit)
        {
            denied.push(Denied::Memory(limit));
        }
        if start.network > self.network {
            denied.push(Denied::Network);
        }
        let secrets = start.secrets.iter().filter(|path| !self.gives(path));
        denied.extend(secrets.map(|path| Denied::Secret(path.clone())));
        denied
    }

    /// A listed path that ends in `/` stands for all below it.
    fn gives(&self, path: &str) -> bool {
        self.secrets.iter().any(|listed| if listed.ends_with('/') { path.starts_with(listed) } else { path == listed })
    }
}

/// Returns every reason against starting a program: those of the node's own policy, and those of the team's, if it has one.
#[must_use]
pub fn denials(local: &Policy, team: Option<&Policy>, start: &Start<'_>) -> Vec<Denied> {
    let mut denied = local.denials(start);
    for reason in team.into_iter().flat_map(|policy| policy.denials(start)) {
        if !denied.contains(&reason) {
            denied.push(reason);
        }
    }
    denied
}

fn plain_paths(paths: &[PathBuf], field: &'static str) -> Result<(), PolicyError> {
    let wrong = paths.iter().find(|path| !is_plain(path));
    wrong.map_or(Ok(()), |path| Err(PolicyError::Value(path.display().to_string(), field)))
}

/// Returns whether a path begins at the root and does not go back.
fn is_plain(path: &Path) -> bool {
    path.is_absolute() && path.components().all(|part| matches!(part, Component::RootDir | Component::Normal(_)))
}

fn hash(text: &str) -> Option<[u8; 32]> {
    let digits = text.strip_prefix("blake3:").unwrap_or(text);
    blake3::Hash::from_hex(digits).ok().map(|hash| *hash.as_bytes())
}
