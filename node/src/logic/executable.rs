//! How the kernel would execute a file, judged by its first bytes. Sources: execve(2), elf(5), fs/binfmt_script.c and
//! fs/binfmt_elf.c in Linux.

/// How many bytes the kernel reads to recognise the kind of a file.
pub const BEGIN_SIZE: usize = 256;
/// The first bytes of an executable in the format of Linux.
const ELF: &[u8] = b"\x7fELF";
/// The first bytes of a script.
const SCRIPT: &[u8] = b"#!";
/// Types of ELF files that can be executed: `ET_EXEC` and `ET_DYN`.
const EXECUTABLE: [u16; 2] = [2, 3];
/// The type of a program header that names the loader: `PT_INTERP`.
const LOADER: u64 = 3;
/// Processors that execute the programs of another processor, if the kernel is built with that support. The first pair:
/// x86-64 executes programs for i386; the second: AArch64 executes programs for ARM.
const COMPATIBLE: [(u16, u16); 2] = [(62, 3), (183, 40)];

/// The format of a file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Format {
    /// The file is empty.
    Empty,
    /// Text for an interpreter.
    Script(Script),
    /// A program for a processor.
    Elf(Elf),
    /// A file that the kernel does not execute by itself.
    Unknown,
}

/// The first line of a script.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Script {
    /// The path of its interpreter; empty if the line names none.
    pub interpreter: String,
    /// The rest of the line: one argument.
    pub argument: String,
    /// Whether the line ends with a carriage return. The kernel takes this character as a part of the last word.
    pub has_carriage_return: bool,
}

/// The header of a program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Elf {
    is_64: bool,
    is_little: bool,
    kind: u16,
    machine: u16,
    headers: Table,
}

/// Where the program headers are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Table {
    offset: u64,
    size: u16,
    count: u16,
}

/// A piece of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Where the piece begins.
    pub offset: u64,
    /// How long the piece is, in bytes.
    pub length: u64,
}

/// Returns the format of a file by its first [`BEGIN_SIZE`] bytes, or by all bytes of a shorter file.
pub fn format(begin: &[u8]) -> Format {
    if begin.is_empty() {
        return Format::Empty;
    }
    if let Some(rest) = begin.strip_prefix(SCRIPT) {
        return Format::Script(script(rest));
    }
    elf(begin).map_or(Format::Unknown, Format::Elf)
}

fn script(rest: &[u8]) -> Script {
    let line = rest.split(|byte| *byte == b'\n').next().unwrap_or_default();
    let line = String::from_utf8_lossy(line);
    let plain = line.trim_matches([' ', '\t', '\r']);
    let (interpreter, argument) = plain.split_once([' ', '\t']).unwrap_or((plain, ""));
    Script {
        interpreter: interpreter.to_owned(),
        argument: argument.trim_start_matches([' ', '\t']).to_owned(),
        has_carriage_return: line.ends_with('\r'),
    }
}

fn elf(begin: &[u8]) -> Option<Elf> {
    let rest = begin.strip_prefix(ELF)?;
    let (is_64, is_little) = (*rest.first()? == 2, *rest.get(1)? == 1);
    let number = |at: usize, size: usize| number(begin, at, size, is_little);
    let short = |at: usize| u16::try_from(number(at, 2)?).ok();
    let (offset, size, count) =
        if is_64 { (number(32, 8)?, short(54)?, short(56)?) } else { (number(28, 4)?, short(42)?, short(44)?) };
    Some(Elf { is_64, is_little, kind: short(16)?, machine: short(18)?, headers: Table { offset, size, count } })
}

fn number(bytes: &[u8], at: usize, size: usize, is_little: bool) -> Option<u64> {
    let bytes = bytes.get(at..at.checked_add(size)?)?;
    let append = |value: u64, byte: &u8| value << 8 | u64::from(*byte);
    Some(if is_little { bytes.iter().rev().fold(0, append) } else { bytes.iter().fold(0, append) })
}

impl Elf {
    /// Returns whether the file is a program, and not an object file or the memory image of a crashed program.
    pub fn is_executable(&self) -> bool {
        EXECUTABLE.contains(&self.kind) && self.headers.count > 0
    }

    /// Returns whether the processor of `running`, a program that runs here, can also execute this program.
    pub fn is_for_processor_of(&self, running: &Self) -> bool {
        let is_same = self.machine == running.machine && self.is_little == running.is_little;
        is_same || COMPATIBLE.contains(&(running.machine, self.machine))
    }

