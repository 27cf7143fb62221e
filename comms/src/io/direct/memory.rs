//! Memory that two programs share: a file without a name, mapped by both. The memory is gone once both
//! programs have ended, even if they were killed.
//!
//! This is the only unsafe module of the direct path. It never makes a reference to shared memory: it copies bytes in
//! and out. So if another program writes at the same time, this program reads bytes of some value, and there is no
//! undefined behaviour.

use crate::logic::decode::Source;
use rustix::fs::{MemfdFlags, SealFlags, fcntl_add_seals, fcntl_get_seals, fstat, ftruncate, memfd_create};
use rustix::io::Errno;
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::ptr::NonNull;

/// A mapping of shared memory that another program fills.
#[derive(Debug)]
pub struct Mapping {
    start: NonNull<libc::c_void>,
    size: usize,
}

/// A buffer that this program fills.
#[derive(Debug)]
pub struct Buffer {
    file: OwnedFd,
    mapping: Mapping,
}

/// Fills a buffer, piece by piece.
#[derive(Debug)]
pub struct Filler<'a> {
    buffer: &'a mut Buffer,
    /// The number of bytes to read, at most the length of the mapping.
    size: usize,
}

/// Copies bytes out of memory, each once, from their beginning.
#[derive(Debug)]
pub struct Reading<'a> {
    mapping: &'a Mapping,
    at: usize,
    size: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Access {
    Read,
    Write,
}

#[expect(unsafe_code, reason = "a mapping belongs to the process, not to a thread")]
// SAFETY: the pointer is used under `&self` to read, and under `&mut self` to write and to unmap.
unsafe impl Send for Mapping {}
#[expect(unsafe_code, reason = "as above")]
// SAFETY: under `&self` memory is only copied from.
unsafe impl Sync for Mapping {}

impl Buffer {
    /// Makes a buffer with room for `size` bytes.
    ///
    /// # Errors
    /// If the system has no memory for the buffer, or does not support such files.
    pub fn new(size: usize) -> io::Result<Self> {
        let flags = MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING;
        let file = memfd_create("dca-wire", flags)?;
        ftruncate(&file, u64::try_from(size).map_err(|_too_long| Errno::FBIG)?)?;
        // No process can shrink the file, so no access ends in SIGBUS.
        fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW)?;
        let mapping = Mapping::new(file.as_fd(), size, Access::Write)?;
        // From now on no other process can map the file for writing. Linux before 5.1 has no such seal; there,
        // consumers still do not write.
        match fcntl_add_seals(&file, SealFlags::FUTURE_WRITE | SealFlags::SEAL) {
            Ok(()) | Err(Errno::INVAL) => Ok(Self { file, mapping }),
            Err(error) => Err(error.into()),
        }
    }

    /// Returns how many bytes it has room for.
    pub fn size(&self) -> usize {
        self.mapping.size
    }

    /// Returns the file, to be handed to consumers.
    pub fn file(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }

    /// Puts bytes at the beginning; returns whether there is room.
    pub fn write(&mut self, bytes: &[u8]) -> bool {
        self.filler().put(bytes)
    }

    /// Returns a filler that writes from its beginning.
    pub fn filler(&mut self) -> Filler<'_> {
        Filler { buffer: self, size: 0 }
    }

    /// Returns a copy of the first `size` bytes; none if the buffer is shorter.
    pub fn read(&self, size: usize) -> Option<Vec<u8>> {
        self.mapping.read(size)
    }
}

impl Filler<'_> {
    /// Appends bytes; returns whether there is room.
    #[inline]
    #[expect(unsafe_code, reason = "writes to mapped memory")]
    pub fn put(&mut self, bytes: &[u8]) -> bool {
        let mapping = &self.buffer.mapping;
        if bytes.len() > mapping.size - self.size {
            return false;
        }
        // SAFETY: the mapping is writable, it has room for these bytes behind the first `size` bytes, and no Rust
        // reference leads to it.
        unsafe {
            let to = mapping.start.cast::<u8>().as_ptr().add(self.size);
            std::ptr::copy_nonoverlapping(bytes.as_ptr(), to, bytes.len());
        }
        self.size += bytes.len();
        true
    }

    /// Returns how many bytes it has put.
    pub fn size(&self) -> usize {
        self.size
    }
}

impl Mapping {
    /// Maps a buffer that another program fills.
    ///
    /// # Errors
    /// If the file could be shortened while it is mapped, or the system has no room for the mapping.
    pub fn of(file: &OwnedFd) -> io::Result<Self> {
        if !fcntl_get_seals(file)?.contains(SealFlags::SHRINK) {
            return Err(Errno::PERM.into());
        }
        let size = usize::try_from(fstat(file)?.st_size).map_err(|_negative| Errno::INVAL)?;
        Self::new(file.as_fd(), size, Access::Read)
    }

