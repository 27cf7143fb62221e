//! The messages of `sensor_msgs`, written by `tests/all/typed.rs`.

super::message! {
    BatteryState, "sensor_msgs/msg/BatteryState", "ros.sensor.BatteryState";
    header: super::std_msgs::Header,
    voltage: f32,
    temperature: f32,
    current: f32,
    charge: f32,
    capacity: f32,
    design_capacity: f32,
    percentage: f32,
    power_supply_status: u8,
    power_supply_health: u8,
    power_supply_technology: u8,
    present: bool,
    cell_voltage: Vec<f32>,
    cell_temperature: Vec<f32>,
    location: String,
    serial_number: String,
    ;
    const POWER_SUPPLY_STATUS_UNKNOWN: u8 = 0;
    const POWER_SUPPLY_STATUS_CHARGING: u8 = 1;
    const POWER_SUPPLY_STATUS_DISCHARGING: u8 = 2;
    const POWER_SUPPLY_STATUS_NOT_CHARGING: u8 = 3;
    const POWER_SUPPLY_STATUS_FULL: u8 = 4;
    const POWER_SUPPLY_HEALTH_UNKNOWN: u8 = 0;
    const POWER_SUPPLY_HEALTH_GOOD: u8 = 1;
    const POWER_SUPPLY_HEALTH_OVERHEAT: u8 = 2;
    const POWER_SUPPLY_HEALTH_DEAD: u8 = 3;
    const POWER_SUPPLY_HEALTH_OVERVOLTAGE: u8 = 4;
    const POWER_SUPPLY_HEALTH_UNSPEC_FAILURE: u8 = 5;
    const POWER_SUPPLY_HEALTH_COLD: u8 = 6;
    const POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE: u8 = 7;
    const POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE: u8 = 8;
    const POWER_SUPPLY_TECHNOLOGY_UNKNOWN: u8 = 0;
    const POWER_SUPPLY_TECHNOLOGY_NIMH: u8 = 1;
    const POWER_SUPPLY_TECHNOLOGY_LION: u8 = 2;
    const POWER_SUPPLY_TECHNOLOGY_LIPO: u8 = 3;
    const POWER_SUPPLY_TECHNOLOGY_LIFE: u8 = 4;
    const POWER_SUPPLY_TECHNOLOGY_NICD: u8 = 5;
    const POWER_SUPPLY_TECHNOLOGY_LIMN: u8 = 6;
    const POWER_SUPPLY_TECHNOLOGY_TERNARY: u8 = 7;
    const POWER_SUPPLY_TECHNOLOGY_VRLA: u8 = 8;
}

super::message! {
    CameraInfo, "sensor_msgs/msg/CameraInfo", "ros.sensor.CameraInfo";
    header: super::std_msgs::Header,
    height: u32,
    width: u32,
    distortion_model: String,
    d: Vec<f64>,
    k: [f64; 9],
    r: [f64; 9],
    p: [f64; 12],
    binning_x: u32,
    binning_y: u32,
    roi: RegionOfInterest,
}

super::message! {
    ChannelFloat32, "sensor_msgs/msg/ChannelFloat32", "ros.sensor.ChannelFloat32";
    name: String,
    values: Vec<f32>,
}

super::message! {
    CompressedImage, "sensor_msgs/msg/CompressedImage", "ros.sensor.CompressedImage";
    header: super::std_msgs::Header,
    format: String,
    data: Vec<u8>,
}

super::message! {
    FluidPressure, "sensor_msgs/msg/FluidPressure", "ros.sensor.FluidPressure";
    header: super::std_msgs::Header,
    fluid_pressure: f64,
    variance: f64,
}

super::message! {
    Illuminance, "sensor_msgs/msg/Illuminance", "ros.sensor.Illuminance";
    header: super::std_msgs::Header,
    illuminance: f64,
    variance: f64,
}

super::message! {
    Image, "sensor_msgs/msg/Image", "ros.sensor.Image";
    header: super::std_msgs::Header,
    height: u32,
    width: u32,
    encoding: String,
    is_bigendian: u8,
    step: u32,
    data: Vec<u8>,
}

super::message! {
    Imu, "sensor_msgs/msg/Imu", "ros.sensor.Imu";
    header: super::std_msgs::Header,
    orientation: super::geometry_msgs::Quaternion,
    orientation_covariance: [f64; 9],
    angular_velocity: super::geometry_msgs::Vector3,
    angular_velocity_covariance: [f64; 9],
    linear_acceleration: super::geometry_msgs::Vector3,
    linear_acceleration_covariance: [f64; 9],
}

super::message! {
    JointState, "sensor_msgs/msg/JointState", "ros.sensor.JointState";
    header: super::std_msgs::Header,
    name: Vec<String>,
    position: Vec<f64>,
    velocity: Vec<f64>,
    effort: Vec<f64>,
}

super::message! {
    Joy, "sensor_msgs/msg/Joy", "ros.sensor.Joy";
    header: super::std_msgs::Header,
    axes: Vec<f32>,
    buttons: Vec<i32>,
}

super::message! {
    JoyFeedback, "sensor_msgs/msg/JoyFeedback", "ros.sensor.JoyFeedback";
    r#type: u8,
    id: u8,
    intensity: f32,
    ;
    const TYPE_LED: u8 = 0;
    const TYPE_RUMBLE: u8 = 1;
    const TYPE_BUZZER: u8 = 2;
}

super::message! {
    JoyFeedbackArray, "sensor_msgs/msg/JoyFeedbackArray", "ros.sensor.JoyFeedbackArray";
    array: Vec<JoyFeedback>,
}

super::message! {
    LaserEcho, "sensor_msgs/msg/LaserEcho", "ros.sensor.LaserEcho";
    echoes: Vec<f32>,
}