    /// Returns the name of the processor that the program is for.
    pub fn processor(&self) -> String {
        let name = match self.machine {
            3 => "x86 (32 bit)",
            8 => "MIPS",
            20 => "PowerPC",
            21 => "PowerPC (64 bit)",
            22 => "S390",
            40 => "ARM (32 bit)",
            62 => "x86-64",
            183 => "ARM (AArch64)",
            243 => "RISC-V",
            258 => "LoongArch",
            other => return format!("processor number {other}"),
        };
        name.to_owned()
    }

    /// Returns where the program headers are in the file.
    pub fn headers(&self) -> Piece {
        let Table { offset, size, count } = self.headers;
        Piece { offset, length: u64::from(size) * u64::from(count) }
    }

    /// Returns where the path of the loader is, by the program headers; nothing if the program needs no loader.
    pub fn loader(&self, headers: &[u8]) -> Option<Piece> {
        let (offset, length, size) = if self.is_64 { (8, 32, 8) } else { (4, 16, 4) };
        headers.chunks(usize::from(self.headers.size).max(1)).find_map(|header| {
            let number = |at: usize, size: usize| number(header, at, size, self.is_little);
            (number(0, 4)? == LOADER).then_some(())?;
            Some(Piece { offset: number(offset, size)?, length: number(length, size)? })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the header of a 64-bit program with one program header, which names the loader.
    fn program(machine: u16) -> Vec<u8> {
        let mut bytes = vec![0; 120];
        bytes[..6].copy_from_slice(b"\x7fELF\x02\x01");
        bytes[16..20].copy_from_slice(&[3, 0, machine.to_le_bytes()[0], machine.to_le_bytes()[1]]);
        (bytes[32], bytes[54], bytes[56]) = (64, 56, 1);
        (bytes[64], bytes[72], bytes[96]) = (3, 200, 28);
        bytes
    }

    #[test]
    fn programs_say_their_processor_and_their_loader() {
        let elf = |bytes: &[u8]| match format(bytes) {
            Format::Elf(elf) => elf,
            other @ (Format::Empty | Format::Script(_) | Format::Unknown) => panic!("{other:?}"),
        };
        let bytes = program(62);
        let native = elf(&bytes);
        assert_eq!(native.headers(), Piece { offset: 64, length: 56 });
        assert_eq!(native.loader(&bytes[64..]), Some(Piece { offset: 200, length: 28 }));
        assert!(native.is_executable() && native.is_for_processor_of(&native));
        let foreign = elf(&program(183));
        assert!(!foreign.is_for_processor_of(&native));
        assert_eq!(foreign.processor(), "ARM (AArch64)");
        assert!(elf(&program(3)).is_for_processor_of(&native), "where the kernel is built for that");
        let mut object = program(62);
        object[16] = 1;
        assert!(!elf(&object).is_executable());
        let mut big = program(62);
        big[5] = 2;
        assert!(!elf(&big).is_for_processor_of(&native), "its bytes have another order");
    }

    /// The reader accepts any bytes without a panic.
    #[test]
    fn a_file_may_end_anywhere() {
        let bytes = program(62);
        for length in 0..bytes.len() {
            let found = format(&bytes[..length]);
            let expected = length >= 58;
            assert_eq!(matches!(found, Format::Elf(_)), expected, "{length} bytes");
            if let Format::Elf(elf) = found {
                assert!(elf.loader(&bytes[..length.min(8)]).is_none());
            }
        }
        assert_eq!((format(b""), format(b"MZ\x90")), (Format::Empty, Format::Unknown));
    }

    #[test]
    fn scripts_say_their_interpreter() {
        let check = |line: &str, interpreter: &str, argument: &str, has_carriage_return| {
            let (interpreter, argument) = (interpreter.to_owned(), argument.to_owned());
            let expected = Script { interpreter, argument, has_carriage_return };
            assert_eq!(format(line.as_bytes()), Format::Script(expected), "{line:?}");
        };
        check("#!/bin/sh\necho a b", "/bin/sh", "", false);
        check("#! /usr/bin/env  python3 -u \nimport os", "/usr/bin/env", "python3 -u", false);
        check("#!/bin/sh\r\necho\r\n", "/bin/sh", "", true);
        check("#!/bin/sh", "/bin/sh", "", false);
        check("#!\n", "", "", false);
        check("#!", "", "", false);
    }
}
