//! Peers that send nonsense: nothing ends, and all of it is counted.

use super::peer::{Bridge, Router, STRING, attachment, expect_reader, string, value};
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
    // Other types and other hashes are other keys.
    node.put("7/chatter/std_msgs::msg::dds_::String_/RIHS01_00", &message[..]).attachment(&whole[..]).wait().unwrap();
    node.put("7/chatter/std_msgs::msg::dds_::Bool_/RIHS01_00", &message[..]).attachment(&whole[..]).wait().unwrap();
    node.put(&key, &message[..]).attachment(&whole[..]).wait().unwrap();
    assert_eq!(bridge.sent(1).values, [("chatter", value(&message))]);
    bridge.expect_signal("/chatter refused", f64::from(count));
    bridge.expect_signal("/chatter received", 1.0);
}

/// Shows so many publishers and a node with a long name, and sends a message beside them.
fn check_tokens(count: usize) {
    let router = Router::new();
    let node = router.node();
    let tokens: Vec<_> = (0..count)
        .map(|number| format!("@ros2_lv/7/aa/0/{number}/MP/%/%/n/%chatter/{STRING}/::,:,:,:,,"))
        .chain([format!("@ros2_lv/7/aa/0/0/NN/%/%/{}", "n".repeat(4096))])
        .map(|key| node.liveliness().declare_token(key).wait().expect("Zenoh takes any key"))
        .collect();
    let mut bridge = Bridge::new("</chatter std_msgs/msg/String ::,10:,:,:,,", &router);
    let key = format!("7/chatter/{STRING}");
    expect_reader(&node, &key);
    let put = node.put(key, string("a")).attachment(attachment(1, 1));
    put.wait().expect("the router is there");
    assert_eq!(bridge.sent(1).values, [("chatter", value(&string("a")))]);
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
