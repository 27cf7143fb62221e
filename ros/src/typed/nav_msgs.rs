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

super::message! {
    GetMapRequest, "nav_msgs/srv/GetMap_Request", "ros.nav.GetMap_Request";
}

super::message! {
    GetMapResponse, "nav_msgs/srv/GetMap_Response", "ros.nav.GetMap_Response";
    map: OccupancyGrid,
}

super::message! {
    GetPlanRequest, "nav_msgs/srv/GetPlan_Request", "ros.nav.GetPlan_Request";
    start: super::geometry_msgs::PoseStamped,
    goal: super::geometry_msgs::PoseStamped,
    tolerance: f32,
}

super::message! {
    GetPlanResponse, "nav_msgs/srv/GetPlan_Response", "ros.nav.GetPlan_Response";
    plan: Path,
}

super::message! {
    SetMapRequest, "nav_msgs/srv/SetMap_Request", "ros.nav.SetMap_Request";
    map: OccupancyGrid,
    initial_pose: super::geometry_msgs::PoseWithCovarianceStamped,
}

super::message! {
    SetMapResponse, "nav_msgs/srv/SetMap_Response", "ros.nav.SetMap_Response";
    success: bool,
}

super::message! {
    LoadMapRequest, "nav_msgs/srv/LoadMap_Request", "ros.nav.LoadMap_Request";
    map_url: String,
}

super::message! {
    LoadMapResponse, "nav_msgs/srv/LoadMap_Response", "ros.nav.LoadMap_Response";
    map: OccupancyGrid,
    result: u8,
    ;
    const RESULT_SUCCESS: u8 = 0;
    const RESULT_MAP_DOES_NOT_EXIST: u8 = 1;
    const RESULT_INVALID_MAP_DATA: u8 = 2;
    const RESULT_INVALID_MAP_METADATA: u8 = 3;
    const RESULT_UNDEFINED_FAILURE: u8 = 255;
}
