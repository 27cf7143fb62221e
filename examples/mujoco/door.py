"""The robot before its door in MuJoCo, for `MujocoDoor` in plant.py.

`obey` takes the newest command of each device, `advance` goes on to a time, and `answer` returns the states that are due, under the names of
their devices, and `signals`. The messages come from controllers/src/message.rs. SI units; the wall is at x = 0, the robot before it, z is up.

Lengths, masses, limits and rates come from controllers/src/control and controllers/src/robot. Dynamics, contacts, friction and
the grasp are MuJoCo's: nothing glues the lever to the fingers.
"""

import math
import random

import mujoco
import numpy as np

NAMES = ["arm", "base", "ft", "gripper", "laser", "camera"]
PERIODS = dict(zip(NAMES, [8, 8, 8, 20, 50, 40]))  # ms
WATCHDOG = 100_000_000  # ns
STEP = 0.002  # s
STEP_NS = 2_000_000
# Standard Denavit-Hartenberg, m and rad: d, a, alpha.
LINKS = [
    (0.67183, 0.0, math.pi / 2),
    (0.0, 0.4318, 0.0),
    (0.15005, 0.0203, -math.pi / 2),
    (0.4318, 0.0, math.pi / 2),
    (0.0, 0.0, -math.pi / 2),
    (0.0, 0.0, 0.0),
]
RANGES = [(-160, 160), (-45, 225), (-225, 45), (-110, 170), (-100, 100), (-266, 266)]  # deg
TORQUES = [97.6, 186.4, 89.4, 24.2, 20.1, 21.3]  # Nm
# kg, centre of mass (m), inertia about it (kg m2), motor inertia times gear squared (kg m2); Corke 1994. Links 1 and 3 are patched: no
# body has the published inertias.
MASSES = [
    (10.0, (0, 0, 0), (0.35, 0.35, 0.35), 1.14),
    (17.4, (-0.3638, 0.006, 0.2275), (0.13, 0.524, 0.539), 2.32),
    (4.8, (-0.0203, -0.0141, 0.070), (0.066, 0.086, 0.0201), 0.58),
    (0.82, (0, 0.019, 0), (1.8e-3, 1.3e-3, 1.8e-3), 0.19),
    (0.34, (0, 0, 0), (0.3e-3, 0.4e-3, 0.3e-3), 0.17),
    (0.09, (0, 0, 0.032), (0.15e-3, 0.15e-3, 0.1e-3), 0.19),
]
START = [math.radians(q) for q in (0, 45, -180, 0, 45, 90)]
STIFF = [1e4, 1e4, 1e4, 2e3, 2e3, 2e3]  # Nm s/rad
BASE_STIFF, TRACTION = 2e4, 400.0  # N s/m, N
BUMPED = 8.0  # N, on the bumper of the base
LIMITS = [0.6, 0.6, 0.7]  # m/s, m/s, rad/s
BASE_LAG, ARM_LAG = 0.08, 0.02  # s
RADIUS, BEYOND, HEIGHT, STANDOFF, LEVER = 0.82, 0.08, 1.05, 0.06, 0.09  # m
INERTIA, CLOSER, CLOSER_RATE = 6.75, 8.0, 2.0  # kg m2, Nm, Nm/rad
LATCH, PLAY = math.radians(28), math.radians(0.6)
WHEEL, OFFSET, CASTER = 0.055, 0.020, 0.24  # m
WHEEL_ERROR = 0.01
FOCAL, IMAGE, CAMERA_BEHIND = 600.0, (640.0, 480.0), 0.12
MARKS = [(-0.05, -0.015, 0.0), (-0.05, 0.015, 0.0), (0.04, -0.012, 0.0), (0.04, 0.012, 0.0)]
GRIP_MAX, GRIP_SPEED = 0.10, 0.12


def quaternion_x(angle):
    return f"{math.cos(angle / 2)} {math.sin(angle / 2)} 0 0"


