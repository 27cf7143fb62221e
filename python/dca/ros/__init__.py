"""The standard messages of ROS 2: `dca.ros.sensor.LaserScan` is `ros.sensor.LaserScan` in a spec, and `sensor_msgs/msg/LaserScan` in ROS 2.

A class is made when it is first used. On a wire, it has the same bytes as the message in Rust.
"""

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

from ._standard import Message, from_cdr, to_cdr

if TYPE_CHECKING:
    from . import action as action
    from . import builtin as builtin
    from . import composition as composition
    from . import diagnostic as diagnostic
    from . import example as example
    from . import geometry as geometry
    from . import lifecycle as lifecycle
    from . import nav as nav
    from . import nav2 as nav2
    from . import rcl as rcl
    from . import rosgraph as rosgraph
    from . import sensor as sensor
    from . import service as service
    from . import shape as shape
    from . import std as std
    from . import std_srvs as std_srvs
    from . import tf2 as tf2
    from . import trajectory as trajectory
    from . import unique_identifier as unique_identifier
    from . import visualization as visualization

__all__ = ["Message", "from_cdr", "to_cdr"]


def __getattr__(name: str) -> ModuleType:
    if name.startswith("_"):
        raise AttributeError(f"module `{__name__}` has no `{name}`")
    try:
        return importlib.import_module(f"{__name__}.{name}")
    except ModuleNotFoundError:
        raise AttributeError(f"there is no package `{name}` of messages in `{__name__}`") from None
