//! The system calls of a program on its files, as `strace` saw them.

use std::collections::BTreeMap;
use std::io::BufRead;
use std::path::{Path, PathBuf};

/// The calls that change files, make changes durable, or report this to the outside.
pub(crate) const CALLS: &str = "openat,pwrite64,write,fsync,fdatasync,rename,unlink,mkdir,ftruncate,writev,pwritev,pwritev2,\
     fallocate,truncate,copy_file_range,renameat,renameat2,unlinkat,mkdirat";

/// The part of a system call that concerns files below a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Call {
    /// A new file, or an existing one that is now empty.
    Create(PathBuf),
    /// A directory is made.
    MakeDir(PathBuf),
    /// Bytes, at an offset.
    Write(PathBuf, usize, Vec<u8>),
    /// A file ends here now.
    Truncate(PathBuf, usize),
    /// A file or directory has another name.
    Rename(PathBuf, PathBuf),
    /// A name is gone.
    Unlink(PathBuf),
    /// Everything written to a file before `since` is durable. Calls are numbered from 0 in the order of their ends;
    /// `since` calls had ended when this call began.
    Sync { path: PathBuf, data_only: bool, since: usize },
    /// The program has printed a line.
    Notification(String),
}

/// Reads a log of `strace -f -qq -y -xx`. Keeps the calls on files below `root`, and the writes to descriptor 1.
pub(crate) fn read(log: impl BufRead, root: &Path, keep: impl FnMut(Call)) {
    let mut reader = Reader { root: root.to_owned(), keep, count: 0, positions: BTreeMap::new() };
    let mut begun: BTreeMap<String, (String, usize)> = BTreeMap::new();
    for line in log.lines() {
        let line = line.unwrap();
        let (thread, call) = line.split_once(' ').unwrap();
        let call = call.trim_start();
        if let Some(start) = call.strip_suffix(" <unfinished ...>") {
            begun.insert(thread.to_owned(), (start.to_owned(), reader.count));
        } else if let Some((_, rest)) = call.split_once(" resumed>").filter(|_| call.starts_with("<... ")) {
            let (start, since) = begun.remove(thread).unwrap();
            reader.take(&format!("{start}{rest}"), since);
        } else {
            reader.take(call, reader.count);
        }
    }
}

struct Reader<F> {
    root: PathBuf,
    keep: F,
    /// How many calls were kept.
    count: usize,
    /// The position of the next `write`, by descriptor.
    positions: BTreeMap<String, usize>,
}

impl<F: FnMut(Call)> Reader<F> {
    fn take(&mut self, text: &str, since: usize) {
        // Ends of threads and signals have no result. Calls that failed have changed nothing.
        let Some((call, result)) = text.rsplit_once(" = ") else { return };
        let Some((name, arguments)) = call.trim_end().strip_suffix(')').and_then(|call| call.split_once('(')) else {
            return;
        };
        if result.starts_with('-') || result.starts_with('?') {
            return;
        }
        let arguments: Vec<&str> = arguments.split(", ").collect();
        let number = |text: &str| text.split(['<', ' ']).next().unwrap().parse::<usize>().unwrap();
        match (name, &arguments[..]) {
            ("openat", [_, path, flags, ..]) => {
                let path = path_in(path);
                self.positions.insert(number(result).to_string(), 0);
                if flags.contains("O_CREAT") {
                    self.keep_in(&[&path], Call::Create(path.clone()));
                }
                if flags.contains("O_TRUNC") {
                    self.keep_in(&[&path], Call::Truncate(path.clone(), 0));
                }
            }
            ("pwrite64", [file, data, _, offset]) => self.write(file, number(offset), data, number(result)),
            ("write", [file, data, _]) if file.starts_with("1<") => {
                self.keep(Call::Notification(String::from_utf8(bytes_in(data)).unwrap()));
            }
            ("write", [file, data, _]) => {
                let length = number(result);
                let position = self.positions.entry(number(file).to_string()).or_default();
                let offset = *position;
                *position += length;
                self.write(file, offset, data, length);
            }
            ("fsync" | "fdatasync", [file]) => {
                let (path, data_only) = (path_in(file), name == "fdatasync");
                self.keep_in(&[&path], Call::Sync { path: path.clone(), data_only, since });
            }
            ("ftruncate", [file, length]) => {
                let path = path_in(file);
                self.keep_in(&[&path], Call::Truncate(path.clone(), number(length)));
            }
            ("mkdir", [path, _]) => {
                let path = path_in(path);
                self.keep_in(&[&path], Call::MakeDir(path.clone()));
            }
            ("rename", [from, to]) => {
                let (from, to) = (path_in(from), path_in(to));
                self.keep_in(&[&from, &to], Call::Rename(from.clone(), to.clone()));
            }
            ("unlink", [path]) => {
                let path = path_in(path);
                self.keep_in(&[&path], Call::Unlink(path.clone()));
            }
            _ => panic!("a call that nobody has thought of: {text}"),
        }
    }

