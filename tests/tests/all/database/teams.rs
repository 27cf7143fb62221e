//! Two teams with the same name, begun separately.

use super::*;

/// Two people begin teams with the same name, each without knowing about the other. Robots that are alone in their
/// teams find each other without help. If two teams have several robots each, both report the other team until a
/// person chooses one.
#[test]
fn two_teams_of_one_name_become_one() {
    let cluster = Cluster::new();
    let here = cluster.here();
    let status = |robot: &str| here.ask(&["db", "status", "--robot", robot]).out;
    let are_one = |robots: &'static [&'static str]| {
        let knows_all = |robot: &&str| {
            let text = status(robot);
            robots.iter().all(|other| text.contains(other))
                && !text.contains("second team")
                && text.contains("all robots have all writes")
        };
        wait_until(SOON, || robots.iter().all(knows_all))
            .unwrap_or_else(|| panic!("{}", robots.iter().map(|robot| status(robot)).collect::<Vec<_>>().join("\n")));
    };
    let begin = |robot: &str, key: &str| {
        let node = here.node(robot, &[]);
        let found = here.ask(&["db", "found", "--robot", robot]);
        assert!(found.code == Some(0) && found.out.contains("begins with"), "{found}");
        assert_eq!(here.ask(&["db", "put", key, "1", "--robot", robot]).code, Some(0));
        node
    };
    let leave = |node: Program| {
        node.signal(Signal::TERM);
        assert_eq!(node.ended(SOON).code, Some(0));
    };
    leave(begin("r1", "team/first"));
    let second = begin("r2", "team/second");
    let first = here.node("r1", &[]);
    are_one(&["r1", "r2"]);
    [first, second].into_iter().for_each(leave);

    let _third = begin("r3", "team/third");
    let _fourth = here.node("r4", &[]);
    are_one(&["r3", "r4"]);
    let _others = ["r1", "r2"].map(|robot| here.node(robot, &[]));
    for (robot, others) in [("r1", "`r3`, `r4`"), ("r2", "`r3`, `r4`"), ("r3", "`r1`, `r2`"), ("r4", "`r1`, `r2`")] {
        let tells = || status(robot).contains(&format!("Its members: {others}."));
        assert!(wait_until(SOON, tells).is_some(), "{}", status(robot));
    }
    let put = here.ask(&["db", "put", "team/x", "1", "--robot", "r1"]);
    assert!(put.code == Some(0) && put.err.contains("`r3`, `r4` will not get this"), "{put}");
    let again = here.ask(&["db", "join", "r2", "--robot", "r1"]);
    assert!(again.code == Some(0) && again.out.contains("belongs to the team of `r2` now"), "{again}");
    let refused = here.ask(&["db", "join", "r9", "--robot", "r1"]);
    assert!(refused.code == Some(1) && refused.err.contains("`dca db status` lists such robots"), "{refused}");
    for robot in ["r3", "r4"] {
        let joined = here.ask(&["db", "join", "r1", "--robot", robot]);
        assert!(joined.code == Some(0) && joined.out.contains("belongs to the team of `r1` now"), "{joined}");
    }
    are_one(&["r1", "r2", "r3", "r4"]);
    let told = status("r1");
    assert!(!told.contains("another team"), "it is over, and so is what was said of it: {told}");
    for robot in ["r1", "r2", "r3", "r4"] {
        let all = here.ask(&["db", "get", "team/", "--robot", robot]).out;
        assert!(
            ["team/first", "team/second", "team/third", "team/x"].iter().all(|key| all.contains(key)),
            "{robot}: {all}"
        );
    }
}
