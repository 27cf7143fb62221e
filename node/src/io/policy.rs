//! The execution policy of this host. The file `/etc/dca/policy.toml` is for all nodes of the
//! machine. If it does not exist, the node uses `policy.toml` in the folder of its state.
//!
//! The file is read again for each start of a program. So a change has effect from the next start on, also for a restarted
//! program. No other setting decides which programs may run here, and another host cannot change it.

mod place;

use crate::io::users::{self, User};
use crate::io::{child, programs};
use crate::logic::effect::SpawnOrder;
use crate::logic::protocol::PolicyInUse;
use anyhow::{Context, anyhow, ensure};
use comms::io::file;
use language::plan::ROS_NODE;
use rustix::fs::{Mode, OFlags};
use rustix::process::getuid;
use shim::protocol::{Judged, JudgedBy, Limits, Sandbox, SandboxLevel, Stamp};
use std::collections::BTreeMap;
use std::fs::{self, File};
use std::io::{self, ErrorKind};
use std::os::fd::AsRawFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;
use team::audit::AuditEntry;
use team::member::Member;
use trust::audit::Decision;
use trust::policy::{self, POLICY_MAX, Policy, Start};

/// The policy of a machine.
pub const SYSTEM: &str = "/etc/dca/policy.toml";
/// The name of a node's policy file, in the folder of the node's state.
pub const FILE: &str = "policy.toml";
/// The most hashes of programs that are kept.
const HASHES_MAX: usize = 256;

/// A policy, and its path.
#[derive(Debug)]
pub struct PolicyFile {
    /// Its path.
    pub path: PathBuf,
    /// Its content.
    pub policy: Policy,
}

/// Returns the policy for a node whose state is in this folder; nothing if no policy exists. Blocks.
///
/// # Errors
/// A policy exists and cannot be used. The reason contains its path and line.
pub fn find(state: Option<&Path>) -> anyhow::Result<Option<PolicyFile>> {
    let places = std::iter::once(PathBuf::from(SYSTEM)).chain(state.map(|state| state.join(FILE)));
    for path in places {
        match fs::symlink_metadata(&path) {
            Err(error) if error.kind() == ErrorKind::NotFound => {}
            // If a file exists but cannot be read, this must not count as a missing file.
            _ => {
                let read = read(&path).with_context(|| format!("the policy `{}` cannot be used", path.display()));
                return read.map(|policy| Some(PolicyFile { path, policy }));
            }
        }
    }
    Ok(None)
}

fn read(path: &Path) -> anyhow::Result<Policy> {
    let file = file::opened(path)?;
    let found = file.metadata()?;
    let (owner, own) = (found.uid(), getuid().as_raw());
    ensure!(owner == 0 || owner == own, "it belongs to user {owner}, not to root or to the user of the node");
    ensure!(found.mode() & 0o022 == 0, "other users may write to it; run `chmod go-w` on it");
    let text = String::from_utf8(file::bounded(file, POLICY_MAX)?).context("it is not UTF-8")?;
    let policy = Policy::parse(&text)?;
    if let (Some(user), Some(line)) = (policy.user(), policy.user_line()) {
        ensure!(users::named(user)?.is_some(), "line {line}: this machine has no user `{user}`");
    }
    Ok(policy)
}

/// The limits and rights with which a program is started.
#[derive(Clone, Debug, Default)]
pub(crate) struct Admitted {
    pub(crate) limits: Limits,
    pub(crate) sandbox: Sandbox,
    /// The variables of its environment that differ from the environment of its node.
    pub(crate) environment: Vec<(String, String)>,
}

/// An executable file that is being examined. The file stays open, so that it is the same file even if its name changes.
struct Looked {
    file: File,
    path: PathBuf,
    stamp: Stamp,
}

impl Looked {
    /// Opens a program. Follows links.
    fn open(program: &Path) -> io::Result<Self> {
        let file = File::from(rustix::fs::open(program, OFlags::PATH | OFlags::CLOEXEC, Mode::empty())?);
        let stamp = Stamp::of(&file.metadata()?);
        let path = fs::read_link(descriptor(&file))?;
        Ok(Self { file, path, stamp })
    }

