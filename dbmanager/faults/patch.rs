//! Injected faults: bugs that the simulation has to find. The sources do not have these bugs. Each is a patch in `patches.txt`.
//! All patches are applied to a copy of the sources, in which [`planted`](../fault.rs) switches one fault on.
//!
//! A patch names its fault. For each place it gives three things: the file below `src/logic/`, a text that occurs in exactly one
//! line before the file's tests, and the replacement of that text. Later patches may change the replacements of earlier ones.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;

const PATCHES: &str = include_str!("patches.txt");
/// The module of the copy that switches a fault on.
const SWITCH: &str = include_str!("fault.rs");

/// An injected fault.
#[derive(Debug)]
pub(crate) struct Fault {
    pub(crate) name: &'static str,
    places: Vec<Place>,
}

#[derive(Debug)]
struct Place {
    file: &'static str,
    find: &'static str,
    replacement: &'static str,
}

/// Returns every fault.
pub(crate) fn all() -> Vec<Fault> {
    PATCHES.split("\n\n").map(str::trim_end).filter(|text| !text.is_empty()).map(fault).collect()
}

fn fault(text: &'static str) -> Fault {
    let (head, places) = text.split_once('\n').unwrap_or((text, ""));
    let (name, _story) = head.split_once(": ").unwrap_or_else(|| panic!("`{head}` has no name"));
    let lines: Vec<&str> = places.lines().map(str::trim_start).collect();
    let place = |lines: &[&'static str]| {
        let [file, find, replacement] = lines else { panic!("{name}: a place has three lines, not {lines:?}") };
        let text = |line: &'static str, sign| {
            line.strip_prefix(sign).unwrap_or_else(|| panic!("{name}: `{line}` does not begin with `{sign}`"))
        };
        Place { file, find: text(find, "- "), replacement: text(replacement, "+ ") }
    };
    Fault { name, places: lines.chunks(3).map(place).collect() }
}

/// Returns the sources with these faults, by file. The error is the place that a patch does not fit.
pub(crate) fn apply(faults: &[Fault], logic: &Path) -> Result<BTreeMap<&'static str, String>, String> {
    let mut files: BTreeMap<&str, String> = BTreeMap::new();
    for Fault { name, places } in faults {
        for Place { file, find, replacement } in places {
            let read = || fs::read_to_string(logic.join(file)).map_err(|error| format!("{name}: {file}: {error}"));
            let text = files.remove(file).map_or_else(read, Ok)?;
            let end = text.find("\n#[cfg(test)]\nmod tests").unwrap_or(text.len());
            let (code, tests) = text.split_at(end);
            let found = code.matches(find).count();
            if found != 1 {
                return Err(format!("{name}: `{find}` is {found} times in {file}, not once: mend faults/patches.txt"));
            }
            let replacement = replacement.replace("planted(", "crate::logic::fault::planted(");
            files.insert(file, code.replace(find, &replacement) + tests);
        }
    }
    Ok(files)
}

/// Writes a copy of this room with all faults.
///
/// # Errors
/// If a patch does not fit any more, or a file cannot be read or written.
pub(crate) fn write_copy(to: &Path) -> io::Result<()> {
    let room = Path::new(env!("CARGO_MANIFEST_DIR"));
    let house = room.parent().unwrap_or(room);
    for part in ["dbmanager/Cargo.toml", "dbmanager/src", "dbmanager/tests/all/simulation"] {
        copy(&house.join(part), &to.join(part))?;
    }
    copy(&house.join("Cargo.lock"), &to.join("Cargo.lock"))?;
    let manifest = fs::read_to_string(house.join("Cargo.toml"))?;
    let rest = manifest.find("[workspace.package]").unwrap_or(0);
    let head = "[workspace]\nresolver = \"3\"\nmembers = [\"dbmanager\"]\n\n";
    // The copy uses `comms` from this repository.
    let below = format!("path = \"{}\"", house.join("comms").display());
    let manifest = manifest[rest..].replace("path = \"comms\"", &below);
    write(&to.join("Cargo.toml"), &format!("{head}{manifest}"))?;
    let bench = to.join("dbmanager/benches/ratios/main.rs");
    write(&bench, "fn main() {}\n")?;
    write(&to.join("dbmanager/examples/planted.rs"), include_str!("planted.rs"))?;
    let logic = to.join("dbmanager/src/logic");
    for (file, text) in apply(&all(), &room.join("src/logic")).map_err(io::Error::other)? {
        write(&logic.join(file), &text)?;
    }
    let modules = fs::read_to_string(room.join("src/logic.rs"))?;
    write(&logic.with_extension("rs"), &format!("{modules}\n/// Which fault is switched on.\npub mod fault;\n"))?;
    write(&logic.join("fault.rs"), SWITCH)
}

fn copy(from: &Path, to: &Path) -> io::Result<()> {
    if from.is_dir() {
        return fs::read_dir(from)?.try_for_each(|entry| {
            let entry = entry?;
            copy(&entry.path(), &to.join(entry.file_name()))
        });
    }
    write(to, &fs::read_to_string(from)?)
}

/// Writes a file, unless it has this content already. An unchanged file is not compiled again.
fn write(path: &Path, text: &str) -> io::Result<()> {
    if fs::read_to_string(path).is_ok_and(|known| known == text) {
        return Ok(());
    }
    path.parent().map_or(Ok(()), fs::create_dir_all)?;
    fs::write(path, text)
}
