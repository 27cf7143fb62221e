"""PressHandle of the door mission, in Python: presses the lever that the hand holds, until it yields.

It reads three devices and sends hand velocities, in the place of the controller in Rust of the same name, whose law and constants it has
(`controllers/src/control/press.rs` says where they come from).
"""

import math
from collections import deque
from dataclasses import dataclass, field

import dca
import numpy as np

SPEED, LEVER, DEPTH_MAX = 0.020, 0.10, 0.16
TWIST, RELAX = (0.2, 0.8), (5.0, 1.0)
MOVES, FORCE_MAX = 0.015, 45.0
STOP_SLOPE, SPRING_SLOPE, SLOPE_WAY, SURE = 1700.0, 600.0, (0.003, 0.008), 4.0
NOISE_SAMPLES, DROP_FROM = 60.0, 12.0
EASE, EASE_SPEED, EASE_TIME = 5.0, 0.010, 0.6
ROLL, CUTOFF = 0.9, 12.0
LAG, HOPS, TIMEOUT, SENSED = 0.035, 4.0, 12.0, "200 ms"
JUMP, EQUAL_MAX = 15.0, 5
UP = np.array([0.0, 0.0, 1.0])

Six = tuple[float, float, float, float, float, float]
Three = tuple[float, float, float]


@dca.message(of_device=True)
@dataclass(slots=True)
class ArmState:
    stamp: dca.Stamp
    angles: Six
    rates: Six


@dca.message(of_device=True)
@dataclass(slots=True)
class FtState:
    stamp: dca.Stamp
    force: Three
    torque: Three
    zeroed: dca.Natural


@dca.message(of_device=True)
@dataclass(slots=True)
class GripperState:
    stamp: dca.Stamp
    width: float
    force: float


@dca.message
@dataclass(slots=True)
class Velocity:
    twist: Six = (0.0,) * 6
    null: tuple[float, float, float, float, float, float, float, float, float] = (0.0,) * 9
    steady: bool = False
    rests: bool = False


@dca.message
@dataclass(slots=True)
class Depth:
    depth: float


class LowPass:
    """First-order low-pass for uneven steps."""

    def __init__(self, cutoff: float, size: int) -> None:
        self.cutoff, self.state = cutoff, np.zeros(size)

    def update(self, value, dt: float):
        self.state += (1.0 - math.exp(-math.tau * self.cutoff * dt)) * (value - self.state)
        return self.state


class Despike:
    """Leaves out single wrong readings of a force sensor: the previous reading is used instead."""

    def __init__(self) -> None:
        self.last, self.doubted = None, False

    def update(self, wrench):
        jumps = self.last is not None and np.linalg.norm(wrench[:3] - self.last[:3]) > JUMP
        self.doubted = not self.doubted and jumps
        if not self.doubted:
            self.last = wrench
        return self.last


@dataclass
class Swings:
    """Swings of one axis of a force loop that is not calm."""

    low: float = 0.0
    high: float = 0.0
    sense: float = 0.0
    since: float = 0.0
    count: int = 0

    def update(self, value: float, swing: float, dt: float) -> bool:
        self.since += dt
        self.low, self.high = min(self.low, value), max(self.high, value)
        rises, falls = value - self.low > swing, self.high - value > swing
        turned = (rises and self.sense <= 0.0) or (falls and self.sense >= 0.0)
        if turned:
            self.count = self.count + 1 if self.since < 0.25 else 1
            self.sense = 1.0 if rises and self.sense <= 0.0 else -1.0
            self.low, self.high, self.since = value, value, 0.0
        if self.sense > 0.0:
            self.low = self.high
        elif self.sense < 0.0:
            self.high = self.low
        return turned and self.count >= 3


@dataclass
class Compliance:
    """The hand gives way to the forces that it feels. This is an admittance, whose gain is limited by a measured delay and by oscillations."""

    slow: LowPass = field(default_factory=lambda: LowPass(2.0, 3))
    size: LowPass = field(default_factory=lambda: LowPass(2.0, 1))
    calm: LowPass = field(default_factory=lambda: LowPass(15.0, 3))
    axes: list[Swings] = field(default_factory=lambda: [Swings() for _ in range(3)])
    last: np.ndarray | None = None
    variance: float = 0.0
    share: float = 1.0

    def update(self, force, torque, delay: float, dt: float):
        slow = float(np.linalg.norm(self.slow.update(force, dt)))
        size = float(self.size.update(np.linalg.norm(force), dt)[0])
        cap, share = 0.6 / (6000.0 * max(delay, 1e-3)), self.guard(force, dt)
        stays = min(max((2.0 * slow - size - 15.0) / 20.0, 0.0), 1.0)
        gain = min(1 / 2000.0 + stays * (1 / 600.0 - 1 / 2000.0), cap) * share
        return limited(force * gain, 0.15), limited(torque * 0.12, 0.5)

    def guard(self, force, dt: float) -> float:
        if self.last is not None:
            self.variance += (float(np.sum((force - self.last) ** 2)) / 6.0 - self.variance) / NOISE_SAMPLES
        self.last = force
        swing = max(8.0, 4.0 * math.sqrt(self.variance))
        values = self.calm.update(force, dt)
        self.share = min(self.share + 0.04 * dt, 1.0)
        for axis, value in zip(self.axes, values, strict=True):
            if axis.update(float(value), swing, dt):
                self.share = max(self.share * 0.75, 0.12)
        return self.share