    /// Opens the same file again, for reading.
    fn read(&self) -> io::Result<File> {
        file::opened(&descriptor(&self.file))
    }
}

/// Returns a path that leads to an open file.
fn descriptor(file: &File) -> PathBuf {
    format!("/proc/self/fd/{}", file.as_raw_fd()).into()
}

/// Decides which programs run on this host.
#[derive(Clone, Debug)]
pub(crate) struct ExecutionPolicy(Arc<Inner>);

#[derive(Debug)]
struct Inner {
    state: Option<PathBuf>,
    /// The member with the audit log, if the node is in a team.
    member: Option<Arc<Member>>,
    hashes: Mutex<BTreeMap<Stamp, [u8; 32]>>,
    /// The policy that was read last.
    in_use: Mutex<Option<PolicyInUse>>,
}

impl ExecutionPolicy {
    /// Reads the policy for the first time.
    ///
    /// # Errors
    /// The policy cannot be used, so the node must not start.
    pub(crate) fn open(state: Option<PathBuf>, member: Option<Arc<Member>>) -> anyhow::Result<Self> {
        let found = find(state.as_deref())?;
        if let Some(PolicyFile { path, .. }) = &found {
            tracing::info!(path = %path.display(), "this node has an execution policy");
        }
        if let Some(user) = found.as_ref().and_then(PolicyFile::could_be_changed_by) {
            tracing::warn!(
                user,
                "the programs that the execution policy governs could change it; keep it in `/etc/dca`, and run them as another user"
            );
        }
        let in_use = Mutex::new(found.as_ref().map(in_use));
        Ok(Self(Arc::new(Inner { state, member, hashes: Mutex::default(), in_use })))
    }

    /// Returns the node as a member of its team, if it is in one.
    pub(crate) fn member(&self) -> Option<&Member> {
        self.0.member.as_deref()
    }

