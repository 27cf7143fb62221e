//! The text of `dca db status`, and the refusal for a robot that is not in the team.

use super::question::{Clock, MemberStatus, Status};
use crate::logic::printable::one_line;
use crate::logic::table::{counted, table};
use comms::logic::human::size;
use dbmanager::logic::view::date;
use dbmanager::logic::view::status::Lag;
use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::time::Duration;

/// How many digits of a state are shown. They are enough to compare two states by eye.
const DIGITS: usize = 12;
/// From which difference of clocks on the difference is shown. A smaller difference is the delay between two robots, or
/// has no importance.
const APART: Duration = Duration::from_secs(10);

/// Returns a status as text.
pub fn status(status: &Status) -> String {
    let mut blocks = vec![headline(status)];
    if !status.members.is_empty() {
        let mut rows = vec![["ROBOT", "HEARD", "CLOCK", "LACKS", "AHEAD", ""].map(str::to_owned).to_vec()];
        rows.extend(status.members.iter().map(|member| row(status, member)));
        blocks.push(indented(&table(&rows)));
    }
    blocks.push(indented(&facts(status)));
    if !status.other_team.is_empty() {
        blocks.push(indented(&second_team(status)));
    }
    if !status.alarms.is_empty() {
        let alarms: Vec<String> = status.alarms.iter().map(|alarm| format!("! {alarm}")).collect();
        blocks.push(indented(&alarms.join("\n")));
    }
    blocks.join("\n\n")
}

/// Returns the text which says that two teams of one name exist, and how they become one team.
fn second_team(status: &Status) -> String {
    let (team, robots) = (&status.team, status.other_team.join("`, `"));
    format!(
        "! There is a second team `{team}`, which was begun separately. Its members: `{robots}`.\n  The teams do not exchange their \
         writes. Choose the team to give up. Each of its robots has to join the other team:\n  `dca db join ROBOT-OF-THE-OTHER \
         --robot ROBOT`. The robots keep their writes."
    )
}

/// Returns the headline, which says whether a user has to do something.
fn headline(status: &Status) -> String {
    let Status { robot, team, .. } = status;
    if let Some(why) = &status.store.closed {
        return why.clone();
    }
    if !status.member {
        return format!(
            "`{robot}` belongs to no team yet. Its writes stay on this robot, and reach a team when the robot joins it.\nThe robot joins \
             the first member of `{team}` that it hears; if there is no member, `dca db found` begins the team here."
        );
    }
    let behind =
        status.members.iter().filter(|member| member.lacks.transactions > 0 && member.origin != status.origin).count();
    let with = status.members.len() - 1;
    match (with, behind) {
        (0, _) => format!("team `{team}`: `{robot}` is its only member so far"),
        (_, 0) => format!("team `{team}`, as `{robot}` sees it: all robots have all writes"),
        (_, behind) => format!("team `{team}`, as `{robot}` sees it: {behind} of {with} peers are behind"),
    }
}

fn row(status: &Status, member: &MemberStatus) -> Vec<String> {
    let me = member.origin == status.origin;
    let count = |count: u64| if count == 0 || me { "-".to_owned() } else { count.to_string() };
    let heard = match member.heard {
        _ if me => "this robot".to_owned(),
        Some(ago) => format!("{} ago", span(ago)),
        None => "not since the start".to_owned(),
    };
    // A robot that has had two disks is listed twice until the older member is retired.
    let twice = status.members.iter().filter(|other| other.robot == member.robot).count() > 1;
    let name = if twice { format!("{} ({})", member.robot, member.origin) } else { member.robot.clone() };
    // If a robot has several names, its present name is the name of the asked replica, or else the name in the last message.
    let rank = |one: &MemberStatus| (one.origin == status.origin, one.heard.map(Reverse));
    let is_older = status.members.iter().any(|other| other.robot == member.robot && rank(other) > rank(member));
    let pins = if is_older {
        format!("a name from before: `dca db retire {} --older` ends it", member.robot)
    } else if member.pins && !me {
        "the log keeps older writes until this robot is back or retired".to_owned()
    } else {
        String::new()
    };
    let clock = if me { status.clock.clone() } else { member.clock.as_ref().map_or("-".to_owned(), apart) };
    vec![name, heard, clock, if me { "-".to_owned() } else { lag(member.lacks) }, count(member.ahead), pins]
}

