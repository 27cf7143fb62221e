//! Finds out whether programs could change the policy that applies to them, because of the place of its file.

use super::PolicyFile;
use crate::io::users::{self, User};
use rustix::process::getuid;
use shim::protocol::Account;
use std::fs::{self, Metadata};
use std::os::unix::fs::MetadataExt;
use std::path::Path;
use trust::policy::Sandbox;

/// A folder that the standard sandbox closes even to root, if the kernel has Landlock.
const CLOSED: &str = "/etc";
/// In a folder with this bit, only the owner of a file may remove the file. Source: inode(7).
const STICKY: u32 = 0o1000;
const ROOT: u32 = 0;

impl PolicyFile {
    /// If the user that programs of this node run as could change or remove this policy, returns that user. Blocks.
    #[must_use]
    pub fn could_be_changed_by(&self) -> Option<String> {
        let named = self.policy.user().and_then(|user| users::named(user).ok().flatten());
        let own = || User {
            name: users::own_name(),
            home: String::new(),
            account: Account { uid: getuid().as_raw(), gid: rustix::process::getgid().as_raw(), groups: Vec::new() },
        };
        let user = named.unwrap_or_else(own);
        let is_closed = self.policy.sandbox() == Sandbox::Standard && self.path.starts_with(CLOSED);
        let may = !(is_closed && super::has_landlock()) && can_change(&self.path, &user.account);
        may.then_some(user.name)
    }
}

/// Returns whether a user owns a file, or may write to the file or to one of its parent folders. Links are resolved.
fn can_change(path: &Path, user: &Account) -> bool {
    let real = fs::canonicalize(path).unwrap_or_else(|_gone| path.to_owned());
    // The parent folders of the link count as well: a user who may write to them could change where it leads.
    let folders = real.ancestors().skip(1).chain(path.ancestors().skip(1));
    let of = |path: &Path| fs::metadata(path).ok();
    let file = of(&real).is_some_and(|file| user.uid == ROOT || file.uid() == user.uid || writes(&file, user));
    file || folders.filter_map(of).any(|folder| opens(&folder, user))
}

/// Returns whether a user can replace the file of another user in a folder.
fn opens(folder: &Metadata, user: &Account) -> bool {
    folder.uid() == user.uid || (folder.mode() & STICKY == 0 && writes(folder, user))
}

fn writes(what: &Metadata, user: &Account) -> bool {
    let is_of_group = what.gid() == user.gid || user.groups.contains(&what.gid());
    what.mode() & 0o002 != 0 || (is_of_group && what.mode() & 0o020 != 0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::Permissions;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn who_owns_or_may_write_the_file_or_a_folder_above_it_can_change_it() {
        let folder = std::env::temp_dir().join(format!("dca-place-{}", std::process::id()));
        let file = folder.join("below/policy.toml");
        fs::create_dir_all(folder.join("below")).unwrap();
        fs::write(&file, "").unwrap();
        let own = fs::metadata(&file).unwrap();
        let account = |uid, gid| Account { uid, gid, groups: vec![own.gid() + 2] };
        let stranger = account(own.uid() + 1, own.gid() + 1);
        let check = |below: u32, file_mode: u32, user: &Account, expected: bool| {
            fs::set_permissions(folder.join("below"), Permissions::from_mode(below)).unwrap();
            fs::set_permissions(&file, Permissions::from_mode(file_mode)).unwrap();
            assert_eq!(can_change(&file, user), expected, "{below:o} {file_mode:o} {user:?}");
        };
        check(0o755, 0o644, &account(own.uid(), own.gid()), true);
        check(0o755, 0o644, &account(ROOT, 0), true);
        check(0o755, 0o644, &stranger, false);
        check(0o755, 0o646, &stranger, true);
        check(0o777, 0o644, &stranger, true);
        check(0o1777, 0o644, &stranger, false);
        check(0o775, 0o644, &stranger, false);
        check(0o775, 0o644, &account(own.uid() + 1, own.gid()), true);
        std::os::unix::fs::symlink(folder.join("below"), folder.join("link")).unwrap();
        assert!(!can_change(&folder.join("link/policy.toml"), &stranger));
        fs::set_permissions(&folder, Permissions::from_mode(0o777)).unwrap();
        assert!(can_change(&folder.join("link/policy.toml"), &stranger), "the link could lead elsewhere");
        fs::remove_dir_all(&folder).unwrap();
    }
}
