use super::*;
use crate::logic::txn::EncodedTxn;
use crate::logic::view::as_of::diff;
use crate::logic::view::table;
use crate::logic::view::tests::{Robot, heal, key, play, steps, toml};
use crate::logic::view::value;
use expect_test::{Expect, expect};
use proptest::prelude::*;

/// Commits the changes of an import.
fn carry_out(robot: &mut Robot, import: Import) {
    import.drafts.into_iter().for_each(|draft| {
        draft.check().unwrap();
        robot.commit(draft);
    });
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn what_was_exported_is_imported(values in proptest::collection::btree_map("team/[a-c/ä\"+ ]{0,4}x", value::tests::datum(), 0..8)) {
        let mut robot = Robot::team(1).remove(0);
        for (at, datum) in values {
            if let Ok(key) = Key::new(at) {
                robot.commit(Draft::new("").put(key, datum.encode().unwrap()));
            }
        }
        let file = export(&robot.state, "team/");
        prop_assert_eq!(import(&file, &robot.state, Absent::Delete, ""), Ok(Import::default()), "nothing is to be done");
        let mut other = Robot::team(1).remove(0);
        let plan = import(&file, &other.state, Absent::Keep, "").unwrap();
        carry_out(&mut other, plan);
        prop_assert_eq!(export(&other.state, "team/"), file);
    }

    #[test]
    fn replacing_leads_to_the_file_and_keeping_deletes_nothing(steps in steps(), at in any::<prop::sample::Index>()) {
        let mut team = Robot::team(3);
        let mut moments: Vec<Robot> = team.clone();
        play(&mut team, &steps, |robot| moments.push(robot.clone()));
        heal(&mut team);
        let file = export(&moments[at.index(moments.len())].state, "team/");
        let shown = |file: &str| file.lines().filter(|line| !line.starts_with('#')).map(str::to_owned).collect::<Vec<_>>();
        for (robot, absent) in [(0, Absent::Delete), (1, Absent::Keep)] {
            let before = team[robot].state.clone();
            let plan = import(&file, &before, absent, "").unwrap();
            let (expected, settles) = (plan.differences.clone(), plan.settles.clone());
            carry_out(&mut team[robot], plan);
            let after = &team[robot].state;
            prop_assert_eq!(diff(&before, after, ""), expected, "the dry run has told all");
            prop_assert!(settles.iter().all(|key| before.is_conflict(key) && !after.is_conflict(key)));
            if absent == Absent::Delete {
                prop_assert_eq!(shown(&export(after, "team/")), shown(&file));
            }
            prop_assert!(absent == Absent::Delete || before.scan("team/").all(|(key, _)| before.get(key).is_none() || after.get(key).is_some()));
        }
    }
}

