//! `dca ctl`: shows the questions and states of a running activity, and gives it the orders of a user.

use crate::ConnectArgs;
use crate::client::{Client, Clients, Statuses, unasked};
use crate::complete;
use crate::io::user;
use crate::logic::process_name::{DeploymentName, ProcessName};
use crate::logic::suggestion;
use crate::stop::{Located, locate};
use anyhow::{anyhow, bail};
use clap_complete::ArgValueCompleter;
use language::plan::Notice;
use node::console::{self, Failure, block_on};
use node::logic::protocol::{
    ActivityInput, ActivityStatus, Answer, Delivery, Deployment, ProcessStatus, Request, Taken, TellRequest,
};
use std::time::Duration;

/// How long the home of the deployment may take to answer.
const ANSWER_WITHIN: Duration = Duration::from_secs(5);

/// The arguments of `dca ctl`.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// The deployment: NAME, or NAME@NUMBER for one run of it
    #[arg(value_parser = DeploymentName::parse, add = ArgValueCompleter::new(complete::deployments))]
    name: DeploymentName,
    /// The activity: its path, or the end of its path
    #[arg(value_parser = ProcessName::parse_one, add = ArgValueCompleter::new(complete::activities))]
    activity: ProcessName,
    /// The order; without an order, shows the states and questions of the activity, and the orders that it waits for
    #[command(subcommand)]
    order: Option<Order>,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// An order for an activity.
#[derive(Debug, clap::Subcommand)]
enum Order {
    /// Give it a message
    Message(Message),
    /// Ask it to suspend: its transition `on suspend` is taken
    Suspend(ConnectArgs),
    /// Ask it to continue: its transition `on resume` is taken
    Resume(ConnectArgs),
    /// Answer one of its questions
    Answer(GivenAnswer),
}

/// An answer to a question.
#[derive(Debug, clap::Args)]
struct GivenAnswer {
    /// The number of the question
    #[arg(value_name = "NUMBER", value_parser = question_number)]
    question: u64,
    /// The answer
    option: String,
    #[command(flatten)]
    connect: ConnectArgs,
}

impl Order {
    fn connect(&self) -> &ConnectArgs {
        match self {
            Self::Message(message) => &message.connect,
            Self::Answer(answer) => &answer.connect,
            Self::Suspend(connect) | Self::Resume(connect) => connect,
        }
    }

    /// Returns the order for an activity in this state.
    fn told(&self, activity: Option<&ActivityStatus>) -> anyhow::Result<ActivityInput> {
        Ok(match self {
            Self::Answer(answer) => {
                answer.check(activity)?;
                ActivityInput::Answer { question: answer.question, option: answer.option.clone() }
            }
            Self::Message(Message { port, text, priority, .. }) => {
                ActivityInput::Message { port: port.clone(), text: text.clone(), priority: *priority }
            }
            Self::Suspend(_) => ActivityInput::Notice(Notice::Suspend),
            Self::Resume(_) => ActivityInput::Notice(Notice::Resume),
        })
    }

    /// Returns the name of the order, for a person.
    fn name(&self) -> &'static str {
        match self {
            Self::Message(_) => "the message",
            Self::Answer(_) => "the answer",
            Self::Suspend(_) => "the order to suspend",
            Self::Resume(_) => "the order to resume",
        }
    }
}

/// A message for an activity.
#[derive(Debug, clap::Args)]
struct Message {
    /// The input port
    port: String,
    /// The content
    text: String,
    /// The priority; of messages that wait, a greater one comes first
    #[arg(long, value_name = "NUMBER", default_value_t = 0, allow_negative_numbers = true)]
    priority: u8,
    #[command(flatten)]
    connect: ConnectArgs,
}

/// Reads the number of a question. It is never left out: the question that is open when the command looks may be another one than
/// the question that a person has read.
fn question_number(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_not_a_number| "the number of the question comes first, such as `answer 1 yes`".to_owned())
}

impl GivenAnswer {
    /// Checks that this question is open, and has this answer.
    fn check(&self, activity: Option<&ActivityStatus>) -> anyhow::Result<()> {
        let open = activity.map_or(&[][..], |activity| &activity.questions);
        let Some(meant) = open.iter().find(|question| question.number == self.question) else {
            let numbers: Vec<String> = open.iter().map(|question| question.number.to_string()).collect();
            let hint =
                if open.is_empty() { "no question is".to_owned() } else { format!("open is {}", numbers.join(", ")) };
            bail!("question {} is not open; {hint}", self.question)
        };
        if !meant.options.contains(&self.option) {
            let options = meant.options.join("`, `");
            bail!("`{}` is not an answer to question {}; the answers are `{options}`", self.option, self.question)
        }
        Ok(())
    }
}

