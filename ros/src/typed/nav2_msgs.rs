//! The messages of `nav2_msgs`, written by `tests/all/typed.rs`.

super::message! {
    NavigateToPoseGoal, "nav2_msgs/action/NavigateToPose_Goal", "ros.nav2.NavigateToPose_Goal";
    pose: super::geometry_msgs::PoseStamped,
    behavior_tree: String,
}

super::message! {
    NavigateToPoseResult, "nav2_msgs/action/NavigateToPose_Result", "ros.nav2.NavigateToPose_Result";
    error_code: u16,
    error_msg: String,
    ;
    const NONE: u16 = 0;
    const UNKNOWN: u16 = 9000;
    const FAILED_TO_LOAD_BEHAVIOR_TREE: u16 = 9001;
    const TF_ERROR: u16 = 9002;
    const TIMEOUT: u16 = 9003;
}

super::message! {
    NavigateToPoseFeedback, "nav2_msgs/action/NavigateToPose_Feedback", "ros.nav2.NavigateToPose_Feedback";
    current_pose: super::geometry_msgs::PoseStamped,
    navigation_time: super::builtin_interfaces::Duration,
    estimated_time_remaining: super::builtin_interfaces::Duration,
    number_of_recoveries: i16,
    distance_remaining: f32,
}
