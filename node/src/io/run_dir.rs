//! The run directory: sockets and output of programs, in a private folder for each user with a folder for each node.
//!
//! ```text
//! BASE/                     0700, owned by the user: /run/dca of a service, /run/user/UID/dca, or dca-UID in the folder for
//!                           temporary files
//!   c1/                     one node
//!     lock                  held while the node runs
//!     cgroup                names the control group that it runs in, if it could have one
//!     state                 names the folder with its state, if it has one
//!     proof                 what commands of this user on this machine show to the node, and nobody else can read
//!     node.sock             its zenoh session, for other nodes and command lines of this machine; beside it zenoh's lock
//!     journal               what it has committed, if it has no folder that survives it
//!     inputs                what its agent was told, while something runs: for the next node, if this one is killed
//!     door_opening.1/       one deployment; of those that are over the last few, without sockets
//!       control.sock        where its programs talk to the node
//!       12/                 one program: out.log, exit (until its node knows), processes (while it runs), data.sock, data.wire,
//!                           shim.sock, beat.sock
//!   c1+u/                   0710, of the group of the user as whom the policy of c1 has programs run, if that is another one
//!     team                  what they know of the team; `revoked` beside it
//!     door_opening.1/       control.sock for them
//!       12/                 0700, of that user: data.sock, data.wire, beat.sock
//! ```
//! With such programs every user who knows its name may enter BASE.

mod names;
mod sockets;

use crate::io::child::leftovers;
use crate::io::folder::{self, FolderError};
use crate::logic::effect::ProcessId;
use crate::logic::protocol::Deployment;
use comms::io::clock::{Wakeup, now};
use comms::io::entropy;
use comms::io::file::{self, Privacy};
use names::{NAME_MAX, folder_name};
use rustix::fs::{FlockOperation, flock};
use rustix::process::getuid;
use std::fs::{self, File, Permissions};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt, chown};
use std::path::{Path, PathBuf};
use std::time::Duration;

pub(crate) use sockets::remove_sockets;

/// How long a killed node may take to end.
const LEAVING: Duration = Duration::from_secs(3);

/// The longest path of a Unix socket that Linux accepts, without its final zero. Source: unix(7).
const SOCKET_PATH_MAX: usize = 107;

/// The beginning of the name of a folder with a command's own nodes. The command's process id follows. The name of a
/// node never contains `+`.
const COMMAND_PREFIX: &str = "run+";

/// The option that names the base.
pub const OPTION: &str = "--run-dir";

/// The folder of a node that is run by a service manager.
const SERVICE: &str = "/run/dca";

/// The file that proves that a client runs on this machine.
const PROOF: &str = "proof";
/// The longest proof, in bytes.
const PROOF_MAX: usize = 64;

/// The file with the credentials that programs use in the team.
pub(crate) const PROGRAMS: &str = "programs";
/// The file with the credentials that visitors show to programs on other hosts.
pub const VISITORS: &str = "visitors";

/// The end of the folder name for the sockets of programs that run as another user. The node's name comes before it.
/// The name of a node never contains `+`.
const OTHERS: &str = "+u";
/// The file in this folder with the credentials that programs use in the team.
pub(crate) const OTHERS_TEAM: &str = "team";
/// The variable with the path of the socket on which a program talks to its node.
pub(crate) const CONTROL_VARIABLE: &str = "DCA_CONTROL";
/// The variable with the path of the socket of a program's data session.
pub(crate) const DATA_VARIABLE: &str = "DCA_DATA_SOCKET";
/// The variable with the path of the credentials that a program uses in its team.
pub(crate) const TEAM_VARIABLE: &str = "DCA_TEAM";
/// The socket of a program's data session.
pub(crate) const DATA_SOCKET: &str = "data.sock";
/// The socket on which the programs of a deployment talk to the node.
const CONTROL_SOCKET: &str = "control.sock";
/// The files that a data session leaves when it is killed.
const DATA_FILES: [&str; 3] = [DATA_SOCKET, "data.sock.lock", "data.wire"];
/// The mode of a folder that all users may enter but not list.
const ENTER: u32 = 0o711;

