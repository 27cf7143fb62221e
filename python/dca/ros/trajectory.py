"""The messages of `trajectory_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field

    from . import builtin as _builtin
    from . import geometry as _geometry
    from . import std as _std
    from ._standard import Message, Numbers

    @dataclass(eq=False)
    class JointTrajectoryPoint(Message):
        """A message of the type `trajectory_msgs/msg/JointTrajectoryPoint`."""

        positions: Numbers[float] = Numbers[float]()
        velocities: Numbers[float] = Numbers[float]()
        accelerations: Numbers[float] = Numbers[float]()
        effort: Numbers[float] = Numbers[float]()
        time_from_start: _builtin.Duration = field(default_factory=lambda: _builtin.Duration())

    @dataclass(eq=False)
    class JointTrajectory(Message):
        """A message of the type `trajectory_msgs/msg/JointTrajectory`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        joint_names: list[str] = field(default_factory=list)
        points: list[JointTrajectoryPoint] = field(default_factory=list)

    @dataclass(eq=False)
    class MultiDOFJointTrajectoryPoint(Message):
        """A message of the type `trajectory_msgs/msg/MultiDOFJointTrajectoryPoint`."""

        transforms: list[_geometry.Transform] = field(default_factory=list)
        velocities: list[_geometry.Twist] = field(default_factory=list)
        accelerations: list[_geometry.Twist] = field(default_factory=list)
        time_from_start: _builtin.Duration = field(default_factory=lambda: _builtin.Duration())

    @dataclass(eq=False)
    class MultiDOFJointTrajectory(Message):
        """A message of the type `trajectory_msgs/msg/MultiDOFJointTrajectory`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        joint_names: list[str] = field(default_factory=list)
        points: list[MultiDOFJointTrajectoryPoint] = field(default_factory=list)

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
