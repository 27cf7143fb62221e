//! The secrets of a program: files in memory, which are on no disk, have mode 0400 and cannot be changed any more. The
//! program inherits them open, and finds their paths in its arguments.
//!
//! Their values come on standard input before any order. They are in no argument and no environment, which others could
//! read.

use rustix::fs::{MemfdFlags, Mode, OFlags, SealFlags, fchmod, fchown, fcntl_add_seals, memfd_create, open};
use rustix::io::{Errno, FdFlags, fcntl_setfd, read};
use rustix::process::{Gid, Uid};
use shim::protocol::{Account, SECRET_MAX, ShimStart};
use std::fs::File;
use std::io::{self, Write as _};
use std::os::fd::{AsRawFd as _, OwnedFd};
use zeroize::Zeroizing;

/// Reads the secrets of a start, and puts their paths into its command. The files exist as long as they are held.
pub(crate) fn take(start: &mut ShimStart) -> io::Result<Vec<OwnedFd>> {
    let mut files = Vec::new();
    for word in std::mem::take(&mut start.secrets) {
        let file = keep(&received()?, start.sandbox.user.as_ref())?;
        let word = usize::try_from(word).ok().and_then(|word| start.command.get_mut(word));
        word.ok_or(io::ErrorKind::InvalidInput)?.push_str(&path(&file));
        files.push(file);
    }
    Ok(files)
}

fn path(file: &OwnedFd) -> String {
    format!("/proc/self/fd/{}", file.as_raw_fd())
}

/// Returns the next secret on standard input.
fn received() -> io::Result<Zeroizing<Vec<u8>>> {
    let mut length = [0; size_of::<u32>()];
    fill(&mut length)?;
    let length = usize::try_from(u32::from_le_bytes(length)).unwrap_or(usize::MAX);
    if length > SECRET_MAX {
        return Err(io::ErrorKind::InvalidData.into());
    }
    let mut value = Zeroizing::new(vec![0; length]);
    fill(&mut value)?;
    Ok(value)
}

/// Reads exactly so many bytes, so that no more than these end up in a buffer.
fn fill(mut bytes: &mut [u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        match read(io::stdin(), &mut *bytes) {
            Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
            Ok(count) => bytes = bytes.split_at_mut(count).1,
            Err(Errno::INTR) => {}
            Err(error) => return Err(error.into()),
        }
    }
    Ok(())
}

/// Returns a file in memory with this content, sealed against changes and open for reading in the program. It belongs
/// to the user of the program.
fn keep(value: &[u8], user: Option<&Account>) -> io::Result<OwnedFd> {
    let memory = memfd_create("dca-secret", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
    let mut file = File::from(memory);
    file.write_all(value)?;
    fchmod(&file, Mode::RUSR)?;
    fcntl_add_seals(&file, SealFlags::WRITE | SealFlags::GROW | SealFlags::SHRINK | SealFlags::SEAL)?;
    let memory = OwnedFd::from(file);
    if let Some(Account { uid, gid, .. }) = user {
        fchown(&memory, Some(Uid::from_raw(*uid)), Some(Gid::from_raw(*gid)))?;
    }
    let readable = open(path(&memory), OFlags::RDONLY | OFlags::CLOEXEC, Mode::empty())?;
    fcntl_setfd(&readable, FdFlags::empty())?;
    Ok(readable)
}
