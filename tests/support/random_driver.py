"""A random driver over the supervised stack: sources, joints, hands and objects, halts, faults, recoveries.

In every tick one source at most, a bounded target, a finite torque that is near the last one, and speeds within the
limits; a latched stop ends at rest. An arm that is pushed may pass the limits for 200 ms: a push of 26 Nm rises at
once, the motors' torque by 1 Nm a tick.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from minidual.config.control import ArbiterConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import (
    HOLD,
    SOURCES,
    ArbiterState,
    JointCommand,
    ObjectCommand,
    ObjectMotion,
    TrajectoryCommand,
)
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.execution import ObjectExecution
from minidual.control.hand_impedance import InHand
from minidual.control.impedance import ObjectState
from minidual.control.reflexes import ReflexError
from minidual.control.stack import OBJECT_CONTROLLERS, ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array, pose
from minidual.skills.object_path import ObjectPath, Waypoint
from minidual.skills.supervised import SceneClearance
from tests.support.control_plant import HandsObject
from tests.support.panda import (
    DOF,
    HOME,
    Q_LOWER,
    Q_UPPER,
    TAU_MAX,
    TAU_RATE_MAX,
    V_MAX,
)
from tests.support.stacks import Arms, breaks, move

CONFIG = ArbiterConfig()
EVENTS = 40
TICKS = 20
REST_TICKS = 800
STILL_TICKS = 100
EXCUSED_S = 0.2
HANDS = ("left_hand", "right_hand")
SETS = (
    ("both_arms",),
    ("left_arm", "right_arm"),
    OBJECT_CONTROLLERS,
    OBJECT_CONTROLLERS,
    HANDS,
    ("left_arm", "right_hand"),
    ("left_hand", "right_arm"),
    ("left_arm",),  # refused, as the next one
    ("left_arm", "left_hand", "right_arm"),
)
GROUPS = ("both_arms", "both_arms", "left_arm", "right_arm")


class Path:
    """A straight lift whose poses can be replaced."""

    def __init__(self, here: Array) -> None:
        x, y, z = (float(value) for value in here[:3, 3])
        self._path = ObjectPath(
            Waypoint((x, y, z), 0.0, 0.0),
            [Waypoint((x, y, z + 0.1), 0.0, 0.8)],
        )
        self.duration_s = self._path.duration_s
        self.lie: Callable[[ObjectState, float], ObjectState] = lambda state, t: state

    def at(self, t_s: float) -> ObjectState:
        return self.lie(self._path.at(t_s), t_s)


def jumps(state: ObjectState, t_s: float) -> ObjectState:
    T = state.T_world_object.copy()
    T[0, 3] += 0.05 * (t_s > 0.42)
    return ObjectState(T, state.twist, state.acceleration)


class Driver:
    """One stack; `play` runs an episode from its seed and checks every tick."""

    def __init__(self, scene: SceneConfig) -> None:
        self.plant = Arms(scene)
        self.clearance = SceneClearance(DUAL_PANDA)
        self.supervisor = Supervisor(
            dt_s=self.plant.dt,
            self_distance=lambda q: self.distance(q),
            clearance=self.clearance,
        )
        self.distance: Callable[[Array], tuple[str, float]] = lambda q: ("a with b", 1.0)
        self.held = HandsObject(self.plant)
        self.stack = ControlStack(
            self.plant,
            Kinematics(),
            CONFIG,
            supervisor=self.supervisor,
            sensor=self.held,
        )
        self.seen: Counter[str] = Counter()
        self.did: Counter[str] = Counter()
        self.rare = RARE
        self.broken_listener = False
        self.stack.on_flush(self.flushed)

    def play(self, *seeds: int) -> None:
        for seed in seeds:
            self._play(seed)

    def _play(self, seed: int) -> None:
        self.rng = np.random.default_rng(seed)
        self.sequence = 0
        self.offered = []
        self.plant.lies.clear()
        self.plant.grip = np.zeros(2)
        self.plant.reset()
        self.distance = lambda q: ("a with b", 1.0)
        self.broken_listener = False
        self.stack.reset()
        self.stack.speed_override = 1.0
        self.told = self.stack.applied
        self.target = HOME
        self.allowed: str | None = None
        self.excused_s = np.zeros(2)
        names = list(self.rare)
        self._hold()
        first = SETS[self.rng.integers(len(SETS))]
        self._try(lambda: self.stack.request(SOURCES[self.rng.integers(3)], first))
        for _ in range(EVENTS):
            event = "speak" if self.rng.random() < 0.8 else names[self.rng.integers(len(names))]
            self.did[event] += 1
            (self.speak if event == "speak" else self.rare[event].__get__(self))()
            for _ in range(int(self.rng.integers(1, TICKS))):
                self.tick()
        if self.stack.reflex is not None:
            self.rest()

    def flushed(self, mode: str) -> None:
        fails = self.broken_listener
        self.broken_listener = False
        if fails:
            breaks()

    def tick(self) -> None:
        plant = self.plant
        stack = self.stack
        count = len(self.plant.torques)
        try:
            stack.step()
        except ReflexError as error:
            self.seen[error.reflex.label] += 1
        assert len(plant.torques) == count + 1, "a tick without torque"
        tau = plant.torques[-1]
        out = stack.output
        assert np.isfinite(tau).all()
        assert np.max(np.abs(tau) / TAU_MAX) <= 1.0 + 1e-9
        step = float(np.abs(tau - self.told).max())
        assert step <= TAU_RATE_MAX * plant.dt + 1e-9, f"the torque steps by {step:.2f} Nm"
        fastest = np.abs(self.v / V_MAX).reshape(2, -1).max(axis=1)
        most = np.where(self.excused_s < plant.steps * plant.dt, 1.1, 2.0)
        assert (fastest <= most).all(), f"faster than its limit: {fastest}"
        assert np.isfinite(out.q_target).all()
        assert ((out.q_target >= Q_LOWER) & (out.q_target <= Q_UPPER)).all()
        self.seen["object"] += any(isinstance(e, ObjectExecution) for e in out.executions)
        self.seen["hand"] += bool(out.active_source) and any(
            name in HANDS for name in stack.manager.active
        )
        if out.active_source is not None:
            self.seen[out.active_source] += 1
            assert out.active_source == stack.source
        if out.state is ArbiterState.ACTIVE and not out.executions:
            moved = float(np.abs(out.q_target - self.target).max())
            assert moved <= CONFIG.switch_step_max_rad + 1e-9, (
                f"the target steps by {moved:.2f} rad"
            )
        self.told = tau
        self.target = out.q_target

    @property
    def v(self) -> Array:
        """What the sensors do not tell: the true velocities."""
        return self.plant.true_v

    def excuse(self, arm: int) -> None:
        """Let an arm pass its speed limits for a while."""
        self.excused_s[arm] = self.plant.steps * self.plant.dt + EXCUSED_S

    def rest(self) -> None:
        """Go on until a latched stop has been at rest for a while, which it must be in time."""
        still = 0
        for _ in range(REST_TICKS):
            self.tick()
            speed = float(np.abs(self.v).max())
            # Velocities that freeze near rest damp nothing, and are noticed from 5 mrad in 0.1 s on.
            still = still + 1 if speed < (0.1 if "v" in self.plant.lies else 0.05) else 0
            if still == STILL_TICKS:
                return
        raise AssertionError(f"{self.stack.reflex}: not at rest, {speed:.2f} rad/s")

    # What may happen ----------------------------------------------------------------------------------------

    def speak(self) -> None:
        """The driving source, or any, says something sensible or not; afterwards it changes its arrays."""
        stack = self.stack
        rng = self.rng
        source = stack.source or SOURCES[rng.integers(3)]
        self.sequence += 1
        stack.affirm(source)
        q = stack.output.q_target + rng.uniform(-0.08, 0.08, DOF)
        gripper = rng.integers(0, 2, 2).astype(float)
        q = np.clip(q, Q_LOWER, Q_UPPER)
        kind = rng.random()
        if kind < 0.05:
            q[rng.integers(DOF)] = np.nan
        elif kind < 0.1:
            q += 4.0
        elif kind < 0.15:
            q = np.clip(q + 0.5, Q_LOWER, Q_UPPER)
        said = (gripper, self.plant.time, self.sequence)
        group = GROUPS[rng.integers(len(GROUPS))]
        joints = self.plant.robot.groups[group]
        if stack.manager.active == OBJECT_CONTROLLERS and kind > 0.2:
            path = self.object_path()
            if path is None:
                return
            command: Any = ObjectCommand(path, lambda t: 40.0 * min(1.0, t / 0.2), *said)
        elif 0.15 <= kind < 0.35:
            here = np.clip(stack.output.q_target, Q_LOWER, Q_UPPER)
            motion = move(here, np.clip(here + rng.uniform(-0.2, 0.2, DOF), Q_LOWER, Q_UPPER), 0.5)
            command = TrajectoryCommand(motion, *said, group)
            q = motion.q
        else:
            q = q[joints].copy()
            command = JointCommand(q, *said, group)
        self._try(lambda: stack.propose(source, command))
        if rng.random() < 0.3:
            q[:] = np.nan
            gripper[:] = np.nan

    def object_path(self) -> ObjectMotion | None:
        """Return a short straight path from the object, or a broken one; None if the object cannot be seen."""
        if "q" in self.plant.lies:
            return None
        lifted = Path(self.held.pose())
        lifted.lie = (lambda state, t: state, lambda state, t: state, jumps)[self.rng.integers(3)]
        return lifted

    def request(self) -> None:
        self._try(lambda: self.stack.request((*SOURCES, HOLD)[self.rng.integers(4)]))

    def switch(self) -> None:
        names = SETS[self.rng.integers(len(SETS))]
        if not self.plant.lies and self.stack.manager.active != OBJECT_CONTROLLERS:
            self._hold()
        self._try(lambda: self.stack.switch_controllers(names))

    def _hold(self) -> None:
        """Tell the laws what the hands hold: one object together, and a part each, a little off the plan."""
        self.stack.impedance.configure(self.held.held())
        for arm, hand in enumerate(self.stack.hands):
            if hand.name not in self.stack.manager.active:
                off = pose(np.eye(3), self.rng.uniform(-0.005, 0.005, 3))
                hand.law.held = InHand("part", off, np.eye(4))
                self.stack.payload.bear(arm, float(self.rng.uniform(0.0, 0.5)))

    def silence(self) -> None:
        """The plant's measurements claim to be old, or its health is bad."""
        if not self.plant.lies:
            age_s = float(self.rng.uniform(0.0, 0.2))
            self.plant.lies["stamp_s"] = lambda t: t - age_s

    def listener(self) -> None:
        """A listener of flushes fails once, at the next switch."""
        if self.stack.source is not None:
            self.broken_listener = True
            self._try(lambda: self.stack.request(HOLD))

    def halt(self) -> None:
        self.stack.halt(SOURCES[self.rng.integers(3)])

    def estop(self) -> None:
        self.supervisor.estop()

    def recover(self) -> None:
        """Often too early; then it must be refused."""
        moving = not self.plant.lies and float(np.abs(self.v).max()) >= CONFIG.still_speed_rad_s
        if self.stack.reflex is None:
            return
        if self.rng.random() < 0.5:
            self.rest()
            moving = False
            broken = dict(self.plant.lies)
            self.plant.lies.clear()
            self.distance = lambda q: ("a with b", 1.0)
            refused = self._try(self.stack.recover)
            if refused:
                self.plant.lies.update(broken)
        else:
            refused = self._try(self.stack.recover)
        assert refused or not moving, "recovered in motion"
        self.seen["recovered"] += not refused

    def blind(self) -> None:
        joints = self.rng.integers(0, DOF, 3)
        row = "qv"[self.rng.integers(2)]
        if self.plant.lies:
            return
        self.plant.lies[row] = lambda x: np.where(np.isin(np.arange(DOF), joints), np.nan, x)

    def push(self) -> None:
        """Something pushes one joint for 30 ms, or blocks it."""
        joint = int(self.rng.integers(DOF))
        if self.rng.random() < 0.5:
            self.plant.pushed[joint] = (
                (0.3 if joint % 7 < 4 else 0.5) * TAU_MAX[joint] * self.rng.choice([-1.0, 1.0])
            )
        else:
            self.plant.stuck[joint] = True
        for _ in range(30):
            self.excuse(joint // 7)
            self.tick()
        self.plant.touch_nothing()

    def override(self) -> None:
        self.stack.speed_override = float(self.rng.choice([0.1, 0.3, 1.0]))

    def dive(self) -> None:
        """The source drives the arms fast at the table or at one another; they never get there."""
        stack = self.stack
        ways = (np.eye(DOF)[1] + np.eye(DOF)[8], np.eye(DOF)[7] - np.eye(DOF)[0])
        if stack.source is None or stack.reflex is not None or self.plant.lies:
            return
        self._try(lambda: stack.switch_controllers(SETS[self.rng.integers(2)]))
        here = np.clip(stack.output.q_target, Q_LOWER, Q_UPPER)
        motion = move(here, np.clip(here + 1.5 * ways[self.rng.integers(2)], Q_LOWER, Q_UPPER), 1.4)
        self.sequence += 1
        stack.propose(
            stack.source,
            TrajectoryCommand(motion, np.ones(2), self.plant.time, self.sequence),
        )
        for k in range(1000):
            if not stack.executing or stack.source is None:
                break
            stack.affirm(stack.source)
            self.tick()
            if k % 20 == 0:
                pair, distance, bound = self.clearance(self.plant.true_q)
                assert distance > bound - 0.004, f"{pair}: {distance:.4f} m"

    def grip(self) -> None:
        """Both hands feel something between their fingers; then it is gone, or their drives fail."""
        plant = self.plant
        fails = self.rng.random() < 0.7
        for grip_n, limp in ((60.0, False), (0.0, fails)):
            plant.grip = np.full(2, grip_n)
            plant.limp = limp
            for _ in range(30):
                self.tick()
        plant.limp = False

    def bias(self) -> None:
        """An encoder jumps."""
        if not self.plant.lies and self.plant.steps > 0:
            off = 0.05 * np.eye(DOF)[self.rng.integers(DOF)]
            self.plant.lies["q"] = lambda x: x + off

    def glitch(self) -> None:
        """One packet is wrong by little or much, in one joint's position, velocity or both: no stop makes arms faster."""
        rng = self.rng
        stack = self.stack
        if self.plant.lies or self.plant.steps == 0 or stack.reflex is not None:
            return
        for _ in range(int(rng.integers(1, 300))):  # often until they rest
            self.tick()
        if stack.reflex is not None or stack.stopping:
            return
        joint = np.eye(DOF)[rng.integers(DOF)]
        which = rng.integers(1, 4)
        before = np.abs(self.v)
        off = rng.choice([-1.0, 1.0], 2) * 10.0 ** rng.uniform(
            [-3.0, -1.5],
            [0.0, 1.5],
        )  # rad, rad/s
        lies: dict[str, Any] = {
            "q": lambda x: x + off[0] * joint,
            "v": lambda x: x + off[1] * joint,
        }
        self.plant.lies.update({name: lies[name] for k, name in enumerate("qv") if which & 1 << k})
        self.tick()
        self.plant.lies.clear()
        if stack.reflex is None:
            return
        self.seen["glitch"] += 1
        for _ in range(300):
            self.tick()
            faster = float((np.abs(self.v) - before.max()).max())
            assert faster < 0.15, (
                f"{off} of joint {joint.argmax()} ({which}) makes a stop {faster:.2f} rad/s faster"
            )

    def flaky(self) -> None:
        """In a stop, some joints are measured now and then: the arms brake all the same."""
        rng = self.rng
        stack = self.stack
        if self.plant.lies or self.plant.steps == 0 or stack.reflex is not None:
            return
        for _ in range(int(rng.integers(1, 300))):
            self.tick()
        if stack.reflex is not None or stack.stopping:
            return
        joints = rng.integers(0, DOF, rng.integers(1, 4))
        share = rng.uniform(0.02, 0.6)
        began = np.abs(self.v).max()
        nothing = lambda x: np.where(np.isin(np.arange(DOF), joints), np.nan, x)  # noqa: E731
        self.supervisor.estop()
        for _ in range(400):
            self.plant.lies.update({"q": nothing, "v": nothing} if rng.random() < share else {})
            self.tick()
            self.plant.lies.clear()
        self.seen["flaky"] += bool(began > 0.3)
        speed = float(np.abs(self.v).max())
        assert speed < 0.1, (
            f"joints {joints}, unmeasured in {share:.0%}: {speed:.2f} rad/s after 0.4 s, {began:.2f} before"
        )

    def freeze(self) -> None:
        """Freeze all positions, or all velocities."""
        row = "qv"[self.rng.integers(2)]
        if not self.plant.lies:  # one sensor at a time
            kept = getattr(self.plant, row).copy()
            self.plant.lies[row] = lambda x: kept

    def clock(self) -> None:
        if (
            self.plant.lies or self.stack.reflex is not None
        ):  # stamps that stand during a stop blind both arms
            return
        now = self.plant.time
        way = self.rng.integers(3)
        self.plant.lies["time"] = lambda t: (now, now - 0.1, np.nan)[way]

    def fail(self) -> None:
        kind = self.rng.integers(3)
        if kind == 0 or self.plant.lies:
            self.stack.fail(ZeroDivisionError("a source"))
        elif kind == 1:
            self.plant.lies["q"] = breaks
        else:
            self.distance = breaks

    def _try(self, call: Callable[[], object]) -> bool:
        """Return whether it was refused."""
        try:
            call()
        except (
            UsageError,
            ControllerSwitchError,
            ZeroDivisionError,
        ):  # the last: a reading that fails, to its caller
            return True
        return False


def _named(*names: str) -> dict[str, Any]:
    return {name: getattr(Driver, name) for name in names}


RARE: dict[str, Any] = {
    **_named("request", "switch", "halt", "estop", "recover"),
    **_named("blind", "freeze", "clock", "fail", "silence", "listener"),
    **_named("push", "grip", "bias", "override", "dive"),
    "dive again": Driver.dive,
    "push again": Driver.push,
    "ask": Driver.request,
    "ask again": Driver.request,
    "recover again": Driver.recover,
}
FAST = _named("dive", "override", "request", "halt", "recover")
WRONG = _named("glitch", "request", "recover", "override", "halt")
WRONG |= {"glitch again": Driver.glitch, "glitch anew": Driver.glitch}
FLAKY = _named("flaky", "request", "recover", "override", "halt")
FLAKY |= {"flaky again": Driver.flaky, "flaky anew": Driver.flaky}
