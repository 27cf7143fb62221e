"""The messages of `service_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import builtin as _builtin
    from ._standard import Message, Octets

    @dataclass(eq=False)
    class ServiceEventInfo(Message):
        """A message of the type `service_msgs/msg/ServiceEventInfo`."""

        REQUEST_SENT: ClassVar[int] = 0
        REQUEST_RECEIVED: ClassVar[int] = 1
        RESPONSE_SENT: ClassVar[int] = 2
        RESPONSE_RECEIVED: ClassVar[int] = 3

        event_type: int = 0
        stamp: _builtin.Time = field(default_factory=lambda: _builtin.Time())
        client_gid: Octets = Octets()
        sequence_number: int = 0

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
