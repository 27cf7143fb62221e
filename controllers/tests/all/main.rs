//! The tests of `controllers`, in one program.

mod adoption;
mod group;
mod process;
