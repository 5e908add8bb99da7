"""A random driver over the supervised stack: sources, requests, halts, faults, recoveries, in seeded episodes.

In every tick one source at most, a bounded target, a finite torque that is near the last one, and speeds within the
limits; a latched stop ends at rest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from panda import DOF, HOME, JOINT_DAMPING, Q_LOWER, Q_UPPER, TAU_MAX, TAU_RATE_MAX, V_MAX
from test_control_broken import FailingPlant, breaks
from test_control_controllers import move

from minidual.config.arbiter import ArbiterConfig
from minidual.config.scene import SceneConfig
from minidual.control.commands import HOLD, SOURCES, ArbiterState, JointCommand, TrajectoryCommand
from minidual.control.controller_manager import ControllerSwitchError
from minidual.control.reflexes import ReflexError
from minidual.control.soft_stop import TorqueRate
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.errors import UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

CONFIG = ArbiterConfig()
EVENTS, TICKS, REST_TICKS = 40, 20, 800
SETS = (("both_arms",), ("left_arm", "right_arm"), ("object_impedance",), ("left_arm",))


class Arms(FailingPlant):
    """As MuJoCo, implicit in the joints' damping."""

    def __init__(self, scene: SceneConfig) -> None:
        super().__init__(scene)
        model = self._kinematics.model = self._kinematics.model.copy()  # all workspaces share the original
        model.armature = model.armature + self.dt * JOINT_DAMPING


class Driver:
    """One stack; `play` runs an episode from its seed and checks every tick."""

    def __init__(self, scene: SceneConfig) -> None:
        self.plant = Arms(scene)
        self.supervisor = Supervisor(dt_s=self.plant.dt, self_distance=lambda q: self.distance(q))
        self.distance: Callable[[Array], tuple[str, float]] = lambda q: ("a with b", 1.0)
        self.stack = ControlStack(self.plant, Kinematics(), CONFIG, supervisor=self.supervisor)
        self.seen: Counter[str] = Counter()

    def play(self, *seeds: int) -> None:
        for seed in seeds:
            self._play(seed)

    def _play(self, seed: int) -> None:
        self.rng, self.sequence, self.offered = np.random.default_rng(seed), 0, []
        self.plant.lies.clear()
        self.plant.reset()
        self.distance = lambda q: ("a with b", 1.0)
        self.stack.reset()
        self.told, self.target = self.supervisor._before_control(self.plant.q), HOME
        self.allowed: str | None = None
        names = list(RARE)
        for _ in range(EVENTS):
            event = "speak" if self.rng.random() < 0.8 else names[self.rng.integers(len(names))]
            (self.speak if event == "speak" else RARE[event].__get__(self))()
            for _ in range(int(self.rng.integers(1, TICKS))):
                self.tick()
        if self.stack.reflex is not None:
            self.rest()

    def tick(self) -> None:
        plant, stack, count = self.plant, self.stack, len(self.plant.torques)
        try:
            stack.step()
        except ReflexError as error:
            self.seen[error.reflex.name] += 1
        assert len(plant.torques) == count + 1, "a tick without torque"
        tau, out = plant.torques[-1], stack.output
        assert np.isfinite(tau).all()
        assert np.max(np.abs(tau) / TAU_MAX) <= 1.0 + 1e-9
        step = float(np.abs(tau - self.told).max())
        assert step <= TAU_RATE_MAX * plant.dt + 1e-9, f"the torque steps by {step:.2f} Nm"
        assert np.max(np.abs(self.v) / V_MAX) <= 1.1, "faster than its limit"
        assert np.isfinite(out.q_target).all()
        assert ((out.q_target >= Q_LOWER) & (out.q_target <= Q_UPPER)).all()
        if out.active_source is not None:
            self.seen[out.active_source] += 1
            assert out.active_source == stack.source
        if out.state is ArbiterState.ACTIVE and not out.executions:
            moved = float(np.abs(out.q_target - self.target).max())
            assert moved <= CONFIG.switch_step_max_rad + 1e-9, f"the target steps by {moved:.2f} rad"
        self.told, self.target = tau, out.q_target

    @property
    def v(self) -> Array:
        """What the sensors do not tell: the true velocities."""
        kept, self.plant.lies = self.plant.lies, {}
        v, self.plant.lies = self.plant.v, kept
        return v

    def rest(self) -> None:
        """Go on until a latched stop must be at rest."""
        for _ in range(REST_TICKS):
            self.tick()
        assert np.abs(self.v).max() < 0.05, f"{self.stack.reflex}: not at rest"

    # What may happen ----------------------------------------------------------------------------------------

    def speak(self) -> None:
        """The driving source, or any, says something sensible or not; afterwards it changes its arrays."""
        stack, rng = self.stack, self.rng
        source = stack.source or SOURCES[rng.integers(3)]
        self.sequence += 1
        stack.affirm(source)
        q, gripper = stack.output.q_target + rng.uniform(-0.08, 0.08, DOF), rng.integers(0, 2, 2).astype(float)
        q = np.clip(q, Q_LOWER, Q_UPPER)
        kind = rng.random()
        if kind < 0.05:
            q[rng.integers(DOF)] = np.nan
        elif kind < 0.1:
            q += 4.0
        elif kind < 0.15:
            q = np.clip(q + 0.5, Q_LOWER, Q_UPPER)
        command: Any = JointCommand(q, gripper, self.plant.time, self.sequence)
        if 0.15 <= kind < 0.35:
            here = np.clip(self.stack.output.q_target, Q_LOWER, Q_UPPER)
            motion = move(here, np.clip(here + rng.uniform(-0.2, 0.2, DOF), Q_LOWER, Q_UPPER), 0.5)
            command = TrajectoryCommand(motion, gripper, self.plant.time, self.sequence)
            q = motion.q
        stack.propose(source, command)
        if rng.random() < 0.3:
            q[:], gripper[:] = np.nan, np.nan

    def request(self) -> None:
        self._try(lambda: self.stack.request((*SOURCES, HOLD)[self.rng.integers(4)]))

    def switch(self) -> None:
        self._try(lambda: self.stack.switch_controllers(SETS[self.rng.integers(len(SETS))]))

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
            self.plant.lies.clear()
            self.distance = lambda q: ("a with b", 1.0)
        refused = self._try(self.stack.recover)
        assert refused or not moving, "recovered in motion"
        self.seen["recovered"] += not refused

    def blind(self) -> None:
        joints, row = self.rng.integers(0, DOF, 3), "qv"[self.rng.integers(2)]
        if self.plant.lies:
            return
        self.plant.lies[row] = lambda x: np.where(np.isin(np.arange(DOF), joints), np.nan, x)

    def freeze(self) -> None:
        """Freeze all positions, or all velocities: an arm that has lost both can only be held by its model."""
        row = "qv"[self.rng.integers(2)]
        if not self.plant.lies:  # one sensor at a time
            kept = getattr(self.plant, row).copy()
            self.plant.lies[row] = lambda x: kept

    def clock(self) -> None:
        if self.plant.lies or self.stack.reflex is not None:  # stamps that stand during a stop blind both arms
            return
        now, way = self.plant.time, self.rng.integers(3)
        self.plant.lies["time"] = lambda t: (now, now - 0.1, np.nan)[way]

    def fail(self) -> None:
        kind = self.rng.integers(3)
        if kind == 0 or self.plant.lies:
            self.stack.fail(ZeroDivisionError("a source"))
        elif kind == 1:
            self.plant.lies["q"] = breaks
        else:
            self.distance = breaks

    def _try(self, call: Callable[[], None]) -> bool:
        """Return whether it was refused."""
        try:
            call()
        except (UsageError, ControllerSwitchError, ZeroDivisionError):  # the last: a reading that fails, to its caller
            return True
        return False


