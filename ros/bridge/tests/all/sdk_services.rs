//! Services against `zenoh-ros2-sdk` from PyPI, which is independent of DCA: its server answers, and its client calls.

use super::peer::{Bridge, Router, SOON, value_of};
use super::sdk::{Peer, python};
use comms::logic::object::ObjectError;
use controllers::ros::std_srvs::{SetBoolRequest, SetBoolResponse};
use ros::logic::name::TypeName;
use ros::logic::{hash, library};
use ros::typed::Message;
use std::io::{BufRead, BufReader, Write};
use std::process::{Command, Stdio};

#[test]
#[ignore = "long: PyPI"]
fn an_independent_server_answers_and_an_independent_client_calls() {
    let folder = std::env::temp_dir().join(format!("dca-ros-services-{}", std::process::id()));
    let python = match python(&folder, "zenoh-ros2-sdk==0.1.8") {
        Ok(python) => python,
        Err(why) => return println!("skipped: zenoh-ros2-sdk cannot be had from PyPI: {why}"),
    };
    let router = Router::new();
    let locator = router.locator();
    let port = locator.rsplit(':').next().unwrap();
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/peer_services.py");
    let mut command = Command::new(python);
    command.args([script, "127.0.0.1", port]).stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut peer = Peer(command.spawn().unwrap());
    let mut input = peer.0.stdin.take().unwrap();
    let mut lines = BufReader::new(peer.0.stdout.take().unwrap()).lines();

    let of = TypeName::parse("std_srvs/srv/SetBool").unwrap();
    let schemas = [of.clone(), of.request(), of.response()].map(|name| library::schema(&name).unwrap());
    let [whole, request, response] = &schemas;
    let (hash, request, response) = (hash::rihs01(whole), request.text(), response.text());
    writeln!(
        input,
        "{{\"type\": \"{of}\", \"hash\": \"{hash}\", \"request\": {request:?}, \"response\": {response:?}}}"
    )
    .unwrap();
    let routes = format!("?/there {of} ::,10:,:,:,,;!/back {of} ::,10:,:,:,,");
    let mut bridge = Bridge::new(&routes, &router);
    assert_eq!(lines.next().unwrap().unwrap(), "ready");

    for data in [true, false] {
        let request = value_of(&SetBoolRequest { data }.to_cdr().unwrap());
        let answer = (0..100).find_map(|_| bridge.call("there", &request).recv_timeout(SOON).unwrap().ok());
        let text = if data { "it is True" } else { "it is False" };
        let expected = SetBoolResponse { success: data, message: text.to_owned() };
        assert_eq!(answer, Some(value_of(&expected.to_cdr().unwrap())));
    }
    for (data, told) in [(true, "{\"success\": false, \"message\": \"no\"}"), (false, "null")] {
        writeln!(input, "{{\"data\": {data}}}").unwrap();
        let (call, number, argument) = bridge.asked(1).remove(0);
        assert_eq!((call, argument), ("back", value_of(&SetBoolRequest { data }.to_cdr().unwrap())));
        let response = SetBoolResponse { success: false, message: "no".to_owned() };
        let refused = ObjectError::Refused { reason: "not now".to_owned() };
        let result = if data { Ok(value_of(&response.to_cdr().unwrap())) } else { Err(refused) };
        bridge.answer("back", number, result);
        assert_eq!(lines.next().unwrap().unwrap(), told);
    }
    std::fs::remove_dir_all(folder).unwrap();
}
