//! The record of a running program. The shim writes it into its instance directory; a node that starts after a crash reads it.
//!
//! ```text
//! boot 0e6b3d3c-58f0-4f22-9c0e-6a7d2f1c9f10
//! grace 5000
//! shim 4711 1234567
//! program 4712 1234569
//! ```
//! A record is valid only in the boot of the kernel that it names: a process number and the start time name one
//! process. So the record need not survive a power cut, and the file is not synced. A torn last line is ignored.

use std::time::Duration;

/// The record, in the instance directory. It is removed when nothing of the instance is left.
pub const RECORD_FILE: &str = "processes";

/// The lasting identity of a process: its number, and when it started.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Process {
    /// Its number.
    pub pid: i32,
    /// When it started, in ticks of the kernel since its boot. Source: proc_pid_stat(5), field 22.
    pub started: u64,
}

/// The processes that run in an instance directory.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ProcessRecord {
    /// The boot of the kernel, as `/proc/sys/kernel/random/boot_id` has it.
    pub boot: String,
    /// How long the program may take to stop when its node is gone.
    pub grace: Duration,
    /// The shim.
    pub shim: Option<Process>,
    /// The program, once it was started.
    pub program: Option<Process>,
}

impl ProcessRecord {
    /// Returns the lines that are known before the program starts.
    pub fn head(&self) -> String {
        let shim = self.shim.map(|shim| format!("shim {} {}\n", shim.pid, shim.started)).unwrap_or_default();
        format!("boot {}\ngrace {}\n{shim}", self.boot, self.grace.as_millis())
    }

    /// Returns the line that is added for the program.
    pub fn program_line(program: Process) -> String {
        format!("program {} {}\n", program.pid, program.started)
    }

    /// Reads a record; lines that it does not know are ignored.
    pub fn parse(text: &str) -> Self {
        let mut record = Self::default();
        let whole = text.rfind('\n').map_or("", |end| &text[..end]);
        for line in whole.lines() {
            let (word, rest) = line.split_once(' ').unwrap_or_default();
            match word {
                "boot" => record.boot = rest.to_owned(),
                "grace" => record.grace = Duration::from_millis(rest.parse().unwrap_or(0)),
                "shim" => record.shim = process(rest),
                "program" => record.program = process(rest),
                _ => {}
            }
        }
        record
    }
}

fn process(text: &str) -> Option<Process> {
    let (pid, started) = text.split_once(' ')?;
    let pid = pid.parse().ok().filter(|pid| *pid > 1)?;
    Some(Process { pid, started: started.parse().ok()? })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_read_as_it_was_written_and_a_torn_line_is_not() {
        let (shim, program) = (Process { pid: 7, started: 70 }, Process { pid: 8, started: 80 });
        let mut record = ProcessRecord {
            boot: "0e6b".to_owned(),
            grace: Duration::from_millis(250),
            shim: Some(shim),
            program: Some(program),
        };
        let text = record.head() + &ProcessRecord::program_line(program);
        assert_eq!(ProcessRecord::parse(&text), record);
        record.program = None;
        assert_eq!(ProcessRecord::parse(text.trim_end()), record, "the last line has no end");
        assert_eq!(ProcessRecord::parse("shim 0 1\nprogram -1 4\nshim x\n\n"), ProcessRecord::default());
    }
}
