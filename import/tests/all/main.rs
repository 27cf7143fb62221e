//! All tests of `import`, as one program.

mod behavior;
mod cases;
mod hostile;
mod launch;
mod manual;
#[path = "../../../language/tests/all/random/numbers.rs"]
mod random;
mod scion;
