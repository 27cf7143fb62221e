//! The connection to the databases of robots: sends a question to one of the copies, and returns the answers.

use crate::ConnectArgs;
use crate::absent::{self, Absences};
use crate::client::signer::KeyPlace;
use crate::client::{Answers, Client, unasked};
use crate::complete;
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use comms::io::clock;
use comms::logic::time::Time;
use dbmanager::logic::key::{Key, KeyError};
use dbmanager::logic::state::Version;
use dbmanager::logic::view::past::Keys;
use dbmanager::logic::view::value::Datum;
use node::console::{self, Failure, block_on};
use node::logic::database::question::{AsOf, Question, Reply};
use node::logic::protocol::{Answer, InstanceParameters, NodeStatus, Request, TeamOfNode};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// How long a database may take for an answer that waits for no other robot. Writing to a disk may take a while.
pub(crate) const ANSWER_WITHIN: Duration = Duration::from_secs(10);

/// The robot to ask, and the form of the answer.
#[derive(Debug, clap::Args)]
pub struct DatabaseArgs {
    /// Ask the copy of this robot [default: the one on this machine]
    #[arg(long, value_name = "ROBOT", add = ArgValueCompleter::new(complete::hosts))]
    robot: Option<String>,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// A connection to the databases of the robots that can be reached.
#[derive(Debug)]
pub(crate) struct Databases<'a> {
    client: &'a Client,
    /// The notes that have been printed already.
    noted: Arc<Mutex<BTreeSet<String>>>,
    /// The robot that is asked if the verb names no other robot.
    robot: String,
}

/// The answers to one question.
#[derive(Debug)]
pub(crate) struct Replies {
    answers: Answers,
    noted: Arc<Mutex<BTreeSet<String>>>,
    robot: String,
}

impl DatabaseArgs {
    /// Returns the databases that can be reached with these options.
    pub(crate) fn of(connect: ConnectArgs) -> Self {
        Self { robot: None, json: false, connect }
    }

    /// Returns the options for finding nodes.
    pub(crate) fn connect(&self) -> &ConnectArgs {
        &self.connect
    }

    /// Does some work with the databases, and then closes the connection.
    pub(crate) fn with<T>(&self, work: impl AsyncFnOnce(&Databases<'_>) -> Result<T, Failure>) -> Result<T, Failure> {
        block_on(async {
            let client = Client::open_any(&self.connect).await?;
            let result = match self.whom(&client).await {
                Ok(robot) => work(&Databases::through(&client, robot)).await,
                Err(failure) => Err(failure),
            };
            client.close().await;
            result
        })
    }

    /// Returns the robot to ask if the verb names no other robot.
    async fn whom(&self, client: &Client) -> Result<String, Failure> {
        if let Some(robot) = self.robot.as_deref().or_else(|| client.local()) {
            // The robot may have to be discovered first. Only a question shows whether its database answers.
            if client.local() != Some(robot) && !client.finds(robot).await? {
                tracing::debug!(robot, "no host has announced it");
            }
            return Ok(robot.to_owned());
        }
        let nobody =
            || anyhow!("no node answers; start one with `dca-node --name NAME`, in your team or with `--insecure-lan`");
        client.hosts(&[]).await?.into_iter().next().ok_or_else(|| Failure::Unreachable(nobody()))
    }

    /// Returns the options for the user's key: the folder with the keys of teams, and the file with the passphrase.
    pub(crate) fn key_place(&self) -> KeyPlace {
        self.connect.key_place()
    }

    /// Asks a question with one answer.
    pub(crate) fn ask(&self, question: Question) -> Result<Reply, Failure> {
        self.with(async |databases| databases.ask_one(databases.robot(), question).await)
    }

    /// Asks a question whose answer has any number of parts.
    pub(crate) fn ask_all(
        &self,
        question: Question,
        take: impl FnMut(Reply) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        self.with(async |databases| databases.ask_all(question, take).await)
    }

    /// Asks a question whose answer is one sentence, and prints this sentence.
    pub(crate) fn order(&self, question: Question) -> Result<(), Failure> {
        let reply = self.ask(question)?;
        let Reply::Done(sentence) = reply else { return Err(refusal(&reply)) };
        console::say(&sentence);
        Ok(())
    }
}

impl<'a> Databases<'a> {
    /// Returns the databases that a connection reaches. Questions go to `robot` if they name no other robot.
    pub(crate) fn through(client: &'a Client, robot: String) -> Self {
        Self { client, noted: Arc::default(), robot }
    }

    /// Returns the values of a robot's database below `params/` and `below`, with whole keys.
    pub(crate) async fn parameters_of(&self, robot: &str, below: &str) -> Result<Vec<(String, Datum)>, Failure> {
        let prefix = format!("robot/{robot}/params/{below}");
        let mut replies = self.ask(robot, Question::List { prefix, at: AsOf::Now }).await?;
        let mut keys = Vec::new();
        while let Some(reply) = replies.next(clock::now() + ANSWER_WITHIN).await? {
            let Reply::Entries(entries) = reply else { return Err(refusal(&reply)) };
            let shown = entries
                .into_iter()
                .filter_map(|(key, versions)| Some((key.to_string(), Datum::of(versions.last()?.value.as_ref()?))));
            keys.extend(shown);
        }
        Ok(keys)
    }