    #[expect(unsafe_code, reason = "there is no safe call that maps a file")]
    fn new(file: BorrowedFd<'_>, size: usize, access: Access) -> io::Result<Self> {
        let protection = if access == Access::Write { libc::PROT_READ | libc::PROT_WRITE } else { libc::PROT_READ };
        // Maps all pages at once: separate page faults take longer than copying the content.
        let flags = libc::MAP_SHARED | libc::MAP_POPULATE;
        // SAFETY: a new mapping at a place of the kernel's choice touches no memory of this program.
        let start = unsafe { libc::mmap(std::ptr::null_mut(), size, protection, flags, file.as_raw_fd(), 0) };
        if start == libc::MAP_FAILED {
            return Err(io::Error::last_os_error());
        }
        Ok(Self { start: NonNull::new(start).ok_or(Errno::NOMEM)?, size })
    }

    /// Returns how many bytes it has.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Returns a copy of the first `size` bytes; none if the buffer is shorter.
    pub fn read(&self, size: usize) -> Option<Vec<u8>> {
        if size > self.size {
            return None;
        }
        let mut bytes = Vec::with_capacity(size);
        self.append(0, size, &mut bytes);
        Some(bytes)
    }

    /// Appends `size` bytes, beginning at `from`, to `to`; returns whether the buffer is long enough.
    #[expect(unsafe_code, reason = "reads from mapped memory")]
    fn append(&self, from: usize, size: usize, to: &mut Vec<u8>) -> bool {
        if from > self.size || size > self.size - from {
            return false;
        }
        to.reserve(size);
        // SAFETY: the mapping has at least `size` bytes behind `from`, and its file cannot be shortened. The vector has
        // room for `size` bytes behind its own, and all of them are written before its length includes them.
        unsafe {
            let start = self.start.cast::<u8>().as_ptr().add(from);
            std::ptr::copy_nonoverlapping(start, to.as_mut_ptr().add(to.len()), size);
            to.set_len(to.len() + size);
        }
        true
    }
}

impl<'a> Reading<'a> {
    /// Reads the first `size` bytes, or as many as there are.
    pub fn new(mapping: &'a Mapping, size: usize) -> Self {
        Self { mapping, at: 0, size: size.min(mapping.size) }
    }
}

impl Source for Reading<'_> {
    fn left(&self) -> usize {
        self.size - self.at
    }

    fn append(&mut self, size: usize, to: &mut Vec<u8>) -> bool {
        let is_there = size <= self.left() && self.mapping.append(self.at, size, to);
        self.at += if is_there { size } else { 0 };
        is_there
    }
}

impl Drop for Mapping {
    #[expect(unsafe_code, reason = "the counterpart of `new`")]
    fn drop(&mut self) {
        // SAFETY: it was mapped with this size, is unmapped once, and no reference to it is left.
        unsafe { libc::munmap(self.start.as_ptr(), self.size) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_one_side_writes_the_other_one_reads() {
        let mut buffer = Buffer::new(10_000).unwrap();
        assert!(buffer.write(b"abc") && !buffer.write(&[0; 10_001]));
        let other = Mapping::of(&buffer.file().try_clone_to_owned().unwrap()).unwrap();
        assert_eq!((other.read(3), other.read(10_001)), (Some(b"abc".to_vec()), None));
        assert!(buffer.write(b"xy"));
        assert_eq!(other.read(3), Some(b"xyc".to_vec()));
        let mut filler = buffer.filler();
        assert!(filler.put(b"1") && filler.put(b"") && filler.put(b"23"));
        assert_eq!((filler.size(), filler.put(&[0; 9998]), filler.put(&[0; 9997])), (3, false, true));
        assert_eq!((other.read(4), buffer.read(4)), (Some(b"123\0".to_vec()), Some(b"123\0".to_vec())));
        let (mut reading, mut bytes) = (Reading::new(&other, 3), b"x".to_vec());
        assert!(reading.append(2, &mut bytes) && !reading.append(2, &mut bytes) && reading.append(1, &mut bytes));
        assert_eq!((reading.left(), &*bytes), (0, &b"x123"[..]));
        assert_eq!(Reading::new(&other, usize::MAX).left(), other.size());
        drop(buffer);
        assert_eq!(other.read(2), Some(b"12".to_vec()), "it stays for as long as somebody has it");
    }

    #[test]
    fn what_could_be_cut_is_not_mapped() {
        let file = memfd_create("cut", MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING).unwrap();
        ftruncate(&file, 4096).unwrap();
        assert!(Mapping::of(&file).is_err());
    }
}
