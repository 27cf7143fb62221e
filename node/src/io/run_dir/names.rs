//! The names of the folders of deployments.

/// How many bytes of a deployment's name are in the name of its folder.
pub(super) const NAME_MAX: usize = 24;
/// How many of these bytes are a hash, if the whole name does not fit.
const HASH_LENGTH: usize = 8;

/// Returns the folder name of a deployment. The name of a deployment comes from the network, so it must not lead to
/// another folder. Sockets also need short paths. If the name is changed, it ends with a hash of the whole name. So two
/// deployments with the same epoch from two homes never share a folder.
pub(super) fn folder_name(name: &str) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() || "_-".contains(c) { c } else { '_' };
    let whole: String = name.chars().map(plain).take(NAME_MAX).collect();
    if whole == name {
        return whole;
    }
    let hash = &blake3::hash(name.as_bytes()).to_hex()[..HASH_LENGTH];
    let start: String = whole.chars().take(NAME_MAX - HASH_LENGTH - 1).collect();
    format!("{start}-{hash}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_deployments_have_one_folder() {
        assert_eq!(folder_name("door_opening"), "door_opening");
        let names = ["mobile_manipulator_north_1", "mobile_manipulator_north_2", "a/b", "a_b", "a.b", "..", "", "né"];
        let folders: Vec<String> = names.iter().map(|name| folder_name(name)).collect();
        for (name, folder) in names.iter().zip(&folders) {
            assert!(folder.len() <= NAME_MAX && !folder.contains(['/', '.']), "{name}: {folder}");
            assert_eq!(folders.iter().filter(|other| *other == folder).count(), 1, "{name}: {folder}");
        }
    }
}