/// Why a folder cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RunDirError {
    /// The folder cannot be made or read.
    #[error("cannot use the folder `{path}`: {cause}; choose another folder with `--run-dir`")]
    Unusable {
        /// The path.
        path: PathBuf,
        /// The error of the system.
        cause: io::Error,
    },
    /// A file is in the place of the folder.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The folder belongs to another user, so its sockets cannot be trusted.
    #[error(
        "the folder `{path}` belongs to user {owner}, whose nodes may run there; act as that user, or choose another folder with `--run-dir`"
    )]
    Foreign {
        /// The path.
        path: PathBuf,
        /// The user id of the owner.
        owner: u32,
    },
    /// The folder is a link: the user who made the link could change where it leads.
    #[error("the folder `{path}` is a link; name the folder itself with `--run-dir`")]
    Link {
        /// The path.
        path: PathBuf,
    },
    /// Other users can put files into the folder.
    #[error(
        "every user can write to the folder `{path}`; run `chmod go-w` on it, or choose another folder with `--run-dir`"
    )]
    Open {
        /// The path.
        path: PathBuf,
    },
    /// A node of that name is running.
    #[error("a node named `{name}` is already running on this machine")]
    Taken {
        /// Its name.
        name: String,
    },
    /// The paths of sockets in the folder would be too long for the kernel.
    #[error(
        "the folder `{path}` is too deep for sockets: with the node's name it may have {max} bytes, and has {length}; choose a \
         shorter path with `--run-dir`"
    )]
    TooDeep {
        /// The path.
        path: PathBuf,
        /// Its present length, in bytes.
        length: usize,
        /// Its longest possible length, in bytes.
        max: usize,
    },
}

/// The variable with the base folder, if no option names it.
const VARIABLE: &str = "DCA_RUN_DIR";

/// Returns the default base folder of this user: the folder in `DCA_RUN_DIR`, or else the folder of a service manager's
/// node that runs as this user (`RuntimeDirectory=` of its unit). If neither exists, returns a folder of the user's
/// own.
pub fn default_base() -> PathBuf {
    if let Some(folder) = std::env::var_os(VARIABLE).filter(|folder| !folder.is_empty()) {
        return folder.into();
    }
    let uid = getuid().as_raw();
    let service = PathBuf::from(SERVICE);
    let run = PathBuf::from(format!("/run/user/{uid}"));
    if is_own(&service) {
        service
    } else if run.is_dir() {
        run.join("dca")
    } else {
        std::env::temp_dir().join(format!("dca-{uid}"))
    }
}

/// If the service manager runs a node as another user, returns the user who owns the folder of that node.
pub fn user_of_service() -> Option<u32> {
    let found = fs::symlink_metadata(SERVICE).ok().filter(fs::Metadata::is_dir)?;
    Some(found.uid()).filter(|owner| *owner != getuid().as_raw())
}

/// Returns the nodes that run on this machine with their sockets, sorted by name.
///
/// # Errors
/// The folder does not belong to this user.
pub fn running(base: &Path) -> Result<Vec<(String, PathBuf)>, RunDirError> {
    folder::check(base, OPTION)?;
    if fs::symlink_metadata(base).is_ok() {
        check_own(base)?;
    }
    // Sockets need absolute paths. If the base cannot be made absolute, it also has no entries.
    let base = std::path::absolute(base).unwrap_or_default();
    let entries = fs::read_dir(base).into_iter().flatten().flatten();
    let mut nodes: Vec<(String, PathBuf)> = entries
        // Either of the two files may have been removed.
        .filter(|entry| ["lock", "node.sock.lock"].iter().any(|lock| is_locked(&entry.path().join(lock))))
        .map(|entry| (entry.file_name().to_string_lossy().into_owned(), entry.path().join("node.sock")))
        .collect();
    nodes.sort();
    Ok(nodes)
}

/// Returns the proof that a command shows to the node `name` of this machine. Returns nothing if there is no such node,
/// or if the node belongs to another user.
pub fn proof(base: &Path, name: &str) -> Option<String> {
    // The name comes from the network or from a person, so it must not lead to another folder.
    let plain = Path::new(name).components().eq([std::path::Component::Normal(name.as_ref())]);
    let proof = file::bytes(&base.join(name).join(PROOF), PROOF_MAX).ok().filter(|_| plain)?;
    String::from_utf8(proof).ok()
}

