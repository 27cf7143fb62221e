//! All tests of `import`, as one program.

mod attributes;
mod behavior;
mod cases;
mod charts;
mod delays;
mod events;
mod guards;
mod hostile;
mod launch;
mod manual;
mod player;
#[path = "../../../language/tests/all/random/numbers.rs"]
mod random;
mod scion;
