"""The messages of `std_srvs`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass

    from ._standard import Message

    @dataclass(eq=False)
    class Empty_Request(Message):
        """A message of the type `std_srvs/srv/Empty_Request`."""

    @dataclass(eq=False)
    class Empty_Response(Message):
        """A message of the type `std_srvs/srv/Empty_Response`."""

    @dataclass(eq=False)
    class SetBool_Request(Message):
        """A message of the type `std_srvs/srv/SetBool_Request`."""

        data: bool = False

    @dataclass(eq=False)
    class SetBool_Response(Message):
        """A message of the type `std_srvs/srv/SetBool_Response`."""

        success: bool = False
        message: str = ""

    @dataclass(eq=False)
    class Trigger_Request(Message):
        """A message of the type `std_srvs/srv/Trigger_Request`."""

    @dataclass(eq=False)
    class Trigger_Response(Message):
        """A message of the type `std_srvs/srv/Trigger_Response`."""

        success: bool = False
        message: str = ""

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
