//! The tests of `language`, in one program.

// Helpers for several of them.
mod disk;
mod good_files;
mod random;
mod shown;

mod algebra;
mod automaton;
mod corpus;
mod editors;
mod fixes;
mod format;
mod graph;
mod growth;
mod hostile;
mod ide;
mod manual;
mod robustness;
mod rules;
mod scripts;
mod simulate;
mod size;
mod start_values;
