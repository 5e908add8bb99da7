"""How long each reflex takes from its onset, on the simulated arms; docs/reflexes.md tells the same numbers."""

from __future__ import annotations

import copy
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from minidual.config.control import SupervisorConfig
from minidual.control.observer import Expected
from minidual.control.reflexes import REFLEXES, ReflexError
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array
from minidual.skills.supervised import SceneClearance, arm_distance
from tests.support.guarded_arms import GuardedArms, accelerate, begin_swing, swing
from tests.support.panda import DOF, HOME, Q_UPPER, TAU_MAX, V_MAX

PAGE = Path(__file__).resolve().parents[2] / "docs" / "reflexes.md"
T0 = 0.1
"""When something begins that the test begins."""
Onset = Callable[[float, Array, Array], bool]
"""Whether the bound no longer holds at time t [s], q and v (n,)."""


class Timed(GuardedArms):
    """Guarded arms that note the first tick of the onset; `phase` is the tick of the first slow check."""

    phase = 0

    def __init__(
        self,
        world: World,
        supervisor: Supervisor,
        begins: Onset = lambda t, q, v: t > T0 - 1e-4,
    ) -> None:
        super().__init__(world, supervisor)
        self.begins = begins
        self.onset_s = np.nan
        self.guard = supervisor.guard  # type: ignore[method-assign]
        supervisor.guard = self._guard
        supervisor._next_slow = supervisor._next_ahead = self.phase
        supervisor._next_feel += self.phase % 4

    def _guard(self, time_s: float, q: Array, v: Array, *rest: Any) -> Array:
        if np.isnan(self.onset_s) and self.begins(self.world.time, q, v):
            self.onset_s = self.world.time
        return self.guard(time_s, q, v, *rest)

    def latency_ms(self, name: str) -> float:
        assert self.error is not None
        names = (
            {name, "contact.joint"} if name == "contact.stuck" else {name}
        )  # it has to come to a stand first
        assert self.error.reflex.label in names, self.error.message
        return 1e3 * (
            self.world.time - self.world.dt - self.onset_s
        )  # one step was made after the reflex


def turned(ramp: float, joint: int) -> Array:
    return ramp * np.eye(DOF)[joint]


def timed(
    world: World,
    begins: Onset | None = None,
    watches: dict[str, Any] | None = None,
    **config: Any,
) -> Timed:
    supervisor = Supervisor(SupervisorConfig(**config), **(watches or {}))
    return Timed(world, supervisor, *([] if begins is None else [begins]))


def late(t: float) -> float:
    return float(t > T0 - 1e-4)


def resting_beyond(_t: float, q: Array, v: Array) -> bool:
    return bool((q + v * np.abs(v) / (2.0 * DUAL_PANDA.a_max) > Q_UPPER + 1e-3).any())


def joint_position(world: World) -> Timed:
    arms = timed(world, resting_beyond)
    arms.run(2.0, accelerate(3, 4.0, until_s=0.4))
    return arms


def joint_velocity(world: World) -> Timed:
    arms = timed(world, lambda t, q, v: bool((np.abs(v) > V_MAX).any()))
    arms.run(1.0, accelerate(6, 12.0))
    return arms


def torque_range(world: World) -> Timed:
    arms = timed(world)
    arms.run(0.2, torque=lambda t, tau: tau + turned(200.0 * late(t), 8))
    return arms


def torque_rate(world: World) -> Timed:
    arms = timed(world)
    arms.run(0.3, torque=lambda t, tau: tau + turned(5.0 * late(t) * (-1.0) ** round(t * 1e3), 2))
    return arms


def torque_saturation(world: World) -> Timed:
    arms = timed(world)
    arms.run(
        0.3,
        torque=lambda t, tau: np.where((np.arange(DOF) == 7) & (late(t) > 0.0), TAU_MAX, tau),
    )
    return arms


