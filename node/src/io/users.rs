//! The users of this machine, according to its files. Source: passwd(5), group(5).

use anyhow::Context;
use comms::io::file;
use rustix::process::getuid;
use shim::protocol::Account;
use std::path::Path;

const USERS: &str = "/etc/passwd";
const GROUPS: &str = "/etc/group";
/// The longest of these files that is read, in bytes.
const FILE_MAX: usize = 4 << 20;

/// A user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct User {
    pub(crate) name: String,
    pub(crate) home: String,
    pub(crate) account: Account,
}

/// Returns a user with all of its groups; nothing if the machine has no such user.
///
/// # Errors
/// The files cannot be read.
pub(crate) fn named(name: &str) -> anyhow::Result<Option<User>> {
    let (users, groups) = (text(USERS)?, text(GROUPS)?);
    Ok(user(name, &users, &groups))
}

/// Returns the name of the user of this process, or the user id without a name.
pub(crate) fn own_name() -> String {
    let own = getuid().as_raw();
    let users = text(USERS).unwrap_or_default();
    let named = users.lines().find(|line| line.split(':').nth(2).is_some_and(|uid| uid.parse() == Ok(own)));
    named.and_then(|line| line.split(':').next()).map_or_else(|| own.to_string(), str::to_owned)
}

fn text(path: &str) -> anyhow::Result<String> {
    let bytes = file::bytes(Path::new(path), FILE_MAX).with_context(|| format!("reading `{path}`"))?;
    Ok(String::from_utf8_lossy(&bytes).into_owned())
}

fn user(name: &str, users: &str, groups: &str) -> Option<User> {
    let line = users.lines().find(|line| line.split(':').next() == Some(name))?;
    let fields: Vec<&str> = line.split(':').collect();
    let &[_, _, uid, gid, _, home, ..] = fields.as_slice() else { return None };
    let has_member =
        |line: &&str| line.split(':').nth(3).is_some_and(|members| members.split(',').any(|one| one == name));
    let groups = groups.lines().filter(has_member).filter_map(|line| line.split(':').nth(2)?.parse().ok()).collect();
    let account = Account { uid: uid.parse().ok()?, gid: gid.parse().ok()?, groups };
    Some(User { name: name.to_owned(), home: home.to_owned(), account })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_user_has_a_home_and_all_groups() {
        let users = "root:x:0:0:root:/root:/bin/sh\ndca-run:x:61184:61185:DCA,,,:/srv/dca:/usr/sbin/nologin\nbroken\n";
        let groups = "dialout:x:20:ann,dca-run\nvideo:x:44:dca-run\nroot:x:0:\nrun:x:9:dca\n";
        let account = Account { uid: 61184, gid: 61185, groups: vec![20, 44] };
        let expected = User { name: "dca-run".into(), home: "/srv/dca".into(), account };
        assert_eq!(user("dca-run", users, groups), Some(expected));
        assert_eq!((user("dca", users, groups), user("broken", users, groups)), (None, None));
        let root = named("root").unwrap().expect("every machine has one");
        assert_eq!((root.account.uid, root.account.gid), (0, 0));
    }
}
