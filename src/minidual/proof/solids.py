"""The proof's geometry: convex solids on joint frames.

If a joint turns by e, a point at distance r from its axis moves by at most r |e|. The reach bounds
r in any posture: link lengths plus the part's radius.
"""

import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from minidual.collision.engines import BOX_CORNERS, convex_solids, robot_geometry
from minidual.collision.scene import PlanningScene
from minidual.proof import planes
from minidual.proof.layout import (
    CLUSTER,
    JOINT,
    PAIR,
    PART,
    SOLID,
    Geometry,
    Padding,
    Workspace,
)
from minidual.robot.compiled import floats
from minidual.robot.kinematics import Kinematics, hinges, link_frame
from minidual.robot.pair import SIDES, Array, Robot

_ENDS = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
_CLUSTER_N = 8
"""Vertices of a cluster."""


class _Solid(NamedTuple):
    """A row of `SOLID`; cluster rows count from the part's first."""

    first: int
    end: int
    ball_m: float
    disc_m: float
    axis: list[float]


class _Part(NamedTuple):
    """A part in the frame of the joint that carries it.

    Attributes:
        clusters: `CLUSTER` records.
        frame: Number of the joint; 0: world.
        centre, radius_m: Bounding ball.
        reach_m: See `Geometry.reach` (n,).
    """

    clusters: np.ndarray
    solids: tuple[_Solid, ...]
    frame: int
    centre: list[float]
    radius_m: float
    reach_m: Array


class Solids:
    """One scene's convex solids; `geometry` is what the kernels read."""

    def __init__(self, scene: PlanningScene) -> None:
        self.robot = scene.robot
        self.pairs = scene.checked_pairs
        parts = dict(_robot_parts(self.robot)) | _scene_parts(scene)
        solid_rows: list[tuple[Any, ...]] = []
        part_rows: list[tuple[Any, ...]] = []
        clusters_n = 0
        for part in (parts[name] for name in scene.names):
            first = len(solid_rows)
            for solid in part.solids:
                place = (clusters_n + solid.first, clusters_n + solid.end)
                solid_rows.append((*place, solid.ball_m, solid.disc_m, solid.axis))
            part_rows.append((first, len(solid_rows), part.frame, part.centre, part.radius_m))
            clusters_n += len(part.clusters)
        self._parts = np.array(part_rows, dtype=PART)
        self.geometry = Geometry(
            joints=_joints(self.robot),
            clusters=np.concatenate([parts[name].clusters for name in scene.names]),
            solids=np.array(solid_rows, dtype=SOLID),
            parts=self._parts,
            pairs=self._pairs({name: k for k, name in enumerate(scene.names)}),
            reach=np.array([parts[name].reach_m for name in scene.names]),
        )

    def _pairs(self, part_rows: dict[str, int]) -> np.ndarray:
        """Return `PAIR` records of the checked pairs."""
        n = self.robot.dofs[0]
        frames = self._parts["frame"]
        width = self.robot.dof_most + 1
        still = len(frames) * width
        indices = [[part_rows[name] for name in pair] for pair in self.pairs]
        a, b = np.array(indices, dtype=int).reshape(-1, 2).T
        f = frames[a]
        g = frames[b]
        # Two parts of one arm are described in the inner one's frame.
        one_arm = (f > 0) & (g > 0) & ((f > n) == (g > n))
        inner = np.where(one_arm, np.minimum(f, g), 0)
        column = np.where(inner > n, inner - n, inner)
        moves_a = np.where((f > 0) & (~one_arm | (f >= g)), a * width + column, still)
        moves_b = np.where((g > 0) & (~one_arm | (f < g)), b * width + column, still)
        solids_n = self._parts["end"] - self._parts["first"]
        directions_n = solids_n[a] * solids_n[b]
        ends = np.cumsum(directions_n)
        self._directions_n = int(ends[-1]) if len(ends) else 0
        columns = np.column_stack([a, b, inner, ends - directions_n, moves_a, moves_b])
        return np.array([tuple(row) for row in columns.tolist()], dtype=PAIR)

    def of_arms(self, arms: Sequence[str]) -> np.ndarray:
        """Return the rows of the pairs with a part that one of these arms moves."""
        pairs = self.geometry.pairs
        frame = self._parts["frame"]
        arm = np.where(frame > self.robot.dofs[0], 2, np.minimum(frame, 1))  # 0 for fixed parts
        chosen = np.array([False, *(side in arms for side in SIDES)])
        moves = chosen[arm]
        return np.flatnonzero(moves[pairs["a"]] | moves[pairs["b"]])

    def workspace(self, states_n: int = 1) -> Workspace:
        """Allocate the kernels' memory.

        It is left untouched where it may be: a proof visits few of its states (1 of 9 ms).
        """
        frames_n = self.robot.dof + 1
        return Workspace(
            directions=np.zeros((self._directions_n, 3)),
            R=np.empty((states_n, frames_n, 3, 3)),
            p=np.empty((states_n, frames_n, 3)),
            centres=np.empty((states_n, len(self._parts), 3)),
            seen_R=np.empty((4, 3, 3)),
            seen_p=np.empty((4, 3)),
            simplex=np.empty((4, 3)),
        )

    def padding(self, padding_m: float) -> Padding:
        """Return one padding for every state."""
        return Padding(
            padding_m=float(padding_m),
            tight=np.zeros((0, self.robot.dof)),
            clearances_m=np.zeros(0),
            relax_rad=1.0,
        )

    def free(self, q: Array, padding_m: float = 0.0) -> bool:
        """Return whether all pairs are proven farther apart than `padding_m` at q (dof,)."""
        everything = np.arange(len(self.pairs))
        padding = self.padding(padding_m)
        free_n = planes.survey(
            self.geometry,
            floats(q[None]),
            everything,
            padding,
            self.workspace(),
        )
        return free_n == 1

    def clearance(self, Q: Array, most_m: float, rows: np.ndarray | None = None) -> float:
        """Return a lower bound [m] on the distance over Q (n, dof), at most `most_m`.

        `rows` selects pairs.
        """
        if rows is None:
            rows = np.arange(len(self.pairs))
        return float(planes.clearance(self.geometry, floats(Q), rows, most_m, self.workspace()))