/// Runs the verb.
pub(crate) fn run(arguments: &Arguments) -> Result<(), Failure> {
    block_on(async {
        let order = arguments.order.as_ref();
        let connect = order.map_or_else(|| arguments.connect.clone(), |order| order.connect().or(&arguments.connect));
        let clients = Clients::open(&connect).await?;
        let told = tell(&clients, arguments).await;
        clients.close().await;
        told
    })
}

async fn tell(clients: &Clients, arguments: &Arguments) -> Result<(), Failure> {
    let statuses = clients.statuses().await?;
    let processes = statuses.iter().flat_map(|(_, all)| &all.nodes).flat_map(|node| &node.deployments);
    let processes = processes.filter(|part| arguments.name.is(&part.deployment)).flat_map(|part| &part.processes);
    let shown: Vec<ProcessStatus> = processes.filter(|process| process.activity.is_some()).cloned().collect();
    let Located { client, deployment, home } = match alone(&statuses, arguments) {
        Some(located) => located,
        None => locate(statuses, &arguments.name).await?,
    };
    let activity = &arguments.activity;
    if activity.deployment().is_some_and(|named| !named.is(&deployment)) {
        return Err(Failure::Usage(anyhow!("`{activity}` is not a process of `{deployment}`")));
    }
    let meant: Vec<&ProcessStatus> = shown.iter().filter(|one| activity.is_process(&deployment, &one.path)).collect();
    let Some(order) = &arguments.order else {
        let [one] = meant.as_slice() else {
            return Err(anyhow!(not_one(&deployment, activity, &meant, &shown)).into());
        };
        console::say(&page(one));
        return Ok(());
    };
    let only = if let [one] = meant.as_slice() { Some(*one) } else { None };
    // The home says why an order cannot reach an activity that does not run.
    let process = only.map_or_else(|| activity.process().unwrap_or_default(), |one| &one.path).to_owned();
    let (name, activity) = (deployment.name.clone(), only.and_then(|one| one.activity.as_ref()));
    let order_told = order.told(activity).map_err(|why| anyhow!("cannot give {}: {why}", order.name()))?;
    let request = TellRequest { name, process, order: order_told, by: user::name_and_host() };
    match deliver(client, &home, request, deployment.epoch).await? {
        Delivery::Taken { path, taken } => {
            console::say(&format!("{}\n", confirmed(order.name(), &path, taken)));
            Ok(())
        }
        Delivery::Refused(why) => Err(anyhow!("cannot give {}: {why}", order.name()).into()),
        Delivery::Unconfirmed(why) => Err(Failure::Unreachable(anyhow!(
            "{} is not confirmed: {why}; `dca status` shows the activity",
            order.name()
        ))),
    }
}

/// Finds the host of an activity whose home does not answer. The activity goes on alone, and its host gives it the order.
fn alone<'a>(all: &[(&'a Client, Statuses)], arguments: &Arguments) -> Option<Located<'a>> {
    let mut found = Vec::new();
    for (client, Statuses { nodes, .. }) in all {
        let parts = nodes.iter().flat_map(|node| node.deployments.iter().map(move |part| (&node.host, part)));
        for (host, part) in parts.filter(|(_, part)| arguments.name.is(&part.deployment)) {
            let is_away = nodes.iter().all(|node| node.host != part.home);
            let is_meant = |one: &ProcessStatus| {
                one.activity.is_some() && arguments.activity.is_process(&part.deployment, &one.path)
            };
            if is_away && part.processes.iter().any(is_meant) {
                found.push(Located { client, deployment: part.deployment.clone(), home: host.clone() });
            }
        }
    }
    if found.len() == 1 { found.pop() } else { None }
}

