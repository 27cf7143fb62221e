//! Changes of a running deployment. `dca plan` shows the changes that a spec would make, `dca deploy` makes them, and
//! `dca replace` restarts programs from their present files.

use crate::client::{ANSWER_WITHIN, Client, Clients, unasked};
use crate::complete;
use crate::follow::Spec;
use crate::io::user;
use crate::logic::process_name::{DeploymentName, ProcessName};
use crate::logic::suggestion;
use crate::reader::Leave;
use crate::stop::{Located, locate};
use crate::{ConnectArgs, Controllers, Values, check, stored};
use anyhow::anyhow;
use clap_complete::ArgValueCompleter;
use language::plan::{Difference, Expression, Group, Plan, PlanChange, difference};
use node::console::{self, Failure, block_on};
use node::logic::protocol::{
    Answer, ChangeRequest, ChangeStage, ChangeUnderway, Deployment, Report, Request, Revision,
};
use node::logic::table::counted;
use serde_json::json;
use std::path::PathBuf;
use std::time::Duration;

/// The arguments of `dca plan`.
#[derive(Debug, clap::Args)]
pub struct PlanArguments {
    /// The spec
    file: PathBuf,
    /// Print it as JSON
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    connect: ConnectArgs,
    #[command(flatten)]
    controllers: Controllers,
    #[command(flatten)]
    values: Values,
}

/// The arguments of `dca replace`.
#[derive(Debug, clap::Args)]
pub struct ReplaceArguments {
    /// The deployment: NAME, or NAME@NUMBER for one run of it
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: DeploymentName,
    /// The processes whose programs are started again: their paths, or the ends of these
    #[arg(required = true, value_parser = ProcessName::parse_one, add = ArgValueCompleter::new(complete::processes))]
    processes: Vec<ProcessName>,
    #[command(flatten)]
    probation: Probation,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// How long a new program is watched.
#[derive(Clone, Copy, Debug, clap::Args)]
pub struct Probation {
    /// How many seconds a new program must stay healthy; otherwise the previous one is put back
    #[arg(
        long = "probation", value_name = "SECONDS", default_value_t = 8.0, allow_negative_numbers = true,
        value_parser = |text: &str| crate::seconds(text, &(0.0..=600.0)),
    )]
    seconds: f64,
}

impl Probation {
    /// No probation: the new program is not watched.
    pub(crate) fn none() -> Self {
        Self { seconds: 0.0 }
    }

    fn span(self) -> Duration {
        Duration::from_secs_f64(self.seconds)
    }
}

/// Runs `dca plan`.
pub(crate) fn plan(arguments: &PlanArguments) -> Result<(), Failure> {
    let spec = check::load(&arguments.file, &arguments.controllers, &arguments.values, false)?;
    block_on(async {
        let client = Client::open(&arguments.connect).await?;
        let running = running(&client, &spec.plan).await;
        client.close().await;
        tell_plan(&spec.plan, running?.as_ref(), arguments.json)
    })
}

/// Runs `dca replace`.
pub(crate) fn replace(arguments: &ReplaceArguments) -> Result<(), Failure> {
    block_on(async {
        let clients = Clients::open(&arguments.connect).await?;
        let replaced = replace_by(&clients, arguments).await;
        clients.close().await;
        replaced
    })
}

async fn replace_by(clients: &Clients, arguments: &ReplaceArguments) -> Result<(), Failure> {
    let Located { client, deployment, home } = locate(clients.statuses().await?, &arguments.name).await?;
    let Some(revision) = revision(client, &home, &deployment.name).await? else {
        return Err(anyhow!("`{}` does not run any more", deployment.name).into());
    };
    let meant = arguments.processes.iter().map(|name| meant(&revision.plan, std::iter::empty(), &deployment, name));
    let again = meant.collect::<Result<Vec<String>, String>>().map_err(|why| anyhow!(why))?;
    let plan = revision.plan.clone();
    change(client, &home, revision, plan, again, arguments.probation).await
}

/// The most programs that are listed when a name fits none of them.
const PROGRAMS_TOLD: usize = 20;

