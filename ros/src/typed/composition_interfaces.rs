//! The messages of `composition_interfaces`, written by `tests/all/typed.rs`.

super::message! {
    LoadNodeRequest, "composition_interfaces/srv/LoadNode_Request", "ros.composition.LoadNode_Request";
    package_name: String,
    plugin_name: String,
    node_name: String,
    node_namespace: String,
    log_level: u8,
    remap_rules: Vec<String>,
    parameters: Vec<super::rcl_interfaces::Parameter>,
    extra_arguments: Vec<super::rcl_interfaces::Parameter>,
}

super::message! {
    LoadNodeResponse, "composition_interfaces/srv/LoadNode_Response", "ros.composition.LoadNode_Response";
    success: bool,
    error_message: String,
    full_node_name: String,
    unique_id: u64,
}

super::message! {
    UnloadNodeRequest, "composition_interfaces/srv/UnloadNode_Request", "ros.composition.UnloadNode_Request";
    unique_id: u64,
}

super::message! {
    UnloadNodeResponse, "composition_interfaces/srv/UnloadNode_Response", "ros.composition.UnloadNode_Response";
    success: bool,
    error_message: String,
}

super::message! {
    ListNodesRequest, "composition_interfaces/srv/ListNodes_Request", "ros.composition.ListNodes_Request";
}

super::message! {
    ListNodesResponse, "composition_interfaces/srv/ListNodes_Response", "ros.composition.ListNodes_Response";
    full_node_names: Vec<String>,
    unique_ids: Vec<u64>,
}
