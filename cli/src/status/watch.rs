//! `dca status --watch`: shows the running processes on all hosts, and their changes.
//!
//! On a terminal, one table is drawn repeatedly. Otherwise, a line is printed for each process that has changed. With
//! `--json`, a line is printed for each state of everything.

use super::{Arguments, Group, asked, nodes, text};
use crate::client::Clients;
use crate::client::feed::{Feed, Mode};
use crate::logic::process_name::DeploymentName;
use crate::output;
use crate::reader::Reader;
use comms::io::clock;
use comms::logic::time::Time;
use node::console::{self, Failure, block_on};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::pin::pin;
use std::time::Duration;
use tokio::sync::Notify;
use view::sentence::date_and_time;

/// The longest time until the nodes are asked again, and until the table is drawn again.
const EVERY: Duration = Duration::from_secs(1);
/// The shortest pause between two questions to the nodes after an event: many events often happen at once.
const AGAIN_AFTER: Duration = Duration::from_millis(50);

/// The state when the nodes were last asked.
#[derive(Debug, Default)]
struct View {
    groups: Vec<Group>,
    /// If no state was received, the reason.
    failure: Option<String>,
}

/// The kind of output, and its present content.
#[derive(Debug)]
enum Shown {
    /// The number of lines of the table that is on the terminal.
    Table(usize),
    /// The state of each process, by path.
    Lines(BTreeMap<String, String>),
    /// The last state, without the parts that change all the time.
    Json(String),
}

/// Watches until Ctrl-C.
pub(super) fn run(arguments: &Arguments) -> Result<(), Failure> {
    block_on(async {
        let mut reader = Reader::new()?;
        let mut feed = tokio::select! {
            feed = Feed::open(&arguments.connect, Mode::Follow) => feed?,
            () = reader.left() => return Ok(()),
        };
        let mut shown = if arguments.json {
            Shown::Json(String::new())
        } else if output::screen().is_some() {
            Shown::Table(0)
        } else {
            Shown::Lines(BTreeMap::new())
        };
        let (happened, mut view, mut redraw) = (Notify::new(), View::default(), tokio::time::interval(EVERY));
        let mut looking = pin!(look(feed.clients(), None, &happened));
        let mut is_read = true;
        while is_read {
            tokio::select! {
                seen = &mut looking => {
                    view = seen;
                    if let Some(name) = &arguments.name {
                        view.groups.iter_mut().for_each(|group| group.only(name));
                    }
                    looking.set(look(feed.clients(), Some(clock::now()), &happened));
                    is_read = shown.show(&view, arguments.name.as_ref())?;
                }
                // The next question to the nodes shows the change.
                _ = feed.next() => happened.notify_one(),
                _ = redraw.tick() => {
                    if let Shown::Table(_) = shown {
                        is_read = shown.show(&view, arguments.name.as_ref())?;
                    }
                }
                () = reader.left() => break,
            }
        }
        feed.close().await;
        Ok(())
    })
}

/// Asks every node for its status. Waits before this for some time after the last question, or shortly after an event.
async fn look(clients: Clients, last: Option<Time>, happened: &Notify) -> View {
    if let Some(last) = last {
        tokio::select! {
            () = clock::sleep_until(last + EVERY) => {}
            () = happened.notified() => clock::sleep_until(last + AGAIN_AFTER).await,
        }
    }
    match asked(clients.look().await).await {
        Ok(groups) => View { groups, failure: None },
        Err(failure) => View { failure: Some(crate::client::words(&failure)), ..View::default() },
    }
}

impl Shown {
    /// Shows the changes. Returns whether the output still has a reader.
    fn show(&mut self, view: &View, name: Option<&DeploymentName>) -> anyhow::Result<bool> {
        let said = match self {
            Self::Table(lines) => {
                let (rows, columns) = output::screen().unwrap_or(output::SCREEN_DEFAULT);
                let (drawn, count) = drawn(&view.table(name), *lines, rows, columns);
                *lines = count;
                drawn
            }
            Self::Lines(before) => {
                let mut now = view.lines();
                view.keep_unknown(before, &mut now);
                let said = changed(before, &now);
                *before = now;
                said
            }
            Self::Json(before) => {
                let (line, compared) = view.json()?;
                let is_new = compared != *before;
                *before = compared;
                if is_new { format!("{line}\n") } else { String::new() }
            }
        };
        if said.is_empty() { Ok(true) } else { console::pass(said.as_bytes()) }
    }
}