/// Returns the file with the credentials that a node in a team gives to clients on its machine. Returns nothing if the
/// node is in no team.
pub fn visitors_identity(base: &Path, name: &str) -> Option<PathBuf> {
    let plain = Path::new(name).components().eq([std::path::Component::Normal(name.as_ref())]);
    Some(base.join(name).join(VISITORS)).filter(|file| plain && file.is_file())
}

/// Returns a folder for each group of nodes that see each other. The first is `base`. A folder for each command with
/// its own nodes follows, the oldest first. Folders of other users are left out, because their nodes are strangers.
pub fn groups(base: &Path) -> Vec<PathBuf> {
    let base = std::path::absolute(base).unwrap_or_default();
    let entries = fs::read_dir(&base).into_iter().flatten().flatten();
    let commands = entries.map(|entry| entry.path()).filter(|path| command(path).is_some());
    let mut commands: Vec<PathBuf> =
        commands.filter(|path| running(path).is_ok_and(|nodes| !nodes.is_empty())).collect();
    commands.sort_by_key(|path| (fs::metadata(path).and_then(|folder| folder.modified()).ok(), path.clone()));
    std::iter::once(base).filter(|base| is_own(base)).chain(commands).collect()
}

/// Returns the process id of the command whose nodes are in this folder; nothing for permanent nodes.
pub fn command(folder: &Path) -> Option<u32> {
    folder.file_name()?.to_str()?.strip_prefix(COMMAND_PREFIX)?.parse().ok()
}

/// Returns whether a folder belongs to this user and is not a link.
fn is_own(path: &Path) -> bool {
    fs::symlink_metadata(path).is_ok_and(|folder| folder.is_dir() && folder.uid() == getuid().as_raw())
}

/// Makes a folder for the nodes of this command. Ends and removes what killed commands have left. Blocks.
pub fn of_this_command(base: &Path) -> PathBuf {
    for entry in fs::read_dir(base).into_iter().flatten().flatten() {
        let path = entry.path();
        let pid = command(&path);
        // A command that is just starting holds no lock yet, but its process exists.
        let alive = pid.is_none_or(|pid| Path::new(&format!("/proc/{pid}")).exists());
        if !alive && running(&path).is_ok_and(|nodes| nodes.is_empty()) {
            let nodes = fs::read_dir(&path).into_iter().flatten().flatten();
            nodes.for_each(|node| drop(leftovers::end_all(&node.path())));
            drop(fs::remove_dir_all(&path));
        }
    }
    base.join(format!("{COMMAND_PREFIX}{}", std::process::id()))
}

/// Locks a file. When a process is killed, the kernel holds its lock until its last thread is gone.
fn lock_soon(lock: &File) -> bool {
    let (give_up, pause) = (now() + LEAVING, Wakeup::default());
    while flock(lock, FlockOperation::NonBlockingLockExclusive).is_err() {
        if now() >= give_up {
            return false;
        }
        pause.wait(Some(now() + LEAVING / 200));
    }
    true
}

fn is_locked(lock: &Path) -> bool {
    file::opened(lock).is_ok_and(|file| flock(&file, FlockOperation::NonBlockingLockShared).is_err())
}

/// The folder of a running node. Its lock is held until this is dropped.
#[derive(Debug)]
pub struct RunDir {
    path: PathBuf,
    proof: String,
    _lock: File,
}

impl RunDir {
    /// Takes the folder of node `name` in `base`. If another process holds the folder, blocks for up to 3 s.
    ///
    /// # Errors
    /// The folder cannot be used, or a node of that name is running.
    pub fn take(base: &Path, name: &str) -> Result<Self, RunDirError> {
        let path = Self::path_of(base, name)?;
        private_folder(base)?;
        private_folder(&path)?;
        let kept = |name: &str| {
            let path = path.join(name);
            move |cause| FolderError::kept(&path, cause, OPTION)
        };
        let lock = file::appended(&path.join("lock"), Privacy::Usual).map_err(kept("lock"))?;
        if !lock_soon(&lock) {
            return Err(RunDirError::Taken { name: name.to_owned() });
        }
        let proof = write_proof(&path.join(PROOF)).map_err(kept(PROOF))?;
        Ok(Self { path, proof, _lock: lock })
    }

