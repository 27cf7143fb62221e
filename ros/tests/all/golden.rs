//! Compares the standard library with the output of `rosbags` 0.11.9 for the newest distribution of ROS 2.

#![expect(clippy::unwrap_used, reason = "a test stops where something is not as it should be")]

use super::text;
use ros::logic::cdr::{self, CdrError};
use ros::logic::hash::rihs01;
use ros::logic::library;
use ros::logic::name::TypeName;
use ros::logic::schema::Schema;

const GOLDEN: &str = include_str!("../golden/rosbags.txt");

/// Calls `check` with each value: its schema and its line.
pub(crate) fn each(mut check: impl FnMut(&Schema, &str)) -> (Vec<TypeName>, usize) {
    let (mut names, mut schema, mut values) = (Vec::new(), None, 0);
    for line in GOLDEN.lines() {
        let (kind, rest) = line.split_once(' ').unwrap();
        if kind == "T" {
            let (name, hash) = rest.split_once(' ').unwrap();
            let name = TypeName::parse(name).unwrap();
            let found = library::schema(&name).unwrap();
            assert_eq!(rihs01(&found), hash, "{name}");
            names.push(name);
            schema = Some(found);
        } else {
            check(schema.as_ref().unwrap(), rest);
            values += 1;
        }
    }
    (names, values)
}

/// Several independent sources publish these hashes.
#[test]
fn services_have_the_hashes_of_ros() {
    let golden = include_str!("../golden/services.txt");
    for line in golden.lines() {
        let (name, hash) = line.split_once(' ').unwrap();
        let schema = library::schema(&TypeName::parse(name).unwrap()).unwrap();
        assert_eq!(rihs01(&schema), hash, "{name}");
    }
    assert!(golden.lines().count() > 10);
}

/// Source: the tests of `zenoh-ros2-sdk`, which took the hashes from an unmodified ROS 2.
#[test]
fn actions_have_the_hashes_of_ros() {
    for line in include_str!("../golden/actions.txt").lines() {
        let (name, hash) = line.split_once(' ').unwrap();
        let schema = library::schema(&TypeName::parse(name).unwrap()).unwrap();
        assert_eq!(rihs01(&schema), hash, "{name}");
    }
}

#[test]
fn every_message_has_its_hash_and_values_of_21_types_are_read_and_written() {
    let (mut names, values) = each(text::check);
    let mut all: Vec<TypeName> = library::messages().collect();
    names.sort();
    all.sort();
    assert_eq!((names, values), (all, 21));
}

/// Each byte is removed once, and each bit is changed once.
#[test]
fn damaged_bytes_are_read_or_refused() {
    let (mut read, mut refused) = (0, 0);
    each(|schema, line| {
        let whole = text::bytes(line.split_once(' ').unwrap().0);
        let mut count = |bytes: &[u8]| match cdr::read(schema, bytes) {
            Ok(_) => read += 1,
            Err(_) => refused += 1,
        };
        for at in 0..whole.len() {
            count(&whole[..at]);
            for bit in 0..8 {
                let mut bytes = whole.clone();
                bytes[at] ^= 1 << bit;
                count(&bytes);
            }
        }
    });
    assert!(read > 1000 && refused > 1000, "{read} read, {refused} refused");
}

#[test]
fn the_end_of_a_value_may_have_padding() {
    let schema = library::schema(&TypeName::parse("std_msgs/String").unwrap()).unwrap();
    let bytes = |rest: usize| [&[0, 1, 0, 0, 2, 0, 0, 0, b'a', 0][..], &vec![0; rest]].concat();
    for rest in 0..=3 {
        assert!(cdr::read(&schema, &bytes(rest)).is_ok(), "{rest}");
    }
    assert_eq!(cdr::read(&schema, &bytes(4)), Err(CdrError::Rest(4)));
}