    fn write(&mut self, file: &str, offset: usize, data: &str, length: usize) {
        let path = path_in(file);
        if path.starts_with(&self.root) {
            let mut data = bytes_in(data);
            data.truncate(length);
            self.keep(Call::Write(path, offset, data));
        }
    }

    fn keep_in(&mut self, paths: &[&Path], call: Call) {
        if paths.iter().any(|path| path.starts_with(&self.root)) {
            self.keep(call);
        }
    }

    fn keep(&mut self, call: Call) {
        self.count += 1;
        (self.keep)(call);
    }
}

/// Returns the path in `5<\x2f…>` or `"\x2f…"`.
fn path_in(argument: &str) -> PathBuf {
    String::from_utf8(bytes_in(argument)).unwrap().into()
}

/// Returns the bytes of the hexadecimal escapes in an argument.
fn bytes_in(argument: &str) -> Vec<u8> {
    let digit = |digit: u8| char::from(digit).to_digit(16).and_then(|digit| u8::try_from(digit).ok()).unwrap();
    let start = argument.find('\\').unwrap_or(argument.len());
    let escapes = argument.as_bytes()[start..].chunks_exact(4).take_while(|escape| escape.starts_with(b"\\x"));
    escapes.map(|escape| digit(escape[2]) << 4 | digit(escape[3])).collect()
}

#[test]
fn a_log_is_read() {
    let lines = [
        r#"7  openat(AT_FDCWD<\x2f>, "\x2f\x61\x2f\x62", O_RDWR|O_CREAT|O_TRUNC, 0666) = 5<\x2f\x61\x2f\x62>"#,
        r#"7  openat(AT_FDCWD<\x2f>, "\x2f\x63", O_RDONLY) = -1 ENOENT (No such file or directory)"#,
        r#"7  fdatasync(5<\x2f\x61\x2f\x62> <unfinished ...>"#,
        r#"8  pwrite64(5<\x2f\x61\x2f\x62>, "\x00\xff", 2, 4096) = 2"#,
        r#"7  <... fdatasync resumed>)            = 0"#,
        r#"8  write(5<\x2f\x61\x2f\x62>, "\x31", 1) = 1"#,
        r#"8  write(5<\x2f\x61\x2f\x62>, "\x32", 1) = 1"#,
        r#"7  write(1<\x70>, "\x61\x63\x6b\x0a", 4)  = 4"#,
        r#"7  rename("\x2f\x61\x2f\x62", "\x2f\x61\x2f\x63") = 0"#,
    ];
    let (b, c) = (PathBuf::from("/a/b"), PathBuf::from("/a/c"));
    let expected = [
        Call::Create(b.clone()),
        Call::Truncate(b.clone(), 0),
        Call::Write(b.clone(), 4096, vec![0, 255]),
        Call::Sync { path: b.clone(), data_only: true, since: 2 },
        Call::Write(b.clone(), 0, vec![b'1']),
        Call::Write(b.clone(), 1, vec![b'2']),
        Call::Notification("ack\n".to_owned()),
        Call::Rename(b, c),
    ];
    let mut calls = Vec::new();
    read(lines.join("\n").as_bytes(), Path::new("/a"), |call| calls.push(call));
    assert_eq!(calls, expected);
}
