//! Removes the sockets of deployments that are over.

use super::{CONTROL_SOCKET, DATA_FILES, other, remove_leftover};
use shim::process_record::RECORD_FILE;
use shim::protocol::{BEAT_FILE, SOCKET_FILE};
use std::fs;
use std::path::{Path, PathBuf};

/// Removes unused sockets of a deployment: the sockets of ended programs in its folder. With the last of them, also
/// removes the socket between the programs and the node. `node` is the folder of the node. Blocks.
pub(crate) fn remove_sockets(node: &Path, deployment: &Path) {
    let own = fs::read_dir(deployment).into_iter().flatten().flatten().map(|entry| entry.path());
    let (running, ended): (Vec<PathBuf>, Vec<PathBuf>) =
        own.filter(|path| path.is_dir()).partition(|process| process.join(RECORD_FILE).exists());
    let names = DATA_FILES.iter().chain(&[SOCKET_FILE, BEAT_FILE]);
    let of_programs = ended.iter().flat_map(|process| names.clone().map(move |name| process.join(name)));
    let of_all = running.is_empty().then(|| deployment.join(CONTROL_SOCKET));
    for path in of_programs.chain(of_all) {
        for path in [other(node, &path), path] {
            if let Err(error) = remove_leftover(&path) {
                tracing::debug!(%error, ?path, "a socket of an old deployment stays");
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::of_others;
    use super::*;

    #[test]
    fn sockets_go_with_the_programs_that_have_ended() {
        let node = std::env::temp_dir().join(format!("dca-sockets-{}", std::process::id()));
        let deployment = node.join("door.1");
        let (ended, running) = (deployment.join("1"), deployment.join("2"));
        let others = other(&node, &ended);
        for folder in [&ended, &running, &others] {
            fs::create_dir_all(folder).unwrap();
            for name in DATA_FILES.iter().chain(&[SOCKET_FILE, BEAT_FILE, "out.log"]) {
                fs::write(folder.join(name), "").unwrap();
            }
        }
        fs::write(running.join(RECORD_FILE), "").unwrap();
        fs::write(deployment.join(CONTROL_SOCKET), "").unwrap();
        let count = |folder: &Path| fs::read_dir(folder).unwrap().flatten().filter(|one| one.path().is_file()).count();
        remove_sockets(&node, &deployment);
        assert_eq!((count(&ended), count(&others), count(&running), count(&deployment)), (1, 1, 7, 1));
        fs::remove_file(running.join(RECORD_FILE)).unwrap();
        remove_sockets(&node, &deployment);
        assert_eq!((count(&ended), count(&running), count(&deployment)), (1, 1, 0));
        fs::remove_dir_all(&node).unwrap();
        fs::remove_dir_all(of_others(&node)).unwrap();
    }
}