    /// Returns the policy that was used for the last start of a program, or at the start of the node.
    pub(crate) fn in_use(&self) -> Option<PolicyInUse> {
        self.0.in_use.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Returns the limits and rights with which a program is started. Blocks.
    ///
    /// # Errors
    /// The program cannot be started, or the policy does not allow it. The reason contains the rule, the file and the
    /// line, and is also in the audit log.
    pub(crate) fn admit(&self, order: &SpawnOrder) -> anyhow::Result<Admitted> {
        let asked = child::limits(&order.policy.usage);
        let program = child::check_executable(&order.command, &order.environment)?;
        let admitted = self.decide(order, &program, &asked);
        if let Err(error) = &admitted {
            self.refused(order, &format!("{error:#}"));
        }
        admitted
    }

    fn decide(&self, order: &SpawnOrder, program: &Path, asked: &Limits) -> anyhow::Result<Admitted> {
        let found = find(self.0.state.as_deref());
        if let Ok(found) = &found {
            *self.0.in_use.lock().unwrap_or_else(PoisonError::into_inner) = found.as_ref().map(in_use);
        }
        let Some(PolicyFile { path, policy }) = found.context("this node starts nothing")? else {
            return Ok(Admitted { limits: asked.clone(), ..Admitted::default() });
        };
        let looked = Looked::open(program).with_context(|| format!("finding `{}`", program.display()))?;
        let (by, hash) = self.judged(&policy, &looked)?;
        let secrets: Vec<String> = order.secrets.iter().map(|secret| secret.key.clone()).collect();
        let environment = &order.environment;
        let variables: Vec<String> = environment.variables.keys().chain(&environment.inherited).cloned().collect();
        let own = getuid();
        let named = policy.user().map(users::named).transpose()?.flatten();
        let (mine, other): (Option<User>, Option<User>) = match named {
            Some(user) if user.account.uid == own.as_raw() => (Some(user), None),
            other => (None, other),
        };
        let only = only_own(own.is_root());
        let other = other.filter(|_| only.is_empty());
        let user = other.as_ref().or(mine.as_ref()).map_or_else(users::own_name, |user| user.name.clone());
        let start = Start {
            program: &looked.path,
            hash,
            user: &user,
            is_root: other.as_ref().map_or(own.as_raw(), |user| user.account.uid) == 0,
            only,
            devices: &order.devices,
            secrets: &secrets,
            variables: &variables,
            limits: words_of(asked),
        };
        // The setup file of a ROS 2 program decides which program runs, so it is checked as well.
        let setup = setup_file(order)?.map(|setup| {
            let setup =
                Looked::open(&setup).with_context(|| format!("finding the setup file `{}`", setup.display()))?;
            let (_, hash) = self.judged(&policy, &setup)?;
            anyhow::Ok((setup.path, hash))
        });
        let admitted_setup = setup
            .transpose()?
            .map_or(Ok(()), |(program, hash)| policy.admit(&Start { program: &program, hash, ..start }).map(drop));
        let admitted = admitted_setup.and_then(|()| policy.admit(&start));
        match admitted {
            Ok(limits) => Ok(Admitted {
                limits: with(asked.clone(), &limits),
                sandbox: Sandbox {
                    level: level(policy.sandbox()),
                    user: other.as_ref().map(|user| user.account.clone()),
                    own: None,
                    judged: policy.limits_programs().then_some(Judged { path: looked.path, stamp: looked.stamp, by }),
                },
                environment: other
                    .into_iter()
                    .flat_map(|user| [("USER", user.name), ("HOME", user.home)])
                    .map(|(name, value)| (name.to_owned(), value))
                    .collect(),
            }),
            Err(denied) => {
                let reasons: Vec<String> = denied.iter().map(|denied| denied.sentence(&path)).collect();
                Err(anyhow!("the policy of this node refuses it: {}", reasons.join("; ")))
            }
        }
    }

    /// Returns how a policy judges a file. Also returns the hash of the file if this needs one.
    fn judged(&self, policy: &Policy, looked: &Looked) -> anyhow::Result<(JudgedBy, Option<[u8; 32]>)> {
        if !policy.needs_hash(&looked.path) {
            return Ok((JudgedBy::Folder, None));
        }
        Ok((JudgedBy::Hash, Some(self.hash(looked)?)))
    }

    /// Returns the hash of a program. It is computed only once, as long as the file does not change.
    fn hash(&self, program: &Looked) -> anyhow::Result<[u8; 32]> {
        let failed = || format!("reading `{}`", program.path.display());
        let stamp = program.stamp;
        let known = |hashes: &BTreeMap<Stamp, [u8; 32]>| hashes.get(&stamp).copied();
        if let Some(hash) = known(&self.0.hashes.lock().unwrap_or_else(PoisonError::into_inner)) {
            return Ok(hash);
        }
        let file = program.read().with_context(failed)?;
        let hash = hash_of(&file).with_context(failed)?;
        // If the file was written while it was read, the hash may not fit its content.
        let after = Stamp::of(&file.metadata().with_context(failed)?);
        ensure!(after == stamp, "`{}` was changed while it was checked", program.path.display());
        let mut hashes = self.0.hashes.lock().unwrap_or_else(PoisonError::into_inner);
        if hashes.len() >= HASHES_MAX {
            hashes.pop_first();
        }
        hashes.insert(stamp, hash);
        Ok(hash)
    }

    fn refused(&self, order: &SpawnOrder, why: &str) {
        let SpawnOrder { process, path, .. } = order;
        tracing::warn!(deployment = %process.deployment, instance = path, why, "a program was refused");
        if let Some(member) = &self.0.member {
            let (who, what) = (format!("deployment {}", process.deployment), format!("start {path}"));
            member.record(AuditEntry { decision: Decision::Refused, who, what, reason: why.to_owned() });
        }
    }
}

/// Returns the setup file of a ROS 2 program. A relative path is relative to the folder of the program.
///
/// # Errors
/// An argument has no name, so it could be a setup file as well.
fn setup_file(order: &SpawnOrder) -> anyhow::Result<Option<PathBuf>> {
    let [_, kind, arguments @ ..] = order.command.as_slice() else { return Ok(None) };
    if kind != ROS_NODE {
        return Ok(None);
    }
    let mut setup = None;
    for argument in arguments.iter().take_while(|argument| *argument != "--") {
        let named = argument.split_once('=').map(|(name, value)| (name.trim(), value));
        let named = named.filter(|(name, _)| name.bytes().all(|byte| byte.is_ascii_lowercase() || byte == b'_'));
        let (name, value) = named.ok_or_else(|| anyhow!("`{argument}` has no name: write `NAME={argument}`"))?;
        if name == "setup" && !value.is_empty() {
            let folder = order.environment.directory.as_deref().map_or_else(PathBuf::new, PathBuf::from);
            setup = Some(folder.join(value));
        }
    }
    Ok(setup)
}

/// Returns the end of a sentence: why a program can run only as the user of its node. It is empty if it can run as another user.
const fn only_own(is_root: bool) -> &'static str {
    if is_root { "" } else { ": the node is not root, and can start programs only as itself" }
}

