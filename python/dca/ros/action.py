"""The messages of `action_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import builtin as _builtin
    from . import unique_identifier as _unique_identifier
    from ._standard import Message

    @dataclass(eq=False)
    class GoalInfo(Message):
        """A message of the type `action_msgs/msg/GoalInfo`."""

        goal_id: _unique_identifier.UUID = field(default_factory=lambda: _unique_identifier.UUID())
        stamp: _builtin.Time = field(default_factory=lambda: _builtin.Time())

    @dataclass(eq=False)
    class GoalStatus(Message):
        """A message of the type `action_msgs/msg/GoalStatus`."""

        STATUS_UNKNOWN: ClassVar[int] = 0
        STATUS_ACCEPTED: ClassVar[int] = 1
        STATUS_EXECUTING: ClassVar[int] = 2
        STATUS_CANCELING: ClassVar[int] = 3
        STATUS_SUCCEEDED: ClassVar[int] = 4
        STATUS_CANCELED: ClassVar[int] = 5
        STATUS_ABORTED: ClassVar[int] = 6

        goal_info: GoalInfo = field(default_factory=lambda: GoalInfo())
        status: int = 0

    @dataclass(eq=False)
    class GoalStatusArray(Message):
        """A message of the type `action_msgs/msg/GoalStatusArray`."""

        status_list: list[GoalStatus] = field(default_factory=list)

    @dataclass(eq=False)
    class CancelGoal_Request(Message):
        """A message of the type `action_msgs/srv/CancelGoal_Request`."""

        goal_info: GoalInfo = field(default_factory=lambda: GoalInfo())

    @dataclass(eq=False)
    class CancelGoal_Response(Message):
        """A message of the type `action_msgs/srv/CancelGoal_Response`."""

        ERROR_NONE: ClassVar[int] = 0
        ERROR_REJECTED: ClassVar[int] = 1
        ERROR_UNKNOWN_GOAL_ID: ClassVar[int] = 2
        ERROR_GOAL_TERMINATED: ClassVar[int] = 3

        return_code: int = 0
        goals_canceling: list[GoalInfo] = field(default_factory=list)

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