/// Returns how a clock is synchronised, and how far it differs from the own clock.
fn apart(clock: &Clock) -> String {
    let Clock { quality, ahead } = clock;
    match Duration::from_millis(ahead.unsigned_abs()) {
        apart if apart < APART => quality.clone(),
        apart => format!("{quality}, {} {}", span(apart), if *ahead > 0 { "ahead" } else { "behind" }),
    }
}

/// Returns how many transactions a replica lacks, and since when.
fn lag(lag: Lag) -> String {
    match lag {
        Lag { transactions: 0, .. } => "-".to_owned(),
        Lag { transactions, dropped, .. } if dropped > 0 => {
            format!("{transactions}: the complete state has to be sent")
        }
        Lag { transactions, bytes, since, .. } => {
            // If the clock was not set, its time would be shown as a date in 1970.
            let since =
                since.filter(|since| since.trusted).map(|since| format!(", since {}", date::text(since.millis)));
            let since = since.unwrap_or_default();
            format!("{transactions} ({}){since}", size(bytes))
        }
    }
}

fn facts(status: &Status) -> String {
    let conflicts = match (status.contents.conflicts, status.contents.races) {
        (0, 0) => "no conflicts".to_owned(),
        (conflicts, 0) => format!("{}: `dca db conflicts` lists them", counted(conflicts, "conflict")),
        (0, races) => format!("{}: `dca db conflicts` lists them", counted(races, "race")),
        (conflicts, races) => {
            format!("{} and {}: `dca db conflicts` lists them", counted(conflicts, "conflict"), counted(races, "race"))
        }
    };
    let rows = [
        ("holds", format!("{}, {conflicts}", counted(status.contents.keys, "key"))),
        ("log", format!("{}, {}", counted(status.store.log_len, "transaction"), size(status.store.log_size))),
        (
            "state",
            format!(
                "{} (robots with equal numbers have equal data)",
                &status.contents.digest[..DIGITS.min(status.contents.digest.len())]
            ),
        ),
        ("store", status.store.place.clone().unwrap_or_else(|| "in memory: gone when the node ends".to_owned())),
        ("clock", clock(&status.clock).to_owned()),
    ];
    table(&rows.map(|(name, text)| vec![name.to_owned(), text]))
}

fn clock(quality: &str) -> &str {
    match quality {
        "network" => "kept by the network",
        "satellite" => "kept by a satellite receiver",
        "plausible" => "shows a date that may be right, but is not synchronised: its dates are marked `~`",
        _ => "not set: its writes get the date of the team's clocks, if they have a date",
    }
}

/// Returns a duration with one unit.
pub fn span(time: Duration) -> String {
    let seconds = time.as_secs_f64();
    if seconds < 10.0 {
        format!("{seconds:.1} s")
    } else if seconds < 120.0 {
        format!("{seconds:.0} s")
    } else if seconds < 7200.0 {
        format!("{:.0} min", seconds / 60.0)
    } else if seconds < 172_800.0 {
        format!("{:.0} h", seconds / 3600.0)
    } else {
        format!("{:.0} days", seconds / 86_400.0)
    }
}

fn indented(text: &str) -> String {
    text.lines().map(|line| format!("  {line}").trim_end().to_owned()).collect::<Vec<_>>().join("\n")
}

