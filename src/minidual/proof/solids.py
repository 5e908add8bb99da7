"""The proof's geometry: convex solids on joint frames.

If joint j turns by e, a point at distance r from its axis moves by at most r |e|. The reach bounds r in any posture by
link lengths plus the part's radius.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from minidual.collision.coal_engine import convex_solids, robot_geometry
from minidual.collision.scene import PlanningScene
from minidual.proof import planes
from minidual.proof.planes import JOINT, PAIR, PART, SOLID
from minidual.robot.compiled import floats
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot

_BOX_CORNERS = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
_ENDS = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class _Solid:
    """Vertices (n, 3) [m] in a joint's frame, thickening radii, disc axis."""

    points: Array
    ball: float
    disc: float
    axis: tuple[float, float, float]


class Solids:
    """One scene's convex solids; `geometry` is the kernels' first argument."""

    def __init__(self, scene: PlanningScene) -> None:
        self.robot, self.pairs = scene.robot, scene.checked_pairs
        model, chain = Kinematics(self.robot).model, _chain(self.robot)
        solids = dict(_robot_solids(self.robot))
        for shape in scene.solid_obstacles:
            solids[shape.name] = 0, _placed(shape, pin.SE3(shape.T_parent_shape))
        for held in scene.attached:
            frame = model.frames[model.getFrameId(held.link)]
            on_frame = chain.turns[frame.parentJoint] * frame.placement
            solids[held.name] = frame.parentJoint, _placed(held.shape, on_frame * pin.SE3(held.shape.T_parent_shape))
        vertices: list[Array] = []
        rows: list[tuple[Any, ...]] = []
        parts: list[tuple[Any, ...]] = []
        reaches: list[Array] = []
        end = 0
        for name in scene.names:
            frame, own = solids[name]
            first = len(rows)
            for solid in own:
                begin, end = end, end + len(solid.points)
                rows.append((begin, end, solid.ball, solid.disc, *solid.axis))
                vertices.append(solid.points)
            # The mean of the vertices lies inside their hull, so it is no farther from any axis than the part reaches.
            centre = np.vstack([solid.points for solid in own]).mean(axis=0)
            parts.append((first, len(rows), frame, *centre, _radius(own, centre)))
            reaches.append(self._reach(chain.joints, frame, _radius(own, np.zeros(3))))
        self._parts = np.array(parts, dtype=PART)
        self.geometry = (
            chain.joints,
            np.vstack(vertices),
            np.array(rows, dtype=SOLID),
            self._parts,
            self._pairs({name: k for k, name in enumerate(scene.names)}),
            np.array(reaches),
        )

    def _reach(self, joints: np.ndarray, frame: int, radius: float) -> Array:
        """Return (dof / 2,) [m], largest distances from the arm's joints; 0 if not moved."""
        n = self.robot.dof_per_arm
        reach = np.zeros(n)
        for k in range(frame, 0 if frame <= n else n, -1):
            reach[(k - 1) % n] = radius
            radius += float(np.linalg.norm(joints[k - 1]["p"]))
        return reach

    def _pairs(self, rows: dict[str, int]) -> np.ndarray:
        n = self.robot.dof_per_arm
        counts = (self._parts["end"] - self._parts["first"]).tolist()
        frames = self._parts["frame"].tolist()
        still, width = len(frames) * (n + 1), n + 1
        pairs: list[tuple[int, ...]] = []
        directions_n = 0
        for name_a, name_b in self.pairs:
            a, b = rows[name_a], rows[name_b]
            f, g = frames[a], frames[b]
            if f and g and (f > n) == (g > n):
                # Two parts of one arm are described in the inner one's frame.
                inner = min(f, g)
                seen = inner if inner <= n else inner - n
                moves = (a * width + seen, still) if f >= g else (still, b * width + seen)
            else:
                inner, moves = 0, (a * width if f else still, b * width if g else still)
            pairs.append((a, b, inner, directions_n, *moves))
            directions_n += counts[a] * counts[b]
        self._directions_n = directions_n
        return np.array(pairs, dtype=PAIR)

    def of_arms(self, arms: Sequence[str]) -> np.ndarray:
        """Return pairs moved by these arms."""
        frames, n = self._parts["frame"], self.robot.dof_per_arm
        moves = np.zeros(len(frames), dtype=bool)
        if "left" in arms:
            moves |= (frames > 0) & (frames <= n)
        if "right" in arms:
            moves |= frames > n
        pairs = self.geometry[4]
        return np.flatnonzero(moves[pairs["a"]] | moves[pairs["b"]])

    def workspace(self) -> planes.Work:
        """Allocate the kernels' memory for one state."""
        one = self.robot.dof + 1
        return (
            np.zeros((self._directions_n, 3)),
            np.empty((1, one, 3, 3)),
            np.empty((1, one, 3)),
            np.empty((1, len(self._parts), 3)),
            np.empty((4, 3, 3)),
            np.empty((4, 3)),
            np.empty((4, 3)),
        )

    def keep(self, padding_m: float) -> planes.Keep:
        """Return the same distance for every state."""
        return float(padding_m), np.zeros((0, self.robot.dof)), np.zeros(0), 1.0

    def free(self, q: Array, padding_m: float = 0.0) -> bool:
        """Return whether all pairs are proven farther apart than `padding_m`."""
        everything = np.arange(len(self.pairs))
        return planes.survey(self.geometry, floats(q[None]), everything, self.keep(padding_m), self.workspace()) == 1

    def clearance(self, Q: Array, most_m: float, rows: np.ndarray | None = None) -> float:
        """Return a lower bound [m] on the distance over Q (n, dof), at most `most_m`.

        `rows` selects pairs.
        """
        rows = np.arange(len(self.pairs)) if rows is None else rows
        found = planes.clearance(self.geometry, floats(Q), rows, most_m, self.workspace())
        return float(found)


