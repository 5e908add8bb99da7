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
"""Distances of the arms beyond this are not computed."""
_NEAR_M = 0.02
"""Clearances beyond this are not computed."""
_APART_M = 0.005
_FINGERS_TO_TABLE_M = -0.006
_HELD_TO_TABLE_M = -0.008
"""Least distances where a stop ends: fingers grasp 1 mm above the table."""
_AWAY_M = 100.0
"""Height of a shape that no hand holds."""


@cache
def arm_distance(robot: Robot) -> Callable[[Array], tuple[str, float]]:
    """Return a function from a posture (n,) to the nearest parts of different arms.

    It returns ("left part with right part", distance [m]), or ("none", 0.15) beyond 150 mm, and is
    cheap at 100 Hz.
    """
    left, right = (f"{side}_" for side in robot.sides)
    across: list[tuple[str, str]] = []
    for pair in PlanningScene(robot=robot).checked_pairs:
        first, second = sorted(pair)
        if first.startswith(left) and second.startswith(right):
            across.append((first, second))
    engine = MujocoEngine(Pairs(robot, tuple(across)))
    anywhere = np.zeros([engine.model.nbody] * 2)

    def distance(q: Array) -> tuple[str, float]:
        pair, distance_m, *_ = engine.nearest(q, _WITHIN_M, anywhere)
        return pair, distance_m

    return distance


def _in_hand(shape: Shape, side: str) -> str:
    """Return the name of a hand's copy of a shape."""
    return f"{shape.name} in the {side} hand"


@cache
def _engine(robot: Robot, shapes: tuple[Shape, ...]) -> MujocoEngine:
    """Return an engine of the arms, the table and one shape a hand."""
    hands = tuple(link for side in robot.sides for link in robot.hand_links(side))
    attached: list[Attached] = []
    for shape, side, tcp in zip(shapes, robot.sides, robot.tcp_names, strict=False):
        held = replace(shape, name=_in_hand(shape, side))
        attached.append(Attached(held, tcp, hands))
    scene = PlanningScene(robot=robot, attached=tuple(attached))
    if len({shape.name for shape in shapes}) > 1:
        first, second = (held.name for held in attached)
        scene = scene.allowing(first, second, "they are put together")
    return MujocoEngine(scene)


class SceneClearance:
    """See `Clearance`: arms, table, and held objects.

    Args:
        robot: Arms.
        shapes: One shape for both hands, or one each.
    """

    def __init__(self, robot: Robot, *shapes: Shape) -> None:
        if len(shapes) == 1:
            shapes = shapes * len(robot.sides)
        self._engine = deepcopy(_engine(robot, shapes))
        self._held = [
            _in_hand(shape, side) for shape, side in zip(shapes, robot.sides, strict=False)
        ]
        index_of = self._engine.body_names.index
        fingers = [index_of(link) for side in robot.sides for link in robot.hand_links(side)[1:]]
        held = [index_of(name) for name in self._held]
        table = index_of("table")
        self._usual_m = self._least_distances(fingers, held, table)
        self._lowered_m = self._usual_m.copy()
        at_table = [*fingers, *held]
        self._lowered_m[at_table, table] = -math.inf
        self._lowered_m[table, at_table] = -math.inf
        self.hold(None)

    def _least_distances(self, fingers: list[int], held: list[int], table: int) -> Array:
        """Return the least distance [m] of each pair of bodies where a stop ends."""
        least_m = np.full([self._engine.model.nbody] * 2, _APART_M)
        least_m[held, :] = 0.0
        least_m[:, held] = 0.0
        least_m[fingers, table] = _FINGERS_TO_TABLE_M
        least_m[table, fingers] = _FINGERS_TO_TABLE_M
        least_m[held, table] = _HELD_TO_TABLE_M
        least_m[table, held] = _HELD_TO_TABLE_M
        return least_m

    def lower(self) -> None:
        """See `Clearance`."""
        self._least_m = self._lowered_m

    def hold(self, arm: int | None, T_tcp_shape: Array | None = None) -> None:
        """See `Clearance`."""
        self._least_m = self._usual_m
        for index, name in enumerate(self._held):
            if arm is not None and arm != index:
                continue
            if arm is None or T_tcp_shape is None:
                away_m = (0.0, 0.0, _AWAY_M * (1 + index))
                self._engine.place(name, pose(np.eye(3), away_m))
            else:
                self._engine.place(name, T_tcp_shape)

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
    return Supervisor(
        config,
        dt_s=dt_s,
        kinematics=Kinematics(robot),
        on_reflex=on_reflex,
        self_distance=arm_distance(robot),
        clearance=SceneClearance(robot, *shapes),
    )