impl View {
    fn table(&self, name: Option<&DeploymentName>) -> String {
        let mut table = format!("{}   (Ctrl-C to leave)\n\n", when());
        match &self.failure {
            Some(why) => table.push_str(why),
            None => table.push_str(&text(&self.groups, name)),
        }
        for Group { away, .. } in &self.groups {
            let silent = away.silent.iter().filter(|host| !away.back.contains(*host));
            let silent = silent.map(|host| format!("warning: `{host}` does not answer"));
            for warning in silent.chain(away.warnings()) {
                write!(table, "\n{warning}").unwrap_or_default();
            }
        }
        table
    }

    /// Returns the state of each process and each host.
    fn lines(&self) -> BTreeMap<String, String> {
        let mut lines = BTreeMap::new();
        for group in &self.groups {
            for node in &group.statuses {
                let host = group.robot(&node.host);
                lines.insert(format!("{host}  node"), "answers".to_owned());
                for part in &node.deployments {
                    for process in &part.processes {
                        let what = format!("{host}  {}  {}", part.deployment, process.path);
                        let pid = process.pid.map(|pid| format!("  pid {pid}")).unwrap_or_default();
                        lines.insert(what, format!("{}{pid}", process.state));
                    }
                }
                let waiting = node.waiting.iter();
                lines.extend(waiting.map(|one| (format!("{host}  {}", one.name), one.state().to_owned())));
            }
            for process in &group.away.processes {
                let what = format!("{}  {}  {}", group.robot(&process.host), process.deployment, process.path);
                lines.insert(what, format!("unknown ({})", group.away.word(&process.host)));
            }
        }
        lines.extend(self.away().into_iter().map(|(robot, word)| (format!("{robot}  node"), word)));
        lines
    }

    /// Returns the hosts that do not answer, each with its state in words.
    fn away(&self) -> BTreeMap<String, String> {
        let of_group = |group: &Group| {
            let away = &group.away;
            let hosts = away.silent.iter().chain(&away.revoked).chain(away.hosts.iter().map(|one| &one.host));
            hosts.map(|host| (group.robot(host), away.word(host))).collect::<Vec<_>>()
        };
        self.groups.iter().flat_map(of_group).collect()
    }

    /// Keeps the known processes of hosts that do not answer, so that they are not reported as ended.
    fn keep_unknown(&self, before: &BTreeMap<String, String>, now: &mut BTreeMap<String, String>) {
        let away = self.away();
        for what in before.keys() {
            let robot = what.split("  ").next().unwrap_or_default();
            let is_away = self.failure.is_some() || away.contains_key(robot);
            if !now.contains_key(what) && is_away {
                let word = away.get(robot).cloned().unwrap_or_else(|| format!("{robot} does not answer"));
                let is_node = what.ends_with("  node");
                now.insert(what.clone(), if is_node { word } else { format!("unknown ({word})") });
            }
        }
    }

    /// Returns everything on one line. Also returns it without the parts that are different each time.
    fn json(&self) -> serde_json::Result<(String, String)> {
        let mut nodes = nodes(&self.groups);
        let line = serde_json::to_string(&nodes)?;
        for node in &mut nodes {
            node.status.up = Duration::ZERO;
            for one in &mut node.status.waiting {
                (one.begins_in, one.at_most) = (Duration::ZERO, Duration::ZERO);
            }
            node.absent.hosts.iter_mut().for_each(|host| host.heard = Duration::ZERO);
            let open = node.absent.ends.iter_mut().flat_map(|end| &mut end.hosts);
            open.for_each(|host| host.heard = host.heard.map(|_| Duration::ZERO));
        }
        Ok((line, serde_json::to_string(&nodes)?))
    }
}

/// Returns the time of day, in UTC.
fn when() -> String {
    format!("{}Z", date_and_time(clock::unix_time()))
}

/// Returns a line for each state that has changed.
fn changed(before: &BTreeMap<String, String>, now: &BTreeMap<String, String>) -> String {
    let gone = before.keys().filter(|what| !now.contains_key(*what)).map(|what| (what, "is over"));
    let new =
        now.iter().filter(|(what, state)| before.get(*what) != Some(*state)).map(|(what, state)| (what, &**state));
    let (mut lines, when) = (String::new(), when());
    for (what, state) in gone.chain(new) {
        writeln!(lines, "{when}  {what}  {state}").unwrap_or_default();
    }
    lines
}

