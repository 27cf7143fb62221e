//! `dca db`: the verbs of the database. Every robot of a team has a copy of it.

pub mod databases;
pub mod file;
pub mod import;
pub mod own;
pub mod past;
pub mod read;
pub mod readers;
pub mod secret;
pub mod team;
pub mod watch;
pub mod write;

use clap::Subcommand;
use node::console::Failure;

/// The arguments of `dca db`.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Print what a key holds; of a prefix that ends in `/`, all keys below it
    Get(read::Get),
    /// Write a value
    Put(write::Put),
    /// Delete keys
    Delete(write::Delete),
    /// Write several keys at once, if what is required of them holds
    Tx(file::Tx),
    /// Show what happens to keys, as it happens
    Watch(watch::Watch),
    /// Print keys as a file, to be read, edited, compared and imported
    Export(file::Export),
    /// Make keys what a file says
    Import(import::Import),
    /// Show who has changed what, when and why
    History(past::History),
    /// List writes that did not see each other, and nobody has settled
    Conflicts(past::Conflicts),
    /// Settle a key with such writes, everywhere
    Resolve(past::Resolve),
    /// Show what has changed between two moments
    Diff(past::Diff),
    /// Print what keys held at another moment
    At(past::At),
    /// Print which transactions are there now, or were at a date: a moment for `at` and `diff`
    #[command(alias = "cut")]
    Version(past::VersionAt),
    /// Show who is in the team, who is behind, and how this robot's copy is
    Status(team::Status),
    /// Begin a team with this robot; every other one joins by itself
    Found(team::TeamArgs),
    /// Move this robot from its team to another one of the same name that was begun apart, with what was written
    Join(team::Join),
    /// Show or change the owners of keys, who alone write there
    Own(own::Own),
    /// Retire a robot that is gone for good: nobody waits for it any more
    Retire(team::Retire),
    /// Begin a new epoch of timestamps, above all that were dated wrongly
    HealClock(team::TeamArgs),
}

/// Runs the verb.
pub(crate) fn run(arguments: Arguments) -> Result<(), Failure> {
    match arguments.verb {
        Verb::Get(arguments) => arguments.run(),
        Verb::Put(arguments) => arguments.run(),
        Verb::Delete(arguments) => arguments.run(),
        Verb::Tx(arguments) => arguments.run(),
        Verb::Watch(arguments) => arguments.run(),
        Verb::Export(arguments) => arguments.run(),
        Verb::Import(arguments) => arguments.run(),
        Verb::History(arguments) => arguments.run(),
        Verb::Conflicts(arguments) => arguments.run(),
        Verb::Resolve(arguments) => arguments.run(),
        Verb::Diff(arguments) => arguments.run(),
        Verb::At(arguments) => arguments.run(),
        Verb::Version(arguments) => arguments.run(),
        Verb::Status(arguments) => arguments.run(),
        Verb::Found(arguments) => arguments.found(),
        Verb::Join(arguments) => arguments.run(),
        Verb::Own(arguments) => arguments.run(),
        Verb::Retire(arguments) => arguments.run(),
        Verb::HealClock(arguments) => arguments.heal_clock(),
    }
}
