//! Programs that run as another user than their node. They cannot enter a folder of the node, so a folder of their own
//! has their sockets and their credentials for the team.

use crate::io::run_dir::{self, CONTROL_VARIABLE, DATA_SOCKET, DATA_VARIABLE, TEAM_VARIABLE};
use anyhow::Context;
use comms::io::control::{ControlError, Listener};
use shim::protocol::ShimStart;
use std::path::{Path, PathBuf};
use team::member::Member;

/// If a program runs as another user, moves the program's files to a folder of this user. Returns the socket to its
/// node, if it has one. Blocks.
///
/// # Errors
/// The file system refuses.
pub(super) fn move_to_user(
    start: &mut ShimStart,
    control: Option<PathBuf>,
    node: &Path,
    member: Option<&Member>,
) -> anyhow::Result<Option<PathBuf>> {
    let Some((uid, gid)) = start.sandbox.user.as_ref().map(|user| (user.uid, user.gid)) else { return Ok(control) };
    let own = run_dir::make_other(node, &start.dir, uid, gid).context("making the folder of its user")?;
    let control = control.map(|path| run_dir::other(node, &path));
    for (name, value) in &mut start.environment {
        let moved = match name.as_str() {
            CONTROL_VARIABLE => control.clone().unwrap_or_default(),
            DATA_VARIABLE => own.join(DATA_SOCKET),
            TEAM_VARIABLE => {
                let file = run_dir::other(node, &node.join(run_dir::OTHERS_TEAM));
                if let Some(member) = member {
                    member.share(&file, gid).context("sharing the files of the team with this user")?;
                }
                file
            }
            _ => continue,
        };
        *value = moved.display().to_string();
    }
    start.sandbox.own = Some(own);
    Ok(control)
}

/// Listens for programs of this user, or of another user. `other` is the user and group of the other one.
pub(super) fn listener(path: &Path, other: Option<(u32, u32)>) -> Result<Listener, ControlError> {
    other.map_or_else(|| Listener::bind(path), |(user, group)| Listener::bind_for(path, user, group))
}
