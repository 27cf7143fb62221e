//! Finds the program of a command, and the reason why the kernel would refuse it, before any program of a deployment runs.

use crate::logic::executable::{BEGIN_SIZE, Elf, Format, Piece, Script, format};
use comms::io::file;
use language::plan::Environment;
use rustix::fs::{Access, MemfdFlags, StatVfsMountFlags, access, memfd_create, statvfs};
use rustix::io::Errno;
use std::ffi::{OsStr, OsString};
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::AsRawFd;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The most interpreters in a chain: a script whose interpreter is a script, and so on. Source: execve(2), ELOOP.
const INTERPRETERS_MAX: usize = 4;
/// The longest table of program headers and the longest path of a loader that are read, in bytes.
const PIECE_MAX: u64 = 64 << 10;
/// The program that finds an interpreter by its name.
const ENV: &str = "env";

/// Returns the file that a command executes, so that a spec can be refused before anything runs.
///
/// # Errors
/// The file does not exist, this user may not execute it, or this kernel cannot execute it.
pub fn check_executable(command: &[String], environment: &Environment) -> io::Result<PathBuf> {
    let name = command.first().map_or("", String::as_str);
    let path = environment.variables.get("PATH").map(OsString::from).or_else(|| std::env::var_os("PATH"));
    let path = path.unwrap_or_default();
    // A relative path is relative to the folder of the program.
    let directory = Path::new(environment.directory.as_deref().unwrap_or_default());
    let found = if name.contains('/') { vec![directory.join(name)] } else { on_path(name, &path) };
    let Some(file) = found.first().filter(|file| file.is_file()) else {
        let why = match found.first().map(|file| file.metadata()) {
            Some(Ok(metadata)) if metadata.is_dir() => format!("`{name}` is a folder, not a program"),
            Some(Ok(_)) => format!("`{name}` is not a regular file, so it is not a program"),
            Some(Err(_)) if Path::new(name).is_relative() => {
                let folder =
                    std::path::absolute(directory).or_else(|_empty| std::env::current_dir()).unwrap_or_default();
                format!("no program is at `{name}` in `{}`, where it would run", folder.display())
            }
            Some(Err(_)) | None => format!("there is no program `{name}`"),
        };
        return Err(io::Error::new(io::ErrorKind::NotFound, why));
    };
    let refused = |why: String| io::Error::new(io::ErrorKind::PermissionDenied, format!("`{name}` {why}"));
    check_permission(file).map_err(refused)?;
    check_format(file, &path, INTERPRETERS_MAX).map_err(refused)?;
    Ok(file.clone())
}

/// Returns the files with a name in the folders of the search path.
fn on_path(name: &str, path: &OsStr) -> Vec<PathBuf> {
    std::env::split_paths(path).map(|folder| folder.join(name)).filter(|file| file.is_file()).collect()
}

fn check_permission(file: &Path) -> Result<(), String> {
    if access(file, Access::EXEC_OK).is_ok() {
        return Ok(());
    }
    let is_closed = statvfs(file).is_ok_and(|found| found.f_flag.contains(StatVfsMountFlags::NOEXEC));
    Err(if is_closed {
        "is on a file system that is mounted with `noexec`, so it cannot be executed".to_owned()
    } else {
        "is not executable by this user".to_owned()
    })
}

/// If the content of a file shows why the kernel cannot execute it, returns an error with this reason. `search` is the
/// search path for programs.
fn check_format(path: &Path, search: &OsStr, interpreters: usize) -> Result<(), String> {
    // If this user may not read the file, the kernel may still execute it.
    let Ok(file) = file::opened(path) else { return Ok(()) };
    let mut begin = Vec::new();
    if (&file).take(BEGIN_SIZE as u64).read_to_end(&mut begin).is_err() {
        return Ok(());
    }
    match format(&begin) {
        Format::Empty => Err("is empty".to_owned()),
        Format::Script(script) => check_script(&script, search, interpreters),
        Format::Elf(elf) => check_program(&file, elf, &begin),
        Format::Unknown if is_taken(&begin) => Ok(()),
        Format::Unknown => {
            Err("is not a program for this kernel; the first line of a script is `#!` and its interpreter, \
                                such as `#!/bin/sh`"
                .to_owned())
        }
    }
}

