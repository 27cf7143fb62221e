//! The messages of `std_srvs`, written by `tests/all/typed.rs`.

super::message! {
    EmptyRequest, "std_srvs/srv/Empty_Request", "ros.std_srvs.Empty_Request";
}

super::message! {
    EmptyResponse, "std_srvs/srv/Empty_Response", "ros.std_srvs.Empty_Response";
}

super::message! {
    SetBoolRequest, "std_srvs/srv/SetBool_Request", "ros.std_srvs.SetBool_Request";
    data: bool,
}

super::message! {
    SetBoolResponse, "std_srvs/srv/SetBool_Response", "ros.std_srvs.SetBool_Response";
    success: bool,
    message: String,
}

super::message! {
    TriggerRequest, "std_srvs/srv/Trigger_Request", "ros.std_srvs.Trigger_Request";
}

super::message! {
    TriggerResponse, "std_srvs/srv/Trigger_Response", "ros.std_srvs.Trigger_Response";
    success: bool,
    message: String,
}