def reference(**config: Any) -> Callable[[World], Timed]:
    def make(world: World) -> Timed:
        arms = timed(world, **config)
        jump = np.eye(DOF)[0] if config else 2.0 * np.eye(DOF)[0]
        still = lambda t: (HOME, np.zeros(DOF), 10.0 * late(t) * jump)  # noqa: E731
        arms.run(0.2, still, tell_reference=True)
        return arms

    return make


def hand_speed(kinematics: Kinematics, most: float) -> Onset:
    def faster(_t: float, q: Array, v: Array) -> bool:
        return any(float(np.linalg.norm((J @ v)[:3])) > most for J in kinematics.tcp_jacobians(q))

    return faster


def tcp_speed(world: World) -> Timed:
    arms = timed(world, hand_speed(Kinematics(), 0.3), tcp_speed_max_m_per_s=0.3)
    arms.run(1.0, accelerate(0, 3.0))
    return arms


def pushed(body: str, force: tuple[float, float, float]) -> Callable[[World], Timed]:
    def make(world: World) -> Timed:
        arms = timed(world)
        row = world.model.body(body).id

        def act(t: float) -> None:
            world.data.xfrc_applied[row, :3] = late(t) * np.array(force)

        arms.run(0.3, before=act)
        world.data.xfrc_applied[:] = 0.0
        return arms

    return make


def joint_stuck(world: World) -> Timed:
    world = World(world.scene, model=copy.copy(world.model))
    arms = timed(world)
    dof = world.joints.qvel[1]

    def block(t: float) -> None:
        world.model.dof_damping[dof] = 1e5 if late(t) else 0.1

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
    arms.supervisor.expected = lambda: Expected(
        "closed hands",
        hand_fault="0 of 60 N" if late(world.time) else "",
    )
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
    return arms


def converge(t: float) -> tuple[Array, Array, Array]:
    inwards = 0.5 * (np.eye(DOF)[7] - np.eye(DOF)[0])
    return HOME + 0.5 * t**2 * inwards, t * inwards, inwards


def self_collision(world: World) -> Timed:
    distance = arm_distance(DUAL_PANDA)
    near = lambda t, q, v: distance(q)[1] < 0.03  # noqa: E731
    arms = timed(world, near, {"self_distance": distance}, self_collision_min_m=0.03)
    arms.run(2.2, converge)
    return arms


def stopping_distance(world: World) -> Timed:
    clearance = SceneClearance(DUAL_PANDA)
    own = SceneClearance(DUAL_PANDA)
    arms = timed(world, watches={"clearance": clearance})
    stop = Supervisor()._stop

    def ends_near(_t: float, q: Array, v: Array) -> bool:
        _, distance, bound = own(stop.rest(q, v))
        return distance < bound

    arms.begins = ends_near
    arms.run(2.2, converge)
    t = world.time
    while np.isnan(arms.onset_s):  # it comes first; the onset is that of the same motion without it
        arms.onset_s = t if ends_near(t, *converge(t)[:2]) else np.nan
        t += world.dt
    return arms


def emergency_stop(world: World) -> Timed:
    arms = timed(world)
    pressed = []

    def press(t: float) -> None:
        if late(t) and not pressed:
            pressed.append(t)
            arms.supervisor.estop()

    arms.run(0.2, before=press)
    return arms


def measured(
    change: Callable[[float, Array, Array], tuple[Array, Array]],
) -> Callable[[World], Timed]:
    def make(world: World) -> Timed:
        arms = timed(world)
        arms.run(0.2, senses=change)
        return arms

    return make


def not_finite(t: float, q: Array, v: Array) -> tuple[Array, Array]:
    return q + (np.nan if late(t) else 0.0) * np.eye(DOF)[1], v


def jumps(t: float, q: Array, v: Array) -> tuple[Array, Array]:
    return q + 0.05 * late(t) * np.eye(DOF)[1], v