const fn level(sandbox: policy::Sandbox) -> SandboxLevel {
    match sandbox {
        policy::Sandbox::Standard => SandboxLevel::Standard,
        policy::Sandbox::None => SandboxLevel::None,
    }
}

fn in_use(found: &PolicyFile) -> PolicyInUse {
    let is_confined = found.policy.sandbox() == policy::Sandbox::Standard;
    let sandbox = if is_confined { standard() } else { "none" };
    let weakness = found.could_be_changed_by().map(|user| format!("; `{user}`, as whom programs run, could change it"));
    PolicyInUse { file: found.path.display().to_string(), sandbox: sandbox.to_owned() + &weakness.unwrap_or_default() }
}

/// Returns whether the sandbox can close folders of the system on this machine.
fn has_landlock() -> bool {
    !standard().contains("landlock")
}

/// Describes to a person what the standard sandbox consists of on this machine.
fn standard() -> &'static str {
    static STANDARD: OnceLock<String> = OnceLock::new();
    STANDARD.get_or_init(|| {
        let found = child::sandbox_levels(&programs::beside("dca-shim"));
        let found = found.inspect_err(|error| tracing::warn!(%error, "cannot find out which parts the sandbox has"));
        let missing = |level: &&str| !found.as_ref().is_ok_and(|found| found.iter().any(|one| one == level));
        let missing: Vec<&str> = ["landlock", "seccomp"].into_iter().filter(missing).collect();
        if missing.is_empty() {
            return "standard".to_owned();
        }
        tracing::warn!(missing = missing.join(", "), "this kernel lacks parts of the standard sandbox");
        format!("standard without {}", missing.join(" and "))
    })
}

fn hash_of(file: &File) -> io::Result<[u8; 32]> {
    let mut hasher = blake3::Hasher::new();
    io::copy(&mut io::BufReader::with_capacity(64 << 10, file), &mut hasher)?;
    Ok(*hasher.finalize().as_bytes())
}

/// Converts limits to the form of a policy.
fn words_of(limits: &Limits) -> policy::Limits {
    policy::Limits {
        realtime: limits.realtime.map(|realtime| u64::from(realtime.priority)),
        memory: limits.memory,
        cores: limits.cpu_share.map(u64::from),
        cpu: limits.cpu.map(|time| time.as_secs()),
        pids: limits.pids,
        files: limits.files,
        file_size: limits.file_size,
    }
}