    /// Returns the path that the folder of node `name` has or would have.
    ///
    /// # Errors
    /// The paths of sockets in the folder would be too long.
    pub fn path_of(base: &Path, name: &str) -> Result<PathBuf, RunDirError> {
        let absolute = std::path::absolute(base);
        let path = absolute.map_err(|cause| RunDirError::Unusable { path: base.to_owned(), cause })?.join(name);
        let (length, max) = (path.as_os_str().len(), SOCKET_PATH_MAX - deepest_socket().len());
        if length > max { Err(RunDirError::TooDeep { path, length, max }) } else { Ok(path) }
    }

    /// Returns the folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Removes the folders of an earlier run's deployments. Their programs have ended.
    pub fn clear(&self) {
        drop(fs::remove_dir_all(of_others(&self.path)));
        for entry in fs::read_dir(&self.path).into_iter().flatten().flatten() {
            let folder = entry.path();
            if entry.file_name().to_string_lossy().contains('.') && folder.is_dir() {
                drop(fs::remove_dir_all(&folder));
            }
        }
    }

    /// Removes the socket of an earlier run.
    ///
    /// # Errors
    /// The socket cannot be removed. Or its lock is not a regular file: opening a pipe would wait for ever. Or another
    /// node holds this lock, although its own lock was removed.
    pub fn remove_socket(&self) -> Result<(), RunDirError> {
        let socket = self.socket();
        if is_locked(&socket.with_extension("sock.lock")) {
            let name = self.path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            return Err(RunDirError::Taken { name });
        }
        remove_leftover(&socket).map_err(|cause| FolderError::kept(&socket, cause, OPTION))?;
        Ok(folder::check_kept(&socket.with_extension("sock.lock"), OPTION)?)
    }

    /// Returns the proof. Only this user can read it, and only on this machine.
    pub fn proof(&self) -> &str {
        &self.proof
    }

    /// Returns the socket of the node's session.
    pub fn socket(&self) -> PathBuf {
        self.path.join("node.sock")
    }

    /// Returns the file of committed deployments.
    pub fn journal(&self) -> PathBuf {
        self.path.join("journal")
    }

    /// Returns the folder of a deployment.
    pub fn deployment(&self, deployment: &Deployment) -> PathBuf {
        self.path.join(format!("{}.{}", folder_name(&deployment.name), deployment.epoch))
    }

    /// Returns the socket on which the programs of a deployment talk to the node.
    pub fn control_socket(&self, deployment: &Deployment) -> PathBuf {
        self.deployment(deployment).join(CONTROL_SOCKET)
    }

    /// Returns the folder of a program.
    pub fn process(&self, process: &ProcessId) -> PathBuf {
        self.deployment(&process.deployment).join(process.leaf.to_string())
    }
}

/// Returns the longest path that a socket has in the folder of a node.
fn deepest_socket() -> String {
    format!("{OTHERS}/{}.{}/10000/data.sock", "d".repeat(NAME_MAX), u64::MAX)
}

/// Returns the folder beside a node's folder for programs that run as another user. Only the node may enter its own folder.
fn of_others(node: &Path) -> PathBuf {
    let mut name = node.file_name().unwrap_or_default().to_owned();
    name.push(OTHERS);
    node.with_file_name(name)
}

/// Returns the folder for the sockets of a program or a deployment, if it runs as another user. `path` is its folder
/// inside the folder `node`.
pub(crate) fn other(node: &Path, path: &Path) -> PathBuf {
    of_others(node).join(path.strip_prefix(node).unwrap_or(path))
}

/// Returns the user and the group of a program, if it runs as another user. `process` is its folder inside the folder of its node.
pub(crate) fn user_of(node: &Path, process: &Path) -> Option<(u32, u32)> {
    let own = fs::symlink_metadata(other(node, process)).ok().filter(fs::Metadata::is_dir)?;
    (own.uid() != getuid().as_raw()).then(|| (own.uid(), own.gid()))
}