/// Says that a name means no running activity of a deployment, or several.
fn not_one(deployment: &Deployment, name: &ProcessName, meant: &[&ProcessStatus], all: &[ProcessStatus]) -> String {
    let paths = |all: &mut dyn Iterator<Item = &ProcessStatus>| {
        all.map(|one| format!("`{}`", one.path)).collect::<Vec<_>>().join(", ")
    };
    if !meant.is_empty() {
        let paths = paths(&mut meant.iter().copied());
        return format!("`{name}` may be any of {paths}; give more of the path");
    }
    let near = suggestion::process(name, all.iter().map(|one| (deployment, one.path.as_str())));
    let otherwise =
        if all.is_empty() { "it runs none".to_owned() } else { format!("it runs {}", paths(&mut all.iter())) };
    let hint = suggestion::question(near, &otherwise);
    format!("no running activity of `{deployment}` is called `{name}`; {hint}")
}

/// Signs an order if necessary, and has the home of the deployment deliver it.
pub(crate) async fn deliver(
    client: &Client,
    home: &str,
    request: TellRequest,
    epoch: u64,
) -> Result<Delivery, Failure> {
    let request = client.signed(home, Request::Tell(Box::new(request)), epoch).await?;
    let answer = client.ask(home, &request, ANSWER_WITHIN).await?;
    if let Answer::Delivered(told) = answer { Ok(told) } else { Err(unasked(home, &answer)) }
}

/// Describes how an activity has reacted to an order.
pub(crate) fn confirmed(order: &str, path: &str, taken: Taken) -> String {
    match taken {
        Taken::Reacted => format!("`{path}` has taken {order}"),
        Taken::Waits => {
            format!("`{path}` has received {order}, and will react after the processes that it is stopping have ended")
        }
        Taken::Ignored => format!("`{path}` has received {order}, but its present states have no transition for it"),
    }
}

/// Describes the states of an activity, its questions, and the orders that it waits for.
fn page(process: &ProcessStatus) -> String {
    let ActivityStatus { states, questions, orders } = process.activity.clone().unwrap_or_default();
    let states = if states.is_empty() { "between two states".to_owned() } else { format!("in {}", states.join(", ")) };
    let mut lines = vec![format!("{} is {states}", process.path)];
    lines.extend(questions.iter().map(|question| format!("question {}: {}", question.number, question.text)));
    let first = questions.first().and_then(|question| Some((question.number, question.options.first()?)));
    lines.extend(first.map(|(number, option)| format!("  answer with `answer {number} {option}`, for example")));
    if !orders.is_empty() {
        lines.push(format!("it waits for: {}", orders.join(", ")));
    }
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::tree::tests::door_node;
    use node::logic::protocol::OpenQuestion;

    /// A person answers the question that he has read, and no other one that is open now.
    #[test]
    fn an_answer_is_for_one_question() {
        let options = ["yes", "no"].map(str::to_owned).to_vec();
        let question = OpenQuestion { number: 2, text: "Fire? (yes, no)".to_owned(), options };
        let activity = ActivityStatus { questions: vec![question], ..ActivityStatus::default() };
        let check = |question: u64, option: &str| {
            let answer = GivenAnswer { question, option: option.to_owned(), connect: ConnectArgs::default() };
            answer.check(Some(&activity)).map_err(|error| error.to_string())
        };
        assert_eq!(check(2, "yes"), Ok(()));
        assert_eq!(check(1, "yes"), Err("question 1 is not open; open is 2".to_owned()));
        assert_eq!(
            check(2, "maybe"),
            Err("`maybe` is not an answer to question 2; the answers are `yes`, `no`".to_owned())
        );
        assert!(question_number("yes").is_err_and(|why| why.contains("`answer 1 yes`")));
    }

    #[test]
    fn a_slip_in_the_name_of_an_activity_is_told_with_what_was_meant() {
        let part = door_node("c1", &[("main/ask", "running", None), ("main/hit/ask", "running", None)]);
        let (deployment, all) = (&part.deployments[0].deployment, &part.deployments[0].processes);
        let told = |name: &str, meant: &[&ProcessStatus], all: &[ProcessStatus]| {
            not_one(deployment, &ProcessName::new(name), meant, all)
        };
        let none = "no running activity of `door@1` is called";
        assert_eq!(told("assk", &[], all), format!("{none} `assk`; did you mean `ask`?"));
        assert_eq!(told("x", &[], all), format!("{none} `x`; it runs `main/ask`, `main/hit/ask`"));
        assert_eq!(told("x", &[], &[]), format!("{none} `x`; it runs none"));
        let both: Vec<&ProcessStatus> = all.iter().collect();
        assert_eq!(told("ask", &both, all), "`ask` may be any of `main/ask`, `main/hit/ask`; give more of the path");
    }
}