fn check_script(script: &Script, search: &OsStr, interpreters: usize) -> Result<(), String> {
    let Script { interpreter, argument, has_carriage_return } = script;
    if interpreter.is_empty() {
        return Err("names no interpreter after `#!` in its first line".to_owned());
    }
    if *has_carriage_return {
        return Err(
            "ends its lines as Windows does, with CR and LF: the kernel takes the CR for a part of the interpreter's \
                    name; `dos2unix` or `sed -i 's/\\r$//'` changes that"
                .to_owned(),
        );
    }
    let path = Path::new(interpreter);
    let of = |why: String| format!("has the interpreter `{interpreter}` in its first line, which {why}");
    if !path.is_file() {
        return Err(of("is not there".to_owned()));
    }
    check_permission(path).map_err(of)?;
    if interpreters == 0 {
        return Err(of("has too many interpreters of its own".to_owned()));
    }
    check_format(path, search, interpreters - 1).map_err(of)?;
    let is_name = !argument.is_empty() && !argument.starts_with('-') && !argument.contains(['=', ' ', '\t', '/']);
    if path.file_name() == Some(OsStr::new(ENV))
        && is_name
        && !on_path(argument, search).iter().any(|file| file.is_file())
    {
        return Err(of(format!("finds no program `{argument}` in `PATH`")));
    }
    Ok(())
}

fn check_program(file: &File, elf: Elf, begin: &[u8]) -> Result<(), String> {
    if !elf.is_executable() {
        return Err("is an object file or a core, not a program".to_owned());
    }
    if this().is_some_and(|this| !elf.is_for_processor_of(&this)) {
        let of = |elf: Elf| elf.processor();
        return if is_taken(begin) {
            Ok(())
        } else {
            Err(format!("is a program for {}, and this machine has {}", of(elf), this().map_or_else(String::new, of)))
        };
    }
    let loader = piece(file, elf.headers()).and_then(|headers| piece(file, elf.loader(&headers)?));
    let loader = loader.map(|path| path.strip_suffix(b"\0").unwrap_or(&path).to_vec());
    match loader.as_deref().map(|path| Path::new(OsStr::from_bytes(path))) {
        Some(loader) if !loader.is_file() => Err(format!(
            "needs the loader `{}`, which is not on this machine: it was built for another system or another C library",
            loader.display()
        )),
        _ => Ok(()),
    }
}

/// Returns the header of the running executable, which is for this machine.
fn this() -> Option<Elf> {
    let begin =
        piece(&file::opened(Path::new("/proc/self/exe")).ok()?, Piece { offset: 0, length: BEGIN_SIZE as u64 })?;
    if let Format::Elf(elf) = format(&begin) { Some(elf) } else { None }
}

/// Reads a piece of a file. Returns nothing if the file has no such piece, or if the piece is too long.
fn piece(file: &File, Piece { offset, length }: Piece) -> Option<Vec<u8>> {
    let mut bytes = vec![0; usize::try_from(length).ok().filter(|_| length <= PIECE_MAX)?];
    file.read_exact_at(&mut bytes, offset).ok().map(|()| bytes)
}

