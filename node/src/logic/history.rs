//! The reports of a deployment so far. They are for callers that watch it, for callers that return after their
//! connection was cut, and for callers that listen to everything.

use crate::logic::effect::Out;
use crate::logic::protocol::{Answer, Deployment, Event, Report};
use comms::logic::time::Time;
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::time::Duration;

/// How many reports are kept: the first and the latest. The reports between these are left out, but counted.
const REPORTS_MAX: usize = 20_000;
/// How many of the first reports are always kept. They show how the deployment began.
const FIRST_MAX: usize = 1000;
/// How many adopted plans of changes are kept.
const PLANS_MAX: usize = 16;
/// How many events are sent in one answer. A caller can buffer only a limited number of answers.
const EVENTS_IN_ONE: usize = 512;

/// The calls that get the reports of a deployment.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Audience {
    /// The calls that wait for the reports of this deployment.
    pub watchers: Vec<u64>,
    /// The calls that get the events of all deployments.
    pub listeners: Vec<u64>,
}

impl Audience {
    /// Forgets a caller that has gone away.
    pub fn forget(&mut self, call: u64) {
        self.watchers.retain(|watcher| *watcher != call);
        self.listeners.retain(|listener| *listener != call);
    }
}

/// The reports of one deployment, in order.
#[derive(Debug, Default, Serialize, Deserialize)]
pub struct History {
    deployment: Deployment,
    /// The hosts of its plan.
    hosts: Vec<String>,
    entries: VecDeque<Entry>,
    /// How many reports have been made.
    count: u64,
}

/// A report, with the data that users ask for.
#[derive(Debug, Serialize, Deserialize)]
struct Entry {
    number: u64,
    at: Time,
    /// When the report was made on the calendar clock, as time since 1970.
    time: Duration,
    /// Index into the hosts of the plan.
    host: u32,
    report: Report,
}

impl History {
    /// Returns the history of a deployment that has reported nothing.
    pub fn new(deployment: Deployment, hosts: Vec<String>) -> Self {
        Self { deployment, hosts, entries: VecDeque::new(), count: 0 }
    }

    /// Returns the deployment of this history.
    pub fn deployment(&self) -> &Deployment {
        &self.deployment
    }

    /// Returns the kept reports, the last one first.
    pub fn latest(&self) -> impl Iterator<Item = &Report> {
        self.entries.iter().rev().map(|entry| &entry.report)
    }

    /// Keeps a report about a host of the plan, and sends it to the audience.
    pub fn report(&mut self, report: Report, host: u32, audience: &Audience, out: &mut Out<'_>) {
        for &call in &audience.watchers {
            out.answer(call, Answer::Report(report.clone()));
        }
        let entry = Entry { number: self.count, at: out.now, time: out.since_1970, host, report };
        for &call in &audience.listeners {
            tell(call, self.event(&entry, out.now).into_iter().collect(), out);
        }
        if matches!(entry.report, Report::Replanned { .. }) {
            self.drop_plans();
        }
        self.count += 1;
        if self.entries.len() == REPORTS_MAX {
            self.entries.remove(FIRST_MAX);
        }
        self.entries.push_back(entry);
    }

    /// Drops all plans except the latest, to make room for one more: plans are long.
    fn drop_plans(&mut self) {
        let plans = self.entries.iter_mut().rev().filter(|entry| matches!(entry.report, Report::Replanned { .. }));
        plans.skip(PLANS_MAX - 1).for_each(|entry| entry.report = Report::Omitted { count: 1 });
    }

    /// Sends a caller who has the first `seen` reports all later ones.
    pub fn tell_missed(&self, call: u64, seen: u64, out: &mut Out<'_>) {
        // The report of the end is always sent, because it ends the watch.
        let end = self.entries.back().filter(|last| is_last(&last.report));
        let mut next = end.map_or(seen, |end| seen.min(end.number));
        let mut tell = |report| {
            out.answer(call, Answer::Report(report));
        };
        for entry in &self.entries {
            if entry.number < next {
                continue;
            }
            if entry.number > next {
                tell(Report::Omitted { count: entry.number - next });
            }
            tell(entry.report.clone());
            next = entry.number + 1;
        }
    }