/// Returns the path of the only matching program or group.
pub(crate) fn meant<'a>(
    plan: &'a Plan,
    groups: impl Iterator<Item = &'a String>,
    deployment: &Deployment,
    name: &ProcessName,
) -> Result<String, String> {
    let (process, live) = (name.process().unwrap_or_default(), plan.live_leaves());
    let leaves = live.iter().filter_map(|number| plan.leaves.get(*number as usize));
    let paths = leaves.map(|leaf| &leaf.path).chain(groups);
    let found: Vec<&String> = paths.filter(|path| name.is_process(deployment, path)).collect();
    match found[..] {
        [one] => Ok(one.clone()),
        [] => {
            let live = live.iter().filter_map(|number| plan.leaves.get(*number as usize));
            let mut all: Vec<&str> = live.map(|leaf| leaf.path.as_str()).collect();
            all.sort_unstable();
            if let Some(near) = suggestion::process(name, all.iter().map(|path| (deployment, *path))) {
                return Err(format!("`{}` has no program `{process}`; did you mean `{near}`?", plan.name));
            }
            let more = if all.len() > PROGRAMS_TOLD { ", …" } else { "" };
            all.truncate(PROGRAMS_TOLD);
            let all = all.join("`, `");
            Err(format!("`{}` has no program `{process}`; it has `{all}`{more}", plan.name))
        }
        _ => Err(format!(
            "{} of `{}` end in `{process}`; give more of the path",
            counted(found.len(), "program"),
            plan.name
        )),
    }
}

/// How a deployment that runs becomes another.
#[derive(Clone, Debug, clap::Args)]
pub struct Rollout {
    #[command(flatten)]
    probation: Probation,
    /// Change the programs of this host first; the rest once they are healthy, or they are taken back
    #[arg(long, value_name = "HOST", add = ArgValueCompleter::new(complete::hosts))]
    canary: Option<String>,
}

/// Changes the running deployment of the spec's name to that spec. Returns whether there was such a deployment.
pub(crate) async fn change_running(client: &Client, spec: &Spec, rollout: &Rollout) -> Result<bool, Failure> {
    let (home, probation) = (home(&spec.plan)?, rollout.probation);
    let Some(running) = revision(client, &home, &spec.plan.name).await? else {
        return match &rollout.canary {
            Some(host) => Err(anyhow!("`{}` is not running, so `{host}` cannot change first", spec.plan.name).into()),
            None => Ok(false),
        };
    };
    let name = format!("{}@{}", spec.plan.name, running.epoch);
    if let Some(change) = &running.change {
        console::note(&underway_text(&name, running.revision, change));
    }
    let found = difference(&running.plan, &spec.plan).map_err(|obstacles| {
        anyhow!(
            "`{name}` is already deployed, and cannot become this spec while it runs: {}; `dca stop {}` ends it",
            obstacles.join("; "),
            spec.plan.name
        )
    })?;
    if found.changes.is_empty() {
        console::say(&format!("`{name}` runs already as in this spec: nothing changes"));
        return Ok(true);
    }
    stored::check(client, spec).await?;
    found.changes.iter().for_each(|change| console::note(&change.to_string()));
    let Some(host) = &rollout.canary else {
        change(client, &home, running, spec.plan.clone(), Vec::new(), probation).await?;
        return Ok(true);
    };
    change_by_canary(client, &home, running, &spec.plan, host, probation).await?;
    Ok(true)
}

/// Changes the programs of one host, then all others. If the second change fails, the first one is undone.
async fn change_by_canary(
    client: &Client,
    home: &str,
    running: Revision,
    wanted: &Plan,
    host: &str,
    probation: Probation,
) -> Result<(), Failure> {
    let (before, name) = (running.plan.clone(), wanted.name.clone());
    let part = before.changed_on(wanted, host).map_err(|obstacles| anyhow!(obstacles.join("; ")))?;
    let is_all = difference(&part, wanted).is_ok_and(|rest| rest.changes.is_empty());
    let (epoch, first) = (running.epoch, running.revision + 1);
    console::note(&format!("on `{host}` first"));
    change(client, home, running, part, Vec::new(), probation).await?;
    if is_all {
        return Ok(());
    }
    let of_canary = || Revision { epoch, revision: first, plan: before.clone(), change: None };
    let Err(failure) = change(client, home, of_canary(), wanted.clone(), Vec::new(), probation).await else {
        return Ok(());
    };
    if matches!(failure, Failure::Unreachable(_)) {
        return Err(failure);
    }
    console::note(&format!("the change of `{name}` has failed, so the change of the host `{host}` is taken back"));
    change(client, home, of_canary(), before.clone(), Vec::new(), probation).await?;
    Err(failure)
}

/// Returns the running revision of the deployment that has the name of the plan. The home node is asked for it.
async fn running(client: &Client, plan: &Plan) -> Result<Option<Revision>, Failure> {
    let home = home(plan)?;
    client.refuse_revoked(std::slice::from_ref(&home)).await?;
    if !client.finds(&home).await? {
        return Err(Failure::Unreachable(anyhow!(
            "no node answers for the host `{home}`, where `main` runs; start `dca-node --name {home}` on it, in the \
             same team or with `--insecure-lan`"
        )));
    }
    revision(client, &home, &plan.name).await
}