def arm(index, inside):
    """Link `index` and all that it carries. Its frame is at its far end; its joint is where the link before it ends."""
    if index == len(LINKS):
        return inside
    d, a, alpha = LINKS[index]
    (mass, com, inertia, rotor), (low, high) = MASSES[index], RANGES[index]
    s, c = math.sin(alpha), math.cos(alpha)
    # Rx(-alpha) of the joint's axis z, and of the way back to it.
    axis, at = f"0 {s} {c}", f"{-a} {-d * s} {-d * c}"
    shape = {
        1: '<geom class="robot" type="capsule" size="0.09" fromto="-0.4318 0 0.15 0 0 0.15"/>',
        3: '<geom class="robot" type="capsule" size="0.07" fromto="0 -0.43 0 0 0 0"/>',
        5: '<geom class="robot" type="capsule" size="0.05" fromto="0 0 0.03 0 0 0.08"/>',
    }.get(index, "")
    return f"""
    <body name="link{index + 1}" pos="{a} 0 {d}" quat="{quaternion_x(alpha)}" gravcomp="1">
      <joint name="q{index + 1}" axis="{axis}" pos="{at}" range="{low} {high}" armature="{rotor}" damping="1"/>
      <inertial mass="{mass}" pos="{com[0]} {com[1]} {com[2]}" diaginertia="{inertia[0]} {inertia[1]} {inertia[2]}"/>
      {shape}{arm(index + 1, inside)}
    </body>"""


def finger(name, side):
    """Moves along the tool's y axis, from the middle outwards."""
    return f"""
    <body name="{name}" gravcomp="1">
      <joint name="{name}" type="slide" axis="0 {side} 0" range="0 {GRIP_MAX / 2}" armature="0.2" damping="20"/>
      <geom class="pad" type="box" size="0.012 0.006 0.03" pos="0 {side * 0.006} -0.01" mass="0.05"/>
    </body>"""


