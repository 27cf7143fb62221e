//! Peers that send nonsense: the bridge continues, and counts all of it.

use super::peer::{Bridge, Router, SOON, STRING, attachment, expect_reader, string, value};
use zenoh::Wait;

#[test]
fn nonsense_is_counted_and_the_next_message_passes() {
    let router = Router::new();
    let mut bridge = Bridge::new("</chatter std_msgs/msg/String ::,100:,:,:,,", &router);
    let node = router.node();
    let key = format!("7/chatter/{STRING}");
    expect_reader(&node, &key);
    let whole = attachment(1, 1);
    let message = string("hello");
    let long = [&whole[..], &[0]].concat();
    let names = [&whole[..], &[1; 44]].concat();
    let mut count = 0;
    for attachment in [&[][..], &whole[..32], &long, &names] {
        node.put(&key, &message[..]).attachment(attachment).wait().unwrap();
        count += 1;
    }
    node.put(&key, &message[..]).wait().unwrap();
    count += 1;
    for end in 0..message.len() {
        node.put(&key, &message[..end]).attachment(&whole[..]).wait().unwrap();
        count += 1;
    }
    for at in 0..4 {
        let mut other = message.clone();
        other[4 + at] ^= 0xff;
        node.put(&key, other).attachment(&whole[..]).wait().unwrap();
        count += 1;
    }
    // Messages with other types and other hashes have other keys.
    node.put("7/chatter/std_msgs::msg::dds_::String_/RIHS01_00", &message[..]).attachment(&whole[..]).wait().unwrap();
    node.put("7/chatter/std_msgs::msg::dds_::Bool_/RIHS01_00", &message[..]).attachment(&whole[..]).wait().unwrap();
    node.put(&key, &message[..]).attachment(&whole[..]).wait().unwrap();
    assert_eq!(bridge.sent(1).values, [("chatter", value(&message))]);
    bridge.expect_signal("/chatter refused", f64::from(count));
    bridge.expect_signal("/chatter received", 1.0);
}

/// Neither its values nor its token end anything, and both nodes are reported.
#[test]
fn a_topic_whose_type_changes_is_told_and_counted() {
    let router = Router::new();
    let node = router.node();
    let token = |of: &str| {
        let key = format!("@ros2_lv/7/aa/0/1/MP/%/%/n/%chatter/{of}/::,:,:,:,,");
        node.liveliness().declare_token(key).wait().unwrap()
    };
    let bool = STRING.replace("String", "Bool");
    let before = token(&bool);
    let mut bridge = Bridge::new("</chatter std_msgs/msg/String ::,10:,:,:,,", &router);
    bridge.expect_signal("/chatter of other types", 1.0);
    let humble = token("std_msgs::msg::dds_::String_/TypeHashNotSupported");
    bridge.expect_signal("/chatter of other types", 2.0);
    drop((before, humble));
    let same = token(STRING);
    bridge.expect_signal("/chatter of other types", 0.0);
    let key = format!("7/chatter/{STRING}");
    expect_reader(&node, &key);
    node.put(format!("7/chatter/{bool}"), vec![0, 1, 0, 0, 1]).attachment(attachment(1, 1)).wait().unwrap();
    node.put(&key, string("a")).attachment(attachment(1, 1)).wait().unwrap();
    assert_eq!(bridge.sent(1).values, [("chatter", value(&string("a")))]);
    drop(same);
}

/// The number of publishers of one process.
const PUBLISHERS: usize = 50;

/// Declares `count` publishers and a node with a long name, and sends a message in addition.
fn check_tokens(count: usize) {
    let router = Router::new();
    let node = router.node();
    let tokens: Vec<_> = (0..count)
        .map(|number| {
            // There are as many processes as in a large network, each with some publishers.
            let (process, publisher) = (number / PUBLISHERS, number % PUBLISHERS);
            format!(
                "@ros2_lv/7/{process:x}/0/{publisher}/MP/%/%/n/%chatter/{}/::,:,:,:,,",
                STRING.replace("String", "Bool")
            )
        })
        .chain([format!("@ros2_lv/7/aa/0/0/NN/%/%/{}", "n".repeat(4096))])
        .map(|key| node.liveliness().declare_token(key).wait().expect("Zenoh takes any key"))
        .collect();
    let mut bridge = Bridge::new("</chatter std_msgs/msg/String ::,10:,:,:,,", &router);
    // The bridge only knows a limited number of them.
    bridge.expect_signal("/chatter of other types", if count > 1000 { 1000.0 } else { 50.0 });
    let key = format!("7/chatter/{STRING}");
    expect_reader(&node, &key);
    let put = node.put(key, string("a")).attachment(attachment(1, 1));
    put.wait().expect("the router is there");
    // The message arrives after all the tokens.
    assert_eq!(bridge.sent_within(1, 4 * SOON).values, [("chatter", value(&string("a")))]);
    drop(tokens);
}

#[test]
fn tokens_and_long_names_are_nothing_to_it() {
    check_tokens(50);
}

#[test]
#[ignore = "long: 10,000 tokens"]
fn ten_thousand_tokens_are_nothing_to_it() {
    check_tokens(10_000);
}
