"""What the planner's tests measure by other means than the planner does."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin

from minidual.collision.engines import CoalEngine, MujocoEngine
from minidual.collision.scene import PlanningScene
from minidual.motion.blend import SmoothPath, rounded
from minidual.robot.pair import Array
from tests.support.panda import HOME, Q_LOWER, Q_UPPER


def states(count: int, seed: int = 0, spread: float = 0.8) -> Array:
    """Return (1.5 count, 14): postures round home, most of them free, and half as many anywhere."""
    rng = np.random.default_rng(seed)
    near = np.clip(HOME + rng.uniform(-spread, spread, (count, 14)), Q_LOWER, Q_UPPER)
    return np.vstack([near, rng.uniform(Q_LOWER, Q_UPPER, (count // 2, 14))])


class CoalDistances:
    """Exact distances of every checked pair through coal's own query."""

    def __init__(self, scene: PlanningScene, engine: CoalEngine) -> None:
        self._model = engine.model
        self._geometry = engine.geometry
        names = {k: name for name, items in engine.items.items() for k in items}
        owners = [
            frozenset((names[p.first], names[p.second])) for p in self._geometry.collisionPairs
        ]
        self._items = [
            [k for k, owner in enumerate(owners) if owner == frozenset(pair)]
            for pair in scene.checked_pairs
        ]
        self._data = self._model.createData()
        self._placed = pin.GeometryData(self._geometry)
        for request in self._placed.distanceRequests:
            request.gjk_tolerance = 1e-9

    def __call__(self, Q: Array) -> Array:
        """Return (n, p) [m] at the rows of Q (n, 14), negative inside each other."""
        rows = []
        for q in Q:
            pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._placed, q)
            rows.append(
                [
                    min(
                        pin.computeDistance(self._geometry, self._placed, k).min_distance
                        for k in items
                    )
                    for items in self._items
                ],
            )
        return np.array(rows)


def farthest_in_mujoco(engine: MujocoEngine, part: str, direction: Array) -> float:
    """Return how far a part goes along a unit direction (3,) [m] at the engine's last state, from what it compiled."""
    model = engine.model
    data = engine.data
    body = model.body(part)
    far = -np.inf
    for geom in range(int(body.geomadr[0]), int(body.geomadr[0]) + int(body.geomnum[0])):
        R = data.geom_xmat[geom].reshape(3, 3)
        p = data.geom_xpos[geom]
        own = R.T @ direction
        size = model.geom_size[geom]
        match mujoco.mjtGeom(int(model.geom_type[geom])):
            case mujoco.mjtGeom.mjGEOM_MESH:
                mesh = int(model.geom_dataid[geom])
                first = int(model.mesh_vertadr[mesh])
                count = int(model.mesh_vertnum[mesh])
                reach = float((model.mesh_vert[first : first + count] @ own).max())
            case mujoco.mjtGeom.mjGEOM_SPHERE:
                reach = size[0]
            case mujoco.mjtGeom.mjGEOM_CAPSULE:
                reach = size[0] + size[1] * abs(own[2])
            case mujoco.mjtGeom.mjGEOM_CYLINDER:
                reach = size[0] * np.hypot(own[0], own[1]) + size[1] * abs(own[2])
            case kind:
                raise AssertionError(f"no oracle for a {kind}")
        far = max(far, float(direction @ p) + float(reach))
    return far


def rounded_polyline(seed: int = 4, n: int = 5, d: int = 14) -> SmoothPath:
    """Return the curve through the origin and n - 1 random points of d coordinates."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-0.5, 0.5, (n - 1, d))
    return rounded(np.vstack([np.zeros(d), points]), 0.2)


def toppra_profile(path: SmoothPath, grid: Array, v_max: Array, a_max: Array) -> Array:
    """Return toppra's fastest path speed on a grid (n,) within limits (d,) of all coordinates."""
    import toppra  # slow to import
    from toppra.algorithm import TOPPRA
    from toppra.constraint import (
        DiscretizationType,
        JointAccelerationConstraint,
        JointVelocityConstraint,
    )
    from toppra.interpolator import AbstractGeometricPath

    class Path(AbstractGeometricPath):
        dof = len(v_max)
        waypoints = None
        path_interval = np.array([0.0, path.length])

        def __call__(self, s, order=0):
            values = path.at(np.atleast_1d(s), order)
            return values if np.ndim(s) else values[0]

    toppra.setup_logging("ERROR")
    limits = [
        JointVelocityConstraint(np.column_stack([-v_max, v_max])),
        JointAccelerationConstraint(
            np.column_stack([-a_max, a_max]),
            DiscretizationType.Interpolation,
        ),
    ]
    solver = TOPPRA(limits, Path(), gridpoints=grid, solver_wrapper="seidel")
    _, speeds, _ = solver.compute_parameterization(0, 0)
    return speeds


def polyline_from(q_start: Array, joints: slice, seed: int) -> SmoothPath:
    """Return the curve from a posture (n,) through two random ones in which `joints` differ."""
    rng = np.random.default_rng(seed)
    points = np.array([q_start, q_start, q_start])
    size = points[1:, joints].shape
    points[1:, joints] += rng.uniform(-0.5, 0.5, size)
    return rounded(points, 0.2)
