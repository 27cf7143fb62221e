//! A kernel, or a container, without the system calls by which a node ends programs.

use dca_tests::cluster::{Cluster, SOON, executable};
use std::fs;
use std::process::Command;

/// Refuses two system calls, like the seccomp filter of an old container runtime (ENOSYS), and executes the remaining
/// command. Sources: seccomp(2), linux/filter.h. The numbers are the same on x86-64 and AArch64.
const OLD: &str = r#"
import ctypes, os, struct, sys
def code(code, jt, jf, k):
    return struct.pack("HBBI", code, jt, jf, k)
numbers = [int(number) for number in sys.argv[1].split(",")]
program = code(0x20, 0, 0, 0)
for number in numbers:
    program += code(0x15, 0, 1, number) + code(0x06, 0, 0, 0x00050000 | 38)
program += code(0x06, 0, 0, 0x7FFF0000)
buffer = ctypes.create_string_buffer(program)
class Filter(ctypes.Structure):
    _fields_ = [("length", ctypes.c_ushort), ("program", ctypes.c_void_p)]
libc = ctypes.CDLL(None, use_errno=True)
what = Filter(len(program) // 8, ctypes.addressof(buffer))
if libc.prctl(38, 1, 0, 0, 0) or libc.prctl(22, 2, ctypes.byref(what), 0, 0):
    sys.exit(77)
os.execvp(sys.argv[2], sys.argv[2:])
"#;

#[test]
fn a_node_that_could_not_end_programs_does_not_begin() {
    let cluster = Cluster::new();
    let file = cluster.file("old.py", OLD);
    for (number, call) in [("434", "pidfd_open"), ("424", "pidfd_send_signal")] {
        let run = |program: &str, arguments: &[&str]| {
            let mut command = Command::new("timeout");
            command.arg(SOON.as_secs().to_string()).args(["python3", &file, number]).arg(executable(program));
            command.args(arguments).arg("--run-dir").arg(cluster.folder().join("n"));
            let out = command.output().expect("it starts");
            (
                out.status.code(),
                String::from_utf8_lossy(&out.stdout).into_owned() + &String::from_utf8_lossy(&out.stderr),
            )
        };
        let state = cluster.folder().join("state").display().to_string();
        let (code, said) = run("dca-node", &["--name", "c1", "--state", &state]);
        if code == Some(77) {
            return println!("skipped: this kernel takes no seccomp filter");
        }
        let why = format!("a node needs the call `{call}` to end programs");
        assert!(code == Some(1) && said.contains(&why) && said.contains("Linux 5.3"), "{code:?} {said}");
        let (code, said) = run("dca", &["doctor"]);
        assert!(code == Some(1) && said.contains(&why), "{code:?} {said}");
    }
    drop(fs::remove_file(file));
}