def stale_measurement(world: World) -> Timed:
    arms = timed(world)
    kept = (0.0, HOME, np.zeros(DOF))
    for _ in range(200):
        if not late(world.time):
            kept = world.time, world.q, world.v
        stamp_s, q, v = kept
        tau = arms.controller.torque(q, v, HOME, np.zeros(DOF), np.zeros(DOF))
        try:
            tau = arms.supervisor.guard(world.time, q, v, tau, None, stamp_s)
        except ReflexError as error:
            arms.error = error
            tau = error.tau
        arms._apply(tau)
        if arms.error is not None:
            break
    return arms


def clock(world: World) -> Timed:
    arms = timed(world)
    guard = arms.guard
    arms.guard = lambda time_s, *rest: guard(min(time_s, T0 - world.dt), *rest)
    arms.run(0.2)
    return arms


def controller_failed(world: World) -> Timed:
    arms = timed(world)
    arms.run(T0)
    arms.onset_s = world.time
    try:
        arms.supervisor.fail(world.time, world.q, world.v, "the law is singular")
    except ReflexError as error:
        arms.error = error
        arms._apply(error.tau)
    return arms


def stale_command(world: World) -> Timed:
    arms = timed(world)
    arms.run(0.3, before=lambda t: None if t > T0 else arms.supervisor.heard(t))
    return arms


MAKERS = {k: v for k, v in globals().items() if k in REFLEXES}
MAKERS |= {
    "reference.acceleration": reference(),
    "reference.jerk": reference(jerk_reflex=True),
    "contact.joint": pushed("left_panda_link5", (0.0, 100.0, 0.0)),
    "contact.hand": pushed("right_panda_hand", (0.0, 0.0, 30.0)),
    "not_finite": measured(not_finite),
    "measurement.implausible": measured(jumps),
}


PHASES = (0, 3, 6, 9)
"""Ticks of the first slow check, 10 ms apart; of the contact checks, 4 ms apart, they are all phases."""
MOST_MS = {
    **dict.fromkeys(REFLEXES, 0.0),  # in the tick that has the value
    **dict.fromkeys(("joint_position", "speed.hand", "workspace"), 10.0),
    **dict.fromkeys(("contact.joint", "contact.stuck"), 10.0),
    **{
        "contact.hand": 30.0,
        "tracking_error": 54.0,
        "gripper_opened": 4.0,
        "clearance.stop": -10.0,
    },
    **{
        "torque_rate": 51.0,
        "torque.saturation": 21.0,
        "measurement.stale": 21.0,
        "stale_command": 101.0,
    },
}


def told_ms(page: str, name: str) -> list[float]:
    """Return the least and the largest latency in the page's table."""
    cell = re.search(rf"^\| `{name}` \| [^|]+ \| ([^|]+) \|", page, re.MULTILINE)
    assert cell, f"no row of {name}"
    numbers = [float(number) for number in re.findall(r"\d+", cell[1])] or [0.0]
    assert (numbers == [0.0]) == (cell[1] == "same tick")
    return sorted(
        (-1.0 if "before" in cell[1] else 1.0) * number for number in (numbers[0], numbers[-1])
    )


@pytest.mark.parametrize("name", REFLEXES)
def test_a_reflex_comes_within_its_time_and_the_page_tells_it(
    world: World,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
) -> None:
    found = []
    for phase in PHASES:
        monkeypatch.setattr(Timed, "phase", phase)
        world.reset()
        found.append(MAKERS[name](world).latency_ms(name))
    assert max(found) <= MOST_MS[name] + 1e-6, found
    page = PAGE.read_text(encoding="utf-8").partition("### Latency")[2].partition("\n#")[0]
    assert [min(found), max(found)] == pytest.approx(told_ms(page, name), abs=1.01)


def test_a_row_that_is_missing_or_wrong_is_seen() -> None:
    page = "| `clock` | x | same tick | y |\n| `torque_rate` | x | 5 to 50 ms | y |\n| `a` | x | 18 to 10 ms before | y |"
    assert [told_ms(page, name) for name in ("clock", "torque_rate", "a")] == [
        [0.0, 0.0],
        [5.0, 50.0],
        [-18.0, -10.0],
    ]
    with pytest.raises(AssertionError, match="no row of tcp_speed"):
        told_ms(page, "speed.hand")
