//! The secrets of a program, from the pipe of its node to its own descriptors.

use super::*;

#[test]
fn a_secret_is_a_file_in_memory_that_the_program_alone_has() {
    let script =
        r#"cat "$1" > got; cat "$1" "${2#key=}" >> got; stat -L -c %a "$1" > mode; (: > "$1") 2> denied; echo done"#;
    let words = ["sh", "-c", script, "say", "", "key="].map(str::to_owned).to_vec();
    let mut shim = Shim::start_with(|start| {
        start.gate = Gate::Exec;
        (start.command, start.secrets) = (words, vec![4, 5]);
    });
    let mut given = Vec::new();
    shim::protocol::secret(b"hunter2\n", &mut given);
    shim::protocol::secret(&[0, 255], &mut given);
    shim.orders.as_mut().unwrap().write_all(&given).unwrap();
    shim.order(&ShimOrder::Go);
    let over = shim.expect(&[ShimReport::Ready, STARTED, exited(0), ShimReport::Gone]);
    assert_eq!(std::fs::read(over.dir.join("got")).unwrap(), b"hunter2\nhunter2\n\0\xff");
    assert_eq!(over.read("mode"), "400\n");
    assert!(!over.read("denied").is_empty(), "it cannot be written");
    for name in ["shim", "exit", OUTPUT_FILE] {
        assert!(!over.read(name).contains("hunter2"), "{name}");
    }
}

#[test]
fn a_node_that_goes_in_the_middle_of_a_secret_starts_nothing() {
    let mut shim = Shim::start_with(|start| {
        (start.command, start.secrets) = (["sh", "-c", "echo > ran", ""].map(str::to_owned).to_vec(), vec![3]);
    });
    shim.orders.take().unwrap().write_all(&[9, 0, 0, 0, b'h']).unwrap();
    let mut reports = Vec::new();
    while let Some(report) = shim.next() {
        reports.push(report);
    }
    assert!(matches!(&reports[..], [ShimReport::ExecFailed { .. }, ShimReport::Gone]), "{reports:?}");
    assert!(!shim.child.wait().unwrap().success() && !shim.dir.join("ran").exists());
    std::fs::remove_dir_all(&shim.dir).unwrap();
}