fn home(plan: &Plan) -> Result<String, Failure> {
    Ok(plan.home().ok_or_else(|| anyhow!("the plan names no host for `main`"))?.to_owned())
}

pub(crate) async fn revision(client: &Client, home: &str, name: &str) -> Result<Option<Revision>, Failure> {
    let answer = client.ask(home, &Request::Revision { name: name.to_owned() }, ANSWER_WITHIN).await?;
    if let Answer::Revision(revision) = answer {
        return Ok(Some(*revision));
    }
    if matches!(answer, Answer::Refused(_)) { Ok(None) } else { Err(unasked(home, &answer)) }
}

/// Makes the home carry out a change, and reports the result.
pub(crate) async fn change(
    client: &Client,
    home: &str,
    running: Revision,
    plan: Plan,
    again: Vec<String>,
    probation: Probation,
) -> Result<(), Failure> {
    let (name, epoch, revision) = (plan.name.clone(), running.epoch, running.revision);
    let (probation, by) = (probation.span(), user::name_and_host());
    let request = ChangeRequest { name: name.clone(), epoch, revision, plan, again, probation, by };
    let mut left = Leave::new()?;
    let mut answers = client.order_on(home, Request::Change(Box::new(request)), epoch).await?;
    let answer = tokio::select! {
        answer = answers.next() => answer,
        () = left.asked() => return Err(left_alone(&name).into()),
    };
    let answer = match answer {
        Some(Ok(answer)) => answer,
        Some(Err(Failure::Unreachable(why))) => return Err(Failure::Unreachable(unknown(&name, why))),
        Some(Err(failure)) => return Err(failure),
        None => return Err(Failure::Unreachable(unknown(&name, anyhow!("the node `{home}` sent no more reports")))),
    };
    if let Answer::Report(Report::Unchanged { reasons, .. }) = answer {
        return Err(anyhow!("`{name}@{epoch}` is not changed: {}", reasons.join("; ")).into());
    }
    let Answer::Report(Report::Changed { revision, changes, .. }) = answer else {
        return Err(unasked(home, &answer));
    };
    if console::is_json() {
        let changes: Vec<String> = changes.iter().map(ToString::to_string).collect();
        console::answer(&json!({ "deployment": format!("{name}@{epoch}"), "revision": revision, "changes": changes }));
    } else {
        console::say(&format!(
            "`{name}@{epoch}` is changed ({}, revision {revision})",
            counted(changes.len(), "change")
        ));
    }
    Ok(())
}

/// Returns the message for a user who leaves before the end of a change.
fn left_alone(name: &str) -> anyhow::Error {
    anyhow!(
        "this command ends before the home has reported the result; the change of `{name}` continues. `dca plan` shows \
         what differs, and `dca events {name}` shows what happened"
    )
}

fn unknown(name: &str, why: anyhow::Error) -> anyhow::Error {
    why.context(format!("it is not known whether `{name}` was changed; `dca plan` shows what differs"))
}

fn tell_plan(wanted: &Plan, running: Option<&Revision>, is_json: bool) -> Result<(), Failure> {
    let Some(Revision { epoch, revision, plan, change }) = running else {
        let programs = counted(wanted.leaves.len(), "program");
        if is_json {
            console::answer(&json!({ "deployment": null, "start": wanted.leaves.len(), "hosts": wanted.hosts }));
        } else {
            let hosts = wanted.hosts.join("`, `");
            console::say(&format!("`{}` is not running: {programs} would start on `{hosts}`", wanted.name));
        }
        return Ok(());
    };
    let name = format!("{}@{epoch}", wanted.name);
    let found = difference(plan, wanted);
    if is_json {
        let lines = |changes: &[PlanChange]| changes.iter().map(ToString::to_string).collect::<Vec<_>>();
        let (changes, depends, obstacles) = match &found {
            Ok(found) => (lines(&found.changes), conditions(plan, found), Vec::new()),
            Err(obstacles) => (Vec::new(), Vec::new(), obstacles.clone()),
        };
        let change = change
            .as_ref()
            .map(|ChangeUnderway { revision, by, stage }| json!({ "revision": revision, "by": by, "stage": stage }));
        let told = json!({
            "deployment": name, "revision": revision, "change": change, "changes": changes, "depends": depends,
            "obstacles": obstacles,
        });
        console::answer(&told);
        return if obstacles.is_empty() { Ok(()) } else { Err(refusal(&name, &[])) };
    }
    let found = found.map_err(|obstacles| refusal(&name, &obstacles))?;
    let touched = found
        .changes
        .iter()
        .filter(|change| matches!(change, PlanChange::Replace { .. } | PlanChange::Remove { .. }))
        .count();
    match change {
        Some(change) => console::say(&format!("{}:", underway_text(&name, *revision, change))),
        None => console::say(&format!("`{name}`, revision {revision}:")),
    }
    found.changes.iter().for_each(|change| console::say(&format!("  {change}")));
    console::say(&format!("  keep       {}", counted(plan.live_leaves().len().saturating_sub(touched), "program")));
    conditions(plan, &found).iter().for_each(|condition| console::say(&format!("  depends    {condition}")));
    Ok(())
}

