"""Controllers of DCA in Python.

A controller is a class. Ports and parameters are its attributes; `main_calc` is called once per period, or for each value.
`dca.run` makes the class a program, which a node starts like any other program.
"""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

from ._controller import (
    ABSENT,
    EXISTS,
    Calls,
    Database,
    Every,
    In,
    Out,
    Signal,
    abort,
    done,
    outcome,
    parameter,
    procedure,
    run,
    secret,
    service,
    state,
    task,
)
from ._messaging import (
    Asked,
    Filter,
    KeyAnswers,
    KeyNews,
    KeyWriter,
    Lock,
    LockUser,
    Queue,
    Requester,
    Router,
    Sender,
    Subscriber,
)
from ._dca import (
    Abort,
    CallError,
    DatabaseFailure,
    DatabaseUnknown,
    Done,
    Entry,
    Opaque,
    Refused,
    SendError,
    Taken,
    Tick,
    __version__,
)
from ._reply import Reply
from ._message import Bytes, Count, Natural, Stamp, decode, encode, message
from ._offload import Offloaded, offload
from ._quantity import (
    Acceleration,
    Angle,
    AngularSpeed,
    Current,
    Force,
    Frequency,
    Length,
    Mass,
    Power,
    Quantity,
    Size,
    Speed,
    Stiffness,
    Time,
    Torque,
    Voltage,
    si,
)

if TYPE_CHECKING:
    from . import ros as ros

__all__ = [
    "ABSENT",
    "Abort",
    "Acceleration",
    "Angle",
    "AngularSpeed",
    "Asked",
    "Bytes",
    "CallError",
    "Calls",
    "Count",
    "Current",
    "Database",
    "DatabaseFailure",
    "DatabaseUnknown",
    "Done",
    "EXISTS",
    "Entry",
    "Every",
    "Filter",
    "Force",
    "Frequency",
    "In",
    "KeyAnswers",
    "KeyNews",
    "KeyWriter",
    "Length",
    "Lock",
    "LockUser",
    "Mass",
    "Natural",
    "Offloaded",
    "Opaque",
    "Out",
    "Power",
    "Quantity",
    "Queue",
    "Refused",
    "Reply",
    "Requester",
    "Router",
    "SendError",
    "Sender",
    "Signal",
    "Size",
    "Speed",
    "Stiffness",
    "Stamp",
    "Subscriber",
    "Taken",
    "Tick",
    "Time",
    "Torque",
    "Voltage",
    "__version__",
    "abort",
    "decode",
    "done",
    "encode",
    "message",
    "offload",
    "outcome",
    "parameter",
    "procedure",
    "ros",
    "run",
    "secret",
    "service",
    "si",
    "state",
    "task",
]


def __getattr__(name: str) -> ModuleType:
    """Imports `dca.ros` when it is first used."""
    if name != "ros":
        raise AttributeError(f"module `{__name__}` has no attribute `{name}`")
    # `from . import ros` would call this function again.
    return importlib.import_module(f"{__name__}.ros")
