//! `dca db status`, `found`, `join`, `retire` and `heal-clock`: the team of robots that share the database.

use super::databases::{DatabaseArgs, Databases, refusal};
use anyhow::anyhow;
use comms::io::clock;
use node::console::{self, Failure};
use node::logic::database::question::{self, Question, Reply};
use node::logic::database::table;
use std::time::Duration;

/// How long a member of the other team may take to admit the robot.
const ADMITTED_WITHIN: Duration = Duration::from_secs(30);
/// The pause before the next look whether the robot was admitted.
const LOOK_AGAIN: Duration = Duration::from_millis(100);

/// The arguments of `dca db status`.
#[derive(Debug, clap::Args)]
pub struct Status {
    #[command(flatten)]
    database: DatabaseArgs,
}

/// The arguments of `dca db retire`.
#[derive(Debug, clap::Args)]
pub struct Retire {
    /// The robot, or one of its origins as listed by `dca db status`
    member: String,
    /// Retire the names that the robot had before its present one, as after its disk was lost or set back
    #[arg(long)]
    older: bool,
    #[command(flatten)]
    database: DatabaseArgs,
}

/// The arguments of `dca db join`.
#[derive(Debug, clap::Args)]
pub struct Join {
    /// A robot of the other team, as `dca db status` lists them
    member: String,
    #[command(flatten)]
    database: DatabaseArgs,
}

/// The arguments of a verb that needs only a database.
#[derive(Debug, clap::Args)]
pub struct TeamArgs {
    #[command(flatten)]
    database: DatabaseArgs,
}

impl Status {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let reply = self.database.ask(Question::Status)?;
        let Reply::Status(status) = reply else { return Err(refusal(&reply)) };
        if self.database.json {
            console::answer(&status);
        } else {
            console::say(&table::status(&status));
        }
        Ok(())
    }
}

impl Retire {
    /// Runs the verb.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let robot = self.member;
        self.database.order(if self.older {
            Question::RetireOlder { robot }
        } else {
            Question::Retire { member: robot }
        })
    }
}

impl Join {
    /// Runs the verb. The robot leaves its own team at once. The verb is done when the other team has admitted the robot.
    pub(crate) fn run(self) -> Result<(), Failure> {
        let Self { member, database } = self;
        let robot = database.with(async |databases| {
            let reply = databases.ask_one(databases.robot(), Question::Join { robot: member.clone() }).await?;
            let Reply::Done(_) = reply else { return Err(refusal(&reply)) };
            let until = clock::now() + ADMITTED_WITHIN;
            loop {
                let own = status(databases, databases.robot()).await?;
                if own.members.iter().any(|one| own.member && one.robot == member) {
                    return Ok(own.robot);
                }
                if clock::now() >= until {
                    return Err(Failure::Unreachable(anyhow!(
                        "`{member}` has not admitted `{}` yet; `dca db status --robot {}` shows when a member of the other team has",
                        own.robot,
                        own.robot
                    )));
                }
                clock::sleep_until(clock::now() + LOOK_AGAIN).await;
            }
        })?;
        let sentence = format!("`{robot}` belongs to the team of `{member}` now");
        console::say(&sentence);
        Ok(())
    }
}

impl TeamArgs {
    /// Runs `found`. Another robot may have founded the same team a moment ago, and the asked robot may not know it yet.
    pub(crate) fn found(self) -> Result<(), Failure> {
        self.database.with(async |databases| {
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
        self.database.order(Question::Found)
    }

    /// Runs `heal-clock`.
    pub(crate) fn heal_clock(self) -> Result<(), Failure> {
        self.database.order(Question::HealClock)
    }
}

async fn status(databases: &Databases<'_>, robot: &str) -> Result<question::Status, Failure> {
    let reply = databases.ask_one(robot, Question::Status).await?;
    let Reply::Status(status) = reply else { return Err(refusal(&reply)) };
    Ok(*status)
}
