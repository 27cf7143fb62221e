#!/usr/bin/env python3
"""Writes the message definitions of ROS 2 below `ros/messages`, one file for each package.

Run it in a virtual environment with `pip install rosbags==0.11.9`, and again for a newer distribution:

    python ros/generate/messages.py

The definitions come from the typestore of the newest distribution that `rosbags` knows. A test compares them with Jazzy's.
"""

from pathlib import Path

from rosbags.typesys import Stores, get_typestore

PACKAGES = [
    "action_msgs",
    "builtin_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "lifecycle_msgs",
    "nav_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "service_msgs",
    "shape_msgs",
    "std_msgs",
    "tf2_msgs",
    "trajectory_msgs",
    "unique_identifier_msgs",
    "visualization_msgs",
]
# The defaults of fields, which typestores leave out. A default is not part of the hash of a type.
DEFAULTS = {"geometry_msgs/Quaternion": [("float64 w\n", "float64 w 1\n")]}
SEPARATOR = "=" * 80


def main() -> None:
    """Write one file for each package."""
    store = get_typestore(Stores.LATEST)
    folder = Path(__file__).parent.parent / "messages"
    for package in PACKAGES:
        text = ""
        for name in sorted(name for name in store.fielddefs if name.startswith(f"{package}/msg/")):
            definition, _ = store.gendefhash(name, {}, ros_version=2)
            short = f"{package}/{name.rsplit('/', 1)[1]}"
            for field, with_default in DEFAULTS.get(short, []):
                definition = definition.replace(field, with_default)
            text += f"{SEPARATOR}\nMSG: {short}\n{definition}"
        (folder / f"{package}.msgs").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
