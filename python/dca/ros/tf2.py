"""The messages of `tf2_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import geometry as _geometry
    from ._standard import Message

    @dataclass(eq=False)
    class TF2Error(Message):
        """A message of the type `tf2_msgs/msg/TF2Error`."""

        NO_ERROR: ClassVar[int] = 0
        LOOKUP_ERROR: ClassVar[int] = 1
        CONNECTIVITY_ERROR: ClassVar[int] = 2
        EXTRAPOLATION_ERROR: ClassVar[int] = 3
        INVALID_ARGUMENT_ERROR: ClassVar[int] = 4
        TIMEOUT_ERROR: ClassVar[int] = 5
        TRANSFORM_ERROR: ClassVar[int] = 6

        error: int = 0
        error_string: str = ""

    @dataclass(eq=False)
    class TFMessage(Message):
        """A message of the type `tf2_msgs/msg/TFMessage`."""

        transforms: list[_geometry.TransformStamped] = field(default_factory=list)

    @dataclass(eq=False)
    class FrameGraph_Request(Message):
        """A message of the type `tf2_msgs/srv/FrameGraph_Request`."""

    @dataclass(eq=False)
    class FrameGraph_Response(Message):
        """A message of the type `tf2_msgs/srv/FrameGraph_Response`."""

        frame_yaml: str = ""

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
