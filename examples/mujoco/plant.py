"""MujocoDoor: a second plant for `specs/door_opening.dca`, the same six devices in front of the physics engine MuJoCo."""

from dataclasses import asdict, dataclass

import dca
from door import World

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
Six = tuple[float, float, float, float, float, float]


@dca.message(of_device=True)
@dataclass(slots=True)
class ArmCommand:
    owner: str
    rates: Six | None
    fence: dca.Natural | None


@dca.message(of_device=True)
@dataclass(slots=True)
class ArmState:
    stamp: dca.Stamp
    angles: Six
    rates: Six


@dca.message(of_device=True)
@dataclass(slots=True)
class BaseCommand:
    owner: str
    velocity: Three | None
    fence: dca.Natural | None


@dca.message(of_device=True)
@dataclass(slots=True)
class BaseState:
    stamp: dca.Stamp
    steering: Four
    rolling: Four
    bumped: bool


@dca.message(of_device=True)
@dataclass(slots=True)
class FtCommand:
    after: dca.Natural


@dca.message(of_device=True)
@dataclass(slots=True)
class FtState:
    stamp: dca.Stamp
    force: Three
    torque: Three
    zeroed: dca.Natural


@dca.message(of_device=True)
@dataclass(slots=True)
class GripperCommand:
    owner: str
    width: float | None
    force: float
    fence: dca.Natural | None


@dca.message(of_device=True)
@dataclass(slots=True)
class GripperState:
    stamp: dca.Stamp
    width: float
    force: float


@dca.message(of_device=True)
@dataclass(slots=True)
class LaserState:
    stamp: dca.Stamp
    ranges: list[float]


@dca.message(of_device=True)
@dataclass(slots=True)
class CameraState:
    stamp: dca.Stamp
    marks: tuple[Three | None, Three | None, Three | None, Three | None]


@dca.service(
    "Simulates the robot before a door with MuJoCo and owns its devices.",
    every="4 ms",
    remembers=True,
    signals_every="40 ms",
)
class MujocoDoor:
    arm_cmd = dca.In(ArmCommand, device="arm/cmd", owner=True)
    base_cmd = dca.In(BaseCommand, device="base/cmd", owner=True)
    ft_cmd = dca.In(FtCommand, device="ft/cmd", owner=True)
    gripper_cmd = dca.In(GripperCommand, device="gripper/cmd", owner=True)
    arm = dca.Out(ArmState, device="arm/state", owner=True)
    base = dca.Out(BaseState, device="base/state", owner=True)
    ft = dca.Out(FtState, device="ft/state", owner=True)
    gripper = dca.Out(GripperState, device="gripper/state", owner=True)
    laser = dca.Out(LaserState, device="laser/state", owner=True)
    camera = dca.Out(CameraState, device="camera/state", owner=True)
    side = dca.parameter(str, ("left", "right"), default="left")
    swing = dca.parameter(str, ("pull", "push"), default="pull")
    seed = dca.parameter(int, (0, 1_000_000_000), default=1)

    def __init__(self):
        # The physics is ready before the program reports that it is ready.
        self.world = World({"side": self.side, "swing": self.swing, "seed": str(self.seed)})
        self.told = []

    def main_calc(self, tick):
        commands = {"arm": self.arm_cmd, "base": self.base_cmd, "ft": self.ft_cmd, "gripper": self.gripper_cmd}
        fresh = {device: port.fresh() for device, port in commands.items()}
        now = round(tick.now * 1e9)
        self.world.obey(now, {device: asdict(command) if command else None for device, command in fresh.items()})
        self.world.advance(now)
        answer = self.world.answer(now)
        self.told = answer.pop("signals")
        states = {
            "arm": (self.arm, ArmState),
            "base": (self.base, BaseState),
            "ft": (self.ft, FtState),
            "gripper": (self.gripper, GripperState),
            "laser": (self.laser, LaserState),
            "camera": (self.camera, CameraState),
        }
        for device, state in answer.items():
            port, kind = states[device]
            port.send(kind(**(state | {"stamp": state["stamp"] / 1e9})))

    def signals(self):
        return [dca.Signal(name, float(value), unit, headline) for name, unit, value, headline in self.told]


if __name__ == "__main__":
    dca.run(MujocoDoor)
