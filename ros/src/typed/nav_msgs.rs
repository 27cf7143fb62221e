//! The messages of `nav_msgs`, written by `tests/all/typed.rs`.

super::message! {
    Goals, "nav_msgs/msg/Goals", "ros.nav.Goals";
    header: super::std_msgs::Header,
    goals: Vec<super::geometry_msgs::PoseStamped>,
}

super::message! {
    GridCells, "nav_msgs/msg/GridCells", "ros.nav.GridCells";
    header: super::std_msgs::Header,
    cell_width: f32,
    cell_height: f32,
    cells: Vec<super::geometry_msgs::Point>,
}

super::message! {
    MapMetaData, "nav_msgs/msg/MapMetaData", "ros.nav.MapMetaData";
    map_load_time: super::builtin_interfaces::Time,
    resolution: f32,
    width: u32,
    height: u32,
    origin: super::geometry_msgs::Pose,
}

super::message! {
    OccupancyGrid, "nav_msgs/msg/OccupancyGrid", "ros.nav.OccupancyGrid";
    header: super::std_msgs::Header,
    info: MapMetaData,
    data: Vec<i8>,
}

super::message! {
    Odometry, "nav_msgs/msg/Odometry", "ros.nav.Odometry";
    header: super::std_msgs::Header,
    child_frame_id: String,
    pose: super::geometry_msgs::PoseWithCovariance,
    twist: super::geometry_msgs::TwistWithCovariance,
}

super::message! {
    Path, "nav_msgs/msg/Path", "ros.nav.Path";
    header: super::std_msgs::Header,
    poses: Vec<super::geometry_msgs::PoseStamped>,
}
