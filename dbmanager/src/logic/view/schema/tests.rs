use super::*;
use crate::logic::txn::Draft;
use crate::logic::view::tests::{Robot, heal, key, toml};
use expect_test::{Expect, expect};
use proptest::prelude::*;

fn schema(text: &str) -> Schema {
    Schema::of(&toml(text)).unwrap()
}

/// Returns the schemas with these patterns.
fn schemas(entries: &[(&str, &str)]) -> Schemas {
    let mut robot = Robot::team(1).remove(0);
    for (pattern, text) in entries {
        robot.put("", &format!("{SCHEMA}{pattern}"), text);
    }
    Schemas::of(&robot.state)
}

fn told(schemas: &Schemas, at: &str, value: &str) -> String {
    let draft = Draft::new("").put(key(at), toml(value).encode().unwrap());
    schemas.check(&draft).iter().map(ToString::to_string).collect::<Vec<_>>().join("\n")
}

#[test]
fn one_clear_sentence() {
    let all = schemas(&[
        ("robot/+/params/force/limit", "{type = \"float\", min = 0.0, max = 200.0, unit = \"N\"}"),
        ("team/mode", "{type = \"text\", one_of = [\"manual\", \"auto\"]}"),
        ("team/name", "{type = \"text\", min = 1, max = 8}"),
        ("team/count", "{type = \"integer\", min = 1}"),
        ("team/any", "{max = 3}"),
        ("team/raw", "{type = \"bytes\", max = 2}"),
        ("team/list", "{type = \"list\", min = 3, max = 3}"),
    ]);
    let check = |at: &str, value: &str, expected: Expect| expected.assert_eq(&told(&all, at, value));
    check(
        "robot/r2/params/force/limit",
        "500.0",
        expect!["robot/r2/params/force/limit must be between 0 and 200 N, got 500"],
    );
    check(
        "robot/r2/params/force/limit",
        "500",
        expect!["robot/r2/params/force/limit must be a float, got 500 (as a float it is written 500.0)"],
    );
    check(
        "robot/r2/params/force/limit",
        "nan",
        expect!["robot/r2/params/force/limit must be between 0 and 200 N, got nan"],
    );
    check("robot/r2/params/force/limit", "200.0", expect![""]);
    check("robot/r2/params/force", "500.0", expect![""]);
    check("team/mode", "\"off\"", expect![[r#"team/mode must be one of "manual", "auto", got "off""#]]);
    check("team/name", "\"\"", expect!["team/name must be between 1 and 8 characters long, got 0 characters"]);
    check("team/name", "\"Rosie\"", expect![""]);
    check("team/count", "0", expect!["team/count must be at least 1, got 0"]);
    check("team/count", "true", expect!["team/count must be an integer, got true"]);
    check("team/any", "3.5", expect!["team/any must be at most 3, got 3.5"]);
    check("team/any", "\"four\"", expect!["team/any must be at most 3 characters long, got 4 characters"]);
    check("team/raw", "{\"$bytes\" = \"000000\"}", expect!["team/raw must be at most 2 bytes long, got 3 bytes"]);
    check("team/raw", "{\"$sealed\" = \"000000\"}", expect![""]);
    check("team/list", "[1]", expect!["team/list must be 3 values long, got 1 values"]);
    check(
        "team/schema/x",
        "{type = \"number\"}",
        expect![[
            r#"team/schema/x must hold a schema (the field `type` of a schema must be one of bool, integer, float, text, bytes, list, table, got "number")"#
        ]],
    );
}

#[test]
fn the_longest_pattern_counts() {
    let all = schemas(&[
        ("robot", "{doc = \"1\"}"),
        ("robot/+/params", "{doc = \"2\"}"),
        ("robot/r2/params", "{doc = \"3\"}"),
        ("robot/+/params/+", "{doc = \"4\"}"),
        ("robot/+/+/a", "{doc = \"5\"}"),
        ("+/r3/params/a", "{doc = \"6\"}"),
    ]);
    let doc = |at: &str| all.find(&key(at)).map(|schema| schema.doc.as_str());
    assert_eq!(doc("team/a"), None);
    assert_eq!(doc("robot/r1/a"), Some("1"));
    assert_eq!(doc("robots/r1"), None);
    assert_eq!((doc("robot/r1/params"), doc("robot/r2/params")), (Some("2"), Some("3")));
    assert_eq!(doc("robot/r2/params/b/c"), Some("4"));
    assert_eq!(doc("robot/r2/params/a"), Some("4"), "of two as long, the one whose first `+` comes last");
    assert_eq!(doc("robot/r3/params/a"), Some("4"));
}

#[test]
fn what_is_required_and_what_counts_if_there_is_nothing() {
    let mut team = Robot::team(2);
    team[0].put("", "team/schema/team/gain", "{default = 1.5, required = true, doc = \"of the camera\"}");
    team[0].put("", "team/schema/team/site", "{type = \"text\", required = true}");
    team[0].put("", "team/schema/team/bad", "17");
    team[1].put("", "team/gain", "2.5");
    heal(&mut team);
    let all = Schemas::of(&team[0].state);
    assert_eq!(all.read(&team[0].state, &key("team/gain")), Some(toml("2.5")));
    let delete = Draft::new("").delete(key("team/gain")).delete(key("team/other"));
    let told: Vec<String> = all.check(&delete).iter().map(ToString::to_string).collect();
    expect!["team/gain must not be deleted: it is required (of the camera)"].assert_eq(&told.join("\n"));
    team[0].commit(delete);
    assert_eq!(all.read(&team[0].state, &key("team/gain")), Some(toml("1.5")), "a schema refuses nothing");
    team[0].put("", "team/site", "5");
    let told = |state: &State| all.audit(state).iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
    expect![[r#"
        team/site must be a text, got 5 (a text stands in quotes)
        team/schema/team/bad must hold a schema (a schema is a table, such as {type = "float", min = 0.0, max = 200.0, unit = "N"}; this is 17)"#]].assert_eq(&told(&team[0].state));
    expect![[r#"
        team/site must have a value: it is required
        team/schema/team/bad must hold a schema (a schema is a table, such as {type = "float", min = 0.0, max = 200.0, unit = "N"}; this is 17)"#]].assert_eq(&told(&team[1].state));
    assert_eq!(all.malformed().len(), 1);
}

#[test]
fn schemas_that_are_none() {
    let check = |text: &str, expected: Expect| expected.assert_eq(&Schema::of(&toml(text)).unwrap_err().to_string());
    check(
        "5",
        expect![[r#"a schema is a table, such as {type = "float", min = 0.0, max = 200.0, unit = "N"}; this is 5"#]],
    );
    check(
        "{type = \"double\"}",
        expect![[
            r#"the field `type` of a schema must be one of bool, integer, float, text, bytes, list, table, got "double""#
        ]],
    );
    check("{min = \"0\"}", expect![[r#"the field `min` of a schema must be a number, got "0""#]]);
    check("{min = 3, max = 2.5}", expect!["the field `max` of a schema must be at least min, which is 3, got 2.5"]);
    check("{one_of = []}", expect!["the field `one_of` of a schema must be a list with at least one value, got []"]);
    check("{required = 1}", expect!["the field `required` of a schema must be true or false, got 1"]);
    check("{max = 3, default = 4}", expect!["the field `default` of a schema must be at most 3, got 4"]);
    let newer = schema("{max = 3, colour = \"red\"}");
    assert_eq!(newer, Schema { max: Some(Datum::Integer(3)), ..Schema::default() });
}

#[expect(clippy::cast_possible_truncation, reason = "it is a whole number")]
fn whole(float: f64) -> i128 {
    float as i128
}

proptest! {
    #[test]
    fn integers_and_floats_are_ordered_exactly(integer: i64, near in -3_i64..4, float: f64) {
        // The closest float, where rounding could give a wrong result.
        let close = integer.saturating_add(near) as f64;
        let exact = i128::from(integer).cmp(&whole(close));
        prop_assert_eq!(check::compare(&Datum::Integer(integer), &Datum::float(close)), Some(exact));
        let (left, right) = (Datum::Integer(integer), Datum::float(float));
        prop_assert_eq!(check::compare(&left, &right), check::compare(&right, &left).map(Ordering::reverse));
    }
}
