"""The messages of `nav2_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import builtin as _builtin
    from . import geometry as _geometry
    from ._standard import Message

    @dataclass(eq=False)
    class NavigateToPose_Goal(Message):
        """A message of the type `nav2_msgs/action/NavigateToPose_Goal`."""

        pose: _geometry.PoseStamped = field(default_factory=lambda: _geometry.PoseStamped())
        behavior_tree: str = ""

    @dataclass(eq=False)
    class NavigateToPose_Result(Message):
        """A message of the type `nav2_msgs/action/NavigateToPose_Result`."""

        NONE: ClassVar[int] = 0
        UNKNOWN: ClassVar[int] = 9000
        FAILED_TO_LOAD_BEHAVIOR_TREE: ClassVar[int] = 9001
        TF_ERROR: ClassVar[int] = 9002
        TIMEOUT: ClassVar[int] = 9003

        error_code: int = 0
        error_msg: str = ""

    @dataclass(eq=False)
    class NavigateToPose_Feedback(Message):
        """A message of the type `nav2_msgs/action/NavigateToPose_Feedback`."""

        current_pose: _geometry.PoseStamped = field(default_factory=lambda: _geometry.PoseStamped())
        navigation_time: _builtin.Duration = field(default_factory=lambda: _builtin.Duration())
        estimated_time_remaining: _builtin.Duration = field(default_factory=lambda: _builtin.Duration())
        number_of_recoveries: int = 0
        distance_remaining: float = 0.0

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
