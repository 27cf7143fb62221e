//! The table of resource locks: `dca lock`.

use crate::logic::queues::Shown;
use comms::logic::messaging::wire::LockStatus;
use node::logic::printable::printable;
use node::logic::table::table;
use serde_json::{Value, json};
use std::time::Duration;

/// Formats a time as `0.30 s`, or as `-` if there is none.
fn seconds(time: Option<Duration>) -> String {
    time.map_or("-".to_owned(), |time| format!("{:.2} s", time.as_secs_f64()))
}

impl Shown for LockStatus {
    fn table(rows: &[(String, String, Self)]) -> String {
        const HEAD: [&str; 9] =
            ["LOCK", "HOLDER", "NUMBER", "LEFT", "LEASE", "WAITING", "GRANTED", "RAN OUT", "PREEMPTED"];
        let mut lines = vec![HEAD.map(str::to_owned).to_vec()];
        for (process, name, lock) in rows {
            let cells = [
                format!("{process}.{name}"),
                lock.holder.clone().unwrap_or_else(|| "-".to_owned()),
                lock.fence.map_or("-".to_owned(), |fence| fence.to_string()),
                seconds(lock.left),
                seconds(Some(lock.lease)),
                if lock.waiting.is_empty() { "-".to_owned() } else { lock.waiting.join(", ") },
                lock.counters.grants.to_string(),
                lock.counters.expired.to_string(),
                lock.counters.preempted.to_string(),
            ];
            lines.push(cells.map(|cell| printable(&cell).to_string()).to_vec());
        }
        table(&lines)
    }

    fn fields(&self) -> Value {
        json!({
            "holder": self.holder,
            "fence": self.fence,
            "left": self.left.map(|left| left.as_secs_f64()),
            "lease": self.lease.as_secs_f64(),
            "waiting": self.waiting,
            "granted": self.counters.grants,
            "expired": self.counters.expired,
            "preempted": self.counters.preempted,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use comms::logic::messaging::wire::LockCounters;

    #[test]
    fn locks_are_shown() {
        let held = LockStatus {
            holder: Some("joy\u{1b}[2J".into()),
            fence: Some(7),
            left: Some(Duration::from_millis(300)),
            lease: Duration::from_millis(600),
            waiting: vec!["drive".into(), "clean".into()],
            counters: LockCounters { grants: 4, expired: 1, preempted: 2 },
        };
        let free = LockStatus { holder: None, fence: None, left: None, waiting: vec![], ..held.clone() };
        let row = |lock: &LockStatus| ("d:main/hw".to_owned(), "lock".to_owned(), lock.clone());
        let text = LockStatus::table(&[row(&held), row(&free)]);
        let lines: Vec<String> =
            text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
        assert!(!text.contains('\u{1b}') && lines[1].ends_with("7 0.30 s 0.60 s drive, clean 4 1 2"), "{text}");
        assert_eq!(lines[2], "d:main/hw.lock - - - 0.60 s - 4 1 2");
        let json = LockStatus::json(&[row(&held), row(&free)]);
        assert_eq!((&json[0]["process"], &json[0]["name"]), (&"d:main/hw".into(), &"lock".into()));
        assert_eq!((&json[0]["fence"], &json[0]["left"]), (&7.into(), &0.3.into()));
        assert_eq!((&json[1]["holder"], &json[1]["waiting"]), (&Value::Null, &json!([])));
    }
}