/// Returns why nothing is written for a robot: the team has no robot of that name. Nothing if the team has one, or if
/// its members are not known.
pub fn no_robot<'a>(robot: &str, members: impl Iterator<Item = &'a str>) -> Option<String> {
    let members: BTreeSet<&str> = members.collect();
    if members.is_empty() || members.contains(robot) {
        return None;
    }
    let hint = language::nearest(robot, members.iter().copied()).map(|near| format!("; did you mean `{near}`?"));
    let all = members.iter().map(|member| format!("`{member}`")).collect::<Vec<_>>().join(", ");
    Some(format!(
        "the team has no robot `{}`, so nothing was written: its robots are {all}{}",
        one_line(robot),
        hint.unwrap_or_default()
    ))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::logic::database::question::{ContentsStatus, StoreStatus};
    use dbmanager::logic::version_vector::{ReplicaId, VersionVector};
    use dbmanager::logic::view::past::When;
    use expect_test::expect;

    fn member(robot: &str, number: u64, heard: Option<u64>, lacks: u64) -> MemberStatus {
        let heard = heard.map(Duration::from_secs);
        let since = (lacks > 0).then_some(When { millis: 1_795_255_200_000, trusted: true });
        let lag = Lag { transactions: lacks, bytes: 100 * lacks, dropped: 0, since };
        let clock = heard.map(|heard| Clock {
            quality: if lacks > 0 { "unset" } else { "network" }.into(),
            ahead: if lacks > 0 { -i64::try_from(heard.as_millis()).unwrap() * 3600 } else { 8 },
        });
        let (robot, origin, pins) = (robot.into(), ReplicaId::new(number), lacks > 0);
        MemberStatus { robot, origin, heard, lacks: lag, ahead: 0, pins, clock }
    }

    fn team(members: Vec<MemberStatus>) -> Status {
        Status {
            robot: "r1".into(),
            origin: ReplicaId::new(1),
            team: "dca".into(),
            member: !members.is_empty(),
            store: StoreStatus { closed: None, place: Some("/var/lib/dca/r1/db".into()), log_len: 34, log_size: 4301 },
            contents: ContentsStatus {
                version: VersionVector::default(),
                stable: VersionVector::default(),
                digest: "0123456789abcdef0123456789abcdef".into(),
                keys: 12,
                conflicts: 1,
                races: 2,
            },
            clock: "unset".into(),
            members,
            alarms: vec![],
            other_team: vec![],
        }
    }

    #[test]
    fn a_robot_that_is_not_in_the_team_is_named() {
        let why = no_robot("r99", ["r1", "r9", "r9"].into_iter()).unwrap();
        assert_eq!(
            why,
            "the team has no robot `r99`, so nothing was written: its robots are `r1`, `r9`; did you mean `r9`?"
        );
        assert_eq!(no_robot("r1", ["r1", "r2"].into_iter()), None);
        assert_eq!(no_robot("r1", std::iter::empty()), None, "a robot without a team does not know the members");
    }

    #[test]
    fn a_robot_that_is_away() {
        let members = vec![member("r1", 1, None, 0), member("r2", 2, Some(1), 0), member("r3", 3, Some(720), 14)];
        expect![[r#"
            team `dca`, as `r1` sees it: 1 of 2 peers are behind

              ROBOT  HEARD       CLOCK                  LACKS                                  AHEAD
              r1     this robot  unset                  -                                      -
              r2     1.0 s ago   network                -                                      -
              r3     12 min ago  unset, 30 days behind  14 (1 KiB), since 2026-11-21 10:00:00  -      the log keeps older writes until this robot is back or retired

              holds  12 keys, 1 conflict and 2 races: `dca db conflicts` lists them
              log    34 transactions, 4 KiB
              state  0123456789ab (robots with equal numbers have equal data)
              store  /var/lib/dca/r1/db
              clock  not set: its writes get the date of the team's clocks, if they have a date"#]]
        .assert_eq(&status(&team(members)));
    }

    #[test]
    fn a_robot_under_two_names() {
        let members = |heard| vec![member("r1", 1, None, 0), member("r2", 2, heard, 0), member("r2", 3, Some(1), 0)];
        for heard in [None, Some(20)] {
            let text = status(&team(members(heard)));
            let told: Vec<&str> = text.lines().filter(|line| line.contains("dca db retire r2 --older")).collect();
            assert!(told.len() == 1 && told[0].contains(&ReplicaId::new(2).to_string()), "{text}");
        }
    }

    #[test]
    fn a_second_team_of_the_same_name() {
        let text =
            status(&Status { other_team: vec!["r3".into(), "r4".into()], ..team(vec![member("r1", 1, None, 0)]) });
        assert!(
            text.contains("a second team `dca`") && text.contains("`r3`, `r4`") && text.contains("dca db join"),
            "{text}"
        );
    }

    #[test]
    fn no_team_yet() {
        let text = status(&team(vec![]));
        assert!(text.starts_with("`r1` belongs to no team yet.") && text.contains("`dca db found`"), "{text}");
    }
}