@dataclass(frozen=True)
class _Chain:
    """Joints, frames turned to have axis z; `turns` maps original frames into them."""

    joints: np.ndarray
    turns: tuple[pin.SE3, ...]


@functools.cache
def _chain(robot: Robot) -> _Chain:
    """Raise ValueError for joints that are not revolute."""
    model = Kinematics(robot).model
    turned = [pin.SE3.Identity()]
    joints = np.zeros(robot.dof, dtype=JOINT)
    for k in range(1, robot.dof + 1):
        data = model.joints[k].createData()
        model.joints[k].calc(data, np.ones(model.nq))
        axis = pin.log3(data.M.rotation)  # at one radian
        if abs(float(np.linalg.norm(axis)) - 1.0) > 1e-9 or np.any(data.M.translation):
            raise ValueError(f"{model.names[k]} is a {model.joints[k].shortname()}; arms need hinges")
        to_axis = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), axis).matrix()
        turned.append(pin.SE3(to_axis, np.zeros(3)))
        placement = turned[model.parents[k]].inverse() * model.jointPlacements[k] * turned[k]
        joints[k - 1] = (model.parents[k], placement.rotation, placement.translation)
    return _Chain(joints, tuple(turn.inverse() for turn in turned))


@functools.cache
def _robot_solids(robot: Robot) -> dict[str, tuple[int, tuple[_Solid, ...]]]:
    model, turns = Kinematics(robot).model, _chain(robot).turns
    found: dict[str, tuple[int, tuple[_Solid, ...]]] = {}
    for item in robot_geometry(robot).geometryObjects:
        name = model.frames[item.parentFrame].name
        _, before = found.get(name, (0, ()))
        found[name] = item.parentJoint, (*before, _solid(item.geometry, turns[item.parentJoint] * item.placement))
    return found


def _placed(shape: Any, placement: pin.SE3) -> tuple[_Solid, ...]:
    return tuple(_solid(solid, placement) for solid in convex_solids(shape))


def _solid(shape: Any, placement: pin.SE3) -> _Solid:
    ball = disc = 0.0
    match shape:
        case coal.Sphere():
            points, ball = np.zeros((1, 3)), shape.radius
        case coal.Capsule():
            points, ball = _ENDS * shape.halfLength, shape.radius
        case coal.Cylinder():
            points, disc = _ENDS * shape.halfLength, shape.radius
        case coal.Box():
            points = _BOX_CORNERS * shape.halfSide
        case coal.ConvexBase():
            points = np.array(shape.points())
        case _:
            raise TypeError(f"no solid for a {type(shape).__name__}")
    x, y, z = placement.rotation[:, 2].tolist()
    return _Solid(points @ placement.rotation.T + placement.translation, ball, disc, (x, y, z))


def _radius(solids: Sequence[_Solid], centre: Array) -> float:
    """Radius [m] of a bounding ball about `centre`."""
    return max(float(np.linalg.norm(s.points - centre, axis=1).max()) + s.ball + s.disc for s in solids)