/// Returns the text that replaces `before` lines on the terminal, and the number of its lines. Leaves out lines that do
/// not fit. Source: ECMA-48, CUU, EL and ED.
fn drawn(text: &str, before: usize, rows: usize, columns: usize) -> (String, usize) {
    let all: Vec<&str> = text.lines().collect();
    // The cursor is in a separate line below the text.
    let room = rows.saturating_sub(1).max(1);
    let fits = if all.len() <= room { all.len() } else { room - 1 };
    let mut lines: Vec<String> = all.iter().take(fits).map(|line| line.chars().take(columns).collect()).collect();
    if all.len() > fits {
        lines.push(format!("… and {} more lines", all.len() - fits).chars().take(columns).collect());
    }
    let up = if before > 0 { format!("\x1b[{before}A") } else { String::new() };
    let count = lines.len();
    let body: String = lines.into_iter().map(|line| format!("{line}\x1b[K\n")).collect();
    (format!("\r{up}{body}\x1b[J"), count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::absent::Absences;
    use crate::logic::tree::tests::door_node;
    use node::logic::protocol::{NodeStatus, WaitingDeployment};
    use view::Fleet;

    fn seen(statuses: Vec<NodeStatus>, away: Absences) -> View {
        View { groups: vec![Group { statuses, away, ..Group::default() }], failure: None }
    }

    #[test]
    fn a_table_takes_the_place_of_the_one_before_and_fits() {
        assert_eq!(drawn("one\ntwo", 0, 24, 80), ("\rone\x1b[K\ntwo\x1b[K\n\x1b[J".to_owned(), 2));
        assert_eq!(drawn("three", 2, 24, 4), ("\r\x1b[2Athre\x1b[K\n\x1b[J".to_owned(), 1));
        let (text, count) = drawn("1\n2\n3\n4", 0, 4, 80);
        assert_eq!((text.as_str(), count), ("\r1\x1b[K\n2\x1b[K\n… and 2 more lines\x1b[K\n\x1b[J", 3));
        assert_eq!(drawn("1\n2", 0, 1, 80).1, 1, "a terminal without lines");
    }

    #[test]
    fn what_has_changed_is_a_line() {
        let view = |state| seen(vec![door_node("c1", &[("main/hit", state, Some(7))])], Absences::default());
        let (first, second) = (view("idle").lines(), view("running").lines());
        let said = |before: &BTreeMap<String, String>, now: &BTreeMap<String, String>| {
            let lines = changed(before, now);
            lines.lines().map(|line| line.split_once("Z  ").unwrap().1.to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(said(&BTreeMap::new(), &first), ["c1  door@1  main/hit  idle  pid 7", "c1  node  answers"]);
        assert_eq!(said(&first, &second), ["c1  door@1  main/hit  running  pid 7"]);
        assert_eq!(said(&second, &second), Vec::<String>::new());
        // If a node has ended on request, it is not missed. If a node does not answer, its state is unknown.
        let after = |view: View| {
            let mut now = view.lines();
            view.keep_unknown(&second, &mut now);
            said(&second, &now)
        };
        assert_eq!(after(View::default()), ["c1  door@1  main/hit  is over", "c1  node  is over"]);
        let unknown = ["c1  door@1  main/hit  unknown (c1 does not answer)", "c1  node  c1 does not answer"];
        assert_eq!(after(View { failure: Some("nobody answers".to_owned()), ..View::default() }), unknown);
        let silent = Absences { silent: ["c1".to_owned()].into(), ..Absences::default() };
        assert_eq!(after(seen(Vec::new(), silent)), unknown);
    }

    #[test]
    fn hosts_of_one_name_in_two_groups_have_a_line_each() {
        let mut view = seen(vec![door_node("c1", &[("main/hit", "idle", Some(7))])], Absences::default());
        let statuses = vec![door_node("c1", &[("main/hit", "running", Some(8))])];
        view.groups.push(Group { statuses, fleet: Fleet::Command(9), ..Group::default() });
        let lines = view.lines();
        assert_eq!(lines["c1  door@1  main/hit"], "idle  pid 7");
        assert_eq!(lines["c1 (command 9)  door@1  main/hit"], "running  pid 8");
    }

    #[test]
    fn time_that_passes_is_no_change() {
        let mut view = seen(vec![door_node("c1", &[("main", "running", None)])], Absences::default());
        let (by, resumes, hosts) = (String::new(), None, Vec::new());
        let (begins_in, at_most) = (Duration::from_secs(9), Duration::from_secs(99));
        let waiting = WaitingDeployment { name: "m".into(), by, resumes, begins_in, hosts, at_most };
        view.groups[0].statuses[0].waiting = vec![waiting];
        let (before, lines) = (view.json().unwrap(), view.lines());
        view.groups[0].statuses[0].up = Duration::from_secs(5);
        view.groups[0].statuses[0].waiting[0].begins_in = Duration::from_secs(4);
        assert_eq!((&lines["c1  m"], view.lines()), (&"waits to begin".to_owned(), lines.clone()));
        let after = view.json().unwrap();
        assert_ne!(before.0, after.0);
        assert_eq!(before.1, after.1);
    }
}
