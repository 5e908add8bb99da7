"""Each reflex on the simulated arms: its name, where, its bound, and its latency, as docs/reflexes.md lists them."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.control import SupervisorConfig
from minidual.control.measurement import Measurement
from minidual.control.observer import Expected
from minidual.control.reflexes import REFLEXES
from minidual.control.supervisor import Supervisor
from minidual.control.tick_check import Violation
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.skills.supervised import SceneClearance, arm_distance
from tests.support.guarded_arms import GuardedArms, accelerate, begin_swing, swing
from tests.support.panda import DOF, HOME, JOINT_NAMES, Q_UPPER, TAU_MAX, TAU_RATE_MAX, V_MAX
from tests.support.stacks import nan_of

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reflexes.md"
LABELS = [
    f"{name}.{detail}" if detail else name
    for name, kind in REFLEXES.items()
    for detail in kind.causes
]
T0 = 0.1
"""When something begins that the test begins."""
Onset = Callable[[float, Array, Array], bool]
"""Whether the bound no longer holds at time t [s], q and v (n,)."""


def begun(t: float) -> bool:
    return t > T0 - 1e-4


class Timed(GuardedArms):
    """Guarded arms that note the first tick of the onset; `phase` is the tick of the first slow check."""

    phase = 0

    def __init__(
        self,
        world: World,
        supervisor: Supervisor,
        begins: Onset = lambda t, q, v: begun(t),
    ) -> None:
        super().__init__(world, supervisor)
        self.begins = begins
        self.onset_s = np.nan
        self._guard = supervisor.guard
        supervisor.guard = self._guarded  # type: ignore[method-assign]
        supervisor._space_check._next_hands = self.phase
        supervisor._space_check._next_stop = self.phase
        supervisor.observer._ticks = self.phase % 4

    def _guarded(self, measurement: Measurement, *rest: Any) -> Array:
        world = self.world
        if np.isnan(self.onset_s) and self.begins(world.time, world.q, world.v):
            self.onset_s = world.time
        return self._guard(measurement, *rest)

    def latency_ms(self) -> float:
        last_tick_s = self.world.time - self.world.dt  # one step was made after the reflex
        return 1e3 * (last_tick_s - self.onset_s)


def timed(
    world: World,
    begins: Onset = lambda t, q, v: begun(t),
    watches: dict[str, Any] | None = None,
    **config: Any,
) -> Timed:
    return Timed(world, Supervisor(SupervisorConfig(**config), **(watches or {})), begins)


def joint_position(world: World) -> Timed:
    def rests_beyond(_t: float, q: Array, v: Array) -> bool:
        rest = q + v * np.abs(v) / (2.0 * DUAL_PANDA.a_max)
        return bool((rest > Q_UPPER + 1e-3).any())

    arms = timed(world, rests_beyond)
    arms.run(2.0, accelerate(3, 4.0, until_s=0.4))
    assert world.q[3] < Q_UPPER[3]
    return arms


def joint_speed(world: World) -> Timed:
    arms = timed(world, lambda t, q, v: bool((np.abs(v) > V_MAX).any()))
    arms.run(1.0, accelerate(6, 12.0))
    return arms


def hand_speed(world: World) -> Timed:
    kinematics = Kinematics()

    def faster(_t: float, q: Array, v: Array) -> bool:
        speeds = [np.linalg.norm((J @ v)[:3]) for J in kinematics.tcp_jacobians(q)]
        return max(speeds) > 0.3

    arms = timed(world, faster, tcp_speed_max_m_per_s=0.3)
    arms.run(1.0, accelerate(0, 3.0))
    return arms


def torque(change: Callable[[float, Array], Array]) -> Callable[[World], Timed]:
    def make(world: World) -> Timed:
        arms = timed(world)
        arms.run(0.3, torque=lambda t, tau: change(t, tau) if begun(t) else tau)
        return arms

    return make


def too_large(_t: float, tau: Array) -> Array:
    return tau + 200.0 * np.eye(DOF)[8]


def chattering(t: float, tau: Array) -> Array:
    return tau + 5.0 * (-1.0) ** round(t * 1e3) * np.eye(DOF)[2]


def saturated(_t: float, tau: Array) -> Array:
    return np.where(np.arange(DOF) == 7, TAU_MAX, tau)


def reference(acceleration: float, **config: Any) -> Callable[[World], Timed]:
    def make(world: World) -> Timed:
        arms = timed(world, **config)

        def jumping(t: float) -> tuple[Array, Array, Array]:
            return HOME, np.zeros(DOF), begun(t) * acceleration * np.eye(DOF)[0]

        arms.run(0.2, jumping, tell_reference=True)
        return arms

    return make


def pushed(body: str, force: tuple[float, float, float]) -> Callable[[World], Timed]:
    def make(world: World) -> Timed:
        arms = timed(world)
        row = world.model.body(body).id

        def act(t: float) -> None:
            world.data.xfrc_applied[row, :3] = begun(t) * np.array(force)

        arms.run(0.3, before=act)
        world.data.xfrc_applied[:] = 0.0
        return arms

    return make


def joint_stuck(world: World) -> Timed:
    world = World(world.scene, model=copy.copy(world.model))
    arms = timed(world)
    dof = world.joints.qvel[1]

    def block(t: float) -> None:
        world.model.dof_damping[dof] = 1e5 if begun(t) else 0.1

    begin_swing(world)
    arms.run(0.3, swing, before=block)
    return arms


def tracking_error(world: World) -> Timed:
    moved = accelerate(5, 2.0)
    arms = timed(world, lambda t, q, v: bool((np.abs(q - moved(t)[0]) > 0.05).any()))
    arms.supervisor.expected = lambda: Expected(reference=moved(world.time)[0])
    gravity = Kinematics().gravity(HOME).copy()
    arms.run(0.5, moved, torque=lambda t, tau: np.where(np.arange(DOF) == 5, gravity, tau))
    return arms


def gripper_opened(world: World) -> Timed:
    arms = timed(world)

    def expected() -> Expected:
        fault = "the left hand: 0 of 60 N" if begun(world.time) else ""
        return Expected("closed hands", hand_fault=fault)

    arms.supervisor.expected = expected
    arms.run(0.2)
    return arms


def workspace(world: World) -> Timed:
    kinematics = Kinematics()

    def ahead(_t: float, q: Array, v: Array) -> bool:
        T = kinematics.tcp_poses(q)[0]
        J = kinematics.tcp_jacobians(q)[0]
        return float(T[1, 3] + 0.02 * (J @ v)[1]) > 0.4

    arms = timed(world, ahead, workspace_m=((-0.7, 1.1), (-1.1, 0.4), (-0.005, 1.3)))
    arms.run(2.0, accelerate(0, 1.0))
    assert kinematics.tcp_poses(world.q)[0][1, 3] < 0.4
    return arms


def converge(t: float) -> tuple[Array, Array, Array]:
    inwards = 0.5 * (np.eye(DOF)[7] - np.eye(DOF)[0])
    return HOME + 0.5 * t**2 * inwards, t * inwards, inwards


def near_arms(world: World) -> Timed:
    distance = arm_distance(DUAL_PANDA)
    near: Onset = lambda t, q, v: distance(q)[1] < 0.03  # noqa: E731
    arms = timed(world, near, {"self_distance": distance}, self_collision_min_m=0.03)
    arms.run(2.2, converge)
    return arms


def stop_ends_near(world: World) -> Timed:
    own = SceneClearance(DUAL_PANDA)
    stop = Supervisor()._stop

    def ends_near(_t: float, q: Array, v: Array) -> bool:
        _, distance, bound = own(stop.rest(q, v))
        return distance < bound

    arms = timed(world, lambda t, q, v: False, {"clearance": SceneClearance(DUAL_PANDA)})
    arms.run(2.2, converge)
    t = world.time
    while np.isnan(arms.onset_s):  # the reflex comes first: look at the same motion without it
        q, v, _ = converge(t)
        if ends_near(t, q, v):
            arms.onset_s = t
        t += world.dt
    return arms


def emergency_stop(world: World) -> Timed:
    arms = timed(world)

    def press(t: float) -> None:
        if begun(t):
            arms.supervisor.estop("red button")

    arms.run(0.2, before=press)
    return arms


def passivity(world: World) -> Timed:
    arms = timed(world)

    def report(t: float) -> None:
        if begun(t):
            arms.supervisor.report(Violation("passivity", "", "left arm for 0.5 s", -0.7, -0.5))

    arms.run(0.2, before=report)
    return arms


def not_finite(world: World) -> Timed:
    arms = timed(world)
    arms.run(0.2, senses=lambda t, q, v: (nan_of(1)(q) if begun(t) else q, v))
    return arms


def implausible(world: World) -> Timed:
    arms = timed(world)
    arms.run(0.2, senses=lambda t, q, v: (q + 0.05 * begun(t) * np.eye(DOF)[1], v))
    return arms


def stale(world: World) -> Timed:
    arms = timed(world)
    arms.plant.stamp = lambda t: min(t, T0 - world.dt)
    arms.run(0.2)
    return arms


def clock(world: World) -> Timed:
    arms = timed(world)
    arms.plant.clock = lambda t: min(t, T0 - world.dt)
    arms.run(0.2)
    return arms


def plant_failed(world: World) -> Timed:
    arms = timed(world)

    def fall_ill(t: float) -> None:
        arms.plant.health = "a drive is too hot" if begun(t) else ""

    arms.run(0.2, before=fall_ill)
    return arms


def controller_failed(world: World) -> Timed:
    arms = timed(world)
    arms.run(T0)
    arms.onset_s = world.time
    arms.fail("the law is singular")
    return arms


def stale_command(world: World) -> Timed:
    arms = timed(world)

    def speak(t: float) -> None:
        if t <= T0:
            arms.supervisor.heard(t)

    arms.run(0.3, before=speak)
    return arms


MAKERS: dict[str, Callable[[World], Timed]] = {
    "joint_position": joint_position,
    "speed.joint": joint_speed,
    "speed.hand": hand_speed,
    "torque.range": torque(too_large),
    "torque.rate": torque(chattering),
    "torque.saturation": torque(saturated),
    "reference.acceleration": reference(20.0),
    "reference.jerk": reference(10.0, jerk_reflex=True),
    "contact.joint": pushed("left_panda_link5", (0.0, 100.0, 0.0)),
    "contact.stuck": joint_stuck,
    "contact.hand": pushed("right_panda_hand", (0.0, 0.0, 30.0)),
    "tracking_error": tracking_error,
    "gripper_opened": gripper_opened,
    "clearance.workspace": workspace,
    "clearance.arms": near_arms,
    "clearance.stop": stop_ends_near,
    "emergency_stop": emergency_stop,
    "measurement.not_finite": not_finite,
    "measurement.implausible": implausible,
    "measurement.stale": stale,
    "measurement.clock": clock,
    "passivity": passivity,
    "plant_failed": plant_failed,
    "controller_failed": controller_failed,
    "stale_command": stale_command,
}
PLACES: dict[str, tuple[str, float | None]] = {
    "joint_position": ("left_panda_joint4", Q_UPPER[3]),
    "speed.joint": ("left_panda_joint7", V_MAX[6]),
    "speed.hand": ("left", 0.3),
    "torque.range": (JOINT_NAMES[8], TAU_MAX[8]),
    "torque.rate": ("left_panda_joint3 for 50 ms", TAU_RATE_MAX),
    "torque.saturation": ("right_panda_joint1 for 20 ms", TAU_MAX[7]),
    "reference.acceleration": ("left_panda_joint1", 15.0),
    "reference.jerk": ("left_panda_joint1", 7500.0),
    "contact.joint": ("free motion", 0.15 * 87.0),
    "contact.stuck": ("left_panda_joint2", 0.15 * 87.0),
    "contact.hand": ("the right hand", 20.0),
    "tracking_error": ("left_panda_joint6, free motion", 0.05),
    "gripper_opened": ("the left hand: 0 of 60 N", None),
    "clearance.workspace": ("y of the left hand", 0.4),
    "clearance.arms": ("with", 0.03),
    "clearance.stop": ("with", 0.005),
    "emergency_stop": ("red button", None),
    "measurement.not_finite": ("left_panda_joint2", None),
    "measurement.implausible": ("left_panda_joint2", None),
    "measurement.stale": ("joint positions and velocities", 0.02),
    "measurement.clock": ("after 0.099 s", None),
    "passivity": ("left arm for 0.5 s", -0.5),
    "plant_failed": ("a drive is too hot", None),
    "controller_failed": ("the law is singular", None),
    "stale_command": ("no command", 0.1),
}
"""Where each reflex names its cause, and its bound."""
MOST_MS = dict.fromkeys(LABELS, 0.0) | {
    "joint_position": 10.0,
    "speed.hand": 10.0,
    "clearance.workspace": 10.0,
    "contact.joint": 10.0,
    "contact.stuck": 10.0,
    "contact.hand": 30.0,
    "tracking_error": 54.0,
    "gripper_opened": 4.0,
    "clearance.stop": -10.0,
    "torque.rate": 51.0,
    "torque.saturation": 21.0,
    "measurement.stale": 21.0,
    "stale_command": 101.0,
}
PHASES = (0, 3, 6, 9)
"""Ticks of the first slow check, 10 ms apart; of the contact checks, 4 ms apart, they are all phases."""


def listed_ms(page: str, label: str) -> tuple[float, float]:
    """Return the least and the largest latency in the page's table."""
    cell = re.search(rf"^\| `{label}` \| [^|]+ \| ([^|]+) \|", page, re.MULTILINE)
    assert cell, f"no row of {label}"
    if cell[1] == "same tick":
        return 0.0, 0.0
    numbers = [float(number) for number in re.findall(r"\d+", cell[1])]
    if "before" in cell[1]:
        return -numbers[0], -numbers[-1]
    return numbers[0], numbers[-1]


