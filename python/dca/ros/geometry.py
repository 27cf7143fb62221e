"""The messages of `geometry_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field

    from . import std as _std
    from ._standard import Message, Numbers

    @dataclass(eq=False)
    class Vector3(Message):
        """A message of the type `geometry_msgs/msg/Vector3`."""

        x: float = 0.0
        y: float = 0.0
        z: float = 0.0

    @dataclass(eq=False)
    class Accel(Message):
        """A message of the type `geometry_msgs/msg/Accel`."""

        linear: Vector3 = field(default_factory=lambda: Vector3())
        angular: Vector3 = field(default_factory=lambda: Vector3())

    @dataclass(eq=False)
    class AccelStamped(Message):
        """A message of the type `geometry_msgs/msg/AccelStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        accel: Accel = field(default_factory=lambda: Accel())

    @dataclass(eq=False)
    class AccelWithCovariance(Message):
        """A message of the type `geometry_msgs/msg/AccelWithCovariance`."""

        accel: Accel = field(default_factory=lambda: Accel())
        covariance: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class AccelWithCovarianceStamped(Message):
        """A message of the type `geometry_msgs/msg/AccelWithCovarianceStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        accel: AccelWithCovariance = field(default_factory=lambda: AccelWithCovariance())

    @dataclass(eq=False)
    class Inertia(Message):
        """A message of the type `geometry_msgs/msg/Inertia`."""

        m: float = 0.0
        com: Vector3 = field(default_factory=lambda: Vector3())
        ixx: float = 0.0
        ixy: float = 0.0
        ixz: float = 0.0
        iyy: float = 0.0
        iyz: float = 0.0
        izz: float = 0.0

    @dataclass(eq=False)
    class InertiaStamped(Message):
        """A message of the type `geometry_msgs/msg/InertiaStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        inertia: Inertia = field(default_factory=lambda: Inertia())

    @dataclass(eq=False)
    class Point(Message):
        """A message of the type `geometry_msgs/msg/Point`."""

        x: float = 0.0
        y: float = 0.0
        z: float = 0.0

    @dataclass(eq=False)
    class Point32(Message):
        """A message of the type `geometry_msgs/msg/Point32`."""

        x: float = 0.0
        y: float = 0.0
        z: float = 0.0

    @dataclass(eq=False)
    class PointStamped(Message):
        """A message of the type `geometry_msgs/msg/PointStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        point: Point = field(default_factory=lambda: Point())

    @dataclass(eq=False)
    class Polygon(Message):
        """A message of the type `geometry_msgs/msg/Polygon`."""

        points: list[Point32] = field(default_factory=list)

    @dataclass(eq=False)
    class PolygonInstance(Message):
        """A message of the type `geometry_msgs/msg/PolygonInstance`."""

        polygon: Polygon = field(default_factory=lambda: Polygon())
        id: int = 0

    @dataclass(eq=False)
    class PolygonInstanceStamped(Message):
        """A message of the type `geometry_msgs/msg/PolygonInstanceStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        polygon: PolygonInstance = field(default_factory=lambda: PolygonInstance())

    @dataclass(eq=False)
    class PolygonStamped(Message):
        """A message of the type `geometry_msgs/msg/PolygonStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        polygon: Polygon = field(default_factory=lambda: Polygon())

    @dataclass(eq=False)
    class Quaternion(Message):
        """A message of the type `geometry_msgs/msg/Quaternion`."""

        x: float = 0.0
        y: float = 0.0
        z: float = 0.0
        w: float = 1.0

    @dataclass(eq=False)
    class Pose(Message):
        """A message of the type `geometry_msgs/msg/Pose`."""

        position: Point = field(default_factory=lambda: Point())
        orientation: Quaternion = field(default_factory=lambda: Quaternion())

    @dataclass(eq=False)
    class Pose2D(Message):
        """A message of the type `geometry_msgs/msg/Pose2D`."""

        x: float = 0.0
        y: float = 0.0
        theta: float = 0.0

    @dataclass(eq=False)
    class PoseArray(Message):
        """A message of the type `geometry_msgs/msg/PoseArray`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        poses: list[Pose] = field(default_factory=list)

    @dataclass(eq=False)
    class PoseStamped(Message):
        """A message of the type `geometry_msgs/msg/PoseStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        pose: Pose = field(default_factory=lambda: Pose())

    @dataclass(eq=False)
    class PoseWithCovariance(Message):
        """A message of the type `geometry_msgs/msg/PoseWithCovariance`."""

        pose: Pose = field(default_factory=lambda: Pose())
        covariance: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class PoseWithCovarianceStamped(Message):
        """A message of the type `geometry_msgs/msg/PoseWithCovarianceStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        pose: PoseWithCovariance = field(default_factory=lambda: PoseWithCovariance())

    @dataclass(eq=False)
    class QuaternionStamped(Message):
        """A message of the type `geometry_msgs/msg/QuaternionStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        quaternion: Quaternion = field(default_factory=lambda: Quaternion())

    @dataclass(eq=False)
    class Transform(Message):
        """A message of the type `geometry_msgs/msg/Transform`."""

        translation: Vector3 = field(default_factory=lambda: Vector3())
        rotation: Quaternion = field(default_factory=lambda: Quaternion())

    @dataclass(eq=False)
    class TransformStamped(Message):
        """A message of the type `geometry_msgs/msg/TransformStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        child_frame_id: str = ""
        transform: Transform = field(default_factory=lambda: Transform())

    @dataclass(eq=False)
    class Twist(Message):
        """A message of the type `geometry_msgs/msg/Twist`."""

        linear: Vector3 = field(default_factory=lambda: Vector3())
        angular: Vector3 = field(default_factory=lambda: Vector3())

    @dataclass(eq=False)
    class TwistStamped(Message):
        """A message of the type `geometry_msgs/msg/TwistStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        twist: Twist = field(default_factory=lambda: Twist())

    @dataclass(eq=False)
    class TwistWithCovariance(Message):
        """A message of the type `geometry_msgs/msg/TwistWithCovariance`."""

        twist: Twist = field(default_factory=lambda: Twist())
        covariance: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class TwistWithCovarianceStamped(Message):
        """A message of the type `geometry_msgs/msg/TwistWithCovarianceStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        twist: TwistWithCovariance = field(default_factory=lambda: TwistWithCovariance())

    @dataclass(eq=False)
    class Vector3Stamped(Message):
        """A message of the type `geometry_msgs/msg/Vector3Stamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        vector: Vector3 = field(default_factory=lambda: Vector3())

    @dataclass(eq=False)
    class VelocityStamped(Message):
        """A message of the type `geometry_msgs/msg/VelocityStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        body_frame_id: str = ""
        reference_frame_id: str = ""
        velocity: Twist = field(default_factory=lambda: Twist())

    @dataclass(eq=False)
    class Wrench(Message):
        """A message of the type `geometry_msgs/msg/Wrench`."""

        force: Vector3 = field(default_factory=lambda: Vector3())
        torque: Vector3 = field(default_factory=lambda: Vector3())

    @dataclass(eq=False)
    class WrenchStamped(Message):
        """A message of the type `geometry_msgs/msg/WrenchStamped`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        wrench: Wrench = field(default_factory=lambda: Wrench())

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