RARE: dict[str, Any] = {
    **{name: getattr(Driver, name) for name in ("request", "switch", "halt", "estop", "recover")},
    **{name: getattr(Driver, name) for name in ("blind", "freeze", "clock", "fail")},
    "ask": Driver.request,
    "ask again": Driver.request,
    "recover again": Driver.recover,
}


@pytest.fixture
def driver(scene: SceneConfig) -> Driver:
    return Driver(scene)


def test_random_episodes_keep_every_rule(driver: Driver) -> None:
    driver.play(*range(5))
    assert driver.seen["recovered"] > 0
    assert {"teleop", "policy", "controller_failed"} & set(driver.seen)


@pytest.mark.slow
@pytest.mark.parametrize("block", range(5))
def test_five_thousand_random_episodes_keep_every_rule(driver: Driver, block: int) -> None:
    driver.play(*range(1000 * (block + 1), 1000 * (block + 2)))
    reflexes = {"controller_failed", "emergency_stop", "clock", "not_finite", "implausible_measurement"}
    assert {*reflexes, *SOURCES, "recovered"} <= set(driver.seen)


def test_the_driver_sees_a_torque_that_jumps(driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TorqueRate, "limit", lambda self, tau: setattr(self, "tau", tau) or tau)
    with pytest.raises(AssertionError, match="torque steps"):
        driver.play(*range(5))


def test_the_driver_sees_a_lost_torque(driver: Driver, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ControlStack, "_attempt", lambda self, part, otherwise: part())
    with pytest.raises((AssertionError, ZeroDivisionError, UsageError)):
        driver.play(*range(5))
