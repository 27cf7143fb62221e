"""The messages of `composition_interfaces`, written by `ros/tests/all/python.rs`."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from dataclasses import dataclass, field

    from . import rcl as _rcl
    from ._standard import Message, Numbers

    @dataclass(eq=False)
    class LoadNode_Request(Message):
        """A message of the type `composition_interfaces/srv/LoadNode_Request`."""

        package_name: str = ""
        plugin_name: str = ""
        node_name: str = ""
        node_namespace: str = ""
        log_level: int = 0
        remap_rules: list[str] = field(default_factory=list)
        parameters: list[_rcl.Parameter] = field(default_factory=list)
        extra_arguments: list[_rcl.Parameter] = field(default_factory=list)

    @dataclass(eq=False)
    class LoadNode_Response(Message):
        """A message of the type `composition_interfaces/srv/LoadNode_Response`."""

        success: bool = False
        error_message: str = ""
        full_node_name: str = ""
        unique_id: int = 0

    @dataclass(eq=False)
    class UnloadNode_Request(Message):
        """A message of the type `composition_interfaces/srv/UnloadNode_Request`."""

        unique_id: int = 0

    @dataclass(eq=False)
    class UnloadNode_Response(Message):
        """A message of the type `composition_interfaces/srv/UnloadNode_Response`."""

        success: bool = False
        error_message: str = ""

    @dataclass(eq=False)
    class ListNodes_Request(Message):
        """A message of the type `composition_interfaces/srv/ListNodes_Request`."""

    @dataclass(eq=False)
    class ListNodes_Response(Message):
        """A message of the type `composition_interfaces/srv/ListNodes_Response`."""

        full_node_names: list[str] = field(default_factory=list)
        unique_ids: Numbers[int] = Numbers[int]()

else:
    from ._standard import lazily

    __getattr__, __dir__ = lazily(__name__)
