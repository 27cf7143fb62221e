//! `dca db status`, `found`, `retire`, `heal-clock`: the team.

use super::asking::{Asking, Databases, refusal};
use crate::cli::{Failure, output};
use crate::logic::database::question::{self, Question, Reply};
use crate::logic::database::table;
use anyhow::anyhow;

/// What `dca db status` is told.
#[derive(Debug, clap::Args)]
pub struct Status {
    #[command(flatten)]
    asking: Asking,
}

/// What `dca db retire` is told.
#[derive(Debug, clap::Args)]
pub struct Retire {
    /// The robot, or one of its origins as `dca db status` shows them
    member: String,
    /// Retire the names that the robot had before its present one, as after its disk was lost or set back
    #[arg(long)]
    older: bool,
    #[command(flatten)]
    asking: Asking,
}

/// What a verb without anything of its own is told.
#[derive(Debug, clap::Args)]
pub struct Operate {
    #[command(flatten)]
    asking: Asking,
}

impl Status {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let reply = self.asking.ask(Question::Status)?;
        let Reply::Status(status) = reply else { return Err(refusal(&reply)) };
        output::say(&if self.asking.json { serde_json::to_string_pretty(&status)? } else { table::status(&status) });
        Ok(())
    }
}

impl Retire {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let robot = self.member;
        self.asking.order(if self.older { Question::RetireOlder { robot } } else { Question::Retire { member: robot } })
    }
}

impl Operate {
    /// Runs `found`. A robot that is a member may have become one a moment ago, and the robot that is asked has not heard it.
    pub(crate) fn found(self) -> Result<(), Failure> {
        self.asking.with(async |databases| {
            let own = status(databases, databases.robot()).await?;
            for robot in databases.robots().await?.into_iter().filter(|robot| !own.member && *robot != own.robot) {
                let there = status(databases, &robot).await.ok().filter(|there| there.member && there.team == own.team);
                if there.is_some() {
                    return Err(Failure::Refused(anyhow!(
                        "`{robot}` belongs to the team `{}` already; `{}` joins it by itself when it hears of it",
                        own.team,
                        own.robot
                    )));
                }
            }
            Ok(())
        })?;
        self.asking.order(Question::Found)
    }

    /// Runs `heal-clock`.
    pub(crate) fn heal_clock(self) -> Result<(), Failure> {
        self.asking.order(Question::HealClock)
    }
}

async fn status(databases: &Databases<'_>, robot: &str) -> Result<question::Status, Failure> {
    let reply = databases.ask_one(robot, Question::Status).await?;
    let Reply::Status(status) = reply else { return Err(refusal(&reply)) };
    Ok(*status)
}
