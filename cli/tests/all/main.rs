//! The tests of `cli`, in one program.

mod editors;
mod lsp;
mod nodes;
mod project;
