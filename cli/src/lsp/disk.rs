//! Converts between paths and the URIs of an editor, and finds the specs in folders.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};

/// The most specs in the open folders that are searched for a name.
const SPECS_MAX: usize = 2000;
/// The most folders that are searched for specs.
const FOLDERS_MAX: usize = 10_000;
/// The most entries of one folder that are read.
const ENTRIES_MAX: usize = 10_000;

/// Returns the path of a URI. A URI that names no file is returned unchanged.
pub(super) fn path(uri: &str) -> String {
    let Some(rest) = uri.strip_prefix("file://") else { return uri.to_owned() };
    // A host may come before the path. It can only be this host.
    let encoded = rest.find('/').map_or(rest, |slash| &rest[slash..]).as_bytes();
    let mut bytes = Vec::with_capacity(encoded.len());
    let mut at = 0;
    while at < encoded.len() {
        let digits = encoded.get(at + 1..at + 3).and_then(|digits| std::str::from_utf8(digits).ok());
        match digits.and_then(|digits| u8::from_str_radix(digits, 16).ok()) {
            Some(byte) if encoded[at] == b'%' => {
                bytes.push(byte);
                at += 3;
            }
            Some(_) | None => {
                bytes.push(encoded[at]);
                at += 1;
            }
        }
    }
    String::from_utf8(bytes).unwrap_or_else(|_bytes| uri.to_owned())
}

/// Returns the URI of a path.
pub(super) fn uri(path: &str) -> String {
    if !path.starts_with('/') {
        return path.to_owned();
    }
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/-._~".contains(&byte);
    let encoded = path.bytes().map(|byte| match plain(byte) {
        true => char::from(byte).to_string(),
        false => format!("%{byte:02X}"),
    });
    format!("file://{}", encoded.collect::<String>())
}

/// Returns the specs in some folders, sorted by path. Leaves out hidden folders and folders of build tools.
pub(super) fn specs(folders: &[PathBuf]) -> Vec<String> {
    let mut found = Vec::new();
    let mut next: VecDeque<PathBuf> = folders.iter().cloned().collect();
    let mut looked = 0;
    while let Some(folder) = next.pop_front().filter(|_| looked < FOLDERS_MAX && found.len() < SPECS_MAX) {
        looked += 1;
        let Ok(entries) = fs::read_dir(&folder) else { continue };
        let mut paths: Vec<PathBuf> = entries.take(ENTRIES_MAX).filter_map(|entry| Some(entry.ok()?.path())).collect();
        paths.sort();
        for path in paths {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            // Links are not followed, because a link may lead back to an outer folder.
            let is_folder = fs::symlink_metadata(&path).is_ok_and(|kind| kind.is_dir());
            if is_folder && !name.starts_with('.') && !["target", "node_modules"].contains(&name.as_str()) {
                next.push_back(path);
            } else if !is_folder && Path::new(&name).extension().is_some_and(|extension| extension == "dca") {
                found.push(path.to_string_lossy().into_owned());
            }
        }
    }
    found.truncate(SPECS_MAX);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_and_uris_are_two_names_of_one_thing() {
        for plain in ["/a/door.dca", "/a b/ö#%.dca", "untitled:1"] {
            assert_eq!(path(&uri(plain)), plain);
        }
        assert_eq!(uri("/a b"), "file:///a%20b");
        assert_eq!((path("file://localhost/a%3a").as_str(), path("file:///%zz%").as_str()), ("/a:", "/%zz%"));
        assert_eq!(path("file:///%ff"), "file:///%ff");
    }
}
