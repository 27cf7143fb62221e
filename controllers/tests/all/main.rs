//! The tests of `controllers`, in one program.

mod adoption;
mod calls;
mod group;
mod process;
