//! The messages of `visualization_msgs`, written by `tests/all/typed.rs`.

super::message! {
    ImageMarker, "visualization_msgs/msg/ImageMarker", "ros.visualization.ImageMarker";
    header: super::std_msgs::Header,
    ns: String,
    id: i32,
    r#type: i32,
    action: i32,
    position: super::geometry_msgs::Point,
    scale: f32,
    outline_color: super::std_msgs::ColorRGBA,
    filled: u8,
    fill_color: super::std_msgs::ColorRGBA,
    lifetime: super::builtin_interfaces::Duration,
    points: Vec<super::geometry_msgs::Point>,
    outline_colors: Vec<super::std_msgs::ColorRGBA>,
    ;
    const CIRCLE: i32 = 0;
    const LINE_STRIP: i32 = 1;
    const LINE_LIST: i32 = 2;
    const POLYGON: i32 = 3;
    const POINTS: i32 = 4;
    const ADD: i32 = 0;
    const REMOVE: i32 = 1;
}

super::message! {
    InteractiveMarker, "visualization_msgs/msg/InteractiveMarker", "ros.visualization.InteractiveMarker";
    header: super::std_msgs::Header,
    pose: super::geometry_msgs::Pose,
    name: String,
    description: String,
    scale: f32,
    menu_entries: Vec<MenuEntry>,
    controls: Vec<InteractiveMarkerControl>,
}

super::message! {
    InteractiveMarkerControl, "visualization_msgs/msg/InteractiveMarkerControl", "ros.visualization.InteractiveMarkerControl";
    name: String,
    orientation: super::geometry_msgs::Quaternion,
    orientation_mode: u8,
    interaction_mode: u8,
    always_visible: bool,
    markers: Vec<Marker>,
    independent_marker_orientation: bool,
    description: String,
    ;
    const INHERIT: u8 = 0;
    const FIXED: u8 = 1;
    const VIEW_FACING: u8 = 2;
    const NONE: u8 = 0;
    const MENU: u8 = 1;
    const BUTTON: u8 = 2;
    const MOVE_AXIS: u8 = 3;
    const MOVE_PLANE: u8 = 4;
    const ROTATE_AXIS: u8 = 5;
    const MOVE_ROTATE: u8 = 6;
    const MOVE_3D: u8 = 7;
    const ROTATE_3D: u8 = 8;
    const MOVE_ROTATE_3D: u8 = 9;
}

super::message! {
    InteractiveMarkerFeedback, "visualization_msgs/msg/InteractiveMarkerFeedback", "ros.visualization.InteractiveMarkerFeedback";
    header: super::std_msgs::Header,
    client_id: String,
    marker_name: String,
    control_name: String,
    event_type: u8,
    pose: super::geometry_msgs::Pose,
    menu_entry_id: u32,
    mouse_point: super::geometry_msgs::Point,
    mouse_point_valid: bool,
    ;
    const KEEP_ALIVE: u8 = 0;
    const POSE_UPDATE: u8 = 1;
    const MENU_SELECT: u8 = 2;
    const BUTTON_CLICK: u8 = 3;
    const MOUSE_DOWN: u8 = 4;
    const MOUSE_UP: u8 = 5;
}

super::message! {
    InteractiveMarkerInit, "visualization_msgs/msg/InteractiveMarkerInit", "ros.visualization.InteractiveMarkerInit";
    server_id: String,
    seq_num: u64,
    markers: Vec<InteractiveMarker>,
}

super::message! {
    InteractiveMarkerPose, "visualization_msgs/msg/InteractiveMarkerPose", "ros.visualization.InteractiveMarkerPose";
    header: super::std_msgs::Header,
    pose: super::geometry_msgs::Pose,
    name: String,
}

super::message! {
    InteractiveMarkerUpdate, "visualization_msgs/msg/InteractiveMarkerUpdate", "ros.visualization.InteractiveMarkerUpdate";
    server_id: String,
    seq_num: u64,
    r#type: u8,
    markers: Vec<InteractiveMarker>,
    poses: Vec<InteractiveMarkerPose>,
    erases: Vec<String>,
    ;
    const KEEP_ALIVE: u8 = 0;
    const UPDATE: u8 = 1;
}

super::message! {
    Marker, "visualization_msgs/msg/Marker", "ros.visualization.Marker";
    header: super::std_msgs::Header,
    ns: String,
    id: i32,
    r#type: i32,
    action: i32,
    pose: super::geometry_msgs::Pose,
    scale: super::geometry_msgs::Vector3,
    color: super::std_msgs::ColorRGBA,
    lifetime: super::builtin_interfaces::Duration,
    frame_locked: bool,
    points: Vec<super::geometry_msgs::Point>,
    colors: Vec<super::std_msgs::ColorRGBA>,
    texture_resource: String,
    texture: super::sensor_msgs::CompressedImage,
    uv_coordinates: Vec<UVCoordinate>,
    text: String,
    mesh_resource: String,
    mesh_file: MeshFile,
    mesh_use_embedded_materials: bool,
    ;
    const ARROW: i32 = 0;
    const CUBE: i32 = 1;
    const SPHERE: i32 = 2;
    const CYLINDER: i32 = 3;
    const LINE_STRIP: i32 = 4;
    const LINE_LIST: i32 = 5;
    const CUBE_LIST: i32 = 6;
    const SPHERE_LIST: i32 = 7;
    const POINTS: i32 = 8;
    const TEXT_VIEW_FACING: i32 = 9;
    const MESH_RESOURCE: i32 = 10;
    const TRIANGLE_LIST: i32 = 11;
    const ARROW_STRIP: i32 = 12;
    const ADD: i32 = 0;
    const MODIFY: i32 = 0;
    const DELETE: i32 = 2;
    const DELETEALL: i32 = 3;
}

super::message! {
    MarkerArray, "visualization_msgs/msg/MarkerArray", "ros.visualization.MarkerArray";
    markers: Vec<Marker>,
}

super::message! {
    MenuEntry, "visualization_msgs/msg/MenuEntry", "ros.visualization.MenuEntry";
    id: u32,
    parent_id: u32,
    title: String,
    command: String,
    command_type: u8,
    ;
    const FEEDBACK: u8 = 0;
    const ROSRUN: u8 = 1;
    const ROSLAUNCH: u8 = 2;
}

super::message! {
    MeshFile, "visualization_msgs/msg/MeshFile", "ros.visualization.MeshFile";
    filename: String,
    data: Vec<u8>,
}

super::message! {
    UVCoordinate, "visualization_msgs/msg/UVCoordinate", "ros.visualization.UVCoordinate";
    u: f32,
    v: f32,
}
