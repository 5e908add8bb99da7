"""The supervisor of a trial."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from minidual.collision.engine import Pairs
from minidual.collision.mujoco_engine import MujocoEngine
from minidual.collision.scene import PlanningScene
from minidual.config.supervisor import SupervisorConfig
from minidual.control.supervisor import OnReflex, Supervisor
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot

_WITHIN_M = 0.15


@cache
def arm_distance(robot: Robot) -> Callable[[Array], tuple[str, float]]:
    """Return posture (n,) -> nearest parts of different arms ("left part with right part", [m]), cheap at 100 Hz.

    It says ("none", 0.15) beyond 150 mm.
    """
    left, right = (f"{side}_" for side in robot.sides)
    ordered = (sorted(pair) for pair in PlanningScene(robot=robot).checked_pairs)
    across = tuple((a, b) for a, b in ordered if a.startswith(left) and b.startswith(right))
    engine = MujocoEngine(Pairs(robot, across))

    def nearest(q: Array) -> tuple[str, float]:
        pairs = engine.closest(q, _WITHIN_M)
        return (f"{pairs[0].first} with {pairs[0].second}", pairs[0].distance_m) if pairs else ("none", _WITHIN_M)

    return nearest


def trial_supervisor(
    config: SupervisorConfig, dt_s: float, robot: Robot, on_reflex: OnReflex | None = None
) -> Supervisor:
    """Return a supervisor that also watches the arm distance."""
    distance = arm_distance(robot)
    return Supervisor(config, dt_s=dt_s, kinematics=Kinematics(robot), self_distance=distance, on_reflex=on_reflex)
