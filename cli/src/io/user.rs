//! The user who runs this command, for the records.

/// Returns the name of the user and of the host, such as `ann@c1`.
pub(crate) fn name_and_host() -> String {
    format!("{}@{}", name(), rustix::system::uname().nodename().to_string_lossy())
}

/// Returns the name of the user, or the user id if `/etc/passwd` does not list the user.
pub(crate) fn name() -> String {
    let uid = rustix::process::getuid().as_raw().to_string();
    let users = std::fs::read_to_string("/etc/passwd").unwrap_or_default();
    let named = |line: &str| {
        let mut fields = line.split(':');
        let (name, id) = (fields.next()?, fields.nth(1)?);
        (id == uid).then(|| name.to_owned())
    };
    users.lines().find_map(named).unwrap_or(uid.clone())
}
