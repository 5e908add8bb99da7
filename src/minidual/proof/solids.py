"""The proof's geometry: convex solids on joint frames.

If a joint turns by e, a point at distance r from its axis moves by at most r |e|. The reach bounds r in any posture:
link lengths plus the part's radius.
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
from minidual.robot.compiled import floats
from minidual.robot.kinematics import Kinematics, hinges
from minidual.robot.pair import SIDES, Array, Robot

_ENDS = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])


class _Part(NamedTuple):
    """Clusters in a joint's frame; rows of `planes.SOLID`, counted from 0, of `planes.PART` and reach."""

    clusters: np.ndarray
    solids: tuple[tuple[Any, ...], ...]
    ball: tuple[Any, ...]
    reach: Array


class Solids:
    """One scene's convex solids; `geometry` is the kernels' first argument."""

    def __init__(self, scene: PlanningScene) -> None:
        self.robot = scene.robot
        self.pairs = scene.checked_pairs
        model = Kinematics(self.robot).model
        turns = hinges(self.robot)[1]
        parts = dict(_robot_parts(self.robot))
        for solid in scene.solids:
            frame = model.frames[model.getFrameId(solid.link)]
            place = turns[frame.parentJoint] * frame.placement * pin.SE3(solid.shape.T_parent_shape)
            pieces = [(piece, place) for piece in convex_solids(solid.shape)]
            parts[solid.name] = _part(self.robot, frame.parentJoint, pieces)
        rows: list[tuple[Any, ...]] = []
        balls: list[tuple[Any, ...]] = []
        end = 0
        for part in (parts[name] for name in scene.names):
            balls.append((len(rows), len(rows) + len(part.solids), *part.ball))
            rows += [(end + first, end + last, *shape) for first, last, *shape in part.solids]
            end += len(part.clusters)
        self._parts = np.array(balls, dtype=planes.PART)
        self.geometry = (
            _joints(self.robot),
            np.concatenate([parts[name].clusters for name in scene.names]),
            np.array(rows, dtype=planes.SOLID),
            self._parts,
            self._pairs({name: k for k, name in enumerate(scene.names)}),
            np.array([parts[name].reach for name in scene.names]),
        )

    def _pairs(self, rows: dict[str, int]) -> np.ndarray:
        n = self.robot.dof_per_arm
        frames = self._parts["frame"]
        width = n + 1
        still = len(frames) * (n + 1)
        a, b = (
            np.array([[rows[name] for name in pair] for pair in self.pairs], dtype=int)
            .reshape(-1, 2)
            .T
        )
        f = frames[a]
        g = frames[b]
        # Two parts of one arm are described in the inner one's frame.
        one_arm = (f > 0) & (g > 0) & ((f > n) == (g > n))
        inner = np.where(one_arm, np.minimum(f, g), 0)
        seen = np.where(inner > n, inner - n, inner)
        moves_a = np.where((f > 0) & (~one_arm | (f >= g)), a * width + seen, still)
        moves_b = np.where((g > 0) & (~one_arm | (f < g)), b * width + seen, still)
        counts = self._parts["end"] - self._parts["first"]
        ends = np.cumsum(counts[a] * counts[b])
        self._directions_n = int(ends[-1]) if len(ends) else 0
        columns = np.column_stack([a, b, inner, ends - counts[a] * counts[b], moves_a, moves_b])
        return np.array([tuple(row) for row in columns.tolist()], dtype=planes.PAIR)

    def of_arms(self, arms: Sequence[str]) -> np.ndarray:
        """Return pairs moved by these arms."""
        n = self.robot.dof_per_arm
        pairs = self.geometry[4]
        arm = (self._parts["frame"] + n - 1) // n  # 0 for fixed parts
        moves = np.array([False, *(side in arms for side in SIDES)])[arm]
        return np.flatnonzero(moves[pairs["a"]] | moves[pairs["b"]])

    def workspace(self, states_n: int = 1) -> planes.Work:
        """Allocate the kernels' memory, untouched: most states of a proof are never asked for (1 of 9 ms)."""
        R, p = (np.empty((states_n, self.robot.dof + 1, *size)) for size in ((3, 3), (3,)))
        centres = np.empty((states_n, len(self._parts), 3))
        return (
            np.zeros((self._directions_n, 3)),
            R,
            p,
            centres,
            np.empty((4, 3, 3)),
            np.empty((4, 3)),
            np.empty((4, 3)),
        )

    def keep(self, padding_m: float) -> planes.Keep:
        """Return one padding for every state."""
        return float(padding_m), np.zeros((0, self.robot.dof)), np.zeros(0), 1.0

    def free(self, q: Array, padding_m: float = 0.0) -> bool:
        """Return whether all pairs are proven farther apart than `padding_m`."""
        everything = np.arange(len(self.pairs))
        return (
            planes.survey(
                self.geometry,
                floats(q[None]),
                everything,
                self.keep(padding_m),
                self.workspace(),
            )
            == 1
        )

    def clearance(self, Q: Array, most_m: float, rows: np.ndarray | None = None) -> float:
        """Return a lower bound [m] on the distance over Q (n, dof), at most `most_m`.

        `rows` selects pairs.
        """
        rows = np.arange(len(self.pairs)) if rows is None else rows
        return float(planes.clearance(self.geometry, floats(Q), rows, most_m, self.workspace()))


