"""The messages of `sensor_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import builtin as _builtin
    from . import geometry as _geometry
    from . import std as _std
    from ._standard import Message, Numbers, Octets

    @dataclass(eq=False)
    class BatteryState(Message):
        """A message of the type `sensor_msgs/msg/BatteryState`."""

        POWER_SUPPLY_STATUS_UNKNOWN: ClassVar[int] = 0
        POWER_SUPPLY_STATUS_CHARGING: ClassVar[int] = 1
        POWER_SUPPLY_STATUS_DISCHARGING: ClassVar[int] = 2
        POWER_SUPPLY_STATUS_NOT_CHARGING: ClassVar[int] = 3
        POWER_SUPPLY_STATUS_FULL: ClassVar[int] = 4
        POWER_SUPPLY_HEALTH_UNKNOWN: ClassVar[int] = 0
        POWER_SUPPLY_HEALTH_GOOD: ClassVar[int] = 1
        POWER_SUPPLY_HEALTH_OVERHEAT: ClassVar[int] = 2
        POWER_SUPPLY_HEALTH_DEAD: ClassVar[int] = 3
        POWER_SUPPLY_HEALTH_OVERVOLTAGE: ClassVar[int] = 4
        POWER_SUPPLY_HEALTH_UNSPEC_FAILURE: ClassVar[int] = 5
        POWER_SUPPLY_HEALTH_COLD: ClassVar[int] = 6
        POWER_SUPPLY_HEALTH_WATCHDOG_TIMER_EXPIRE: ClassVar[int] = 7
        POWER_SUPPLY_HEALTH_SAFETY_TIMER_EXPIRE: ClassVar[int] = 8
        POWER_SUPPLY_TECHNOLOGY_UNKNOWN: ClassVar[int] = 0
        POWER_SUPPLY_TECHNOLOGY_NIMH: ClassVar[int] = 1
        POWER_SUPPLY_TECHNOLOGY_LION: ClassVar[int] = 2
        POWER_SUPPLY_TECHNOLOGY_LIPO: ClassVar[int] = 3
        POWER_SUPPLY_TECHNOLOGY_LIFE: ClassVar[int] = 4
        POWER_SUPPLY_TECHNOLOGY_NICD: ClassVar[int] = 5
        POWER_SUPPLY_TECHNOLOGY_LIMN: ClassVar[int] = 6
        POWER_SUPPLY_TECHNOLOGY_TERNARY: ClassVar[int] = 7
        POWER_SUPPLY_TECHNOLOGY_VRLA: ClassVar[int] = 8

        header: _std.Header = field(default_factory=lambda: _std.Header())
        voltage: float = 0.0
        temperature: float = 0.0
        current: float = 0.0
        charge: float = 0.0
        capacity: float = 0.0
        design_capacity: float = 0.0
        percentage: float = 0.0
        power_supply_status: int = 0
        power_supply_health: int = 0
        power_supply_technology: int = 0
        present: bool = False
        cell_voltage: Numbers[float] = Numbers[float]()
        cell_temperature: Numbers[float] = Numbers[float]()
        location: str = ""
        serial_number: str = ""

    @dataclass(eq=False)
    class RegionOfInterest(Message):
        """A message of the type `sensor_msgs/msg/RegionOfInterest`."""

        x_offset: int = 0
        y_offset: int = 0
        height: int = 0
        width: int = 0
        do_rectify: bool = False

    @dataclass(eq=False)
    class CameraInfo(Message):
        """A message of the type `sensor_msgs/msg/CameraInfo`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        height: int = 0
        width: int = 0
        distortion_model: str = ""
        d: Numbers[float] = Numbers[float]()
        k: Numbers[float] = Numbers[float]()
        r: Numbers[float] = Numbers[float]()
        p: Numbers[float] = Numbers[float]()
        binning_x: int = 0
        binning_y: int = 0
        roi: RegionOfInterest = field(default_factory=lambda: RegionOfInterest())

    @dataclass(eq=False)
    class ChannelFloat32(Message):
        """A message of the type `sensor_msgs/msg/ChannelFloat32`."""

        name: str = ""
        values: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class CompressedImage(Message):
        """A message of the type `sensor_msgs/msg/CompressedImage`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        format: str = ""
        data: Octets = Octets()

    @dataclass(eq=False)
    class FluidPressure(Message):
        """A message of the type `sensor_msgs/msg/FluidPressure`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        fluid_pressure: float = 0.0
        variance: float = 0.0

    @dataclass(eq=False)
    class Illuminance(Message):
        """A message of the type `sensor_msgs/msg/Illuminance`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        illuminance: float = 0.0
        variance: float = 0.0

    @dataclass(eq=False)
    class Image(Message):
        """A message of the type `sensor_msgs/msg/Image`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        height: int = 0
        width: int = 0
        encoding: str = ""
        is_bigendian: int = 0
        step: int = 0
        data: Octets = Octets()

    @dataclass(eq=False)
    class Imu(Message):
        """A message of the type `sensor_msgs/msg/Imu`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        orientation: _geometry.Quaternion = field(default_factory=lambda: _geometry.Quaternion())
        orientation_covariance: Numbers[float] = Numbers[float]()
        angular_velocity: _geometry.Vector3 = field(default_factory=lambda: _geometry.Vector3())
        angular_velocity_covariance: Numbers[float] = Numbers[float]()
        linear_acceleration: _geometry.Vector3 = field(default_factory=lambda: _geometry.Vector3())
        linear_acceleration_covariance: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class JointState(Message):
        """A message of the type `sensor_msgs/msg/JointState`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        name: list[str] = field(default_factory=list)
        position: Numbers[float] = Numbers[float]()
        velocity: Numbers[float] = Numbers[float]()
        effort: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class Joy(Message):
        """A message of the type `sensor_msgs/msg/Joy`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        axes: Numbers[float] = Numbers[float]()
        buttons: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class JoyFeedback(Message):
        """A message of the type `sensor_msgs/msg/JoyFeedback`."""

        TYPE_LED: ClassVar[int] = 0
        TYPE_RUMBLE: ClassVar[int] = 1
        TYPE_BUZZER: ClassVar[int] = 2

        type: int = 0
        id: int = 0
        intensity: float = 0.0

    @dataclass(eq=False)
    class JoyFeedbackArray(Message):
        """A message of the type `sensor_msgs/msg/JoyFeedbackArray`."""

        array: list[JoyFeedback] = field(default_factory=list)

    @dataclass(eq=False)
    class LaserEcho(Message):
        """A message of the type `sensor_msgs/msg/LaserEcho`."""

        echoes: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class LaserScan(Message):
        """A message of the type `sensor_msgs/msg/LaserScan`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        angle_min: float = 0.0
        angle_max: float = 0.0
        angle_increment: float = 0.0
        time_increment: float = 0.0
        scan_time: float = 0.0
        range_min: float = 0.0
        range_max: float = 0.0
        ranges: Numbers[float] = Numbers[float]()
        intensities: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class MagneticField(Message):
        """A message of the type `sensor_msgs/msg/MagneticField`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        magnetic_field: _geometry.Vector3 = field(default_factory=lambda: _geometry.Vector3())
        magnetic_field_covariance: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class MultiDOFJointState(Message):
        """A message of the type `sensor_msgs/msg/MultiDOFJointState`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        joint_names: list[str] = field(default_factory=list)
        transforms: list[_geometry.Transform] = field(default_factory=list)
        twist: list[_geometry.Twist] = field(default_factory=list)
        wrench: list[_geometry.Wrench] = field(default_factory=list)

    @dataclass(eq=False)
    class MultiEchoLaserScan(Message):
        """A message of the type `sensor_msgs/msg/MultiEchoLaserScan`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        angle_min: float = 0.0
        angle_max: float = 0.0
        angle_increment: float = 0.0
        time_increment: float = 0.0
        scan_time: float = 0.0
        range_min: float = 0.0
        range_max: float = 0.0
        ranges: list[LaserEcho] = field(default_factory=list)
        intensities: list[LaserEcho] = field(default_factory=list)

    @dataclass(eq=False)
    class NavSatStatus(Message):
        """A message of the type `sensor_msgs/msg/NavSatStatus`."""

        STATUS_UNKNOWN: ClassVar[int] = -2
        STATUS_NO_FIX: ClassVar[int] = -1
        STATUS_FIX: ClassVar[int] = 0
        STATUS_SBAS_FIX: ClassVar[int] = 1
        STATUS_GBAS_FIX: ClassVar[int] = 2
        SERVICE_UNKNOWN: ClassVar[int] = 0
        SERVICE_GPS: ClassVar[int] = 1
        SERVICE_GLONASS: ClassVar[int] = 2
        SERVICE_COMPASS: ClassVar[int] = 4
        SERVICE_GALILEO: ClassVar[int] = 8

        status: int = 0
        service: int = 0

    @dataclass(eq=False)
    class NavSatFix(Message):
        """A message of the type `sensor_msgs/msg/NavSatFix`."""

        COVARIANCE_TYPE_UNKNOWN: ClassVar[int] = 0
        COVARIANCE_TYPE_APPROXIMATED: ClassVar[int] = 1
        COVARIANCE_TYPE_DIAGONAL_KNOWN: ClassVar[int] = 2
        COVARIANCE_TYPE_KNOWN: ClassVar[int] = 3

        header: _std.Header = field(default_factory=lambda: _std.Header())
        status: NavSatStatus = field(default_factory=lambda: NavSatStatus())
        latitude: float = 0.0
        longitude: float = 0.0
        altitude: float = 0.0
        position_covariance: Numbers[float] = Numbers[float]()
        position_covariance_type: int = 0

    @dataclass(eq=False)
    class PointCloud(Message):
        """A message of the type `sensor_msgs/msg/PointCloud`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        points: list[_geometry.Point32] = field(default_factory=list)
        channels: list[ChannelFloat32] = field(default_factory=list)

    @dataclass(eq=False)
    class PointField(Message):
        """A message of the type `sensor_msgs/msg/PointField`."""

        INT8: ClassVar[int] = 1
        UINT8: ClassVar[int] = 2
        INT16: ClassVar[int] = 3
        UINT16: ClassVar[int] = 4
        INT32: ClassVar[int] = 5
        UINT32: ClassVar[int] = 6
        FLOAT32: ClassVar[int] = 7
        FLOAT64: ClassVar[int] = 8

        name: str = ""
        offset: int = 0
        datatype: int = 0
        count: int = 0

    @dataclass(eq=False)
    class PointCloud2(Message):
        """A message of the type `sensor_msgs/msg/PointCloud2`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        height: int = 0
        width: int = 0
        fields: list[PointField] = field(default_factory=list)
        is_bigendian: bool = False
        point_step: int = 0
        row_step: int = 0
        data: Octets = Octets()
        is_dense: bool = False

    @dataclass(eq=False)
    class Range(Message):
        """A message of the type `sensor_msgs/msg/Range`."""

        ULTRASOUND: ClassVar[int] = 0
        INFRARED: ClassVar[int] = 1

        header: _std.Header = field(default_factory=lambda: _std.Header())
        radiation_type: int = 0
        field_of_view: float = 0.0
        min_range: float = 0.0
        max_range: float = 0.0
        range: float = 0.0
        variance: float = 0.0

    @dataclass(eq=False)
    class RelativeHumidity(Message):
        """A message of the type `sensor_msgs/msg/RelativeHumidity`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        relative_humidity: float = 0.0
        variance: float = 0.0

    @dataclass(eq=False)
    class Temperature(Message):
        """A message of the type `sensor_msgs/msg/Temperature`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        temperature: float = 0.0
        variance: float = 0.0

    @dataclass(eq=False)
    class TimeReference(Message):
        """A message of the type `sensor_msgs/msg/TimeReference`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        time_ref: _builtin.Time = field(default_factory=lambda: _builtin.Time())
        source: str = ""

    @dataclass(eq=False)
    class SetCameraInfo_Request(Message):
        """A message of the type `sensor_msgs/srv/SetCameraInfo_Request`."""

        camera_info: CameraInfo = field(default_factory=lambda: CameraInfo())

    @dataclass(eq=False)
    class SetCameraInfo_Response(Message):
        """A message of the type `sensor_msgs/srv/SetCameraInfo_Response`."""

        success: bool = False
        status_message: str = ""

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
