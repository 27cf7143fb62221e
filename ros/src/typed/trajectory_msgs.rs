//! The messages of `trajectory_msgs`, written by `tests/all/typed.rs`.

super::message! {
    JointTrajectory, "trajectory_msgs/msg/JointTrajectory", "ros.trajectory.JointTrajectory";
    header: super::std_msgs::Header,
    joint_names: Vec<String>,
    points: Vec<JointTrajectoryPoint>,
}

super::message! {
    JointTrajectoryPoint, "trajectory_msgs/msg/JointTrajectoryPoint", "ros.trajectory.JointTrajectoryPoint";
    positions: Vec<f64>,
    velocities: Vec<f64>,
    accelerations: Vec<f64>,
    effort: Vec<f64>,
    time_from_start: super::builtin_interfaces::Duration,
}

super::message! {
    MultiDOFJointTrajectory, "trajectory_msgs/msg/MultiDOFJointTrajectory", "ros.trajectory.MultiDOFJointTrajectory";
    header: super::std_msgs::Header,
    joint_names: Vec<String>,
    points: Vec<MultiDOFJointTrajectoryPoint>,
}

super::message! {
    MultiDOFJointTrajectoryPoint, "trajectory_msgs/msg/MultiDOFJointTrajectoryPoint", "ros.trajectory.MultiDOFJointTrajectoryPoint";
    transforms: Vec<super::geometry_msgs::Transform>,
    velocities: Vec<super::geometry_msgs::Twist>,
    accelerations: Vec<super::geometry_msgs::Twist>,
    time_from_start: super::builtin_interfaces::Duration,
}
