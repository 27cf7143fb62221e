//! Each injected fault fits the present sources, and the manual names the test that finds it. `cargo run -p dbmanager
//! --example faults` shows that the tests find them.

#[path = "../../faults/patch.rs"]
#[expect(dead_code, reason = "the copy is made by the example")]
mod patch;

use std::collections::BTreeSet;
use std::path::Path;

#[test]
fn every_injected_fault_fits_the_sources() {
    let faults = patch::all();
    let names: BTreeSet<&str> = faults.iter().map(|fault| fault.name).collect();
    assert_eq!((faults.len(), names.len()), (51, 51));
    let logic = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/logic");
    if let Err(why) = patch::apply(&faults, &logic) {
        panic!("{why}");
    }
    let manual = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/src/database/proof.md");
    let manual = std::fs::read_to_string(manual).unwrap();
    let untold: Vec<_> = names.iter().filter(|name| !manual.contains(&format!("\n| {name} |"))).collect();
    assert!(untold.is_empty(), "proof.md does not say what finds {untold:?}");
}
