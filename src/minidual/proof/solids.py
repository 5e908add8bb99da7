"""The geometry of a scene as the proof reads it: convex solids on the frames of the joints, and what must not touch.

It is read from coal's compiled scene, so it is what that engine sees; that it is also what MuJoCo sees is held by a test
over every kind of shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import numpy as np

from minidual.collision.coal_engine import CoalEngine
from minidual.collision.scene import PlanningScene
from minidual.proof import planes
from minidual.proof.planes import JOINT, PAIR, PART, SOLID
from minidual.proof.reach import Reaches
from minidual.robot.compiled import floats
from minidual.robot.constants import DOF, DOF_PER_ARM, Array

_BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_ENDS = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])


class Solids:
    """Convex solids of one scene, in the memory that `minidual.proof.planes` works on.

    Attributes:
        geometry: (joints, vertices, solids, parts, pairs), the first argument of every kernel.
        reach, first_joint: Of the parts that move, see `minidual.proof.reach`.
        pairs: Names of the pairs that must not touch, in the order of the scene.
    """

    def __init__(self, scene: PlanningScene, engine: CoalEngine) -> None:
        self.pairs = scene.checked_pairs
        reaches = Reaches(scene, engine)
        self.reach, self.first_joint = reaches.reach, reaches.first_joint
        vertices: list[Array] = []
        solids: list[tuple[Any, ...]] = []
        parts: list[tuple[Any, ...]] = []
        for name in scene.names:
            first = len(solids)
            balls: list[tuple[Array, float]] = []
            items = [engine.geometry.geometryObjects[k] for k in engine.items[name]]
            for item in items:
                points, ball, disc = _solid(item.geometry)
                points = points @ item.placement.rotation.T + item.placement.translation
                begin = sum(map(len, vertices))
                axis = item.placement.rotation[:, 2]
                solids.append((begin, begin + len(points), ball, disc, *axis))
                vertices.append(points)
                balls.append((points, ball + disc))
            # The mean of the vertices lies inside their hull: no farther from any axis than the part reaches.
            centre = np.vstack([points for points, _ in balls]).mean(axis=0)
            radius = np.max([np.linalg.norm(points - centre, axis=1).max() + more for points, more in balls])
            parts.append((first, len(solids), items[0].parentJoint, *centre, radius))
        self._parts = np.array(parts, dtype=PART)
        self._directions_n = 0
        model = engine.model
        joints = np.zeros(DOF, dtype=JOINT)
        for k in range(DOF):
            placement = model.jointPlacements[k + 1]
            joints[k] = (model.parents[k + 1], placement.rotation, placement.translation)
        self.geometry = (
            joints,
            np.vstack(vertices),
            np.array(solids, dtype=SOLID),
            self._parts,
            self._pairs(scene, reaches),
        )

    def _pairs(self, scene: PlanningScene, reaches: Reaches) -> np.ndarray:
        rows = {name: k for k, name in enumerate(scene.names)}
        counts = (self._parts["end"] - self._parts["first"]).tolist()
        frames = self._parts["frame"].tolist()
        pairs: list[tuple[int, ...]] = []
        for (name_a, name_b), moves in zip(scene.checked_pairs, reaches.moves, strict=True):
            a, b = rows[name_a], rows[name_b]
            one_arm = frames[a] and frames[b] and (frames[a] > DOF_PER_ARM) == (frames[b] > DOF_PER_ARM)
            frame = min(frames[a], frames[b]) if one_arm else 0
            pairs.append((a, b, frame, self._directions_n, *moves))
            self._directions_n += counts[a] * counts[b]
        return np.array(pairs, dtype=PAIR)

    def of_arms(self, arms: Sequence[str]) -> np.ndarray:
        """Return the rows of the pairs of which one part at least moves with one of these arms ("left", "right")."""
        frames = self._parts["frame"]
        moves = np.zeros(len(frames), dtype=bool)
        if "left" in arms:
            moves |= (frames > 0) & (frames <= DOF_PER_ARM)
        if "right" in arms:
            moves |= frames > DOF_PER_ARM
        pairs = self.geometry[4]
        return np.flatnonzero(moves[pairs["a"]] | moves[pairs["b"]])

    def directions(self) -> Array:
        """Return memory for the directions in which planes are sought, empty."""
        return np.zeros((self._directions_n, 3))

    def workspace(self) -> planes.Work:
        """Return memory for one state, the last argument of `planes.survey` and `planes.clearance`."""
        one = DOF + 1
        return (
            np.empty((1, one, 3, 3)),
            np.empty((1, one, 3)),
            np.empty((1, len(self._parts), 3)),
            np.empty((4, 3, 3)),
            np.empty((4, 3)),
            np.empty((4, 3)),
        )

    def clearance(self, Q: Array, most_m: float, rows: np.ndarray | None = None) -> float:
        """Return the smallest distance [m] at the rows of Q (n, 14) that is sure, at most `most_m`.

        Args:
            Q: Configurations.
            most_m: Pairs farther apart count as this far apart.
            rows: Rows of the pairs that count; all of them by default.
        """
        rows = np.arange(len(self.pairs)) if rows is None else rows
        found = planes.clearance(self.geometry, floats(Q), rows, most_m, self.directions(), self.workspace())
        return float(found)


def _solid(shape: Any) -> tuple[Array, float, float]:
    """Return vertices (n, 3) [m] in the frame of the shape, and the radii of the ball and of the disc about z."""
    match shape:
        case coal.Sphere():
            return np.zeros((1, 3)), shape.radius, 0.0
        case coal.Capsule():
            return _ENDS * shape.halfLength, shape.radius, 0.0
        case coal.Cylinder():
            return _ENDS * shape.halfLength, 0.0, shape.radius
        case coal.Box():
            return _BOX_CORNERS * shape.halfSide, 0.0, 0.0
        case coal.ConvexBase():
            return np.array(shape.points()), 0.0, 0.0
        case _:
            raise TypeError(f"no solid for a {type(shape).__name__}")
