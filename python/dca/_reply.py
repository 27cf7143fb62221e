"""The annotation of a reply: `reply: dca.Reply[Width]`."""

from typing import TYPE_CHECKING, Generic, TypeVar

T = TypeVar("T")

if TYPE_CHECKING:
    from ._dca import Reply as Reply
else:

    class Reply(Generic[T]):
        """The way of the answer to one call, with `send(result)`, `refuse(reason)` and `is_wanted`."""