# The fingers' rubber is three springs between wrist and hand, of the stiffness that `DoorWorld` has by default; encoders do not see them.
def model(mirror, push):
    """The whole world. `mirror`: +1 for a hinge on the left; `push`: whether the leaf goes away from the robot."""
    side, edge, hinge = -mirror, -mirror * (BEYOND + 0.01), mirror * (RADIUS + 0.01)
    width = RADIUS + BEYOND
    wall = lambda a, b: f'<geom class="wall" size="0.025 {abs(b - a) / 2} 1.2" pos="0.025 {(a + b) / 2} 1.2"/>'
    hand = f"""
      <body name="hand" pos="0 0 0.20" gravcomp="1">
        <joint type="slide" axis="1 0 0" stiffness="6000" damping="80"/>
        <joint type="slide" axis="0 1 0" stiffness="6000" damping="80"/>
        <joint type="slide" axis="0 0 1" stiffness="6000" damping="80"/>
        <site name="tool" size="0.005"/>
        <geom class="robot" type="box" size="0.05 0.05 0.02" pos="0 0 -0.08" mass="0.3"/>
        <geom class="pad" type="box" size="0.012 0.03 0.01" pos="0 0 -0.0175" mass="0.05"/>
        {finger("upper", 1)}{finger("lower", -1)}
      </body>"""
    sense = mirror if push else -mirror
    motors = "".join(
        f'<velocity joint="q{i + 1}" kv="{STIFF[i]}" forcerange="{-TORQUES[i]} {TORQUES[i]}"/>' for i in range(6)
    )
    # The leaf's frame: x along it from the hinge to its edge, y out of it towards the robot or away, z up.
    return f"""
<mujoco>
  <compiler angle="degree" autolimits="true"/>
  <option timestep="{STEP}" integrator="implicitfast" cone="elliptic" impratio="20" noslip_iterations="3"/>
  <default>
    <default class="robot"><geom contype="1" conaffinity="2" group="2" mass="0"/></default>
    <default class="wall"><geom type="box" contype="2" conaffinity="1" group="1" mass="0"/></default>
    <default class="pad"><geom contype="4" conaffinity="4" group="3" condim="6" friction="1.2 0.02 0.002"
      solref="0.012 1" solimp="0.9 0.95 0.002"/></default>
  </default>
  <worldbody>
    {wall(side * 2.5, edge)}{wall(hinge, mirror * 2.5)}
    <geom class="wall" size="2 0.025 1.2" pos="-2 2.525 1.2"/><geom class="wall" size="2 0.025 1.2" pos="-2 -2.525 1.2"/>
    <body name="leaf" pos="0 {mirror * RADIUS} 0">
      <joint name="leaf" axis="0 0 {sense}" range="-1 150" damping="1.5" frictionloss="1" solreflimit="0.004 1"/>
      <inertial mass="25" pos="0 {side * width / 2} 1" diaginertia="2 2 {max(INERTIA - 25 * (width / 2) ** 2, 0.5)}"/>
      <geom class="wall" size="0.002 {width / 2} 1.0" pos="0 {side * width / 2} 1.0"/>
      <body name="lever" pos="{-STANDOFF} {side * (RADIUS + LEVER)} {HEIGHT}">
        <joint name="lever" axis="{side} 0 0" range="0 45" armature="0.004" damping="0.05"/>
        <geom class="pad" type="box" size="0.0075 0.07 0.01" pos="0 {-side * 0.08} 0" mass="0.2"/>
        <site name="handle" pos="0 {-side * LEVER} 0" size="0.005"/>
      </body>
    </body>
    <body name="base">
      <joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/><joint name="yaw" axis="0 0 1"/>
      <inertial mass="150" pos="0 0 0.3" diaginertia="8 8 8"/>
      <geom class="robot" type="cylinder" size="0.31 0.40" pos="0 0 0.42"/>
      <body name="foot" pos="0 0 0.40">{arm(0, hand)}</body>
    </body>
  </worldbody>
  <equality>
    <joint name="latch" joint1="leaf" polycoef="0 0 0 0 0" solref="0.004 1"/>
    <joint joint1="upper" joint2="lower" polycoef="0 1 0 0 0"/>
  </equality>
  <actuator>
    <velocity joint="x" kv="{BASE_STIFF}" forcerange="{-TRACTION} {TRACTION}"/>
    <velocity joint="y" kv="{BASE_STIFF}" forcerange="{-TRACTION} {TRACTION}"/>
    <velocity joint="yaw" kv="1e4" forcerange="{-0.3 * TRACTION} {0.3 * TRACTION}"/>
    {motors}
    <motor joint="upper"/><motor joint="lower"/>
  </actuator>
</mujoco>"""


class Drive:
    """Velocities with a lag, limits, one owner at a time, and a watchdog."""

    def __init__(self, limits, lag):
        self.limits, self.lag = np.array(limits), lag
        self.rates, self.target = np.zeros(len(limits)), np.zeros(len(limits))
        self.owner, self.heard = None, -WATCHDOG

    def command(self, now, owner, rates):
        if self.owner not in (None, owner) and now - self.heard <= WATCHDOG:
            return
        self.owner, self.heard = owner, now
        if rates is None:
            self.owner, self.heard = None, now - 2 * WATCHDOG
        else:
            self.target = np.clip(rates, -self.limits, self.limits)

    def step(self, now, dt):
        target = self.target if now - self.heard <= WATCHDOG else 0.0
        self.rates = self.rates + (target - self.rates) * (1.0 - math.exp(-dt / self.lag))
        return self.rates