/// Returns for each group with other event actions when `dca deploy` refuses the change. This depends on the place of
/// the group at that moment, so a plan cannot know it.
fn conditions(running: &Plan, found: &Difference) -> Vec<String> {
    let groups = running.groups.iter().zip(&found.plan.groups);
    let others = groups.filter(|(before, after)| before.expression != after.expression);
    others.map(|(group, _)| condition(group)).collect()
}

fn condition(group: &Group) -> String {
    let is_activity = matches!(group.expression, Expression::Chart(_));
    let why = match is_activity {
        true => "a state that it is in does not exist any more, or a variable cannot keep its value",
        false => "a running process has no place in the new event actions",
    };
    format!("{}: `dca deploy` is refused if {why}", group.path)
}

/// Returns the message for a user who looks at a deployment during a change.
fn underway_text(name: &str, revision: u32, change: &ChangeUnderway) -> String {
    let ChangeUnderway { revision: next, by, stage } = change;
    match stage {
        ChangeStage::Examined => {
            format!("`{name}`, revision {revision}; the hosts examine a change to revision {next} by {by}")
        }
        ChangeStage::Applied => {
            format!("`{name}`, revision {next} by {by}, not current yet: its programs are being started")
        }
        ChangeStage::Probation => {
            format!(
                "`{name}`, revision {next} by {by}, in probation; revision {revision} is current until the probation ends"
            )
        }
        ChangeStage::TakenBack => {
            format!(
                "`{name}`, revision {revision}: the deployment returns to this revision, because revision {next} by {by} has failed"
            )
        }
    }
}

fn refusal(name: &str, obstacles: &[String]) -> Failure {
    let why = if obstacles.is_empty() { String::new() } else { format!(": {}", obstacles.join("; ")) };
    anyhow!("`{name}` cannot become this spec while it runs{why}").into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use language::{Options, Source, compile};

    fn plan(states: &str, actions: &str) -> Plan {
        let text = format!(
            "module Step {{ done; }}
            activity Watch(here: Host) {{
                host{{here}}
                look instof Step(here);
                {states}
            }}
            process main(){{
                host{{c1}}
                instantiated_processes{{ watch instof Watch(c1); a instof Step(c1); b instof Step(c1); }}
                internal_event_actions{{ {actions} }}
            }}"
        );
        let compiled = compile(&Source::new("watch.dca", text), &[], &Options::named("watch"));
        compiled.plan.unwrap_or_else(|| panic!("{:#?}", compiled.diagnostics))
    }

    /// A plan names the changes that the place of a group may forbid, and only these.
    #[test]
    fn a_plan_says_which_changes_depend_on_the_place() {
        let wide = "var n: 0..9 = 0; initial state s { run look; on done when n < 9 -> t { n += 1; } }
            state t { on after 1 s -> s; }";
        let narrow = wide.replace("0..9", "0..3").replace("n < 9", "n < 3");
        let running = plan(wide, "watch # (a ; b)");
        let depends = |wanted: &Plan| conditions(&running, &difference(&running, wanted).unwrap());
        assert_eq!(depends(&running), Vec::<String>::new());
        let activity = "main/watch: `dca deploy` is refused if a state that it is in does not exist any more, \
                        or a variable cannot keep its value";
        assert_eq!(depends(&plan(&narrow, "watch # (a ; b)")), [activity]);
        let without = "initial state s { run look; on done -> s; }";
        assert_eq!(depends(&plan(without, "watch # (a ; b)")), [activity]);
        let actions = "main: `dca deploy` is refused if a running process has no place in the new event actions";
        assert_eq!(depends(&plan(wide, "watch # (b ; a)")), [actions]);
        assert_eq!(depends(&plan(&narrow, "watch # (b ; a)")), [actions, activity]);
    }
}