@functools.cache
def _joints(robot: Robot) -> np.ndarray:
    parents = Kinematics(robot).model.parents
    rows = [
        (parents[k], T.rotation, T.translation) for k, T in enumerate(hinges(robot)[0], start=1)
    ]
    return np.array(rows, dtype=planes.JOINT)


@functools.cache
def _robot_parts(robot: Robot) -> dict[str, _Part]:
    model = Kinematics(robot).model
    turns = hinges(robot)[1]
    pieces: dict[str, list[Any]] = {}
    for item in robot_geometry(robot).geometryObjects:
        pieces.setdefault(model.frames[item.parentFrame].name, []).append(item)
    return {
        name: _part(
            robot,
            own[0].parentJoint,
            [(i.geometry, turns[i.parentJoint] * i.placement) for i in own],
        )
        for name, own in pieces.items()
    }


def _part(robot: Robot, frame: int, solids: Sequence[tuple[Any, pin.SE3]]) -> _Part:
    points: list[Array] = []
    rows: list[tuple[Any, ...]] = []
    clusters: list[tuple[Array, float, Array]] = []
    for shape, place in solids:
        corners, ball, disc = _corners(shape)
        points.append(corners @ place.rotation.T + place.translation)
        first = len(clusters)
        clusters += _clusters(points[-1])
        rows.append((first, len(clusters), ball, disc, place.rotation[:, 2].tolist()))

    def radius(centre: Array) -> float:
        return max(
            float(np.linalg.norm(own - centre, axis=1).max()) + ball + disc
            for own, (_, _, ball, disc, _) in zip(points, rows, strict=True)
        )

    # The mean of the vertices lies inside their hull, so it is no farther from any axis than the part reaches.
    centre = np.vstack(points).mean(axis=0)
    joints = _joints(robot)
    n = robot.dof_per_arm
    far = radius(np.zeros(3))
    reach = np.zeros(n)  # largest distances [m] from the arm's joints; 0 if not moved
    for k in range(frame, 0 if frame <= n else n, -1):
        reach[(k - 1) % n] = far
        far += float(np.linalg.norm(joints[k - 1]["p"]))
    return _Part(
        np.array(clusters, dtype=planes.CLUSTER),
        tuple(rows),
        (frame, centre.tolist(), radius(centre)),
        reach,
    )


def _clusters(points: Array) -> list[tuple[Array, float, Array]]:
    """Return rows of `planes.CLUSTER`: points (n, 3) halved across their longest side until few are left."""
    if len(points) > 8:
        order = np.argsort(points[:, np.argmax(np.ptp(points, axis=0))], kind="stable")
        cut = 8 * ((len(points) + 8) // 16)
        return [*_clusters(points[order[:cut]]), *_clusters(points[order[cut:]])]
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    radius = float(np.linalg.norm(points - centre, axis=1).max())
    return [(centre, radius, points[np.minimum(np.arange(8), len(points) - 1)])]


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
