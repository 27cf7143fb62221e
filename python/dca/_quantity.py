"""Quantities: floats in SI units, with an annotation that names the quantity."""

from dataclasses import dataclass
from typing import Annotated

from . import _dca


@dataclass(frozen=True, slots=True)
class Quantity:
    """The type of a quantity in specs, such as `Force`."""

    name: str


Time = Annotated[float, Quantity("Time")]
"""In seconds."""
Length = Annotated[float, Quantity("Length")]
"""In metres."""
Angle = Annotated[float, Quantity("Angle")]
"""In radians."""
Speed = Annotated[float, Quantity("Speed")]
"""In metres per second."""
AngularSpeed = Annotated[float, Quantity("AngularSpeed")]
"""In radians per second."""
Acceleration = Annotated[float, Quantity("Acceleration")]
"""In metres per second squared."""
Frequency = Annotated[float, Quantity("Frequency")]
"""In hertz."""
Mass = Annotated[float, Quantity("Mass")]
"""In kilograms."""
Force = Annotated[float, Quantity("Force")]
"""In newtons."""
Torque = Annotated[float, Quantity("Torque")]
"""In newton metres."""
Stiffness = Annotated[float, Quantity("Stiffness")]
"""In newtons per metre."""
Power = Annotated[float, Quantity("Power")]
"""In watts."""
Current = Annotated[float, Quantity("Current")]
"""In amperes."""
Voltage = Annotated[float, Quantity("Voltage")]
"""In volts."""
Size = Annotated[float, Quantity("Size")]
"""In bytes."""


def si(value: str | float, quantity: object) -> float:
    """Returns a quantity in SI units: `dca.si("20 cm", dca.Length)` is 0.2."""
    return _dca.si(value, name_of(quantity) or "Number")


def name_of(annotation: object) -> str | None:
    """Returns the name of the quantity in an annotation; `None` if it has none."""
    for extra in getattr(annotation, "__metadata__", ()):
        if isinstance(extra, Quantity):
            return extra.name
    return None