def limited(vector, most: float):
    size = float(np.linalg.norm(vector))
    return vector * (most / size) if size > most else vector


class Press:
    """The law of one pressing."""

    def __init__(self, rotation) -> None:
        left = np.cross(UP, rotation[:, 2])
        size = np.linalg.norm(left)
        self.left = left / size if size > 1e-6 else np.array([0.0, 1.0, 0.0])
        self.height, self.time, self.give = None, 0.0, Compliance()
        self.lever, self.filter = None, LowPass(CUTOFF, 3)
        self.way: deque[tuple[float, float]] = deque()
        self.largest, self.eases, self.last, self.variance = 0.0, None, None, 0.0

    def update(self, rotation, height: float, wrench, delay: float, dt: float):
        """Returns the velocity of the hand (linear and angular, tool axes), the depth, and `pressing`, `down` or `stuck`."""
        force, torque = rotation @ wrench[:3], wrench[3:]
        began = height if self.height is None else self.height
        felt = -float(force @ self.along(began - height))
        if self.last is not None:
            self.variance += (0.5 * (felt - self.last) ** 2 - self.variance) / NOISE_SAMPLES
        self.last = felt
        upward, twist, steady = self.filter.update(np.array([force[2], torque[2], felt]), dt)
        along = np.zeros(3) if self.height is None else self.along(self.height - height)
        across = rotation.T @ (force - along * (force @ along))
        give, give_turn = self.give.update(across, torque, delay, dt)
        self.time += dt
        if self.height is None:
            if self.time < RELAX[1] and (np.linalg.norm(force) > RELAX[0] or self.time < 0.1):
                return give, give_turn, 0.0, "pressing"
            self.height = height
        depth = self.height - height
        if abs(twist) > TWIST[0 if self.lever is None else 1]:
            lever = self.left * -math.copysign(1.0, twist)
            if self.lever is None or not np.array_equal(lever, self.lever):
                self.way.clear()
                self.last = None
            self.lever = lever
        give = rotation @ give
        give[2] = 0.0
        state, speed = self.ease(self.state(depth, float(upward), felt), float(steady), dt)
        linear = rotation.T @ (give + self.along(depth) * speed)
        roll = np.zeros(3) if self.lever is None else np.cross(self.lever, -UP) * (ROLL * speed / LEVER)
        return linear, rotation.T @ roll + give_turn, depth, state

    def ease(self, state: str, felt: float, dt: float) -> tuple[str, float]:
        if state == "down" and self.eases is None:
            self.eases = (min([felt, *(force for _, force in self.way)]), 0.0)
        if self.eases is None:
            return state, SPEED
        spring, time = self.eases[0], self.eases[1] + dt
        self.eases = (spring, time)
        return "down" if felt < spring + EASE or time > EASE_TIME else "pressing", -EASE_SPEED

    def along(self, depth: float):
        if self.lever is None:
            return -UP
        angle = math.asin(min(max(depth / LEVER, 0.0), 0.9))
        return -UP * math.cos(angle) - self.lever * math.sin(angle)

    def state(self, depth: float, upward: float, felt: float) -> str:
        apart = depth - self.way[-1][0] if self.way else 0.0
        if not self.way or apart > 0.0:
            self.way.append((depth, felt))
        noise = math.sqrt(12.0 * min(max(apart, 1e-5), 1e-3) * self.variance)
        length = min(max((noise / ((STOP_SLOPE - SPRING_SLOPE) / SURE)) ** (2 / 3), SLOPE_WAY[0]), SLOPE_WAY[1])
        while len(self.way) > 1 and depth - self.way[1][0] > length:
            self.way.popleft()
        mean, slope = line(self.way)
        is_long = depth - self.way[0][0] > 0.8 * length
        stops = is_long and slope > STOP_SLOPE and upward > DROP_FROM
        if is_long:
            self.largest = max(self.largest, mean)
        drops = is_long and self.largest > DROP_FROM and mean < 0.4 * self.largest
        if depth > MOVES and (upward > FORCE_MAX or stops or drops):
            return "down"
        return "stuck" if upward > FORCE_MAX or depth > DEPTH_MAX else "pressing"


