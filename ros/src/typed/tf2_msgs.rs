//! The messages of `tf2_msgs`, written by `tests/all/typed.rs`.

super::message! {
    TF2Error, "tf2_msgs/msg/TF2Error", "ros.tf2.TF2Error";
    error: u8,
    error_string: String,
    ;
    const NO_ERROR: u8 = 0;
    const LOOKUP_ERROR: u8 = 1;
    const CONNECTIVITY_ERROR: u8 = 2;
    const EXTRAPOLATION_ERROR: u8 = 3;
    const INVALID_ARGUMENT_ERROR: u8 = 4;
    const TIMEOUT_ERROR: u8 = 5;
    const TRANSFORM_ERROR: u8 = 6;
}

super::message! {
    TFMessage, "tf2_msgs/msg/TFMessage", "ros.tf2.TFMessage";
    transforms: Vec<super::geometry_msgs::TransformStamped>,
}

super::message! {
    FrameGraphRequest, "tf2_msgs/srv/FrameGraph_Request", "ros.tf2.FrameGraph_Request";
}

super::message! {
    FrameGraphResponse, "tf2_msgs/srv/FrameGraph_Response", "ros.tf2.FrameGraph_Response";
    frame_yaml: String,
}