#[test]
fn how_it_looks() {
    let mut team = Robot::team(2);
    let put = |draft: Draft, at: &str, value: &str| draft.put(key(at), toml(value).encode().unwrap());
    let draft = put(Draft::new(""), "team/camera/gain", "1.5");
    let draft = put(draft, "robot/r1/name", "\"Rosie \\\"the\\\" robot\"");
    let draft = put(draft, "local/secret", "1");
    team[0].commit(put(draft, "team/pose", "{x = 1, y = [0.5, -0.0]}"));
    team[0].put("", "team/rate", "2");
    team[1].put("", "team/rate", "3");
    heal(&mut team);
    expect![[r##"
        # A database of DCA, one key a line.
        format = 1
        below = ""

        [values]
        "robot/r1/name" = "Rosie \"the\" robot"
        "team/camera/gain" = 1.5
        "team/pose" = {x = 1, y = [0.5, -0.0]}
        # 2 concurrent writes, also: 3
        "team/rate" = 2
        # end
    "##]]
    .assert_eq(&export(&team[0].state, ""));
    assert!(export(&team[0].state, "local/").contains("\"local/secret\" = 1"));
}

#[test]
fn a_dry_run_shows_what_would_change() {
    let mut team = Robot::team(1);
    team[0].put("", "team/a", "1");
    team[0].put("", "team/b", "2");
    let file =
        export(&team[0].state, "team/").replace("\"team/b\" = 2", "\"team/c\" = [3]").replace("= 1\n", "= 1.5\n");
    let file = file.replace("format = 1.5", "format = 1");
    let shown =
        |absent| table::differences(&import(&file, &team[0].state, absent, "").unwrap().differences, &Datum::to_toml);
    expect![[r#"
        ~ team/a  1 → 1.5
        - team/b  2
        + team/c  [3]"#]]
    .assert_eq(&shown(Absent::Delete));
    expect![[r#"
        ~ team/a  1 → 1.5
        + team/c  [3]"#]]
    .assert_eq(&shown(Absent::Keep));
}

/// The file of an interrupted export: importing it must delete nothing.
#[test]
fn a_file_that_was_cut_off_deletes_nothing() {
    let mut team = Robot::team(1);
    for key in ["team/a", "team/b", "team/c"] {
        team[0].put("", key, "1");
    }
    let file = export(&team[0].state, "team/");
    for (end, _) in file.match_indices('\n').filter(|(end, _)| *end + 1 < file.len()) {
        let refused = import(&file[..end], &team[0].state, Absent::Delete, "");
        assert!(refused.is_err(), "{}", &file[..end]);
    }
    assert_eq!(import(&file, &team[0].state, Absent::Delete, ""), Ok(Import::default()));
}

#[test]
fn what_does_not_fit_into_one_transaction_takes_several() {
    let mut file = "format = 1\nbelow = \"team/\"\n[values]\n".to_owned();
    for number in 0..10 {
        file.push_str(&format!("\"team/{number}\" = {}\n", quote(&"x".repeat(60_000))));
    }
    for number in 0..CHANGES_MAX {
        file.push_str(&format!("\"team/small/{number}\" = {number}\n"));
    }
    let mut robot = Robot::team(1).remove(0);
    let plan = import(&file, &robot.state, Absent::Keep, "why").unwrap();
    assert_eq!(plan.drafts.len(), 5);
    assert_eq!(plan.differences.len(), 10 + CHANGES_MAX);
    carry_out(&mut robot, plan);
    assert!(robot.log.in_order().iter().all(|(_, encoded)| EncodedTxn::size(encoded) <= TXN_SIZE_MAX));
}

#[test]
fn mistakes_are_told_with_their_place() {
    let check = |file: &str, expected: Expect| {
        let error = import(file, &State::default(), Absent::Keep, "").unwrap_err();
        expected.assert_eq(&error.to_string());
    };
    let file = |values: &str| format!("format = 1\nbelow = \"team/\"\n[values]\n{values}\n");
    check("", expect!["line 1, column 1: the file does not say its format (write `format = 1` first)"]);
    check(
        "format = 2",
        expect![
            "line 1, column 10: the file has format 2, and this program reads 1 (a newer version of DCA can read it)"
        ],
    );
    check(
        "format = 1",
        expect![[
            r#"line 1, column 1: the file does not say which keys it contains (write for example `below = "team/"`)"#
        ]],
    );
    check(
        "format = 1\nbelow = \"\"\nteam = 1\n[values]",
        expect![
            "line 3, column 8: `team` is not a known name (keys with their values stand under [values], each key in quotes)"
        ],
    );
    check(&file("\"team/a\" = 1\n\"team/a\" = 2"), expect!["line 5, column 1: duplicate key"]);
    check(
        &file("\"team/a\" = 1\n\"robot/r1/a\" = 2"),
        expect![
            "line 5, column 1: `robot/r1/a` does not belong in this file (`below` names the prefix of its keys; keys that the database itself writes (`sys/`) are never in a file)"
        ],
    );
    check(
        &file("\"team/a\" = 1\n\"team//a\" = 2"),
        expect!["line 5, column 1: the key `team//a` has an empty segment"],
    );
    check(
        &file("\"team/a\" = {\"$x\" = 1}"),
        expect![
            "line 4, column 12: `$x` is not a kind of value (write one more `$` before a name that begins with `$` and is alone in its table)"
        ],
    );
    check(
        &file("\"team/a\" = hello"),
        expect!["line 4, column 12: string values must be quoted, expected literal string"],
    );
    check(
        &file(&format!("\"team/a\" = {}", quote(&"x".repeat(70_000)))),
        expect!["line 4, column 12: the value takes 70000 bytes, more than 65536; write its parts to separate keys"],
    );
    check(
        "format = 1\nbelow = \"\"\n[values]\n\"sys/members/1\" = 1",
        expect![
            "line 4, column 1: `sys/members/1` does not belong in this file (`below` names the prefix of its keys; keys that the database itself writes (`sys/`) are never in a file)"
        ],
    );
}

#[test]
fn the_keys_of_one_robot_go_to_another() {
    let mut team = Robot::team(1);
    team[0].put("", "robot/r2/params/gain", "1.5");
    team[0].put("", "robot/r2/params/a b", "[1, \"x\"]");
    team[0].put("", "robot/r3/params/old", "1");
    let file = moved(&export(&team[0].state, "robot/r2/"), "robot/r3/").unwrap();
    expect![[r#"
        + robot/r3/params/a b   [1, "x"]
        + robot/r3/params/gain  1.5
        - robot/r3/params/old   1"#]]
    .assert_eq(&table::differences(
        &import(&file, &team[0].state, Absent::Delete, "").unwrap().differences,
        &Datum::to_toml,
    ));
    // A file that was incomplete still deletes nothing.
    let cut = file.replace("# end\n", "");
    assert!(import(&moved(&cut, "robot/r4/").unwrap(), &team[0].state, Absent::Delete, "").is_err());
    for prefix in ["robot/r3", "sys/", ""] {
        assert!(moved(&file, prefix).is_err(), "{prefix}");
    }
}
