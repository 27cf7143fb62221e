//! `dca db`: the verbs of the database. Every robot of a team has a copy of it.

pub mod compare;
pub mod databases;
pub mod file;
pub mod import;
pub mod moment;
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
    /// Print the value of a key; for a prefix that ends in `/`, all keys below it
    Get(read::Get),
    /// Write a value
    Put(write::Put),
    /// Delete keys
    Delete(write::Delete),
    /// Write several keys at once, if their conditions hold
    Tx(file::Tx),
    /// Show changes of keys as they happen
    Watch(watch::Watch),
    /// Print keys as a file, to be read, edited, compared and imported
    Export(file::Export),
    /// Make keys equal to the content of a file
    Import(import::Import),
    /// Show the changes of keys: who made them, when and why
    History(past::History),
    /// List concurrent writes whose conflict is not settled
    Conflicts(past::Conflicts),
    /// Settle a key with such writes, everywhere
    Resolve(past::Resolve),
    /// Show the changes between two moments, or the differences between the keys below two prefixes
    Diff(compare::Diff),
    /// Print the values of keys at another moment
    At(past::At),
    /// Print the version of the database now, or at a date: a moment for `at` and `diff`
    #[command(alias = "cut")]
    Version(past::VersionAt),
    /// Show the members of the team, the copies that are behind, and the state of this robot's copy
    Status(team::Status),
    /// Begin a team with this robot; every other robot joins by itself
    Found(team::TeamArgs),
    /// Move this robot from its team to another one of the same name that was founded separately, with its data
    Join(team::Join),
    /// Show or change the owners of keys; only the owner may write them
    Own(own::Own),
    /// Retire a robot that will not return: other robots no longer wait for it
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
