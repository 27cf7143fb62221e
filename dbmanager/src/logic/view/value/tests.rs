use super::*;
use expect_test::{Expect, expect};
use proptest::prelude::*;

fn float() -> impl Strategy<Value = Datum> {
    let special = [0.0, -0.0, 1.0, 1e16, 1e300, f64::MIN_POSITIVE, 5e-324, f64::INFINITY, f64::NEG_INFINITY, f64::NAN];
    prop_oneof![any::<u64>().prop_map(f64::from_bits), proptest::sample::select(special.to_vec())]
        .prop_map(Datum::float)
}

pub(crate) fn datum() -> impl Strategy<Value = Datum> {
    let text = prop_oneof!["\\PC{0,8}", any::<String>(), "[$]{0,2}(bytes|float|x)?"];
    let bytes = || proptest::collection::vec(any::<u8>(), 0..12);
    let leaf = prop_oneof![
        any::<bool>().prop_map(Datum::Bool),
        any::<i64>().prop_map(Datum::Integer),
        float(),
        text.clone().prop_map(Datum::Text),
        bytes().prop_map(Datum::Bytes),
        bytes().prop_map(Datum::Sealed),
        (8_u8.., bytes()).prop_map(|(tag, bytes)| Datum::Opaque { tag, bytes }),
    ];
    leaf.prop_recursive(4, 24, 5, move |inner| {
        prop_oneof![
            proptest::collection::vec(inner.clone(), 0..5).prop_map(Datum::List),
            proptest::collection::btree_map(text.clone(), inner, 0..4).prop_map(Datum::Table),
        ]
    })
}

proptest! {
    #[test]
    fn every_form_gives_the_same_value_back(datum in datum()) {
        let stored = datum.encode().unwrap();
        prop_assert_eq!(&Datum::of(&stored), &datum);
        prop_assert_eq!(&Datum::from_toml(&datum.to_toml()).unwrap(), &datum);
        prop_assert_eq!(&Datum::from_json(&datum.to_json()).unwrap(), &datum);
        let sent = postcard::to_stdvec(&datum).unwrap();
        prop_assert_eq!(&postcard::from_bytes::<Datum>(&sent).unwrap(), &datum);
    }

    #[test]
    fn no_stored_bytes_are_lost(tag in 0_u8..12, bytes: Vec<u8>) {
        let value = Value { encoding: Encoding(tag), bytes: bytes.into() };
        prop_assert_eq!(Datum::of(&value).encode().unwrap(), value);
    }

    #[test]
    fn any_text_is_read_or_refused(text in "[\\[\\]{}\",:0-9a-z$ .\n-]{0,40}") {
        for read in [Datum::from_toml(&text), Datum::from_json(&text)] {
            match read {
                Ok(datum) => prop_assert_eq!(Datum::of(&datum.encode().unwrap()), datum),
                Err(error) => prop_assert!(error.line >= 1 && !error.what.is_empty()),
            }
        }
    }
}

fn check(datum: &Datum, expected: &Expect) {
    expected.assert_eq(&format!("{}\n{}\n", datum.to_toml(), datum.to_json()));
}