def line(way) -> tuple[float, float]:
    """Returns the mean of the forces, and their slope over the depths by least squares."""
    depths, forces = np.array(way).T
    spread = float(np.sum((depths - depths.mean()) ** 2))
    mean = float(forces.mean())
    return mean, float(np.sum((depths - depths.mean()) * (forces - mean))) / spread if spread > 0.0 else 0.0


# The Puma 560 on its pedestal, by the parameters of `controllers/src/control/puma560.rs`.
D = (0.67183, 0.0, 0.15005, 0.4318, 0.0, 0.0)
A = (0.0, 0.4318, 0.0203, 0.0, 0.0, 0.0)
ALPHA = (math.pi / 2, 0.0, -math.pi / 2, math.pi / 2, -math.pi / 2, 0.0)
MOUNT_HEIGHT, TOOL_LENGTH = 0.40, 0.20


def forward(angles: Six):
    """Returns the rotation of the tool in the base frame, and its height."""
    rotation, place = np.eye(3), np.array([0.0, 0.0, MOUNT_HEIGHT])
    for q, d, a, alpha in zip(angles, D, A, ALPHA, strict=True):
        c, s, ca, sa = math.cos(q), math.sin(q), math.cos(alpha), math.sin(alpha)
        place = place + rotation @ np.array([a * c, a * s, d])
        rotation = rotation @ np.array([[c, -s * ca, s * sa], [s, c * ca, -c * sa], [0.0, sa, ca]])
    return rotation, float((place + rotation @ np.array([0.0, 0.0, TOOL_LENGTH]))[2])


@dca.task(
    "Presses a lever handle down until it yields, and gives way to forces from the side.",
    every="20 ms",
    triggered_by="ft/state",
    remembers=True,
    signals_every="100 ms",
)
class PressHandle:
    arm = dca.In(ArmState, device="arm/state")
    force = dca.In(FtState, device="ft/state")
    gripper = dca.In(GripperState, device="gripper/state")
    Out = dca.Out(Velocity)
    width_min = dca.parameter(dca.Length, ("1 mm", "20 cm"), default="6 mm")

    def init(self, value):
        self.press, self.despike, self.depth, self.began = None, Despike(), 0.0, None
        self.seen, self.equal = None, 0

    def main_calc(self, tick):
        self.began = tick.now if self.began is None else self.began
        arm, force = self.arm.fresh_within(tick.now, SENSED), self.force.fresh_within(tick.now, SENSED)
        if self.hangs():
            return dca.abort(f"the force sensor hangs: {EQUAL_MAX} samples after one are equal to it")
        linear, angular, state = np.zeros(3), np.zeros(3), "pressing"
        if arm is not None and force is not None:
            rotation, height = forward(arm.angles)
            wrench = np.array([*force.force, *force.torque])
            if self.despike.last is None or self.force.fresh() is not None:
                wrench = self.despike.update(wrench)
            else:
                wrench = self.despike.last
            self.press = self.press or Press(rotation)
            delay = LAG + HOPS * (self.force.age(tick.now) or 0.0)
            linear, angular, self.depth, state = self.press.update(rotation, height, wrench, delay, tick.elapsed)
        gripper = self.gripper.fresh()
        lost = gripper is not None and gripper.width < self.width_min
        if state != "pressing" or lost:
            linear, angular = np.zeros(3), np.zeros(3)
        self.Out.send(Velocity(twist=(*map(float, linear), *map(float, angular))))
        if lost:
            return dca.abort("lost the handle: there is nothing between the fingers")
        if state == "down":
            return dca.done(Depth(self.depth))
        if state == "stuck":
            return dca.abort(f"the lever does not go down: {1e3 * self.depth:.0f} mm")
        if tick.now - self.began > TIMEOUT:
            return dca.abort(f"the lever is not down after 12 s: {1e3 * self.depth:.0f} mm")

    def hangs(self) -> bool:
        """Whether a noisy sensor has said the same again and again."""
        force = self.force.fresh()
        if force is not None:
            sample = (force.force, force.torque)
            self.equal, self.seen = (self.equal + 1, self.seen) if sample == self.seen else (0, sample)
        return self.equal >= EQUAL_MAX

    def stop(self, tick):
        # The process that moves the hand gets it at once.
        self.Out.send(Velocity())
        return True

    def signals(self):
        return [dca.Signal("depth", 1e3 * self.depth, "mm")]


if __name__ == "__main__":
    dca.run(PressHandle)
