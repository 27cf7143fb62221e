//! `dca call` and `dca get`: use the exports of running programs, from any host.
//!
//! The nodes give the place of a program. The call goes directly to the program.

use crate::client::{ANSWER_WITHIN, Client, Clients, Statuses, unasked};
use crate::complete;
use crate::io::taps::Taps;
use crate::logic::object::{ObjectName, argument, argument_of_json, result};
use crate::logic::process_name::ProcessName;
use crate::reader::Reader;
use crate::tapped::locations;
use crate::{ConnectArgs, absent};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use comms::io::clock;
use comms::io::data::call_digest;
use comms::logic::control::Dial;
use comms::logic::key;
use comms::logic::object::{Access, ExportKind, Exported, Exports, ObjectCall, ObjectError, Warrant};
use node::console::{self, Failure, block_on};
use node::logic::printable::printable;
use node::logic::protocol::{Answer, CallRequest, Deployment, LeafStatus, ProcessStatus, Request, leaves};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::time::Duration;

/// The options of both verbs.
#[derive(Debug, clap::Args)]
struct ObjectArgs {
    /// The export: [DEPLOYMENT:]INSTANCE.NAME, such as `hand.Grip`; the last part of the instance's path is enough
    #[arg(value_parser = ObjectName::parse, add = ArgValueCompleter::new(complete::processes))]
    name: ObjectName,
    /// How many seconds the program has to answer
    #[arg(long, value_name = "SECONDS", default_value = "5", value_parser = |text: &str| crate::seconds(text, &(0.001..=86_400.0)), allow_negative_numbers = true)]
    within: f64,
    /// Print the result as JSON, in one object with the name and the time that it took
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
}

impl ObjectArgs {
    fn within(&self) -> Duration {
        Duration::from_secs_f64(self.within)
    }
}

/// The arguments of `dca call`.
#[derive(Debug, clap::Args)]
pub struct CallArguments {
    #[command(flatten)]
    object: ObjectArgs,
    /// The argument, as a spec has it: `'{ force = 20 N }'`, or each field by itself: `force='20 N'`
    #[arg(allow_negative_numbers = true)]
    argument: Vec<String>,
}

/// The arguments of `dca get`.
#[derive(Debug, clap::Args)]
pub struct GetArguments {
    #[command(flatten)]
    object: ObjectArgs,
    /// Continue, and print the state after each change; reads the state ten times per second
    #[arg(long)]
    watch: bool,
}

/// How often a state is read.
const WATCH_EVERY: Duration = Duration::from_millis(100);

/// If a program does not answer, how often its node is asked whether the program still runs.
const LOOK_EVERY: Duration = Duration::from_millis(500);

/// A matching program, with its exports.
struct Found<'a> {
    program: Program<'a>,
    exports: Exports,
}

/// A matching program, with the connection to its node.
#[derive(Clone, Copy)]
struct Program<'a> {
    client: &'a Client,
    at: LeafStatus<'a>,
}

/// Runs `dca call`.
pub(crate) fn call(arguments: &CallArguments) -> Result<(), Failure> {
    let name = &arguments.object.name;
    block_on(with_taps(&arguments.object.connect, arguments.object.within(), async |clients, taps| {
        let all = clients.statuses().await?;
        let found = find(&all, taps, &name.process).await?;
        let exported = exported(&found, &name.name)?;
        if exported.kind == ExportKind::State {
            return Err(anyhow!("`{}` is a state; read it with `dca get {name}`", name.name).into());
        }
        let bytes = argument(&found.exports, &exported.signature, &arguments.argument);
        let bytes = bytes.map_err(|why| anyhow!("`{}` cannot be called in this way: {why}", name.name))?;
        let prepared = taps.prepare(exported, bytes, arguments.object.within());
        let Program { client, at } = found.program;
        let callee = Callee { deployment: at.deployment, host: at.host, path: found.program.path() };
        let signed = signed(client, callee, exported.access, prepared).await?;
        let (value, took) = ask(taps, &found, exported, signed).await?;
        show(&arguments.object, &found, exported, &value, took);
        Ok(())
    }))
}