    /// Returns the keys of the asked robot below a prefix.
    pub(crate) async fn entries(&self, prefix: &str) -> Result<Vec<(Key, Vec<Version>)>, Failure> {
        let mut entries = Vec::new();
        let question = Question::List { prefix: prefix.to_owned(), at: AsOf::Now };
        let take = |reply| {
            let Reply::Entries(part) = reply else { return Err(refusal(&reply)) };
            entries.extend(part);
            Ok(())
        };
        self.ask_all(question, take).await?;
        Ok(entries)
    }

    /// Returns the robot that questions go to by default.
    pub(crate) fn robot(&self) -> &str {
        &self.robot
    }

    /// Returns the team of the robot that is asked; nothing if the robot is in no team.
    pub(crate) async fn team(&self) -> Result<Option<TeamOfNode>, Failure> {
        self.client.team_of(&self.robot).await
    }

    /// Asks one robot's database.
    pub(crate) async fn ask(&self, robot: &str, question: Question) -> Result<Replies, Failure> {
        let request = match self.client.proof(robot) {
            Some(proof) => Request::Here { proof, question },
            None => Request::Database(question),
        };
        let answers = self.client.order_on(robot, request, 0).await?;
        Ok(Replies { answers, noted: Arc::clone(&self.noted), robot: robot.to_owned() })
    }

    /// Asks one robot's database a question with one answer.
    pub(crate) async fn ask_one(&self, robot: &str, question: Question) -> Result<Reply, Failure> {
        let mut replies = self.ask(robot, question).await?;
        replies.next(clock::now() + ANSWER_WITHIN).await?.ok_or_else(|| replies.ended())
    }

    /// Asks a question whose answer has any number of parts.
    pub(crate) async fn ask_all(
        &self,
        question: Question,
        mut take: impl FnMut(Reply) -> Result<(), Failure>,
    ) -> Result<(), Failure> {
        let mut replies = self.ask(self.robot(), question).await?;
        while let Some(reply) = replies.next(clock::now() + ANSWER_WITHIN).await? {
            take(reply)?;
        }
        Ok(())
    }

    /// Returns the parameters that may be set for the programs of a robot.
    pub(crate) async fn parameters(&self, robot: &str) -> Result<Vec<InstanceParameters>, Failure> {
        let answer = self.client.ask(robot, &Request::Parameters, ANSWER_WITHIN).await?;
        let Answer::Parameters(all) = answer else { return Err(unasked(robot, &answer)) };
        Ok(all)
    }

    /// Returns the processes on the hosts that answer, and the hosts that do not answer according to the reports of all nodes.
    pub(crate) async fn statuses(&self) -> Result<(Vec<NodeStatus>, Absences), Failure> {
        let found = [(self.client, self.client.statuses().await?)];
        let away = absent::ask(&found).await;
        Ok((found.into_iter().flat_map(|(_, statuses)| statuses.nodes).collect(), away))
    }

    /// Returns the robots that can be reached now, except those whose keys are revoked. The node of this machine knows them at once.
    pub(crate) async fn robots(&self) -> Result<Vec<String>, Failure> {
        Ok(self.client.all().await?.into_iter().collect())
    }

    /// Returns whether a robot can be reached now.
    pub(crate) async fn reaches(&self, robot: &str) -> Result<bool, Failure> {
        self.client.finds(robot).await
    }
}

impl Replies {
    /// Returns the next answer; nothing after the last one. Prints messages that are meant for a person.
    pub(crate) async fn next(&mut self, deadline: Time) -> Result<Option<Reply>, Failure> {
        tokio::select! {
            biased;
            reply = self.more() => reply,
            () = clock::sleep_until(deadline) => {
                Err(Failure::Unreachable(anyhow!("the database of `{}` has not answered", self.robot)))
            }
        }
    }

    /// Returns the next answer, and waits for it without a limit.
    pub(crate) async fn more(&mut self) -> Result<Option<Reply>, Failure> {
        loop {
            match self.answers.next().await.transpose()? {
                None => return Ok(None),
                Some(Answer::Database(Reply::Note(sentence))) => {
                    let note = format!("note: {sentence}");
                    if self.noted.lock().unwrap_or_else(PoisonError::into_inner).insert(sentence) {
                        console::note(&note);
                    }
                }
                Some(Answer::Database(reply)) => return Ok(Some(reply)),
                Some(other) => return Err(unasked(&self.robot, &other)),
            }
        }
    }

    /// Returns the failure that the answers ended too early.
    pub(crate) fn ended(&self) -> Failure {
        Failure::Unreachable(anyhow!("the database of `{}` ended before it answered", self.robot))
    }
}

/// Reads which keys a user means: one key, or all keys below a prefix. A prefix is empty, or ends in `/`.
pub(crate) fn keys(text: String) -> Result<Keys, KeyError> {
    match text.strip_suffix('/') {
        Some(prefix) => Key::new(prefix).map(|_| Keys::Below(text)),
        None if text.is_empty() => Ok(Keys::Below(text)),
        None => Key::new(text).map(Keys::Only),
    }
}

/// Explains why a database did not carry out a request.
pub(crate) fn refusal(reply: &Reply) -> Failure {
    if let Reply::Refused(why) | Reply::Unmet { why, .. } | Reply::Unknown(why) = reply {
        return anyhow!("{why}").into();
    }
    anyhow!("unexpected answer from the database").into()
}