super::message! {
    LaserScan, "sensor_msgs/msg/LaserScan", "ros.sensor.LaserScan";
    header: super::std_msgs::Header,
    angle_min: f32,
    angle_max: f32,
    angle_increment: f32,
    time_increment: f32,
    scan_time: f32,
    range_min: f32,
    range_max: f32,
    ranges: Vec<f32>,
    intensities: Vec<f32>,
}

super::message! {
    MagneticField, "sensor_msgs/msg/MagneticField", "ros.sensor.MagneticField";
    header: super::std_msgs::Header,
    magnetic_field: super::geometry_msgs::Vector3,
    magnetic_field_covariance: [f64; 9],
}

super::message! {
    MultiDOFJointState, "sensor_msgs/msg/MultiDOFJointState", "ros.sensor.MultiDOFJointState";
    header: super::std_msgs::Header,
    joint_names: Vec<String>,
    transforms: Vec<super::geometry_msgs::Transform>,
    twist: Vec<super::geometry_msgs::Twist>,
    wrench: Vec<super::geometry_msgs::Wrench>,
}

super::message! {
    MultiEchoLaserScan, "sensor_msgs/msg/MultiEchoLaserScan", "ros.sensor.MultiEchoLaserScan";
    header: super::std_msgs::Header,
    angle_min: f32,
    angle_max: f32,
    angle_increment: f32,
    time_increment: f32,
    scan_time: f32,
    range_min: f32,
    range_max: f32,
    ranges: Vec<LaserEcho>,
    intensities: Vec<LaserEcho>,
}

super::message! {
    NavSatFix, "sensor_msgs/msg/NavSatFix", "ros.sensor.NavSatFix";
    header: super::std_msgs::Header,
    status: NavSatStatus,
    latitude: f64,
    longitude: f64,
    altitude: f64,
    position_covariance: [f64; 9],
    position_covariance_type: u8,
    ;
    const COVARIANCE_TYPE_UNKNOWN: u8 = 0;
    const COVARIANCE_TYPE_APPROXIMATED: u8 = 1;
    const COVARIANCE_TYPE_DIAGONAL_KNOWN: u8 = 2;
    const COVARIANCE_TYPE_KNOWN: u8 = 3;
}

super::message! {
    NavSatStatus, "sensor_msgs/msg/NavSatStatus", "ros.sensor.NavSatStatus";
    status: i8,
    service: u16,
    ;
    const STATUS_UNKNOWN: i8 = -2;
    const STATUS_NO_FIX: i8 = -1;
    const STATUS_FIX: i8 = 0;
    const STATUS_SBAS_FIX: i8 = 1;
    const STATUS_GBAS_FIX: i8 = 2;
    const SERVICE_UNKNOWN: u16 = 0;
    const SERVICE_GPS: u16 = 1;
    const SERVICE_GLONASS: u16 = 2;
    const SERVICE_COMPASS: u16 = 4;
    const SERVICE_GALILEO: u16 = 8;
}

super::message! {
    PointCloud, "sensor_msgs/msg/PointCloud", "ros.sensor.PointCloud";
    header: super::std_msgs::Header,
    points: Vec<super::geometry_msgs::Point32>,
    channels: Vec<ChannelFloat32>,
}

super::message! {
    PointCloud2, "sensor_msgs/msg/PointCloud2", "ros.sensor.PointCloud2";
    header: super::std_msgs::Header,
    height: u32,
    width: u32,
    fields: Vec<PointField>,
    is_bigendian: bool,
    point_step: u32,
    row_step: u32,
    data: Vec<u8>,
    is_dense: bool,
}

super::message! {
    PointField, "sensor_msgs/msg/PointField", "ros.sensor.PointField";
    name: String,
    offset: u32,
    datatype: u8,
    count: u32,
    ;
    const INT8: u8 = 1;
    const UINT8: u8 = 2;
    const INT16: u8 = 3;
    const UINT16: u8 = 4;
    const INT32: u8 = 5;
    const UINT32: u8 = 6;
    const FLOAT32: u8 = 7;
    const FLOAT64: u8 = 8;
}

super::message! {
    Range, "sensor_msgs/msg/Range", "ros.sensor.Range";
    header: super::std_msgs::Header,
    radiation_type: u8,
    field_of_view: f32,
    min_range: f32,
    max_range: f32,
    range: f32,
    variance: f32,
    ;
    const ULTRASOUND: u8 = 0;
    const INFRARED: u8 = 1;
}

super::message! {
    RegionOfInterest, "sensor_msgs/msg/RegionOfInterest", "ros.sensor.RegionOfInterest";
    x_offset: u32,
    y_offset: u32,
    height: u32,
    width: u32,
    do_rectify: bool,
}

super::message! {
    RelativeHumidity, "sensor_msgs/msg/RelativeHumidity", "ros.sensor.RelativeHumidity";
    header: super::std_msgs::Header,
    relative_humidity: f64,
    variance: f64,
}

super::message! {
    Temperature, "sensor_msgs/msg/Temperature", "ros.sensor.Temperature";
    header: super::std_msgs::Header,
    temperature: f64,
    variance: f64,
}

super::message! {
    TimeReference, "sensor_msgs/msg/TimeReference", "ros.sensor.TimeReference";
    header: super::std_msgs::Header,
    time_ref: super::builtin_interfaces::Time,
    source: String,
}

super::message! {
    SetCameraInfoRequest, "sensor_msgs/srv/SetCameraInfo_Request", "ros.sensor.SetCameraInfo_Request";
    camera_info: CameraInfo,
}

super::message! {
    SetCameraInfoResponse, "sensor_msgs/srv/SetCameraInfo_Response", "ros.sensor.SetCameraInfo_Response";
    success: bool,
    status_message: String,
}
