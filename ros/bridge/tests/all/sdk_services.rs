//! Services against `zenoh-ros2-sdk` from PyPI, which is independent of DCA: its server answers, and its client calls.

use super::peer::{Bridge, Router, SOON, value_of};
use super::sdk::Peer;
use comms::logic::object::ObjectError;
use controllers::ros::std_srvs::{SetBoolRequest, SetBoolResponse};
use ros::logic::name::TypeName;
use ros::logic::{hash, library};
use ros::typed::Message;

#[test]
#[ignore = "long: PyPI"]
fn an_independent_server_answers_and_an_independent_client_calls() {
    let router = Router::new();
    let Some(mut peer) = Peer::start("peer_services.py", &router) else { return };

    let of = TypeName::parse("std_srvs/srv/SetBool").unwrap();
    let schemas = [of.clone(), of.request(), of.response()].map(|name| library::schema(&name).unwrap());
    let [whole, request, response] = &schemas;
    let (hash, request, response) = (hash::rihs01(whole), request.text(), response.text());
    peer.write(&format!(
        "{{\"type\": \"{of}\", \"hash\": \"{hash}\", \"request\": {request:?}, \"response\": {response:?}}}"
    ));
    let routes = format!("?/there {of} ::,10:,:,:,,;!/back {of} ::,10:,:,:,,");
    let mut bridge = Bridge::new(&routes, &router);
    assert_eq!(peer.read(), "ready");

    for data in [true, false] {
        let request = value_of(&SetBoolRequest { data }.to_cdr().unwrap());
        let answer = (0..100).find_map(|_| bridge.call("there", &request).recv_timeout(SOON).unwrap().ok());
        let text = if data { "it is True" } else { "it is False" };
        let expected = SetBoolResponse { success: data, message: text.to_owned() };
        assert_eq!(answer, Some(value_of(&expected.to_cdr().unwrap())));
    }
    for (data, told) in [(true, "{\"success\": false, \"message\": \"no\"}"), (false, "null")] {
        peer.write(&format!("{{\"data\": {data}}}"));
        let (call, number, argument) = bridge.asked(1).remove(0);
        assert_eq!((call, argument), ("back", value_of(&SetBoolRequest { data }.to_cdr().unwrap())));
        let response = SetBoolResponse { success: false, message: "no".to_owned() };
        let refused = ObjectError::Refused { reason: "not now".to_owned() };
        let result = if data { Ok(value_of(&response.to_cdr().unwrap())) } else { Err(refused) };
        bridge.answer("back", number, result);
        assert_eq!(peer.read(), told);
    }
}
