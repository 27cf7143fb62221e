//! The messages of `geometry_msgs`, written by `tests/all/typed.rs`.

super::message! {
    Accel, "geometry_msgs/msg/Accel", "ros.geometry.Accel";
    linear: Vector3,
    angular: Vector3,
}

super::message! {
    AccelStamped, "geometry_msgs/msg/AccelStamped", "ros.geometry.AccelStamped";
    header: super::std_msgs::Header,
    accel: Accel,
}

super::message! {
    AccelWithCovariance, "geometry_msgs/msg/AccelWithCovariance", "ros.geometry.AccelWithCovariance";
    accel: Accel,
    covariance: [f64; 36],
}

super::message! {
    AccelWithCovarianceStamped, "geometry_msgs/msg/AccelWithCovarianceStamped", "ros.geometry.AccelWithCovarianceStamped";
    header: super::std_msgs::Header,
    accel: AccelWithCovariance,
}

super::message! {
    Inertia, "geometry_msgs/msg/Inertia", "ros.geometry.Inertia";
    m: f64,
    com: Vector3,
    ixx: f64,
    ixy: f64,
    ixz: f64,
    iyy: f64,
    iyz: f64,
    izz: f64,
}

super::message! {
    InertiaStamped, "geometry_msgs/msg/InertiaStamped", "ros.geometry.InertiaStamped";
    header: super::std_msgs::Header,
    inertia: Inertia,
}

super::message! {
    Point, "geometry_msgs/msg/Point", "ros.geometry.Point";
    x: f64,
    y: f64,
    z: f64,
}

super::message! {
    Point32, "geometry_msgs/msg/Point32", "ros.geometry.Point32";
    x: f32,
    y: f32,
    z: f32,
}

super::message! {
    PointStamped, "geometry_msgs/msg/PointStamped", "ros.geometry.PointStamped";
    header: super::std_msgs::Header,
    point: Point,
}

super::message! {
    Polygon, "geometry_msgs/msg/Polygon", "ros.geometry.Polygon";
    points: Vec<Point32>,
}

super::message! {
    PolygonInstance, "geometry_msgs/msg/PolygonInstance", "ros.geometry.PolygonInstance";
    polygon: Polygon,
    id: i64,
}

super::message! {
    PolygonInstanceStamped, "geometry_msgs/msg/PolygonInstanceStamped", "ros.geometry.PolygonInstanceStamped";
    header: super::std_msgs::Header,
    polygon: PolygonInstance,
}

super::message! {
    PolygonStamped, "geometry_msgs/msg/PolygonStamped", "ros.geometry.PolygonStamped";
    header: super::std_msgs::Header,
    polygon: Polygon,
}

super::message! {
    Pose, "geometry_msgs/msg/Pose", "ros.geometry.Pose";
    position: Point,
    orientation: Quaternion,
}

super::message! {
    Pose2D, "geometry_msgs/msg/Pose2D", "ros.geometry.Pose2D";
    x: f64,
    y: f64,
    theta: f64,
}

super::message! {
    PoseArray, "geometry_msgs/msg/PoseArray", "ros.geometry.PoseArray";
    header: super::std_msgs::Header,
    poses: Vec<Pose>,
}

super::message! {
    PoseStamped, "geometry_msgs/msg/PoseStamped", "ros.geometry.PoseStamped";
    header: super::std_msgs::Header,
    pose: Pose,
}

super::message! {
    PoseWithCovariance, "geometry_msgs/msg/PoseWithCovariance", "ros.geometry.PoseWithCovariance";
    pose: Pose,
    covariance: [f64; 36],
}

super::message! {
    PoseWithCovarianceStamped, "geometry_msgs/msg/PoseWithCovarianceStamped", "ros.geometry.PoseWithCovarianceStamped";
    header: super::std_msgs::Header,
    pose: PoseWithCovariance,
}

super::message! {
    Quaternion, "geometry_msgs/msg/Quaternion", "ros.geometry.Quaternion";
    x: f64,
    y: f64,
    z: f64,
    w: f64 = 1.0,
}

super::message! {
    QuaternionStamped, "geometry_msgs/msg/QuaternionStamped", "ros.geometry.QuaternionStamped";
    header: super::std_msgs::Header,
    quaternion: Quaternion,
}

super::message! {
    Transform, "geometry_msgs/msg/Transform", "ros.geometry.Transform";
    translation: Vector3,
    rotation: Quaternion,
}

super::message! {
    TransformStamped, "geometry_msgs/msg/TransformStamped", "ros.geometry.TransformStamped";
    header: super::std_msgs::Header,
    child_frame_id: String,
    transform: Transform,
}

super::message! {
    Twist, "geometry_msgs/msg/Twist", "ros.geometry.Twist";
    linear: Vector3,
    angular: Vector3,
}

super::message! {
    TwistStamped, "geometry_msgs/msg/TwistStamped", "ros.geometry.TwistStamped";
    header: super::std_msgs::Header,
    twist: Twist,
}

super::message! {
    TwistWithCovariance, "geometry_msgs/msg/TwistWithCovariance", "ros.geometry.TwistWithCovariance";
    twist: Twist,
    covariance: [f64; 36],
}

super::message! {
    TwistWithCovarianceStamped, "geometry_msgs/msg/TwistWithCovarianceStamped", "ros.geometry.TwistWithCovarianceStamped";
    header: super::std_msgs::Header,
    twist: TwistWithCovariance,
}

super::message! {
    Vector3, "geometry_msgs/msg/Vector3", "ros.geometry.Vector3";
    x: f64,
    y: f64,
    z: f64,
}

super::message! {
    Vector3Stamped, "geometry_msgs/msg/Vector3Stamped", "ros.geometry.Vector3Stamped";
    header: super::std_msgs::Header,
    vector: Vector3,
}

super::message! {
    VelocityStamped, "geometry_msgs/msg/VelocityStamped", "ros.geometry.VelocityStamped";
    header: super::std_msgs::Header,
    body_frame_id: String,
    reference_frame_id: String,
    velocity: Twist,
}

super::message! {
    Wrench, "geometry_msgs/msg/Wrench", "ros.geometry.Wrench";
    force: Vector3,
    torque: Vector3,
}

super::message! {
    WrenchStamped, "geometry_msgs/msg/WrenchStamped", "ros.geometry.WrenchStamped";
    header: super::std_msgs::Header,
    wrench: Wrench,
}
