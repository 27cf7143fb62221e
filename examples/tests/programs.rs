//! The programs of the examples list their controllers. As a test of this package it also makes cargo build them, which
//! the tests of whole missions need.

use std::process::Command;

#[test]
fn each_program_tells_its_interfaces() {
    for program in [env!("CARGO_BIN_EXE_dca-examples"), env!("CARGO_BIN_EXE_dca-starter")] {
        let output = Command::new(program).arg("--dca-interface").output().expect("cargo has built it");
        let text = String::from_utf8(output.stdout).expect("an interface is text");
        assert!(output.status.success() && text.contains("module "), "{program}: {text}");
    }
}
