"""The messages of `visualization_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import builtin as _builtin
    from . import geometry as _geometry
    from . import sensor as _sensor
    from . import std as _std
    from ._standard import Message, Octets

    @dataclass(eq=False)
    class ImageMarker(Message):
        """A message of the type `visualization_msgs/msg/ImageMarker`."""

        CIRCLE: ClassVar[int] = 0
        LINE_STRIP: ClassVar[int] = 1
        LINE_LIST: ClassVar[int] = 2
        POLYGON: ClassVar[int] = 3
        POINTS: ClassVar[int] = 4
        ADD: ClassVar[int] = 0
        REMOVE: ClassVar[int] = 1

        header: _std.Header = field(default_factory=lambda: _std.Header())
        ns: str = ""
        id: int = 0
        type: int = 0
        action: int = 0
        position: _geometry.Point = field(default_factory=lambda: _geometry.Point())
        scale: float = 0.0
        outline_color: _std.ColorRGBA = field(default_factory=lambda: _std.ColorRGBA())
        filled: int = 0
        fill_color: _std.ColorRGBA = field(default_factory=lambda: _std.ColorRGBA())
        lifetime: _builtin.Duration = field(default_factory=lambda: _builtin.Duration())
        points: list[_geometry.Point] = field(default_factory=list)
        outline_colors: list[_std.ColorRGBA] = field(default_factory=list)

    @dataclass(eq=False)
    class MenuEntry(Message):
        """A message of the type `visualization_msgs/msg/MenuEntry`."""

        FEEDBACK: ClassVar[int] = 0
        ROSRUN: ClassVar[int] = 1
        ROSLAUNCH: ClassVar[int] = 2

        id: int = 0
        parent_id: int = 0
        title: str = ""
        command: str = ""
        command_type: int = 0

    @dataclass(eq=False)
    class UVCoordinate(Message):
        """A message of the type `visualization_msgs/msg/UVCoordinate`."""

        u: float = 0.0
        v: float = 0.0

    @dataclass(eq=False)
    class MeshFile(Message):
        """A message of the type `visualization_msgs/msg/MeshFile`."""

        filename: str = ""
        data: Octets = Octets()

    @dataclass(eq=False)
    class Marker(Message):
        """A message of the type `visualization_msgs/msg/Marker`."""

        ARROW: ClassVar[int] = 0
        CUBE: ClassVar[int] = 1
        SPHERE: ClassVar[int] = 2
        CYLINDER: ClassVar[int] = 3
        LINE_STRIP: ClassVar[int] = 4
        LINE_LIST: ClassVar[int] = 5
        CUBE_LIST: ClassVar[int] = 6
        SPHERE_LIST: ClassVar[int] = 7
        POINTS: ClassVar[int] = 8
        TEXT_VIEW_FACING: ClassVar[int] = 9
        MESH_RESOURCE: ClassVar[int] = 10
        TRIANGLE_LIST: ClassVar[int] = 11
        ARROW_STRIP: ClassVar[int] = 12
        ADD: ClassVar[int] = 0
        MODIFY: ClassVar[int] = 0
        DELETE: ClassVar[int] = 2
        DELETEALL: ClassVar[int] = 3

        header: _std.Header = field(default_factory=lambda: _std.Header())
        ns: str = ""
        id: int = 0
        type: int = 0
        action: int = 0
        pose: _geometry.Pose = field(default_factory=lambda: _geometry.Pose())
        scale: _geometry.Vector3 = field(default_factory=lambda: _geometry.Vector3())
        color: _std.ColorRGBA = field(default_factory=lambda: _std.ColorRGBA())
        lifetime: _builtin.Duration = field(default_factory=lambda: _builtin.Duration())
        frame_locked: bool = False
        points: list[_geometry.Point] = field(default_factory=list)
        colors: list[_std.ColorRGBA] = field(default_factory=list)
        texture_resource: str = ""
        texture: _sensor.CompressedImage = field(default_factory=lambda: _sensor.CompressedImage())
        uv_coordinates: list[UVCoordinate] = field(default_factory=list)
        text: str = ""
        mesh_resource: str = ""
        mesh_file: MeshFile = field(default_factory=lambda: MeshFile())
        mesh_use_embedded_materials: bool = False

    @dataclass(eq=False)
    class InteractiveMarkerControl(Message):
        """A message of the type `visualization_msgs/msg/InteractiveMarkerControl`."""

        INHERIT: ClassVar[int] = 0
        FIXED: ClassVar[int] = 1
        VIEW_FACING: ClassVar[int] = 2
        NONE: ClassVar[int] = 0
        MENU: ClassVar[int] = 1
        BUTTON: ClassVar[int] = 2
        MOVE_AXIS: ClassVar[int] = 3
        MOVE_PLANE: ClassVar[int] = 4
        ROTATE_AXIS: ClassVar[int] = 5
        MOVE_ROTATE: ClassVar[int] = 6
        MOVE_3D: ClassVar[int] = 7
        ROTATE_3D: ClassVar[int] = 8
        MOVE_ROTATE_3D: ClassVar[int] = 9

        name: str = ""
        orientation: _geometry.Quaternion = field(default_factory=lambda: _geometry.Quaternion())
        orientation_mode: int = 0
        interaction_mode: int = 0
        always_visible: bool = False
        markers: list[Marker] = field(default_factory=list)
        independent_marker_orientation: bool = False
        description: str = ""

    @dataclass(eq=False)
    class InteractiveMarker(Message):
        """A message of the type `visualization_msgs/msg/InteractiveMarker`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        pose: _geometry.Pose = field(default_factory=lambda: _geometry.Pose())
        name: str = ""
        description: str = ""
        scale: float = 0.0
        menu_entries: list[MenuEntry] = field(default_factory=list)
        controls: list[InteractiveMarkerControl] = field(default_factory=list)

    @dataclass(eq=False)
    class InteractiveMarkerFeedback(Message):
        """A message of the type `visualization_msgs/msg/InteractiveMarkerFeedback`."""

        KEEP_ALIVE: ClassVar[int] = 0
        POSE_UPDATE: ClassVar[int] = 1
        MENU_SELECT: ClassVar[int] = 2
        BUTTON_CLICK: ClassVar[int] = 3
        MOUSE_DOWN: ClassVar[int] = 4
        MOUSE_UP: ClassVar[int] = 5

        header: _std.Header = field(default_factory=lambda: _std.Header())
        client_id: str = ""
        marker_name: str = ""
        control_name: str = ""
        event_type: int = 0
        pose: _geometry.Pose = field(default_factory=lambda: _geometry.Pose())
        menu_entry_id: int = 0
        mouse_point: _geometry.Point = field(default_factory=lambda: _geometry.Point())
        mouse_point_valid: bool = False

    @dataclass(eq=False)
    class InteractiveMarkerInit(Message):
        """A message of the type `visualization_msgs/msg/InteractiveMarkerInit`."""

        server_id: str = ""
        seq_num: int = 0
        markers: list[InteractiveMarker] = field(default_factory=list)

    @dataclass(eq=False)
    class InteractiveMarkerPose(Message):
        """A message of the type `visualization_msgs/msg/InteractiveMarkerPose`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        pose: _geometry.Pose = field(default_factory=lambda: _geometry.Pose())
        name: str = ""

    @dataclass(eq=False)
    class InteractiveMarkerUpdate(Message):
        """A message of the type `visualization_msgs/msg/InteractiveMarkerUpdate`."""

        KEEP_ALIVE: ClassVar[int] = 0
        UPDATE: ClassVar[int] = 1

        server_id: str = ""
        seq_num: int = 0
        type: int = 0
        markers: list[InteractiveMarker] = field(default_factory=list)
        poses: list[InteractiveMarkerPose] = field(default_factory=list)
        erases: list[str] = field(default_factory=list)

    @dataclass(eq=False)
    class MarkerArray(Message):
        """A message of the type `visualization_msgs/msg/MarkerArray`."""

        markers: list[Marker] = field(default_factory=list)

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
