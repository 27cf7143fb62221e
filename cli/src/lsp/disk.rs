//! File names as editors write them, and the specs of a folder.

use std::collections::VecDeque;
use std::fs;
use std::path::{Path, PathBuf};

/// The most specs of the open folders that are looked through for a name.
const SPECS_MAX: usize = 2000;
/// The most folders that are looked into for them.
const FOLDERS_MAX: usize = 10_000;
/// The most names of one folder that are looked at.
const ENTRIES_MAX: usize = 10_000;

/// Returns the path that a URI names; a URI that names no file stands for itself.
pub(super) fn path(uri: &str) -> String {
    let Some(rest) = uri.strip_prefix("file://") else { return uri.to_owned() };
    // Between the slashes there may be a host, which can only be this one.
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

/// Returns the specs below some folders, in the order of their paths; hidden folders and those of build tools are left out.
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
            // A link may lead back to where one came from.
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