/// Runs `dca get`.
pub(crate) fn get(arguments: &GetArguments) -> Result<(), Failure> {
    let name = &arguments.object.name;
    block_on(with_taps(&arguments.object.connect, arguments.object.within(), async |clients, taps| {
        let all = clients.statuses().await?;
        let found = find(&all, taps, &name.process).await?;
        let exported = exported(&found, &name.name)?;
        if exported.kind == ExportKind::Procedure {
            return Err(anyhow!("`{}` is a procedure; call it with `dca call {name}`", name.name).into());
        }
        let mut shown = None;
        loop {
            let prepared = taps.prepare(exported, Vec::new(), arguments.object.within());
            let (value, took) = ask(taps, &found, exported, prepared).await?;
            if shown.as_ref() != Some(&value) {
                show(&arguments.object, &found, exported, &value, took);
                shown = Some(value);
            }
            if !arguments.watch {
                return Ok(());
            }
            clock::sleep_until(clock::now() + WATCH_EVERY).await;
        }
    }))
}

/// A program whose procedures can be called one after the other.
pub(crate) struct Visit<'a> {
    taps: &'a Taps,
    found: Found<'a>,
    within: Duration,
}

impl Visit<'_> {
    /// Calls a procedure with an argument in JSON, and returns the result.
    pub(crate) async fn call(&self, procedure: &str, given: &Value) -> Result<Value, Failure> {
        let Self { taps, found, within } = self;
        let exported = exported(found, procedure)?;
        let bytes = argument_of_json(&found.exports, &exported.signature, given);
        let bytes = bytes.map_err(|why| anyhow!("`{procedure}` cannot be called in this way: {why}"))?;
        let prepared = taps.prepare(exported, bytes, *within);
        let Program { client, at } = found.program;
        let callee = Callee { deployment: at.deployment, host: at.host, path: found.program.path() };
        let signed = signed(client, callee, exported.access, prepared).await?;
        Ok(ask(taps, found, exported, signed).await?.0)
    }
}

