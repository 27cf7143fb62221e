//! The messages of `action_msgs`, written by `tests/all/typed.rs`.

super::message! {
    GoalInfo, "action_msgs/msg/GoalInfo", "ros.action.GoalInfo";
    goal_id: super::unique_identifier_msgs::UUID,
    stamp: super::builtin_interfaces::Time,
}

super::message! {
    GoalStatus, "action_msgs/msg/GoalStatus", "ros.action.GoalStatus";
    goal_info: GoalInfo,
    status: i8,
    ;
    const STATUS_UNKNOWN: i8 = 0;
    const STATUS_ACCEPTED: i8 = 1;
    const STATUS_EXECUTING: i8 = 2;
    const STATUS_CANCELING: i8 = 3;
    const STATUS_SUCCEEDED: i8 = 4;
    const STATUS_CANCELED: i8 = 5;
    const STATUS_ABORTED: i8 = 6;
}

super::message! {
    GoalStatusArray, "action_msgs/msg/GoalStatusArray", "ros.action.GoalStatusArray";
    status_list: Vec<GoalStatus>,
}

super::message! {
    CancelGoalRequest, "action_msgs/srv/CancelGoal_Request", "ros.action.CancelGoal_Request";
    goal_info: GoalInfo,
}

super::message! {
    CancelGoalResponse, "action_msgs/srv/CancelGoal_Response", "ros.action.CancelGoal_Response";
    return_code: i8,
    goals_canceling: Vec<GoalInfo>,
    ;
    const ERROR_NONE: i8 = 0;
    const ERROR_REJECTED: i8 = 1;
    const ERROR_UNKNOWN_GOAL_ID: i8 = 2;
    const ERROR_GOAL_TERMINATED: i8 = 3;
}