/// Combines the limits that a program asks for with the limits of the policy.
fn with(asked: Limits, admitted: &policy::Limits) -> Limits {
    Limits {
        memory: admitted.memory,
        cpu: admitted.cpu.map(Duration::from_secs),
        files: admitted.files,
        pids: admitted.pids,
        // A policy gives at most 4096 processors, so the number always fits.
        cpu_share: admitted.cores.and_then(|cores| u32::try_from(cores).ok()),
        file_size: admitted.file_size,
        ..asked
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::effect::ProcessId;
    use crate::logic::protocol::Deployment;
    use std::os::unix::fs::PermissionsExt;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("dca-policy-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    #[test]
    fn a_policy_that_cannot_be_trusted_or_read_is_refused() {
        if fs::symlink_metadata(SYSTEM).is_ok() {
            println!("skipped: this machine has a policy");
            return;
        }
        let folder = folder("file");
        let file = folder.join(FILE);
        assert!(find(Some(&folder)).unwrap().is_none() && find(None).unwrap().is_none());
        let check = |mode, text: &str, expected: &str| {
            fs::write(&file, text).unwrap();
            fs::set_permissions(&file, fs::Permissions::from_mode(mode)).unwrap();
            let error = format!("{:#}", find(Some(&folder)).unwrap_err());
            assert_eq!(error, format!("the policy `{}` cannot be used: {expected}", file.display()));
        };
        check(0o622, "root = true", "other users may write to it; run `chmod go-w` on it");
        check(0o600, "\nuser = \"nobody-here\"", "line 2: this machine has no user `nobody-here`");
        check(0o600, "\npids = 0", "line 2: `0` is not allowed in `pids`: write a number above 0");
        fs::write(&file, "root = true").unwrap();
        assert_eq!(find(Some(&folder)).unwrap().unwrap().path, file);
        fs::remove_file(&file).unwrap();
        std::os::unix::fs::symlink("/nowhere", &file).unwrap();
        assert!(find(Some(&folder)).is_err(), "a link that leads nowhere is not the same as no policy");
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn the_setup_file_of_a_program_of_ros_is_judged_as_well() {
        let folder = folder("setup").canonicalize().unwrap();
        fs::create_dir_all(folder.join("opt")).unwrap();
        for name in ["dca-ros", "opt/setup.bash", "setup.bash"] {
            fs::write(folder.join(name), "#!/bin/sh\n").unwrap();
            fs::set_permissions(folder.join(name), fs::Permissions::from_mode(0o755)).unwrap();
        }
        let own_root = if getuid().is_root() { "root = true" } else { "root = false" };
        fs::create_dir_all(folder.join("bin")).unwrap();
        fs::rename(folder.join("dca-ros"), folder.join("bin/dca-ros")).unwrap();
        let rules =
            format!("{own_root}\nfolders = [\"{0}/bin\", \"{0}/opt\"]\nenvironment = [\"ROS_*\"]", folder.display());
        fs::write(folder.join(FILE), rules).unwrap();
        let policy = ExecutionPolicy::open(Some(folder.clone()), None).unwrap();
        let admitted = |arguments: &[&str]| {
            let text = "module A(host) { exec \"a\"; done; }
                process main(){ host{c1} instantiated_processes{ a instof A(c1); } internal_event_actions{ a } }";
            let plan = language::compile(&language::Source::new("a.dca", text), &[], &language::Options::named("a"));
            let plan = plan.plan.unwrap();
            let process = ProcessId { deployment: Deployment { name: "a".to_owned(), epoch: 1 }, leaf: 0 };
            let program = folder.join("bin/dca-ros").display().to_string();
            let command =
                [program, ROS_NODE.to_owned()].into_iter().chain(arguments.iter().map(|one| (*one).to_owned()));
            let order = crate::logic::programs::order(process, command.collect(), &plan, &plan.leaves[0]);
            policy.admit(&order).map(drop).map_err(|error| format!("{error:#}"))
        };
        let setup = |name: &str| format!("setup={}/{name}", folder.display());
        assert_eq!(admitted(&["package=a", &setup("opt/setup.bash"), "--", "0"]), Ok(()));
        assert_eq!(admitted(&["package=a"]), Ok(()));
        for arguments in [&[&*setup("setup.bash")][..], &[&format!(" {}", setup("setup.bash"))]] {
            let refused = admitted(arguments).unwrap_err();
            assert!(refused.contains("setup.bash` is not in a folder of allowed programs"), "{refused}");
        }
        let unnamed = admitted(&["a", "b", "", &folder.join("setup.bash").display().to_string()]).unwrap_err();
        assert!(unnamed.contains("`a` has no name"), "{unnamed}");
        fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_program_that_changes_has_another_hash() {
        let (folder, policy) = (folder("hash"), ExecutionPolicy::open(None, None).unwrap());
        let program = folder.join("program");
        let written = |bytes: &str| {
            fs::write(&program, bytes).unwrap();
            policy.hash(&Looked::open(&program).unwrap()).unwrap()
        };
        for bytes in ["one", "two!", "three"] {
            assert_eq!(written(bytes), *blake3::hash(bytes.as_bytes()).as_bytes());
            assert_eq!(
                policy.hash(&Looked::open(&program).unwrap()).unwrap(),
                *blake3::hash(bytes.as_bytes()).as_bytes()
            );
        }
        fs::remove_dir_all(&folder).unwrap();
    }
}
