"""The messages of `lifecycle_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from ._standard import Message

    @dataclass(eq=False)
    class State(Message):
        """A message of the type `lifecycle_msgs/msg/State`."""

        PRIMARY_STATE_UNKNOWN: ClassVar[int] = 0
        PRIMARY_STATE_UNCONFIGURED: ClassVar[int] = 1
        PRIMARY_STATE_INACTIVE: ClassVar[int] = 2
        PRIMARY_STATE_ACTIVE: ClassVar[int] = 3
        PRIMARY_STATE_FINALIZED: ClassVar[int] = 4
        TRANSITION_STATE_CONFIGURING: ClassVar[int] = 10
        TRANSITION_STATE_CLEANINGUP: ClassVar[int] = 11
        TRANSITION_STATE_SHUTTINGDOWN: ClassVar[int] = 12
        TRANSITION_STATE_ACTIVATING: ClassVar[int] = 13
        TRANSITION_STATE_DEACTIVATING: ClassVar[int] = 14
        TRANSITION_STATE_ERRORPROCESSING: ClassVar[int] = 15

        id: int = 0
        label: str = ""

    @dataclass(eq=False)
    class Transition(Message):
        """A message of the type `lifecycle_msgs/msg/Transition`."""

        TRANSITION_CREATE: ClassVar[int] = 0
        TRANSITION_CONFIGURE: ClassVar[int] = 1
        TRANSITION_CLEANUP: ClassVar[int] = 2
        TRANSITION_ACTIVATE: ClassVar[int] = 3
        TRANSITION_DEACTIVATE: ClassVar[int] = 4
        TRANSITION_UNCONFIGURED_SHUTDOWN: ClassVar[int] = 5
        TRANSITION_INACTIVE_SHUTDOWN: ClassVar[int] = 6
        TRANSITION_ACTIVE_SHUTDOWN: ClassVar[int] = 7
        TRANSITION_DESTROY: ClassVar[int] = 8
        TRANSITION_ON_CONFIGURE_SUCCESS: ClassVar[int] = 10
        TRANSITION_ON_CONFIGURE_FAILURE: ClassVar[int] = 11
        TRANSITION_ON_CONFIGURE_ERROR: ClassVar[int] = 12
        TRANSITION_ON_CLEANUP_SUCCESS: ClassVar[int] = 20
        TRANSITION_ON_CLEANUP_FAILURE: ClassVar[int] = 21
        TRANSITION_ON_CLEANUP_ERROR: ClassVar[int] = 22
        TRANSITION_ON_ACTIVATE_SUCCESS: ClassVar[int] = 30
        TRANSITION_ON_ACTIVATE_FAILURE: ClassVar[int] = 31
        TRANSITION_ON_ACTIVATE_ERROR: ClassVar[int] = 32
        TRANSITION_ON_DEACTIVATE_SUCCESS: ClassVar[int] = 40
        TRANSITION_ON_DEACTIVATE_FAILURE: ClassVar[int] = 41
        TRANSITION_ON_DEACTIVATE_ERROR: ClassVar[int] = 42
        TRANSITION_ON_SHUTDOWN_SUCCESS: ClassVar[int] = 50
        TRANSITION_ON_SHUTDOWN_FAILURE: ClassVar[int] = 51
        TRANSITION_ON_SHUTDOWN_ERROR: ClassVar[int] = 52
        TRANSITION_ON_ERROR_SUCCESS: ClassVar[int] = 60
        TRANSITION_ON_ERROR_FAILURE: ClassVar[int] = 61
        TRANSITION_ON_ERROR_ERROR: ClassVar[int] = 62
        TRANSITION_CALLBACK_SUCCESS: ClassVar[int] = 97
        TRANSITION_CALLBACK_FAILURE: ClassVar[int] = 98
        TRANSITION_CALLBACK_ERROR: ClassVar[int] = 99

        id: int = 0
        label: str = ""

    @dataclass(eq=False)
    class TransitionDescription(Message):
        """A message of the type `lifecycle_msgs/msg/TransitionDescription`."""

        transition: Transition = field(default_factory=lambda: Transition())
        start_state: State = field(default_factory=lambda: State())
        goal_state: State = field(default_factory=lambda: State())

    @dataclass(eq=False)
    class TransitionEvent(Message):
        """A message of the type `lifecycle_msgs/msg/TransitionEvent`."""

        timestamp: int = 0
        transition: Transition = field(default_factory=lambda: Transition())
        start_state: State = field(default_factory=lambda: State())
        goal_state: State = field(default_factory=lambda: State())

    @dataclass(eq=False)
    class ChangeState_Request(Message):
        """A message of the type `lifecycle_msgs/srv/ChangeState_Request`."""

        transition: Transition = field(default_factory=lambda: Transition())

    @dataclass(eq=False)
    class ChangeState_Response(Message):
        """A message of the type `lifecycle_msgs/srv/ChangeState_Response`."""

        success: bool = False

    @dataclass(eq=False)
    class GetState_Request(Message):
        """A message of the type `lifecycle_msgs/srv/GetState_Request`."""

    @dataclass(eq=False)
    class GetState_Response(Message):
        """A message of the type `lifecycle_msgs/srv/GetState_Response`."""

        current_state: State = field(default_factory=lambda: State())

    @dataclass(eq=False)
    class GetAvailableStates_Request(Message):
        """A message of the type `lifecycle_msgs/srv/GetAvailableStates_Request`."""

    @dataclass(eq=False)
    class GetAvailableStates_Response(Message):
        """A message of the type `lifecycle_msgs/srv/GetAvailableStates_Response`."""

        available_states: list[State] = field(default_factory=list)

    @dataclass(eq=False)
    class GetAvailableTransitions_Request(Message):
        """A message of the type `lifecycle_msgs/srv/GetAvailableTransitions_Request`."""

    @dataclass(eq=False)
    class GetAvailableTransitions_Response(Message):
        """A message of the type `lifecycle_msgs/srv/GetAvailableTransitions_Response`."""

        available_transitions: list[TransitionDescription] = field(default_factory=list)

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