/// Finds a program, and lets `work` call its procedures. Each answer may take up to `within`.
pub(crate) fn visit<T>(
    connect: &ConnectArgs,
    process: &ProcessName,
    within: Duration,
    work: impl AsyncFnOnce(&Visit<'_>) -> Result<T, Failure>,
) -> Result<T, Failure> {
    let mut result = None;
    block_on(with_taps(connect, within, async |clients, taps| {
        let all = clients.statuses().await?;
        let found = find(&all, taps, process).await?;
        result = Some(work(&Visit { taps, found, within }).await?);
        Ok(())
    }))?;
    result.ok_or_else(|| anyhow!("the reader of this command's output has ended").into())
}

async fn with_taps(
    connect: &ConnectArgs,
    within: Duration,
    work: impl AsyncFnOnce(&Clients, &Taps) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let clients = Clients::open(connect).await?;
    let taps = Taps::open(clients.iter().find_map(Client::team)).await?;
    let taps = taps.within(within);
    let mut reader = Reader::new()?;
    let done = tokio::select! {
        done = work(&clients, &taps) => done,
        () = reader.left() => Ok(()),
    };
    taps.close().await;
    clients.close().await;
    done
}

/// Returns the matching processes, each once. A process that stands for a process of another deployment is treated as that process.
fn meant<'a>(all: &'a [(&'a Client, Statuses)], name: &ProcessName) -> Vec<Program<'a>> {
    let programs =
        all.iter().flat_map(|(client, statuses)| leaves(&statuses.nodes).into_iter().map(|at| Program { client, at }));
    let programs: Vec<Program<'a>> = programs.collect();
    let is_meant = |program: &&Program<'a>| name.is_process(program.at.deployment, program.path());
    let mut meant: Vec<Program<'a>> = programs.iter().filter(is_meant).copied().collect();
    // If the name is the whole path of a process, only this process matches.
    let is_whole = |program: &Program<'a>| Some(program.path()) == name.process();
    if meant.iter().any(is_whole) {
        meant.retain(is_whole);
    }
    for program in &mut meant {
        let Some((deployment, path)) = program.at.process.stands_for() else { continue };
        let is_that = |other: &&Program<'a>| {
            let is_there = (other.client.folder(), other.at.host) == (program.client.folder(), program.at.host);
            is_there && (&*other.at.deployment.name, other.path()) == (deployment, path)
        };
        *program = programs.iter().find(is_that).copied().unwrap_or(*program);
    }
    let mut known = BTreeSet::new();
    meant.retain(|program| {
        let at = &program.at;
        known.insert((program.client.folder(), at.host, at.deployment, at.process.path.as_str()))
    });
    meant
}

/// Finds the only matching program, and asks it for its exports.
async fn find<'a>(all: &'a [(&'a Client, Statuses)], taps: &Taps, name: &ProcessName) -> Result<Found<'a>, Failure> {
    let meant = meant(all, name);
    let program = match meant.as_slice() {
        [] => return Err(absent::no_process(name, all).await),
        [one] => *one,
        several => {
            let names = several.iter().map(|one| format!("`{}:{}`", one.at.deployment.name, one.path()));
            let names: Vec<String> = names.collect();
            let choice = Client::choice(several.iter().map(|one| one.client), &names);
            let how = choice.unwrap_or_else(|| "give the whole path of one process".to_owned());
            return Err(anyhow!("several processes are called `{name}`: {}; {how}", names.join(", ")).into());
        }
    };
    let (deployment, path) = (program.at.deployment, program.path());
    let found = Found { program, exports: Exports::default() };
    let Some(mut dial) = program.located(taps.patience()).await? else { return Ok(found) };
    let exports = loop {
        let failure = tokio::select! {
            exports = exports_of(taps, deployment, path, dial.clone()) => match exports {
                Ok(exports) => break exports,
                Err(failure) => failure,
            },
            failure = program.leaves(&dial.session) => failure,
        };
        taps.forget(&dial.session);
        match program.place().await {
            Ok(Place::At(other)) if other.session != dial.session => dial = other,
            Ok(Place::Gone(_)) => return Err(program.ended()),
            Ok(Place::Coming(_)) => dial = program.located(taps.patience()).await?.ok_or(failure)?,
            Ok(Place::At(_) | Place::WithoutSession) | Err(_) => return Err(failure),
        }
    };
    Ok(Found { exports, ..found })
}

/// The place of a program.
enum Place {
    At(Dial),
    /// The program runs, but has no session in which it could be asked.
    WithoutSession,
    /// The program is being started. The text is its state.
    Coming(String),
    /// The program has ended. The text is its state.
    Gone(String),
}

impl Program<'_> {
    fn path(&self) -> &str {
        &self.at.process.path
    }

    /// Asks the node of the program for its place.
    async fn place(&self) -> Result<Place, Failure> {
        let located = match locations(self.client, self.at.host, self.at.deployment).await {
            Ok(located) => located,
            // The node does not know the deployment any more.
            Err(Failure::Refused(why)) => return Ok(Place::Gone(why.to_string())),
            Err(failure) => return Err(failure),
        };
        if let Some((_, dial)) = located.into_iter().find(|(located, _)| located == self.path()) {
            return Ok(Place::At(dial));
        }
        let answer = self.client.ask(self.at.host, &Request::Status, ANSWER_WITHIN).await?;
        let Answer::Status(status) = answer else { return Err(unasked(self.at.host, &answer)) };
        let part = status.deployments.into_iter().find(|part| part.deployment == *self.at.deployment);
        let process = part.and_then(|part| part.processes.into_iter().find(|process| process.path == self.path()));
        let Some(ProcessStatus { state, .. }) = process else { return Ok(Place::Gone("it is not there".to_owned())) };
        Ok(match state.as_str() {
            "starting" | "restarting" | "connecting" | "being replaced" => Place::Coming(state),
            _ if ["ended", "dead", "refused", "not there"].iter().any(|word| state.starts_with(word)) => {
                Place::Gone(state)
            }
            _ => Place::WithoutSession,
        })
    }

    /// Returns the address of the program; nothing if it cannot be asked. Waits if the program is being started.
    async fn located(&self, within: Duration) -> Result<Option<Dial>, Failure> {
        let until = clock::now() + within;
        loop {
            match self.place().await? {
                Place::At(dial) => return Ok(Some(dial)),
                Place::WithoutSession => return Ok(None),
                Place::Gone(state) => return Err(anyhow!("`{}` does not run: {state}", self.path()).into()),
                Place::Coming(state) if clock::now() >= until => {
                    return Err(Failure::Unreachable(anyhow!("`{}` cannot be asked yet: it was {state}", self.path())));
                }
                Place::Coming(_) => clock::sleep_until(clock::now() + WATCH_EVERY).await,
            }
        }
    }

    /// Waits until the program has left this session. If the node does not answer, continues to wait.
    ///
    /// # Cancellation
    /// Safe.
    async fn leaves(&self, session: &str) -> Failure {
        loop {
            clock::sleep_until(clock::now() + LOOK_EVERY).await;
            match self.place().await {
                Ok(Place::At(dial)) if dial.session == session => {}
                Err(_) => {}
                Ok(Place::At(_) | Place::WithoutSession | Place::Coming(_) | Place::Gone(_)) => return self.ended(),
            }
        }
    }

    fn ended(&self) -> Failure {
        let (path, deployment) = (self.path(), &self.at.deployment.name);
        anyhow!("`{path}` ended before it could be asked; `dca events {deployment}` says why").into()
    }
}

/// The program that a call goes to.
pub(crate) struct Callee<'a> {
    pub(crate) deployment: &'a Deployment,
    pub(crate) host: &'a str,
    pub(crate) path: &'a str,
}

/// Returns a call. The user signs it if the node is in a team and the procedure requires a right.
pub(crate) async fn signed(
    client: &Client,
    callee: Callee<'_>,
    access: Access,
    call: ObjectCall,
) -> Result<ObjectCall, Failure> {
    let Callee { deployment, host, path } = callee;
    let key = key::object(&deployment.name, path).call;
    let asked = CallRequest {
        deployment: deployment.clone(),
        path: path.to_owned(),
        procedure: call.name.clone(),
        access,
        digest: call_digest(&key, &call).map_err(|error| anyhow!("the call cannot be sent: {error}"))?,
    };
    let asked = client.signed(host, Request::Call(Box::new(asked)), deployment.epoch).await?;
    let Request::Signed(signed) = asked else { return Ok(call) };
    Ok(ObjectCall { warrant: Some(Warrant { head: signed.head.into(), body: signed.body.into() }), ..call })
}

pub(crate) async fn exports_of(
    taps: &Taps,
    deployment: &Deployment,
    path: &str,
    dial: Dial,
) -> Result<Exports, Failure> {
    taps.dial(dial).await?;
    let silent = || {
        anyhow!("`{path}` has not reported its exports: it has no links yet, or was built with an older version of DCA")
    };
    taps.exports(&deployment.name, path).await?.ok_or_else(|| Failure::Unreachable(silent()))
}

fn exported<'a>(found: &'a Found<'_>, name: &str) -> Result<&'a Exported, Failure> {
    let exported = found.exports.exports.iter().find(|exported| exported.name == name);
    let known = || found.exports.exports.iter().map(|exported| exported.name.clone()).collect();
    exported.ok_or_else(|| {
        let error = ObjectError::NoSuchProcedure { name: name.to_owned(), known: known() };
        failure(found, name, &error)
    })
}

/// Makes the call. Returns its result, and how long it took.
async fn ask(
    taps: &Taps,
    found: &Found<'_>,
    exported: &Exported,
    call: ObjectCall,
) -> Result<(Value, Duration), Failure> {
    let (begun, program) = (clock::now(), &found.program);
    let called = taps.call(&program.at.deployment.name, program.path(), call).await?;
    let bytes = called.map_err(|error| failure(found, &exported.name, &error))?;
    Ok((result(&found.exports, &exported.signature, &bytes), clock::now() - begun))
}

fn show(arguments: &ObjectArgs, found: &Found<'_>, exported: &Exported, value: &Value, took: Duration) {
    if arguments.json {
        let name = format!("{}:{}.{}", found.program.at.deployment.name, found.program.path(), exported.name);
        let kind = exported.signature.result.name.as_str();
        console::answer(&json!({ "name": name, "type": kind, "value": value, "took": took.as_secs_f64() }));
    } else if !value.is_null() {
        console::say(&printable(&value.to_string()));
    }
}

/// Returns the failure as one sentence. If the outcome is unknown, the program counts as unreachable.
fn failure(found: &Found<'_>, name: &str, error: &ObjectError) -> Failure {
    let why = anyhow!(sentence(found.program.path(), name, error));
    if error.may_have_happened() { Failure::Unreachable(why) } else { Failure::Refused(why) }
}

/// Describes in a sentence why a call has no result.
pub(crate) fn sentence(path: &str, name: &str, error: &ObjectError) -> String {
    let hint = if error.hint().is_empty() { String::new() } else { format!("; {}", error.hint()) };
    format!("`{name}` of `{path}`: {error}{hint}")
}
