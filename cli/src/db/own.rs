//! `dca db own`: gives a prefix to one robot, and lists the owners.

use super::databases::refusal;
use super::write::CommitArgs;
use anyhow::Context;
use dbmanager::logic::key::Key;
use node::console::{self, Failure};
use node::logic::database::question::{Own as OwnRequest, Question, Reply};
use node::logic::printable::one_line;

/// The arguments of `dca db own`.
#[derive(Debug, clap::Args)]
pub struct Own {
    /// The prefix of the keys, such as `team/arm` [default: list all keys that have an owner]
    #[arg(requires = "who")]
    prefix: Option<String>,
    /// The robot that owns the keys from now on: only this robot may write them
    #[arg(group = "who")]
    owner: Option<String>,
    /// Let every robot write the keys again
    #[arg(long, group = "who")]
    release: bool,
    /// Take the keys from their owner, which may be out of reach; the owner's writes in the meantime are listed by
    /// `dca db conflicts`
    #[arg(long, requires = "owner")]
    by_force: bool,
    #[command(flatten)]
    commit: CommitArgs,
}

impl Own {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let Some(prefix) = &self.prefix else { return self.list() };
        let prefix = Key::new(prefix.trim_end_matches('/')).context("reading the prefix")?;
        let (robot, by_force, reason) = (self.owner, self.by_force, self.commit.reason_or("own"));
        let (level, within) = (self.commit.level.clone(), self.commit.within);
        self.commit.send(&Question::Own(OwnRequest { prefix, robot, by_force, reason, level, within }))
    }

    fn list(&self) -> Result<(), Failure> {
        let database = &self.commit.database;
        let reply = database.ask(Question::Owners)?;
        let Reply::Owners(owners) = reply else { return Err(refusal(&reply)) };
        if database.json {
            console::answer(&owners);
            return Ok(());
        }
        for (prefix, robot) in owners {
            console::say(&format!("{prefix}/  {}", one_line(robot.as_deref().unwrap_or("everybody"))));
        }
        console::note("`robot/NAME/` belongs to the robot of that name, unless it is listed");
        Ok(())
    }
}
