//! All tests of `import`, as one program.

mod behavior;
mod cases;
mod hostile;
mod manual;
mod random;
mod scion;