/// Asks the kernel whether it can execute files with this beginning, for example with an emulator. The kernel is given a
/// file with only this beginning. If it fails with another error than `ENOEXEC`, the file itself is tried later.
fn is_taken(begin: &[u8]) -> bool {
    let tried = || -> io::Result<()> {
        let mut file = File::from(memfd_create("dca-trial", MemfdFlags::CLOEXEC)?);
        file.write_all(begin)?;
        let path = format!("/proc/self/fd/{}", file.as_raw_fd());
        let mut trial = Command::new(path);
        trial.env_clear().stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        trial.status().map(drop)
    };
    tried().err().and_then(|error| error.raw_os_error()) != Some(Errno::NOEXEC.raw_os_error())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{self, Permissions};
    use std::os::unix::fs::PermissionsExt;

    /// Each problem is found before any program runs, and is reported with its cause.
    #[test]
    fn what_the_kernel_cannot_execute_is_refused_with_the_cause() {
        let folder = std::env::temp_dir().join(format!("dca-executable-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let check = |content: &[u8]| {
            let path = folder.join("program");
            fs::write(&path, content).unwrap();
            fs::set_permissions(&path, Permissions::from_mode(0o755)).unwrap();
            let name = path.display().to_string();
            let why = check_executable(std::slice::from_ref(&name), &Environment::default())
                .err()
                .map(|error| error.to_string());
            why.unwrap_or_default().replace(&format!("`{name}` "), "")
        };
        let mut own = Vec::new();
        File::open("/proc/self/exe").unwrap().take(1 << 16).read_to_end(&mut own).unwrap();
        assert_eq!(check(&own), "");
        assert_eq!(check(b"#!/bin/sh\necho fine\n"), "");
        assert_eq!(check(b"#!/usr/bin/env sh\necho fine\n"), "");
        assert_eq!(check(b""), "is empty");
        assert!(check(b"echo no first line\n").starts_with("is not a program for this kernel"));
        assert!(check(b"#!/bin/sh\r\necho\r\n").starts_with("ends its lines as Windows does"));
        assert_eq!(
            check(b"#!/nonexistent/interp\n"),
            "has the interpreter `/nonexistent/interp` in its first line, which is not there"
        );
        assert_eq!(
            check(b"#!/usr/bin/env no-such-program\n"),
            "has the interpreter `/usr/bin/env` in its first line, which finds no program `no-such-program` in `PATH`"
        );
        assert!(check(b"#!\n").starts_with("names no interpreter"));
        let mut foreign = own.clone();
        // The processor is SPARC, for which nothing on this machine executes programs.
        (foreign[18], foreign[19]) = (43, 0);
        assert!(check(&foreign).starts_with("is a program for processor number 43, and this machine has "));
        let mut object = own.clone();
        object[16] = 1;
        assert_eq!(check(&object), "is an object file or a core, not a program");
        if let Format::Elf(elf) = format(&own[..BEGIN_SIZE])
            && let Some(loader) = elf.loader(&own[64..4096])
        {
            let mut other = own;
            let offset = usize::try_from(loader.offset).unwrap();
            other[offset..offset + 4].copy_from_slice(b"/no/");
            assert!(check(&other).starts_with("needs the loader `/no/"), "{}", check(&other));
        }
        fs::remove_dir_all(&folder).unwrap();
    }

    /// The module of a program can set the folder of the program and its search path.
    #[test]
    fn a_program_is_looked_for_where_it_will_run() {
        let folder = std::env::temp_dir().join(format!("dca-executable-where-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let path = folder.join("here-alone");
        fs::write(&path, "#!/bin/sh\n").unwrap();
        fs::set_permissions(&path, Permissions::from_mode(0o755)).unwrap();
        let text = folder.display().to_string();
        let (variables, directory) = ([("PATH".to_owned(), text.clone())].into(), Some(text));
        let module = Environment { variables, directory, ..Environment::default() };
        for (name, is_there) in [("./here-alone", true), ("here-alone", true), ("sh", false), ("/bin/sh", true)] {
            let command = [name.to_owned()];
            assert_eq!(check_executable(&command, &module).is_ok(), is_there, "{name}");
            let elsewhere = check_executable(&command, &Environment::default()).is_ok();
            assert_eq!(elsewhere, !name.contains("alone"), "{name}");
        }
        let why = check_executable(&["./absent".to_owned()], &module).unwrap_err().to_string();
        assert_eq!(why, format!("no program is at `./absent` in `{}`, where it would run", folder.display()));
        fs::remove_dir_all(&folder).unwrap();
    }
}
