"""The messages of `builtin_interfaces`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass

    from ._standard import Message

    @dataclass(eq=False)
    class Time(Message):
        """A message of the type `builtin_interfaces/msg/Time`."""

        sec: int = 0
        nanosec: int = 0

    @dataclass(eq=False)
    class Duration(Message):
        """A message of the type `builtin_interfaces/msg/Duration`."""

        sec: int = 0
        nanosec: int = 0

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
