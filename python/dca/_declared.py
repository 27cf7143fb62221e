"""The base of all declarations in a class: ports, calls, queues, locks, keys and the database."""

from typing import Any, Generic, Self, TypeVar, overload

R = TypeVar("R")


class Declared(Generic[R]):
    """A declaration in a class. It has the name of its attribute, unless it gets another name.

    In each instance that DCA makes, an `R` replaces it: the port, queue or lock itself.
    """

    missing = "is not there"
    """What an attribute lacks if DCA has not made its object."""

    def __init__(self, name: str | None = None, *, optional: bool = False, doc: str = "") -> None:
        self.name, self.attribute, self.is_optional, self.doc = name or "", "", optional, doc

    def __set_name__(self, _: type, attribute: str) -> None:
        self.attribute = attribute
        self.name = self.name or attribute

    @overload
    def __get__(self, controller: None, cls: type) -> Self: ...
    @overload
    def __get__(self, controller: object, cls: type) -> R: ...
    def __get__(self, controller: object, cls: type) -> Any:
        """Returns this declaration for access through the class. An instance that DCA has made has its own attribute instead."""
        if controller is None:
            return self
        raise AttributeError(f"`{self.attribute}` {self.missing}: this object was not made by dca.run or a dca.testing.Harness")
