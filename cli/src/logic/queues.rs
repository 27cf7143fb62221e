//! States that have a table of their own, and names for them. Also the table of queues: `dca queue`.

use crate::logic::process_name::ProcessName;
use comms::logic::messaging::queue::Full;
use comms::logic::messaging::wire::QueueStatus;
use node::logic::printable::printable;
use node::logic::table::table;
use serde_json::{Value, json};
use std::fmt::{self, Display, Formatter};

/// The meaning of `[DEPLOYMENT:]INSTANCE[.NAME]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct ShownName {
    pub(crate) process: ProcessName,
    /// The name of the state; nothing for any state.
    state: Option<String>,
}

/// A state that is shown in a table of its own. Each row has the process, the name and the value.
pub(crate) trait Shown: Sized {
    /// Returns a table for people.
    fn table(rows: &[(String, String, Self)]) -> String;
    /// Returns the known values of the state, as a JSON object.
    fn fields(&self) -> Value;

    /// Returns a JSON array with an object for each row: the fields of the state, its process and its name.
    fn json(rows: &[(String, String, Self)]) -> Value {
        let object = |(process, name, value): &(String, String, Self)| {
            let mut fields = value.fields();
            fields["process"] = json!(process);
            fields["name"] = json!(name);
            fields
        };
        Value::Array(rows.iter().map(object).collect())
    }
}

impl Display for ShownName {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.process.fmt(f)?;
        self.state.iter().try_for_each(|state| write!(f, ".{state}"))
    }
}

impl ShownName {
    /// Reads a name. If it is not valid, returns the mistake.
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        let (process, state) = ProcessName::with_name(text);
        // A name without a state may mean all processes of a deployment. A name with a state has to name a process.
        let is_named = state.map_or_else(|| process.is_any(), |name| !name.is_empty() && process.process().is_some());
        if !is_named {
            return Err(format!(
                "`{text}` names nothing: expected [DEPLOYMENT:]INSTANCE[.NAME], such as `base.commands`"
            ));
        }
        Ok(Self { process, state: state.map(str::to_owned) })
    }

    /// Returns whether the name matches the state of this name.
    pub(crate) fn is_state(&self, name: &str) -> bool {
        self.state.as_ref().is_none_or(|state| state == name)
    }
}

/// Returns the policy in words: `reject`, `drop lowest`, `drop oldest`.
fn policy(full: Full) -> &'static str {
    match full {
        Full::Reject => "reject",
        Full::DropLowest => "drop lowest",
        Full::DropOldest => "drop oldest",
    }
}

impl Shown for QueueStatus {
    fn table(rows: &[(String, String, Self)]) -> String {
        const HEAD: [&str; 10] =
            ["QUEUE", "TYPE", "WAITING", "MOST", "IF FULL", "ACCEPTED", "TAKEN", "DROPPED", "REJECTED", "LAST SENDER"];
        let mut lines = vec![HEAD.map(str::to_owned).to_vec()];
        for (process, name, queue) in rows {
            let counters = &queue.counters;
            let count = |number: u64| number.to_string();
            let sender = if queue.last_sender.is_empty() { "-" } else { &queue.last_sender };
            let cells = [
                format!("{process}.{name}"),
                queue.type_name.clone(),
                format!("{} of {}", counters.depth, queue.capacity),
                count(counters.depth_max),
                policy(queue.full).to_owned(),
                count(counters.accepted),
                count(counters.taken),
                count(counters.dropped),
                count(counters.rejected),
                sender.to_owned(),
            ];
            lines.push(cells.map(|cell| printable(&cell).to_string()).to_vec());
        }
        table(&lines)
    }

    fn fields(&self) -> Value {
        let counters = &self.counters;
        json!({
            "type": self.type_name,
            "fields": self.fields,
            "waiting": counters.depth,
            "waiting_max": counters.depth_max,
            "capacity": self.capacity,
            "full": policy(self.full),
            "accepted": counters.accepted,
            "taken": counters.taken,
            "dropped": counters.dropped,
            "rejected": counters.rejected,
            "repeated": counters.repeated,
            "last_sender": self.last_sender,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::messaging::queue::QueueCounters;

    #[test]
    fn names() {
        let name = |text: &str| ShownName::parse(text).unwrap();
        let one = name("door:main/base.commands");
        assert!(one.is_state("commands") && !one.is_state("requests"));
        assert!(name("base").is_state("commands") && name("door:").is_state("commands"));
        assert_eq!(
            (one.to_string(), one.process),
            ("door:main/base.commands".into(), ProcessName::new("door:main/base"))
        );
        for wrong in ["", ".commands", "base.", ":", "door:.x"] {
            assert!(ShownName::parse(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn queues_are_shown() {
        let queue = |last_sender: &str| QueueStatus {
            type_name: "Speed".into(),
            fields: String::new(),
            capacity: 8,
            full: Full::DropOldest,
            lock: String::new(),
            counters: QueueCounters {
                depth: 1,
                depth_max: 2,
                accepted: 3,
                taken: 4,
                dropped: 5,
                rejected: 6,
                repeated: 7,
            },
            last_sender: last_sender.into(),
        };
        let row = |sender| ("d:main/a".to_owned(), "commands".to_owned(), queue(sender));
        let text = QueueStatus::table(&[row("joy\u{1b}[2J"), row("")]);
        let cells: Vec<Vec<&str>> = text.lines().map(|line| line.split_whitespace().collect()).collect();
        let start = ["d:main/a.commands", "Speed", "1", "of", "8", "2", "drop", "oldest", "3", "4", "5", "6"];
        assert_eq!(cells[1][..12], start);
        assert!(!text.contains('\u{1b}') && cells[2][12] == "-", "{text}");
        let json = QueueStatus::json(&[row("joy")]);
        assert_eq!((&json[0]["waiting"], &json[0]["last_sender"]), (&1.into(), &"joy".into()));
    }
}
