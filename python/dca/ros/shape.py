"""The messages of `shape_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import geometry as _geometry
    from ._standard import Message, Numbers

    @dataclass(eq=False)
    class MeshTriangle(Message):
        """A message of the type `shape_msgs/msg/MeshTriangle`."""

        vertex_indices: Numbers[int] = Numbers[int]()

    @dataclass(eq=False)
    class Mesh(Message):
        """A message of the type `shape_msgs/msg/Mesh`."""

        triangles: list[MeshTriangle] = field(default_factory=list)
        vertices: list[_geometry.Point] = field(default_factory=list)

    @dataclass(eq=False)
    class Plane(Message):
        """A message of the type `shape_msgs/msg/Plane`."""

        coef: Numbers[float] = Numbers[float]()

    @dataclass(eq=False)
    class SolidPrimitive(Message):
        """A message of the type `shape_msgs/msg/SolidPrimitive`."""

        BOX: ClassVar[int] = 1
        SPHERE: ClassVar[int] = 2
        CYLINDER: ClassVar[int] = 3
        CONE: ClassVar[int] = 4
        PRISM: ClassVar[int] = 5
        BOX_X: ClassVar[int] = 0
        BOX_Y: ClassVar[int] = 1
        BOX_Z: ClassVar[int] = 2
        SPHERE_RADIUS: ClassVar[int] = 0
        CYLINDER_HEIGHT: ClassVar[int] = 0
        CYLINDER_RADIUS: ClassVar[int] = 1
        CONE_HEIGHT: ClassVar[int] = 0
        CONE_RADIUS: ClassVar[int] = 1
        PRISM_HEIGHT: ClassVar[int] = 0

        type: int = 0
        dimensions: Numbers[float] = Numbers[float]()
        polygon: _geometry.Polygon = field(default_factory=lambda: _geometry.Polygon())

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
