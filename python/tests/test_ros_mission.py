"""A mission whose controller in Python drives a robot of ROS 2: a peer on plain Zenoh is the robot, and the bridge is between them."""

import queue
import shutil
import signal
import socket
import struct
import time

import pytest
from conftest import ROOT

zenoh = pytest.importorskip("zenoh")

EXAMPLES = ROOT / "examples" / "python"
HASHES = {
    words[1]: words[2]
    for words in map(str.split, (ROOT / "ros" / "tests" / "golden" / "rosbags.txt").read_text().splitlines())
    if words[0] == "T"
}
SCAN = f"7/scan/sensor_msgs::msg::dds_::LaserScan_/{HASHES['sensor_msgs/msg/LaserScan']}"
COMMAND = f"7/cmd_vel/geometry_msgs::msg::dds_::Twist_/{HASHES['geometry_msgs/msg/Twist']}"
ENABLE = "7/avoid/enable/std_srvs::srv::dds_::SetBool_/" + next(
    line.split()[1]
    for line in (ROOT / "ros" / "tests" / "golden" / "services.txt").read_text().splitlines()
    if line.startswith("std_srvs/srv/SetBool ")
)
HEADER = b"\0\1\0\0"


def attachment(sequence: int) -> bytes:
    return struct.pack("<qq", sequence, 0) + b"\x10" + b"\x09" * 16


def scan(*ranges: float) -> bytes:
    """Returns a scan as ROS 2 sends it, written by hand."""
    body = struct.pack("<iI", 12, 34) + struct.pack("<I", 6) + b"laser\0" + b"\0\0"
    body += struct.pack("<7f", -1.0, 1.0, 0.5, 0.0, 0.1, 0.05, 10.0)
    return HEADER + body + struct.pack(f"<I{len(ranges)}f", len(ranges), *ranges) + struct.pack("<I", 0)


class Robot:
    """A router and a node of ROS 2 in one session."""

    def __init__(self) -> None:
        for _ in range(20):
            with socket.socket() as probe:
                probe.bind(("127.0.0.1", 0))
                self.locator = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
            config = zenoh.Config()
            config.insert_json5("mode", '"router"')
            config.insert_json5("listen/endpoints", f'["{self.locator}"]')
            config.insert_json5("scouting/multicast/enabled", "false")
            config.insert_json5("timestamping/enabled", "true")
            try:
                self.session = zenoh.open(config)
                break
            except zenoh.ZError:
                # Another program has taken the port.
                continue
        self.commands: queue.Queue[tuple[float, float]] = queue.Queue(1000)
        self.session.declare_subscriber(COMMAND, self.hear)
        self.sequence = 0

    def hear(self, sample) -> None:
        payload = bytes(sample.payload)
        assert payload[:4] == HEADER and len(payload) == 52 and len(bytes(sample.attachment)) == 33
        numbers = struct.unpack("<6d", payload[4:])
        self.commands.put_nowait((numbers[0], numbers[5]))

    def answers(self, expected: tuple[float, float], ranges: tuple[float, ...]) -> bool:
        """Sends scans until a command comes that is as expected."""
        until = time.monotonic() + 60.0
        while time.monotonic() < until:
            self.sequence += 1
            self.session.put(SCAN, scan(*ranges), attachment=attachment(self.sequence))
            try:
                while True:
                    if self.commands.get(timeout=0.05) == expected:
                        return True
            except queue.Empty:
                continue
        return False

    def enable(self, on: bool) -> bytes | None:
        """Calls the service until it answers."""
        until = time.monotonic() + 60.0
        while time.monotonic() < until:
            self.sequence += 1
            replies = self.session.get(
                ENABLE, payload=HEADER + bytes([on]), attachment=attachment(self.sequence), target=zenoh.QueryTarget.ALL_COMPLETE
            )
            for reply in replies:
                if reply.ok is not None:
                    return bytes(reply.ok.payload)
        return None


def test_a_controller_in_python_drives_a_robot_of_ros(missions, monkeypatch):
    robot = Robot()
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'connect/endpoints=["{robot.locator}"]')
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    for name in ("avoid.py", "avoid.dca"):
        shutil.copy(EXAMPLES / name, missions.folder / name)
    checked = missions("check", "avoid.dca")
    assert checked.returncode == 0, checked.stdout + checked.stderr
    mission = missions.begin("run", "avoid.dca")
    try:
        free, near = (float("inf"), 3.0, 0.7), (3.0, 0.5, float("inf"))
        assert robot.answers((0.3, 0.0), free)
        assert robot.answers((0.0, 0.8), near)
        assert robot.enable(False) == HEADER + b"\1\0\0\0" + struct.pack("<I", 9) + b"standing\0"
        assert robot.answers((0.0, 0.0), free)
        assert robot.enable(True) == HEADER + b"\1\0\0\0" + struct.pack("<I", 8) + b"driving\0"
        assert robot.answers((0.3, 0.0), free)
    finally:
        mission.send_signal(signal.SIGINT)
        out, _ = mission.communicate(timeout=60)
        robot.session.close()
    assert "avoid" in out
