"""The messages of `nav_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import builtin as _builtin
    from . import geometry as _geometry
    from . import std as _std
    from ._standard import Message, Numbers

    @dataclass(eq=False)
    class Goals(Message):
        """A message of the type `nav_msgs/msg/Goals`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        goals: list[_geometry.PoseStamped] = field(default_factory=list)

    @dataclass(eq=False)
    class GridCells(Message):
        """A message of the type `nav_msgs/msg/GridCells`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        cell_width: float = 0.0
        cell_height: float = 0.0
        cells: list[_geometry.Point] = field(default_factory=list)

    @dataclass(eq=False)
    class MapMetaData(Message):
        """A message of the type `nav_msgs/msg/MapMetaData`."""

        map_load_time: _builtin.Time = field(default_factory=lambda: _builtin.Time())
        resolution: float = 0.0
        width: int = 0
        height: int = 0
        origin: _geometry.Pose = field(default_factory=lambda: _geometry.Pose())

    @dataclass(eq=False)
    class OccupancyGrid(Message):
        """A message of the type `nav_msgs/msg/OccupancyGrid`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        info: MapMetaData = field(default_factory=lambda: MapMetaData())
        data: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class Odometry(Message):
        """A message of the type `nav_msgs/msg/Odometry`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        child_frame_id: str = ""
        pose: _geometry.PoseWithCovariance = field(default_factory=lambda: _geometry.PoseWithCovariance())
        twist: _geometry.TwistWithCovariance = field(default_factory=lambda: _geometry.TwistWithCovariance())

    @dataclass(eq=False)
    class Path(Message):
        """A message of the type `nav_msgs/msg/Path`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        poses: list[_geometry.PoseStamped] = field(default_factory=list)

    @dataclass(eq=False)
    class GetMap_Request(Message):
        """A message of the type `nav_msgs/srv/GetMap_Request`."""

    @dataclass(eq=False)
    class GetMap_Response(Message):
        """A message of the type `nav_msgs/srv/GetMap_Response`."""

        map: OccupancyGrid = field(default_factory=lambda: OccupancyGrid())

    @dataclass(eq=False)
    class GetPlan_Request(Message):
        """A message of the type `nav_msgs/srv/GetPlan_Request`."""

        start: _geometry.PoseStamped = field(default_factory=lambda: _geometry.PoseStamped())
        goal: _geometry.PoseStamped = field(default_factory=lambda: _geometry.PoseStamped())
        tolerance: float = 0.0

    @dataclass(eq=False)
    class GetPlan_Response(Message):
        """A message of the type `nav_msgs/srv/GetPlan_Response`."""

        plan: Path = field(default_factory=lambda: Path())

    @dataclass(eq=False)
    class SetMap_Request(Message):
        """A message of the type `nav_msgs/srv/SetMap_Request`."""

        map: OccupancyGrid = field(default_factory=lambda: OccupancyGrid())
        initial_pose: _geometry.PoseWithCovarianceStamped = field(default_factory=lambda: _geometry.PoseWithCovarianceStamped())

    @dataclass(eq=False)
    class SetMap_Response(Message):
        """A message of the type `nav_msgs/srv/SetMap_Response`."""

        success: bool = False

    @dataclass(eq=False)
    class LoadMap_Request(Message):
        """A message of the type `nav_msgs/srv/LoadMap_Request`."""

        map_url: str = ""

    @dataclass(eq=False)
    class LoadMap_Response(Message):
        """A message of the type `nav_msgs/srv/LoadMap_Response`."""

        RESULT_SUCCESS: ClassVar[int] = 0
        RESULT_MAP_DOES_NOT_EXIST: ClassVar[int] = 1
        RESULT_INVALID_MAP_DATA: ClassVar[int] = 2
        RESULT_INVALID_MAP_METADATA: ClassVar[int] = 3
        RESULT_UNDEFINED_FAILURE: ClassVar[int] = 255

        map: OccupancyGrid = field(default_factory=lambda: OccupancyGrid())
        result: int = 0

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