@pytest.mark.parametrize("label", LABELS)
def test_a_reflex_comes_in_time_by_its_name_and_the_page_lists_its_latency(
    world: World,
    monkeypatch: pytest.MonkeyPatch,
    label: str,
) -> None:
    names = {label, "contact.joint"} if label == "contact.stuck" else {label}
    where, bound = PLACES[label]
    page = PAGE.read_text(encoding="utf-8").partition("### Latency")[2].partition("\n#")[0]
    listed = listed_ms(page, label)
    latencies = []
    for phase in PHASES[: 1 if listed == (0.0, 0.0) else None]:
        monkeypatch.setattr(Timed, "phase", phase)
        world.reset()
        arms = MAKERS[label](world)
        assert arms.error is not None
        reflex = arms.error.reflex
        assert reflex.label in names, reflex.text
        assert where in reflex.where
        assert reflex.bound == (None if bound is None else pytest.approx(bound, abs=1e-9))
        assert reflex.label in arms.error.message
        assert arms.error.remedy == REFLEXES[reflex.name].remedy
        assert np.isfinite(arms.error.tau).all()
        latencies.append(arms.latency_ms())
    assert max(latencies) <= MOST_MS[label] + 1e-6, latencies
    assert (min(latencies), max(latencies)) == pytest.approx(listed, abs=1.01)


def test_a_row_that_is_missing_is_seen() -> None:
    page = "| `clock` | x | same tick | y |\n| `a` | x | 5 to 50 ms | y |\n| `b` | x | 18 to 10 ms before | y |"
    assert listed_ms(page, "clock") == (0.0, 0.0)
    assert listed_ms(page, "a") == (5.0, 50.0)
    assert listed_ms(page, "b") == (-18.0, -10.0)
    with pytest.raises(AssertionError, match="no row of c"):
        listed_ms(page, "c")


def test_the_table_of_bounds_lists_every_reflex() -> None:
    page = PAGE.read_text(encoding="utf-8").partition("### Latency")[0]
    rows = re.findall(r"^\| (?:`([a-z_]+)` )?\| (?:`([a-z_]+)` )?\|", page, re.MULTILINE)
    listed = []
    name = ""
    for row_name, detail in rows:
        name = row_name or name
        listed.append(f"{name}.{detail}" if detail else name)
    assert sorted(listed) == sorted(LABELS)
