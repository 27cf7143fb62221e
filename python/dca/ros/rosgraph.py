"""The messages of `rosgraph_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field

    from . import builtin as _builtin
    from ._standard import Message

    @dataclass(eq=False)
    class Clock(Message):
        """A message of the type `rosgraph_msgs/msg/Clock`."""

        clock: _builtin.Time = field(default_factory=lambda: _builtin.Time())

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
