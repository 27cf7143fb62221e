"""The messages of `unique_identifier_msgs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass

    from ._standard import Message, Octets

    @dataclass(eq=False)
    class UUID(Message):
        """A message of the type `unique_identifier_msgs/msg/UUID`."""

        uuid: Octets = Octets()

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