/// Makes the folder for the sockets of a program that runs as another user. Only that user may list it. The group of
/// that user may enter its parent folders.
///
/// # Errors
/// The file system refuses, or the node is not root.
pub(crate) fn make_other(node: &Path, process: &Path, uid: u32, gid: u32) -> io::Result<PathBuf> {
    let (others, own) = (of_others(node), other(node, process));
    if let Some(base) = others.parent() {
        let mode = fs::metadata(base)?.mode();
        fs::set_permissions(base, Permissions::from_mode((mode & 0o777) | ENTER))?;
    }
    let deployment = own.parent().unwrap_or(&others);
    for (folder, (owner, mode)) in [(&*others, (0, 0o710)), (deployment, (0, 0o710)), (&own, (uid, 0o700))] {
        match fs::DirBuilder::new().mode(0o700).create(folder) {
            Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
            _ => {}
        }
        chown(folder, Some(owner), Some(gid))?;
        fs::set_permissions(folder, Permissions::from_mode(mode))?;
    }
    DATA_FILES.iter().try_for_each(|name| remove_leftover(&own.join(name)))?;
    Ok(own)
}

/// Makes the folder of a program.
///
/// # Errors
/// The file system refuses.
pub fn make_process(path: &Path) -> io::Result<()> {
    fs::DirBuilder::new().recursive(true).mode(0o700).create(path)?;
    // If a lock were a pipe, the program would wait for it.
    DATA_FILES.iter().try_for_each(|name| remove_leftover(&path.join(name)))
}

/// Writes a random secret to a file that only this user can read.
fn write_proof(path: &Path) -> io::Result<String> {
    let proof = format!("{:032x}", u128::from_le_bytes(entropy::bytes()?));
    let mut file = file::created(path, Privacy::Own)?;
    file.write_all(proof.as_bytes())?;
    Ok(proof)
}

/// Makes a folder that belongs to this user and that no other user can write to. An existing folder has to meet the same conditions.
///
/// # Errors
/// The folder cannot be made, is a link, or belongs to another user.
pub fn private_folder(path: &Path) -> Result<(), RunDirError> {
    folder::check(path, OPTION)?;
    let unusable = |cause| RunDirError::Unusable { path: path.to_owned(), cause };
    let made = fs::DirBuilder::new().recursive(true).mode(0o700).create(path);
    match (check_own(path), made) {
        // The reason why the folder could not be made is more helpful than that it does not exist.
        (Err(RunDirError::Unusable { cause, .. }), Err(why)) if cause.kind() == io::ErrorKind::NotFound => {
            Err(unusable(why))
        }
        // If the folder exists, its problem is a more helpful message than that it cannot be made.
        (checked, made) => checked.and_then(|()| made.map_err(unusable)),
    }
}

/// Checks that a folder belongs to this user, and that no other user can write to it.
fn check_own(path: &Path) -> Result<(), RunDirError> {
    let unusable = |cause| RunDirError::Unusable { path: path.to_owned(), cause };
    let found = fs::symlink_metadata(path).map_err(unusable)?;
    let (owner, path) = (found.uid(), path.to_owned());
    if found.is_symlink() {
        Err(RunDirError::Link { path })
    } else if owner != getuid().as_raw() {
        Err(RunDirError::Foreign { path, owner })
    } else if found.mode() & 0o002 != 0 {
        Err(RunDirError::Open { path })
    } else {
        Ok(())
    }
}