@functools.cache
def _joints(robot: Robot) -> np.ndarray:
    parents = Kinematics(robot).model.parents
    placements = hinges(robot)[0]
    rows = [(parents[k], T.rotation, T.translation) for k, T in enumerate(placements, start=1)]
    return np.array(rows, dtype=JOINT)


@functools.cache
def _robot_parts(robot: Robot) -> dict[str, _Part]:
    """Return the links' parts by name. Cached: do not modify."""
    model = Kinematics(robot).model
    turns = hinges(robot)[1]
    items: dict[str, list[Any]] = {}
    for item in robot_geometry(robot).geometryObjects:
        items.setdefault(model.frames[item.parentFrame].name, []).append(item)
    parts: dict[str, _Part] = {}
    for name, own in items.items():
        pieces = [(item.geometry, turns[item.parentJoint] * item.placement) for item in own]
        parts[name] = _part(robot, own[0].parentJoint, pieces)
    return parts


def _scene_parts(scene: PlanningScene) -> dict[str, _Part]:
    """Return the parts of obstacles and held objects by name."""
    robot = scene.robot
    model = Kinematics(robot).model
    turns = hinges(robot)[1]
    parts: dict[str, _Part] = {}
    for solid in scene.solids:
        frame = model.frames[link_frame(model, solid.link)]
        link = turns[frame.parentJoint] * frame.placement
        place = link * pin.SE3(solid.shape.T_parent_shape)
        pieces = [(piece, place) for piece in convex_solids(solid.shape)]
        parts[solid.name] = _part(robot, frame.parentJoint, pieces)
    return parts


def _part(robot: Robot, frame: int, pieces: Sequence[tuple[Any, pin.SE3]]) -> _Part:
    """Return a part of convex pieces, each with its placement in the joint's frame."""
    points: list[Array] = []
    solids: list[_Solid] = []
    clusters: list[tuple[Array, float, Array]] = []
    for shape, place in pieces:
        corners, ball_m, disc_m = _corners(shape)
        points.append(corners @ place.rotation.T + place.translation)
        first = len(clusters)
        clusters += _clusters(points[-1])
        axis = place.rotation[:, 2].tolist()
        solids.append(_Solid(first, len(clusters), ball_m, disc_m, axis))

    def radius(centre: Array) -> float:
        return max(
            float(np.linalg.norm(own - centre, axis=1).max()) + solid.ball_m + solid.disc_m
            for own, solid in zip(points, solids, strict=True)
        )

    # The mean of the vertices lies inside their hull, so it is no farther from any axis than the
    # part reaches.
    centre = np.vstack(points).mean(axis=0)
    return _Part(
        clusters=np.array(clusters, dtype=CLUSTER),
        solids=tuple(solids),
        frame=frame,
        centre=centre.tolist(),
        radius_m=radius(centre),
        reach_m=_reach(robot, frame, radius(np.zeros(3))),
    )


def _reach(robot: Robot, frame: int, radius_m: float) -> Array:
    """Return a part's largest distance [m] from each joint of its arm; 0 if not moved.

    There are as many as joints of the arm that has more.

    `radius_m` is its radius about the origin of its frame.
    """
    joints = _joints(robot)
    left_n = robot.dofs[0]
    arm_base = 0 if frame <= left_n else left_n
    far = radius_m
    reach = np.zeros(robot.dof_most)
    for k in range(frame, arm_base, -1):
        reach[k - 1 - arm_base] = far
        far += float(np.linalg.norm(joints[k - 1]["p"]))
    return reach


def _clusters(points: Array) -> list[tuple[Array, float, Array]]:
    """Return rows of `CLUSTER`: points (n, 3), halved across their longest side until few."""
    if len(points) > _CLUSTER_N:
        longest = np.argmax(np.ptp(points, axis=0))
        order = np.argsort(points[:, longest], kind="stable")
        cut = 8 * ((len(points) + 8) // 16)
        return [*_clusters(points[order[:cut]]), *_clusters(points[order[cut:]])]
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    rows = np.minimum(np.arange(_CLUSTER_N), len(points) - 1)
    return [(centre, radius, points[rows])]


def _corners(shape: Any) -> tuple[Array, float, float]:
    """Return vertices (n, 3) [m] and the radii of ball and disc that thicken them."""
    match shape:
        case coal.Sphere():
            return np.zeros((1, 3)), shape.radius, 0.0
        case coal.Capsule():
            return _ENDS * shape.halfLength, shape.radius, 0.0
        case coal.Cylinder():
            return _ENDS * shape.halfLength, 0.0, shape.radius
        case coal.Box():
            return BOX_CORNERS * shape.halfSide, 0.0, 0.0
        case coal.ConvexBase():
            return np.array(shape.points()), 0.0, 0.0
        case _:
            raise TypeError(f"no solid for a {type(shape).__name__}")