#[test]
fn how_values_look() {
    check(
        &Datum::float(0.5),
        &expect![[r#"
        0.5
        0.5
    "#]],
    );
    check(
        &Datum::float(2.0),
        &expect![[r#"
        2.0
        2.0
    "#]],
    );
    check(
        &Datum::float(-0.0),
        &expect![[r#"
        -0.0
        -0.0
    "#]],
    );
    check(
        &Datum::float(f64::NEG_INFINITY),
        &expect![[r#"
        -inf
        {"$float":"-inf"}
    "#]],
    );
    check(
        &Datum::float(-f64::NAN),
        &expect![[r#"
        nan
        {"$float":"nan"}
    "#]],
    );
    check(
        &Datum::Integer(i64::MIN),
        &expect![[r#"
        -9223372036854775808
        -9223372036854775808
    "#]],
    );
}

#[test]
fn how_texts_and_tables_look() {
    check(
        &Datum::from("a \"b\"\n\u{7f}ä"),
        &expect![[r#"
        "a \"b\"\n\u007fä"
        "a \"b\"\nä"
    "#]],
    );
    check(
        &Datum::Bytes(vec![0, 255]),
        &expect![[r#"
        {"$bytes" = "00ff"}
        {"$bytes":"00ff"}
    "#]],
    );
    check(
        &Datum::Opaque { tag: 9, bytes: vec![1] },
        &expect![[r#"
        {"$opaque" = "9:01"}
        {"$opaque":"9:01"}
    "#]],
    );
    let pose = [("x", Datum::float(1.0)), ("$y", Datum::List(vec![Datum::Bool(true), Datum::Sealed(vec![])]))];
    check(
        &Datum::Table(pose.into_iter().map(|(name, field)| (name.to_owned(), field)).collect()),
        &expect![[r#"
        {"$y" = [true, {"$sealed" = ""}], x = 1.0}
        {"$y":[true,{"$sealed":""}],"x":1.0}
    "#]],
    );
    check(
        &Datum::Table([("$bytes".to_owned(), Datum::from("x"))].into()),
        &expect![[r#"
        {"$$bytes" = "x"}
        {"$$bytes":"x"}
    "#]],
    );
}

#[test]
fn mistakes_are_told_with_their_place() {
    let toml = |text: &str, expected: Expect| expected.assert_eq(&Datum::from_toml(text).unwrap_err().to_string());
    let json = |text: &str, expected: Expect| expected.assert_eq(&Datum::from_json(text).unwrap_err().to_string());
    toml(
        "hello",
        expect![[
            r#"line 1, column 1: string values must be quoted, expected literal string (a text stands in quotes: "hello")"#
        ]],
    );
    toml("", expect![[r#"line 1, column 1: there is no value (an empty text is "")"#]]);
    toml(
        "[1,\n 9223372036854775808]",
        expect![
            "line 2, column 2: the integer 9223372036854775808 does not fit into 64 bits with a sign (a float has a point or an exponent; a longer number is best a text)"
        ],
    );
    toml("2026-11-21", expect!["line 1, column 1: a date is not a value (write it as a text, in quotes)"]);
    toml("{a = 1, a = 2}", expect!["line 1, column 9: duplicate key"]);
    toml(
        "{a = {\"$bytes\" = \"0\"}}",
        expect![[
            r#"line 1, column 6: "0" is not a `$bytes` (write one more `$` before a name that begins with `$` and is alone in its table)"#
        ]],
    );
    toml(
        "{\"$byte\" = \"0\"}",
        expect![
            "line 1, column 1: `$byte` is not a kind of value (write one more `$` before a name that begins with `$` and is alone in its table)"
        ],
    );
    toml("1e999", expect!["line 1, column 1: 1e999 is not a 64-bit float"]);
    toml("1e-999", expect!["line 1, column 1: 1e-999 is not a 64-bit float"]);
    assert_eq!(Datum::from_toml("0.0e-999"), Ok(Datum::float(0.0)));
    toml(&"[".repeat(1000), expect!["line 1, column 81: cannot recurse further; max recursion depth met"]);
    json(
        "{\"a\": [1, -9223372036854775809]}",
        expect![
            "line 1, column 11: the integer -9223372036854775809 does not fit into 64 bits with a sign (a float has a point or an exponent; a longer number is best a text)"
        ],
    );
    json(
        "{\"a\": \"\\\"99999999999999999999\", \"b\": 99999999999999999999}",
        expect![
            "line 1, column 38: the integer 99999999999999999999 does not fit into 64 bits with a sign (a float has a point or an exponent; a longer number is best a text)"
        ],
    );
    json("{\"a\": 1, \"a\": 2}", expect![[r#"line 1, column 16: the name "a" occurs twice"#]]);
    json("null", expect!["line 1, column 4: `null` is not a value (delete the key instead)"]);
    json("[1,\n2", expect!["line 2, column 1: EOF while parsing a list"]);
    json("1e999", expect!["line 1, column 5: number out of range"]);
}

#[test]
fn integers_and_floats_are_two() {
    assert_eq!(Datum::from_json("[1, 1.0, -0, -0.0, 1e2]"), Datum::from_toml("[1, 1.0, -0.0, -0.0, 100.0]"));
    assert_ne!(Datum::from_toml("1"), Datum::from_toml("1.0"));
    assert_ne!(Datum::float(0.0), Datum::float(-0.0));
    assert_eq!(Datum::from_toml("[0x10, 1_000, -nan]").unwrap().to_toml(), "[16, 1000, nan]");
}

#[test]
fn max_value_sizes() {
    assert!(Datum::Bytes(vec![0; VALUE_SIZE_MAX]).encode().is_ok());
    let long = Datum::Bytes(vec![0; VALUE_SIZE_MAX + 1]);
    assert_eq!(long.encode(), Err(DatumError::Long { size: VALUE_SIZE_MAX + 1 }));
    assert_eq!(Datum::from_json(&long.to_json()).unwrap(), long, "too long to store is not too long to read");
    let nested = |depth| (0..depth).fold(Datum::Integer(1), |inner, _| Datum::List(vec![inner]));
    let deep = nested(DEPTH_MAX);
    assert_eq!(Datum::of(&deep.encode().unwrap()), deep);
    assert_eq!(Datum::from_toml(&deep.to_toml()), Ok(deep));
    let bytes = (0..DEPTH_MAX).fold(Datum::Bytes(vec![1]), |inner, _| Datum::List(vec![inner]));
    assert!(bytes.encode().is_ok());
    assert_eq!(Datum::from_toml(&bytes.to_toml()), Ok(bytes.clone()));
    assert_eq!(Datum::from_json(&bytes.to_json()), Ok(bytes));
    let deeper = nested(DEPTH_MAX + 1);
    assert_eq!(deeper.encode(), Err(DatumError::Deep));
    let stored = deeper.to_value();
    assert_eq!(Datum::of(&stored).encode(), Ok(stored), "what somebody else could write is kept");
}

/// The exact bytes, on which other versions rely.
#[test]
fn golden_bytes() {
    let datum = Datum::from_toml("{a = [true, 1, 0.5], b = \"c\"}").unwrap();
    let value = datum.encode().unwrap();
    let hex: String = value.bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    expect!["7 020161061803020101030801000000000000000508000000000000e03f0162010163"]
        .assert_eq(&format!("{} {hex}", value.encoding.0));
}