/// Removes a file that an earlier run left behind.
fn remove_leftover(path: &Path) -> io::Result<()> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(error),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    /// Another user may have made the folder first. Such a user must not answer in place of the nodes.
    #[test]
    fn a_folder_of_somebody_else_is_refused() {
        let folder = std::env::temp_dir().join(format!("dca-own-{}", std::process::id()));
        let (own, link, open) = (folder.join("own"), folder.join("link"), folder.join("open"));
        fs::create_dir_all(&own).unwrap();
        fs::create_dir_all(&open).unwrap();
        symlink(&own, &link).unwrap();
        fs::set_permissions(&open, Permissions::from_mode(0o777)).unwrap();
        let check = |path: &Path| {
            let taken = RunDir::take(path, "c1").map(|_| ()).map_err(|error| error.to_string());
            let asked = running(path).map(|_| ()).map_err(|error| error.to_string());
            assert_eq!(taken, asked, "nodes and command lines agree");
            taken.err().unwrap_or_default()
        };
        assert_eq!(check(&own), "");
        assert!(check(&link).contains("is a link"));
        assert!(check(&open).contains("every user can write to the folder"));
        assert_eq!(running(&folder.join("nowhere")).unwrap(), []);
        fs::create_dir_all(folder.join("named")).unwrap();
        symlink(&own, folder.join("named/c1")).unwrap();
        assert!(RunDir::take(&folder.join("named"), "c1").unwrap_err().to_string().contains("is a link"));
        if getuid().is_root() {
            chown(&own, Some(12345), None).unwrap();
            assert!(check(&own).contains("belongs to user 12345"));
        } else {
            println!("skipped: needs root to make a folder of somebody else");
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    /// When a node starts, it clears its folders. A command clears the folders of killed commands.
    #[test]
    fn no_node_has_the_name_of_a_folder_that_others_clear() {
        let base = Path::new("/run/dca");
        for folder in [of_others(&base.join("c1")), base.join(format!("{COMMAND_PREFIX}41"))] {
            let name = folder.file_name().unwrap().to_str().unwrap();
            assert!(comms::logic::key::HostName::parse(name).is_err(), "{name}");
        }
        // Nodes whose names look like those of such folders keep their folders.
        let base = std::env::temp_dir().join(format!("dca-names-{}", std::process::id()));
        let living = ["c1.u", "run-999999999"].map(|name| RunDir::take(&base, name).unwrap());
        fs::create_dir_all(living[0].path().join("door.1")).unwrap();
        RunDir::take(&base, "c1").unwrap().clear();
        of_this_command(&base);
        assert!(living.iter().all(|node| node.path().join("lock").exists()));
        assert!(living[0].path().join("door.1").exists());
        fs::remove_dir_all(&base).unwrap();
    }

    #[test]
    fn a_folder_that_cannot_be_made_says_why() {
        // Even root cannot make a folder there.
        let error = RunDir::take(Path::new("/proc/1/dca"), "c1").unwrap_err().to_string();
        assert!(error.contains("cannot use the folder `/proc/1/dca`"), "{error}");
        let made = fs::create_dir("/proc/1/dca").unwrap_err();
        assert!(error.contains(&made.to_string()), "{error}: {made}");
    }

    /// The kernel still removes a killed node while its successor starts.
    #[test]
    fn a_holder_that_is_leaving_is_waited_for() {
        let base = std::env::temp_dir().join(format!("dca-leaving-{}", std::process::id()));
        let first = RunDir::take(&base, "c1").unwrap();
        let folder = base.clone();
        let second = std::thread::spawn(move || RunDir::take(&folder, "c1").map(drop));
        Wakeup::default().wait(Some(now() + Duration::from_millis(50)));
        drop(first);
        second.join().unwrap().unwrap();
        fs::remove_dir_all(&base).unwrap();
    }

    #[test]
    fn groups_are_the_base_and_the_commands_that_run_and_belong_to_this_user() {
        let base = std::env::temp_dir().join(format!("dca-groups-{}", std::process::id()));
        drop(fs::remove_dir_all(&base));
        assert_eq!(groups(&base), Vec::<PathBuf>::new(), "there is no such folder");
        let node = |folder: &Path| RunDir::take(folder, "c1").unwrap();
        let command = base.join("run+41");
        let (first, second) = (node(&base), node(&command));
        fs::create_dir_all(base.join("run+42").join("c1")).unwrap();
        symlink(&command, base.join("run+43")).unwrap();
        assert_eq!(groups(&base), [base.clone(), command.clone()], "one is not running, one is a link");
        let sockets: Vec<PathBuf> = running(&command).unwrap().into_iter().map(|(_, socket)| socket).collect();
        assert_eq!(sockets, [command.join("c1").join("node.sock")]);
        drop(second);
        assert_eq!(groups(&base), std::slice::from_ref(&base), "the command has ended");
        drop(first);
        fs::remove_dir_all(&base).unwrap();
    }
}