class Wrist:
    """What the hand touches, filtered; set to zero on demand."""

    def __init__(self):
        self.filtered, self.zero, self.zeroed, self.zeroing = np.zeros(6), np.zeros(6), 0, None
        self.offset = np.array([random.uniform(-3, 3) for _ in range(3)] + [random.uniform(-0.1, 0.1) for _ in range(3)])

    def step(self, wrench):
        self.filtered += (wrench - self.filtered) * (1.0 - math.exp(-2 * math.pi * 60.0 * STEP))
        if self.zeroing is not None:
            self.zeroing.append(self.filtered + self.offset)
            if len(self.zeroing) == 50:
                self.zero, self.zeroing, self.zeroed = np.mean(self.zeroing, axis=0), None, self.zeroed + 1

    def read(self):
        noise = np.array([random.gauss(0, 0.4) for _ in range(3)] + [random.gauss(0, 0.02) for _ in range(3)])
        return self.filtered + self.offset - self.zero + noise


class World:
    """Robot and door."""

    def __init__(self, arguments):
        random.seed(int(float(arguments.get("seed", 1))))
        self.mirror = 1 if arguments.get("side", "left") == "left" else -1
        self.model = mujoco.MjModel.from_xml_string(model(self.mirror, arguments.get("swing", "pull") == "push"))
        self.data = mujoco.MjData(self.model)
        joint = lambda name: self.model.joint(name).qposadr[0]
        names = ["x", "y", "yaw"] + [f"q{i + 1}" for i in range(6)]
        self.q = [joint(name) for name in names]
        self.v = [self.model.joint(name).dofadr[0] for name in names]
        self.leaf, self.lever = joint("leaf"), joint("lever")
        self.leaf_v, self.lever_v = (self.model.joint(name).dofadr[0] for name in ("leaf", "lever"))
        self.fingers = [joint("upper"), joint("lower")]
        self.latch = self.model.equality("latch").id
        self.held = {self.model.body(name).id for name in ("hand", "upper", "lower")}
        self.lever_body, self.base_body = self.model.body("lever").id, self.model.body("base").id
        self.bumped = False
        start = [-1.75 + random.uniform(-0.08, 0.08), 0.22 + random.uniform(-0.06, 0.06), -0.06 + random.uniform(-0.05, 0.05)]
        self.data.qpos[self.q] = start + START
        self.base, self.arm = Drive(LIMITS, BASE_LAG), Drive([1.4, 1.0, 1.8, 3.0, 3.0, 3.0], ARM_LAG)
        self.grip = {"owner": None, "heard": -WATCHDOG, "width": 0.0, "force": 40.0, "target": 0.0}
        self.wrist, self.now, self.due = Wrist(), None, {}
        self.casters = np.array([random.uniform(-3, 3) for _ in range(4)] + [0.0] * 4)
        self.peak = [0.0, 0.0, 0.0]  # of this window, of the one before, ever (N)
        bearings = np.radians(0.5 * np.arange(361) - 90.0)
        self.rays = np.stack([np.cos(bearings), np.sin(bearings), np.zeros(361)], axis=1)
        mujoco.mj_forward(self.model, self.data)

    def obey(self, now, orders):
        if order := orders.get("arm"):
            self.arm.command(now, order["owner"], order["rates"])
        if order := orders.get("base"):
            self.base.command(now, order["owner"], order["velocity"])
        if order := orders.get("gripper"):
            grip = self.grip
            if grip["owner"] in (None, order["owner"]) or now - grip["heard"] > WATCHDOG:
                grip["owner"], grip["heard"] = order["owner"], now
                if order["width"] is None:
                    grip["owner"] = None
                else:
                    # Fingers with an order to close continue to press, also if an object is between them.
                    width = order["width"] if order["width"] > 0 else -0.02
                    grip["target"], grip["force"] = min(width, GRIP_MAX), min(order["force"], 40.0)
        if (order := orders.get("ft")) and order["after"] == self.wrist.zeroed and self.wrist.zeroing is None:
            self.wrist.zeroing = []

    def advance(self, now):
        if self.now is None or now - self.now > 2_000_000_000:
            self.now = now
            self.due = self.due or dict.fromkeys(NAMES, now)
        while self.now + STEP_NS <= now:
            self.now += STEP_NS
            self.step()

    def step(self):
        data = self.data
        rates, yaw = self.base.step(self.now, STEP), data.qpos[self.q[2]]
        c, s = math.cos(yaw), math.sin(yaw)
        data.ctrl[0:3] = [c * rates[0] - s * rates[1], s * rates[0] + c * rates[1], rates[2]]
        data.ctrl[3:9] = self.arm.step(self.now, STEP)
        # The fingers follow their width, and press with no more than they are told.
        grip = self.grip
        step = GRIP_SPEED * STEP
        grip["width"] += min(max(grip["target"] - grip["width"], -step), step)
        wanted = 4000.0 * (grip["width"] / 2 - data.qpos[self.fingers[0]])
        data.ctrl[9:11] = min(max(wanted, -grip["force"]), grip["force"])
        angle, lever = data.qpos[self.leaf], data.qpos[self.lever]
        data.eq_active[self.latch] = angle < PLAY and lever < LATCH
        data.qfrc_applied[self.leaf_v] = -(CLOSER + CLOSER_RATE * angle) if angle > 0 else 0.0
        data.qfrc_applied[self.lever_v] = -(0.6 + 1.8 * lever)
        mujoco.mj_step(self.model, data)
        self.roll()
        wrench, collision = self.touch()
        self.wrist.step(wrench)
        force = max(np.linalg.norm(wrench[:3]), collision)
        if self.now % 40_000_000 < STEP_NS:
            self.peak[0:2] = [0.0, self.peak[0]]
        self.peak[0], self.peak[2] = max(self.peak[0], force), max(self.peak[2], force)

    def roll(self):
        """The casters roll and swing with the base, whose wheels are smaller than believed."""
        yaw, (x, y, w) = self.data.qpos[self.q[2]], self.data.qvel[self.v[:3]]
        c, s = math.cos(yaw), math.sin(yaw)
        vx, vy = c * x + s * y, c * y - s * x
        for i in range(4):
            phi, beta = self.casters[i], math.pi / 4 + math.pi / 2 * i
            turn = (-vx * math.sin(phi) + vy * math.cos(phi) + w * CASTER * math.cos(beta - phi)) / OFFSET - w
            roll = vx * math.cos(phi) + vy * math.sin(phi) + w * CASTER * math.sin(phi - beta)
            self.casters[i] += turn * STEP
            self.casters[i + 4] += roll / (WHEEL / (1 + WHEEL_ERROR)) * STEP

    def touch(self):
        """The wrench on the hand in the tool's frame, and the largest force between body and walls."""
        data, site = self.data, self.data.site("tool")
        wrench, collision, bumper = np.zeros(6), 0.0, 0.0
        for index in range(data.ncon):
            contact = data.contact[index]
            bodies = [self.model.geom_bodyid[geom] for geom in contact.geom]
            local = np.zeros(6)
            mujoco.mj_contactForce(self.model, data, index, local)
            frame = contact.frame.reshape(3, 3).T
            force, torque = frame @ local[:3], frame @ local[3:]
            is_hand = [body in self.held for body in bodies]
            if any(is_hand) and not all(is_hand):
                # The force is on the second geom.
                sign = 1.0 if is_hand[1] else -1.0
                wrench[:3] += sign * force
                wrench[3:] += sign * (torque + np.cross(contact.pos - site.xpos, force))
            elif not any(is_hand):
                collision = max(collision, np.linalg.norm(force))
                bumper = max(bumper, np.linalg.norm(force) if self.base_body in bodies else 0.0)
        self.bumped = bool(bumper > BUMPED)
        into = site.xmat.reshape(3, 3).T
        return np.concatenate([into @ wrench[:3], into @ wrench[3:]]), collision

    def sweep(self):
        yaw = self.data.qpos[self.q[2]]
        c, s = math.cos(yaw), math.sin(yaw)
        at = np.array([self.data.qpos[self.q[0]] + 0.3 * c, self.data.qpos[self.q[1]] + 0.3 * s, 0.9])
        rays = self.rays @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])
        group, ids, ranges = np.array([0, 1, 0, 0, 0, 0], dtype=np.uint8), np.zeros(1, np.int32), []
        for ray in rays:
            range_ = mujoco.mj_ray(self.model, self.data, at, ray, group, 1, -1, ids)
            seen = 0.0 <= range_ < 8.0
            ranges.append(min(max(range_ + random.gauss(0, 0.005), 0.0), 8.0) if seen else 8.0)
        return ranges

    def handle(self):
        """Where the lever is held: x along the lever, z into the door."""
        site, lever = self.data.site("handle"), self.data.body("lever")
        axes = lever.xmat.reshape(3, 3)
        along, into = axes @ [0, self.mirror, 0], axes @ [1, 0, 0]
        return site.xpos, np.stack([along, np.cross(into, along), into], axis=1)

    def look(self):
        at, axes = self.handle()
        tool = self.data.site("tool")
        turn, depth_error = tool.xmat.reshape(3, 3), 1.0 + random.gauss(0, 0.03)
        camera, marks = tool.xpos - turn @ [0, 0, CAMERA_BEHIND], []
        for mark in MARKS:
            place = at + axes @ np.array(mark)
            sight, (x, y, depth) = camera - place, turn.T @ (place - camera)
            if -axes[:, 2] @ sight <= 0.2 * np.linalg.norm(sight) or not 0.02 <= depth < 3.0:
                marks.append(None)
                continue
            u, v = x / depth * FOCAL + IMAGE[0] / 2, y / depth * FOCAL + IMAGE[1] / 2
            inside = 0 <= u < IMAGE[0] and 0 <= v < IMAGE[1]
            noisy = [min(max(p + random.gauss(0, 0.5), 0.0), size) for p, size in zip((u, v), IMAGE)]
            marks.append([*noisy, depth * depth_error] if inside else None)
        return marks

    def measure(self, device):
        data = self.data
        state = {"stamp": self.now}
        if device == "arm":
            state |= {"angles": data.qpos[self.q[3:]].tolist(), "rates": data.qvel[self.v[3:]].tolist()}
        elif device == "base":
            state |= {"steering": self.casters[:4].tolist(), "rolling": self.casters[4:].tolist(), "bumped": self.bumped}
        elif device == "ft":
            wrench = self.wrist.read().tolist()
            state |= {"force": wrench[:3], "torque": wrench[3:], "zeroed": self.wrist.zeroed}
        elif device == "gripper":
            width = float(sum(data.qpos[self.fingers]))
            state |= {"width": max(width, 0.0), "force": abs(float(data.ctrl[9]))}
        elif device == "laser":
            state |= {"ranges": self.sweep()}
        else:
            state |= {"marks": self.look()}
        return state

    def answer(self, now):
        said = {}
        for device in NAMES:
            if now >= self.due[device]:
                said[device] = self.measure(device)
            while self.due[device] <= now:
                self.due[device] += PERIODS[device] * 1_000_000
        at, axes = self.handle()
        tool = self.data.site("tool").xpos
        beside = np.linalg.norm((axes.T @ (tool - at))[:2])
        said["signals"] = [
            ["door angle", "deg", math.degrees(self.data.qpos[self.leaf]), True],
            ["contact force", "N", max(self.peak[:2]), True],
            ["peak force", "N", self.peak[2], True],
            ["lever angle", "deg", math.degrees(self.data.qpos[self.lever]), False],
            ["hand beside handle", "mm", 1e3 * beside, False],
            ["base beyond wall", "m", self.data.qpos[self.q[0]], False],
        ]
        return said
