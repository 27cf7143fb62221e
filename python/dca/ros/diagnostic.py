"""The messages of `diagnostic_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field
    from typing import ClassVar

    from . import std as _std
    from ._standard import Message

    @dataclass(eq=False)
    class KeyValue(Message):
        """A message of the type `diagnostic_msgs/msg/KeyValue`."""

        key: str = ""
        value: str = ""

    @dataclass(eq=False)
    class DiagnosticStatus(Message):
        """A message of the type `diagnostic_msgs/msg/DiagnosticStatus`."""

        OK: ClassVar[int] = 0
        WARN: ClassVar[int] = 1
        ERROR: ClassVar[int] = 2
        STALE: ClassVar[int] = 3

        level: int = 0
        name: str = ""
        message: str = ""
        hardware_id: str = ""
        values: list[KeyValue] = field(default_factory=list)

    @dataclass(eq=False)
    class DiagnosticArray(Message):
        """A message of the type `diagnostic_msgs/msg/DiagnosticArray`."""

        header: _std.Header = field(default_factory=lambda: _std.Header())
        status: list[DiagnosticStatus] = field(default_factory=list)

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
