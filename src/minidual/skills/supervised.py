"""The supervisor of a trial."""

import math
from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import cache

import numpy as np

from minidual.collision.engines import MujocoEngine
from minidual.collision.scene import PlanningScene
from minidual.collision.shapes import Attached, Pairs, Shape
from minidual.config.control import SupervisorConfig
from minidual.control.supervisor import OnReflex, Supervisor
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot, pose

_WITHIN_M = 0.15
_NEAR_M = 0.02
_APART_M = 0.005
_FINGERS_TO_TABLE_M = -0.006
_HELD_TO_TABLE_M = -0.008
"""Least distances where a stop ends: fingers grasp 1 mm above the table."""


@cache
def arm_distance(robot: Robot) -> Callable[[Array], tuple[str, float]]:
    """Return posture (n,) -> nearest parts of different arms ("left part with right part", [m]), cheap at 100 Hz.

    It says ("none", 0.15) beyond 150 mm.
    """
    left, right = (f"{side}_" for side in robot.sides)
    ordered = (sorted(pair) for pair in PlanningScene(robot=robot).checked_pairs)
    across = tuple((a, b) for a, b in ordered if a.startswith(left) and b.startswith(right))
    engine = MujocoEngine(Pairs(robot, across))
    anywhere = np.zeros([engine.model.nbody] * 2)
    return lambda q: engine.nearest(q, _WITHIN_M, anywhere)[:2]


@cache
def _engine(robot: Robot, shapes: tuple[Shape, ...]) -> MujocoEngine:
    hands = tuple(link for side in robot.sides for link in robot.hand_links(side))
    held = [
        replace(shape, name=_in_hand(shape, side))
        for shape, side in zip(shapes, robot.sides, strict=False)
    ]
    attached = [
        Attached(copy, tcp, hands) for copy, tcp in zip(held, robot.tcp_names, strict=False)
    ]
    scene = PlanningScene(robot=robot, attached=tuple(attached))
    if len({shape.name for shape in shapes}) > 1:
        scene = scene.allowing(held[0].name, held[1].name, "they are put together")
    return MujocoEngine(scene)


def _in_hand(shape: Shape, side: str) -> str:
    return f"{shape.name} in the {side} hand"


class SceneClearance:
    """See `Clearance`: arms, table, and what the hands hold: one shape for both, or one each."""

    def __init__(self, robot: Robot, *shapes: Shape) -> None:
        shapes = shapes * len(robot.sides) if len(shapes) == 1 else shapes
        self._engine = deepcopy(_engine(robot, shapes))
        self._held = [
            _in_hand(shape, side) for shape, side in zip(shapes, robot.sides, strict=False)
        ]
        body = self._engine.body_names.index
        fingers = [body(link) for side in robot.sides for link in robot.hand_links(side)[1:]]
        held = [body(name) for name in self._held]
        table = body("table")
        self._least_m = least_m = np.full([self._engine.model.nbody] * 2, _APART_M)
        least_m[held, :] = least_m[:, held] = 0.0
        least_m[fingers, table] = least_m[table, fingers] = _FINGERS_TO_TABLE_M
        least_m[held, table] = least_m[table, held] = _HELD_TO_TABLE_M
        lowered_m = least_m.copy()
        at_table = [*fingers, *held]
        lowered_m[at_table, table] = -math.inf
        lowered_m[table, at_table] = -math.inf
        self._usual_m = least_m
        self._lowered_m = lowered_m
        self.hold(None)

    def lower(self) -> None:
        """See `Clearance`."""
        self._least_m = self._lowered_m

    def hold(self, arm: int | None, T_tcp_shape: Array | None = None) -> None:
        """See `Clearance`."""
        self._least_m = self._usual_m
        for index, name in enumerate(self._held):
            away = pose(np.eye(3), (0.0, 0.0, 100.0 * (1 + index)))
            if arm in (None, index):
                self._engine.place(
                    name,
                    away if arm is None or T_tcp_shape is None else T_tcp_shape,
                )

    def __call__(self, q: Array) -> tuple[str, float, float]:
        """See `Clearance`; "none" beyond 20 mm."""
        return self._engine.nearest(q, _NEAR_M, self._least_m)


def trial_supervisor(
    config: SupervisorConfig,
    dt_s: float,
    robot: Robot,
    on_reflex: OnReflex | None = None,
    shapes: Sequence[Shape] = (),
) -> Supervisor:
    """Return a supervisor that also watches distances, with objects as in `SceneClearance`."""
    distances = {"self_distance": arm_distance(robot), "clearance": SceneClearance(robot, *shapes)}
    return Supervisor(
        config,
        dt_s=dt_s,
        kinematics=Kinematics(robot),
        on_reflex=on_reflex,
        **distances,
    )