    /// Sends all events so far to a caller who listens to everything.
    pub fn tell(&self, call: u64, out: &mut Out<'_>) {
        let (mut events, mut next) = (Vec::new(), 0);
        for entry in &self.entries {
            if entry.number > next {
                let report = Report::Omitted { count: entry.number - next };
                let (deployment, host, ago) = (self.deployment.clone(), self.host(entry), out.now - entry.at);
                events.push(Event { deployment, number: next, host, ago, report, time: entry.time });
            }
            next = entry.number + 1;
            events.extend(self.event(entry, out.now));
            if events.len() >= EVENTS_IN_ONE {
                tell(call, std::mem::take(&mut events), out);
            }
        }
        tell(call, events, out);
    }

    fn host(&self, entry: &Entry) -> String {
        self.hosts.get(entry.host as usize).cloned().unwrap_or_default()
    }

    /// Returns a report in the form for callers who listen to everything; nothing if it does not concern them.
    fn event(&self, entry: &Entry, now: Time) -> Option<Event> {
        // Addresses of programs, steps of supervisors, and plans are only for callers that follow one mission.
        let report = match &entry.report {
            Report::Programs { .. } | Report::Stepped { .. } | Report::Replanned { .. } => return None,
            // The marker of a dropped plan is also only for those callers.
            Report::Omitted { .. } => return None,
            Report::Go { took, .. } => Report::Go { took: *took, signals: Vec::new() },
            Report::Accepted { .. }
            | Report::Prepared { .. }
            | Report::Connected { .. }
            | Report::Process { .. }
            | Report::Aligned { .. }
            | Report::BeganLate { .. }
            | Report::Changed { .. }
            | Report::Unchanged { .. }
            | Report::Refused { .. }
            | Report::Finished { .. } => entry.report.clone(),
        };
        let (host, deployment) = (self.host(entry), self.deployment.clone());
        let (number, ago, time) = (entry.number, now - entry.at, entry.time);
        Some(Event { deployment, number, host, ago, report, time })
    }
}

/// Sends some events. An empty list is not sent, because it would mean that the events so far are complete.
fn tell(call: u64, events: Vec<Event>, out: &mut Out<'_>) {
    if !events.is_empty() {
        out.answer(call, Answer::Events(events));
    }
}

