//! Reads files that a user or an entry of a folder names. Reads only regular files up to a limit, and never waits.
//!
//! An entry of a folder may be of any kind. Opening a named pipe waits for a writer, a device may have no end, and a
//! regular file may be larger than the memory.

use anyhow::anyhow;
use comms::io::file::bounded;
pub use comms::io::file::bytes;
use node::console::Failure;
use std::io::{self, ErrorKind};
use std::path::Path;

/// The largest size of a spec, script or import, in bytes: the compiler takes no longer text.
pub const TEXT_MAX: usize = language::SOURCE_MAX;

/// Returns the text of a regular file of at most `bytes_max` bytes.
///
/// # Errors
/// The same as for [`bytes`], or the content is not UTF-8 text.
pub fn text(path: &Path, bytes_max: usize) -> io::Result<String> {
    utf8(bytes(path, bytes_max)?)
}

/// Returns the text on standard input, up to its end. Standard input may be of any kind.
///
/// # Errors
/// Standard input cannot be read, has more than `bytes_max` bytes, or is not UTF-8 text.
pub fn standard_input(bytes_max: usize) -> io::Result<String> {
    utf8(bounded(io::stdin().lock(), bytes_max)?)
}

/// Returns whether two paths lead to the same existing file.
pub fn are_same(one: &Path, other: &Path) -> bool {
    let real = |path: &Path| path.canonicalize().ok();
    real(one).is_some_and(|one| Some(one) == real(other))
}

/// Checks that a command does not overwrite a file that it reads.
///
/// # Errors
/// `output` is one of `inputs`.
pub fn not_over<'a>(output: &Path, inputs: impl IntoIterator<Item = &'a Path>) -> Result<(), Failure> {
    match inputs.into_iter().find(|input| are_same(output, input)) {
        Some(_) => {
            let name = output.display();
            Err(Failure::Usage(anyhow!("this command reads `{name}`; give the output another name")))
        }
        None => Ok(()),
    }
}

fn utf8(bytes: Vec<u8>) -> io::Result<String> {
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        io::Error::new(ErrorKind::InvalidData, format!("it is not UTF-8 text: byte {at} is not valid"))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::fs::{CWD, FileType, Mode, mknodat};
    use std::fs::{self, File};
    use std::os::unix::net::UnixListener;
    use std::path::PathBuf;

    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("dca-named-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        folder
    }

    fn why(path: &Path) -> String {
        text(path, 1 << 20).unwrap_err().to_string()
    }

    #[test]
    fn only_regular_files_are_read() {
        let folder = folder("kinds");
        let path = |name: &str| folder.join(name);
        mknodat(CWD, path("pipe"), FileType::Fifo, Mode::RUSR | Mode::WUSR, 0).unwrap();
        std::os::unix::fs::symlink(path("pipe"), path("link")).unwrap();
        std::os::unix::fs::symlink(path("text"), path("good")).unwrap();
        let _socket = UnixListener::bind(path("socket")).unwrap();
        fs::write(path("text"), "a").unwrap();
        fs::write(path("latin"), [b'a', 0xff]).unwrap();
        assert_eq!(text(&path("good"), 1).unwrap(), "a");
        assert_eq!(why(&path("pipe")), "it is a pipe; only regular files are read");
        assert_eq!(why(&path("link")), "it is a pipe; only regular files are read");
        assert_eq!(why(&path("socket")), "it is a socket; only regular files are read");
        assert_eq!(why(Path::new("/dev/zero")), "it is a device; only regular files are read");
        assert_eq!(why(&folder), "Is a directory (os error 21)");
        assert_eq!(why(&path("none")), "No such file or directory (os error 2)");
        assert_eq!(why(&path("latin")), "it is not UTF-8 text: byte 1 is not valid");
        fs::remove_dir_all(folder).unwrap();
    }

    #[test]
    fn two_names_of_one_file_are_the_same() {
        let folder = folder("same");
        let (file, link) = (folder.join("a"), folder.join("link"));
        fs::write(&file, "a").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert!(are_same(&file, &folder.join(".").join("a")) && are_same(&file, &link));
        assert!(!are_same(&file, &folder) && !are_same(&folder.join("b"), &folder.join("b")), "there is no `b`");
        fs::remove_dir_all(folder).unwrap();
    }

    /// The size that a file reports may be wrong: some files report none, and others a terabyte without a block on the disk.
    #[test]
    fn a_limit_holds_whatever_the_file_says_of_itself() {
        let folder = folder("limit");
        let path = folder.join("long");
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        assert_eq!(why(&path), "it is longer than 1 MiB");
        assert_eq!(text(&path, 1 << 16).unwrap_err().to_string(), "it is longer than 64 KiB");
        File::create(&path).unwrap().set_len(1 << 20).unwrap();
        assert_eq!(bytes(&path, 1 << 20).unwrap().len(), 1 << 20);
        assert!(text(Path::new("/proc/self/status"), 1 << 20).unwrap().contains("Pid:"));
        fs::remove_dir_all(folder).unwrap();
    }
}
