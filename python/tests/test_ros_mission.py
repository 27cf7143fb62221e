"""Missions of Python controllers with ROS 2: a peer on plain Zenoh plays the robot, and the bridge connects the two."""

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
    """Returns the CDR of a scan, as ROS 2 sends it, made by hand."""
    body = struct.pack("<iI", 12, 34) + struct.pack("<I", 6) + b"laser\0" + b"\0\0"
    body += struct.pack("<7f", -1.0, 1.0, 0.5, 0.0, 0.1, 0.05, 10.0)
    return HEADER + body + struct.pack(f"<I{len(ranges)}f", len(ranges), *ranges) + struct.pack("<I", 0)


class Robot:
    """A Zenoh router and a ROS 2 node in one session."""

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
                # Another program uses the port.
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
        """Sends scans until the expected command comes."""
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
        """Calls the service repeatedly until it answers."""
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


ORDER = """
import dca
from dca import ros

@dca.task("Asks a service, and leaves a goal.", triggered_by="Set")
class Order:
    Set = dca.Calls(ros.std_srvs.SetBool_Request, ros.std_srvs.SetBool_Response)

    def init(self, value):
        self.ask()

    def ask(self):
        self.call = self.Set.call(ros.std_srvs.SetBool_Request(data=True), within="60 s")

    def main_calc(self, tick):
        if not self.call.done:
            return
        try:
            answer = self.call.result()
        except dca.CallError:
            # The bridge does not know all servers in its first second.
            return self.ask()
        return dca.done(ros.example.Fibonacci_Goal(order=len(answer.message)))

@dca.task("Looks at the result of an action.")
class Look:
    def init(self, value):
        self.result = dca.decode(ros.example.Fibonacci_Result, value)

    def main_calc(self, tick):
        found = list(self.result.sequence)
        return dca.done() if found == [0, 1, 1, 2, 3] else dca.abort(f"it is {found}")

if __name__ == "__main__":
    dca.run(Order, Look)
"""
ORDER_SPEC = """
module Order { python "order.py"; venv ".venv"; }
module Look { python "order.py"; venv ".venv"; }
module Count(host: Host) { action "/fib": ros.example.Fibonacci; }
process main(){
    host{c1}
    instantiated_processes{ order instof Order(c1); count instof Count(c1); look instof Look(c1); }
    internal_connections{ order.Set -> service("/avoid/enable"); }
    internal_event_actions{ order : count : look }
}
"""
FIBONACCI = "7/fib/_action/{}/example_interfaces::action::dds_::Fibonacci_{}_/RIHS01_{}"
SEND = FIBONACCI.format("send_goal", "SendGoal", "d1a57fb2a4afe8c21e34fb10db206f16ce6729b28531141472df92277c55b557")
RESULT = FIBONACCI.format("get_result", "GetResult", "1b0de0d5d29dc955d92f546706568428632771db13ec84c15ec1c1a59f424a57")


@pytest.fixture
def robot(monkeypatch):
    robot = Robot()
    monkeypatch.setenv("ROS_DOMAIN_ID", "7")
    monkeypatch.setenv("ZENOH_CONFIG_OVERRIDE", f'connect/endpoints=["{robot.locator}"]')
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    yield robot
    robot.session.close()


def test_a_task_in_python_asks_a_service_and_begins_an_action(missions, robot):
    asked = []

    def serve(key, answer):
        def hear(query):
            asked.append(bytes(query.payload))
            query.reply(query.key_expr, HEADER + answer, attachment=query.attachment)

        robot.session.declare_queryable(key, hear, complete=True)

    serve(ENABLE, b"\1\0\0\0" + struct.pack("<I", 5) + b"four\0")
    serve(SEND, b"\1" + bytes(11))
    serve(RESULT, b"\4\0\0\0" + struct.pack("<6i", 5, 0, 1, 1, 2, 3))
    missions.write("order.py", ORDER)
    missions.write("order.dca", ORDER_SPEC)
    ended = missions.run("order.dca", within=120)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    enable, goal = asked[0], asked[1]
    assert enable == HEADER + b"\1"
    assert len(goal) == 24 and goal[20:] == struct.pack("<i", 4)


def test_a_controller_in_python_drives_a_robot_of_ros(missions, robot):
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
    assert "avoid" in out