fn is_last(report: &Report) -> bool {
    matches!(report, Report::Finished { .. } | Report::Refused { .. })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::effect::Effect;
    use crate::logic::protocol::Change;
    use language::plan::Plan;
    use std::time::Duration;

    fn history(count: u64) -> History {
        let mut history = History::new(Deployment { name: "d".into(), epoch: 1 }, vec!["c1".into()]);
        for number in 0..count {
            let report = Report::Process {
                path: number.to_string(),
                change: Change::Activated,
                at: Duration::from_secs(number),
            };
            let (mut effects, mut messages, now) = (Vec::new(), Vec::new(), Time::from_nanos(number));
            let since_1970 = Duration::from_nanos(number);
            let mut out = Out { now, since_1970, effects: &mut effects, messages: &mut messages };
            history.report(report, 0, &Audience::default(), &mut out);
        }
        history
    }

    fn told(tell: impl FnOnce(&mut Out<'_>)) -> Vec<Answer> {
        let (mut effects, mut messages) = (Vec::new(), Vec::new());
        let (now, since_1970) = (Time::from_nanos(1 << 40), Duration::MAX);
        tell(&mut Out { now, since_1970, effects: &mut effects, messages: &mut messages });
        let answer = |effect| {
            let Effect::Answer { answer, .. } = effect else { panic!("{effect:?}") };
            *answer
        };
        effects.into_iter().map(answer).collect()
    }

    /// Returns the number of each report that is sent, and how many reports were left out before it.
    fn missed(history: &History, seen: u64) -> Vec<(u64, u64)> {
        let (mut omitted, mut reports) = (0, Vec::new());
        for answer in told(|out| history.tell_missed(1, seen, out)) {
            let Answer::Report(report) = answer else { panic!("{answer:?}") };
            if let Report::Omitted { count } = report {
                omitted += count;
            } else if let Report::Process { path, .. } = report {
                reports.push((path.parse().unwrap(), std::mem::take(&mut omitted)));
            }
        }
        reports
    }

    #[test]
    fn of_a_long_mission_the_beginning_and_the_latest_are_kept() {
        let (first, all) = (FIRST_MAX as u64, REPORTS_MAX as u64);
        let history = history(all + 500);
        let whole = missed(&history, 0);
        assert_eq!(whole.len(), REPORTS_MAX);
        assert_eq!((whole[0], whole[FIRST_MAX - 1]), ((0, 0), (first - 1, 0)));
        assert_eq!(whole[FIRST_MAX], (first + 500, 500));
        assert_eq!(whole.last(), Some(&(all + 499, 0)));
        // A caller who has seen the first reports misses fewer of the omitted reports. A caller who has seen all
        // omitted reports misses none.
        assert_eq!(missed(&history, first + 100)[0], (first + 500, 400));
        assert_eq!(missed(&history, first + 700)[0], (first + 700, 0));
        assert_eq!(missed(&history, all + 499), [(all + 499, 0)]);
        assert_eq!(missed(&history, all + 500), []);
    }

    #[test]
    fn listeners_are_told_how_many_are_left_out_and_where() {
        let (first, all) = (FIRST_MAX as u64, REPORTS_MAX as u64);
        let history = history(all + 500);
        let events: Vec<Event> = told(|out| history.tell(1, out))
            .into_iter()
            .flat_map(|answer| {
                let Answer::Events(events) = answer else { panic!("{answer:?}") };
                assert!(events.len() <= EVENTS_IN_ONE + 1);
                events
            })
            .collect();
        assert_eq!(events.len(), REPORTS_MAX + 1);
        let gap = &events[FIRST_MAX];
        assert_eq!((gap.number, &gap.report), (first, &Report::Omitted { count: 500 }));
        assert!(events.windows(2).all(|pair| pair[0].number < pair[1].number));
    }

    /// With many changes, the history does not grow by all their plans: only the latest plans are kept, and every report is counted.
    #[test]
    fn of_plans_the_latest_are_kept_and_no_listener_hears_of_them() {
        let mut history = history(1);
        let (mut effects, mut messages) = (Vec::new(), Vec::new());
        let mut out =
            Out { now: Time::ZERO, since_1970: Duration::ZERO, effects: &mut effects, messages: &mut messages };
        for number in 0..100 {
            let (groups, leaves, wires, claims) = Default::default();
            let (name, hosts, on_boot) = (number.to_string(), Vec::new(), Default::default());
            let plan = Box::new(Plan { name, hosts, groups, leaves, wires, claims, on_boot });
            let audience = Audience { listeners: vec![7], ..Audience::default() };
            history.report(Report::Replanned { plan }, 0, &audience, &mut out);
        }
        history.tell(7, &mut out);
        history.tell_missed(8, 0, &mut out);
        let told = |wanted: u64| {
            let answers = effects.iter().filter_map(move |effect| {
                let Effect::Answer { call, answer } = effect else { return None };
                (*call == wanted).then_some(&**answer)
            });
            answers.collect::<Vec<_>>()
        };
        assert!(matches!(told(7)[..], [Answer::Events(all)] if all.len() == 1), "{:?}", told(7));
        let reports = told(8);
        let plans = reports.iter().filter_map(|answer| {
            let Answer::Report(Report::Replanned { plan }) = answer else { return None };
            Some(plan.name.as_str())
        });
        let latest: Vec<String> = (84..100).map(|number| number.to_string()).collect();
        assert_eq!(plans.collect::<Vec<_>>(), latest);
        assert_eq!(reports.len(), 101, "each counts as one");
    }
}
