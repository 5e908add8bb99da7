"""Other planners on the same queries: plain OMPL here, roboplan in an environment of its own.

OMPL's RRTConnect asks MuJoCo every 0.03 rad; toppra times a spline through the simplified path. roboplan gets the same
robot, hulls, pairs and limits, and runs with its defaults (`roboplan_worker.py`).
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import ompl.base as ob
import ompl.geometric as og
import toppra
import trimesh
from scipy.interpolate import CubicHermiteSpline
from toppra import algorithm, constraint

from minidual.collision.shapes import Shape
from minidual.config.planning import PlannerConfig
from minidual.config.seeds import stream
from minidual.errors import EnvironmentMissingError
from minidual.motion.api import Planner
from minidual.motion.held.constraint import GraspConstraint
from minidual.motion.held.hands import RESIDUAL_MAX_M, RESIDUAL_MAX_RAD
from minidual.motion.search import bounded_space, exact_path, seeded
from minidual.motion.timing import DT_S
from minidual.robot.description import pair_urdf
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot, inverse
from minidual.robot.trajectory import Trajectory
from scripts.bench.queries import GROUP, PosedQuery, rod_grasps

ROBOPLAN = "0.7.0"
_EDGE_RAD = 0.03
_SHARE_S = 0.2
_STATES_N = 200
"""States per query on which roboplan must see the contacts that MuJoCo sees."""
_OTHER_SHARE = 0.01
"""Of them may differ: roboplan looks at surfaces, and does not see a box that lies wholly inside a hull."""


@dataclass(frozen=True, eq=False)
class Run:
    """What a planner gives for a query: a timed path or why there is none, and its processor time."""

    trajectory: Trajectory | None
    cpu_s: float
    reason: str = ""


def core_share() -> float:
    """Return the share of a core that this process gets at the moment."""
    wall = time.perf_counter()
    cpu = time.process_time()
    while time.process_time() < cpu + _SHARE_S:
        pass
    return min(1.0, (time.process_time() - cpu) / (time.perf_counter() - wall))


def evenly(times: Array, q: Array, v: Array, a: Array) -> Trajectory:
    """Return a trajectory of about 1 kHz from samples (n,), (n, dof), the last of which may come early."""
    even = np.linspace(0.0, times[-1], max(2, round(times[-1] / DT_S) + 1))
    spline = CubicHermiteSpline(times, q, v)
    a_even = np.stack([np.interp(even, times, column) for column in a.T], axis=1)
    return Trajectory(even, spline(even), spline(even, 1), a_even, GROUP)


def plan_ompl(queries: Sequence[PosedQuery], planner: Planner, budget_s: float) -> list[Run]:
    """Plan with plain OMPL and toppra."""
    return [_ompl(query, planner, budget_s) for query in queries]


def _ompl(query: PosedQuery, planner: Planner, budget_s: float) -> Run:
    assert query.q_start is not None
    assert query.q_goal is not None
    robot = planner.robot
    engine = planner.engines(query.drawn.scene).engine("mujoco")
    began = time.process_time()
    seeded(query.drawn.seed)
    space = bounded_space(robot.q_lower, robot.q_upper)
    held = query.drawn.T_world_rod is not None
    if held:
        left, right = rod_grasps().values()
        grasp = GraspConstraint(inverse(left) @ right, planner.kinematics)
        space = ob.ProjectedStateSpace(space, grasp)
        si = ob.ConstrainedSpaceInformation(space)
        space.setDelta(_EDGE_RAD)
    else:
        si = ob.SpaceInformation(space)

    def joints(state: Any) -> Array:
        return np.array([state[i] for i in range(robot.dof)])

    si.setStateValidityChecker(lambda state: engine.contact_count(joints(state)) == 0)
    si.setStateValidityCheckingResolution(_EDGE_RAD / space.getMaximumExtent())
    si.setup()
    ends: list[Any] = [si.allocState(), si.allocState()]
    for state, q in zip(ends, (query.q_start, query.q_goal), strict=True):
        if held:
            state.copy(np.array(q))
        else:
            for i, value in enumerate(q):
                state[i] = float(value)
    path = exact_path(og.RRTConnect(si), 0.0, ends, lambda: time.process_time() > began + budget_s)
    if path is None:
        return Run(None, time.process_time() - began, "no path in time")
    if not held:
        og.PathSimplifier(si).simplifyMax(path)
    path.interpolate()
    corners = np.array([joints(path.getState(i)) for i in range(path.getStateCount())])
    timed = _timed(corners, robot, planner.config)
    cpu_s = time.process_time() - began
    return Run(timed, cpu_s) if timed is not None else Run(None, cpu_s, "toppra finds no timing")


def _timed(points: Array, robot: Robot, config: PlannerConfig) -> Trajectory | None:
    """Return the spline through points (n, dof), timed by toppra."""
    moved = np.append(True, np.linalg.norm(np.diff(points, axis=0), axis=1) > 1e-9)
    points = points[moved]
    s = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    limits = [
        constraint.JointVelocityConstraint(
            config.velocity_scale * np.stack([-robot.v_max, robot.v_max], axis=1),
        ),
        constraint.JointAccelerationConstraint(
            config.acceleration_scale * np.stack([-robot.a_max, robot.a_max], axis=1),
        ),
    ]
    motion: Any = algorithm.TOPPRA(limits, toppra.SplineInterpolator(s, points)).compute_trajectory(
        0.0,
        0.0,
    )
    if motion is None:
        return None
    times = np.append(np.arange(0.0, motion.duration, DT_S), motion.duration)
    return evenly(times, *(motion(times, order) for order in range(3)))


class Roboplan:
    """roboplan behind the Python of another environment.

    Raises:
        EnvironmentMissingError: That Python does not exist or has no roboplan.
    """

    def __init__(self, python: Path) -> None:
        self._python = python
        done = None
        if python.is_file():
            done = subprocess.run(
                [python, "-c", "import roboplan.rrt, roboplan.toppra"],
                capture_output=True,
                env=_clean(),
                check=False,
            )
        if done is None or done.returncode != 0:
            raise EnvironmentMissingError(
                f"roboplan is not installed for {python}: its rows are left out",
                remedy=f"python3 -m venv .venv-roboplan && .venv-roboplan/bin/pip install roboplan=={ROBOPLAN}, "
                "or name another Python with --roboplan",
            )

    def plan(self, queries: Sequence[PosedQuery], planner: Planner, budget_s: float) -> list[Run]:
        """Plan with roboplan.

        Raises:
            RuntimeError: It sees other contacts than MuJoCo: the geometries differ, and nothing is comparable.
        """
        if not queries:
            return []
        with _job(queries, planner, budget_s / core_share()) as job:  # it goes by the wall clock
            command = [self._python, Path(__file__).with_name("roboplan_worker.py")]
            done = subprocess.run(
                command,
                input=json.dumps(job),
                capture_output=True,
                text=True,
                env=_clean(),
            )
        if done.returncode != 0:
            raise RuntimeError(f"roboplan's process failed: {done.stderr[-2000:]}")
        runs = []
        for query, asked, line in zip(
            queries,
            job["queries"],
            done.stdout.splitlines(),
            strict=True,
        ):
            answer = json.loads(line)
            seen = (
                planner.engines(query.drawn.scene)
                .engine("mujoco")
                .collisions(np.array(asked["states"]))
            )
            if np.mean(seen != answer["contacts"]) > _OTHER_SHARE:
                raise RuntimeError(
                    f"roboplan and MuJoCo see other contacts in query {query.drawn.index}",
                )
            timed = None
            if not answer["reason"]:
                timed = evenly(*(np.array(answer[name]) for name in ("times", "q", "v", "a")))
            runs.append(Run(timed, answer["cpu_s"], answer["reason"]))
        return runs


def _clean() -> dict[str, str]:
    return {
        name: value
        for name, value in os.environ.items()
        if name not in ("PYTHONPATH", "VIRTUAL_ENV")
    }


@contextmanager
def _job(
    queries: Sequence[PosedQuery],
    planner: Planner,
    budget_s: float,
) -> Iterator[dict[str, Any]]:
    """Yield what the worker reads; its meshes exist within the block."""
    robot = planner.robot
    config = planner.config
    with tempfile.TemporaryDirectory() as folder:
        root = ET.fromstring(pair_urdf(robot))
        for index, mesh in enumerate(root.iter("mesh")):
            # The hulls that the other planners use: roboplan would take the triangles of the meshes.
            hull = trimesh.load(mesh.attrib["filename"], force="mesh").convex_hull
            file = f"{folder}/{index}.stl"
            hull.export(file)
            mesh.set("filename", file)
        limits = {
            "max_velocity": robot.v_max,
            "max_acceleration": robot.a_max,
            "max_jerk": robot.jerk_max,
        }
        yield {
            "urdf": ET.tostring(root, encoding="unicode"),
            "joint_names": robot.joint_names,
            "tcp_names": robot.tcp_names,
            "joint_limits": {
                name: {limit: [float(values[k])] for limit, values in limits.items()}
                for k, name in enumerate(robot.joint_names)
            },
            "fingers_m": dict.fromkeys(robot.finger_joint_names, robot.hand.travel_m),
            "budget_s": budget_s,
            "velocity_scale": config.velocity_scale,
            "acceleration_scale": config.acceleration_scale,
            "dt_s": DT_S,
            "residual_m": RESIDUAL_MAX_M,
            "residual_rad": RESIDUAL_MAX_RAD,
            "queries": [_query(query, planner.kinematics) for query in queries],
        }


def _query(query: PosedQuery, kinematics: Kinematics) -> dict[str, Any]:
    assert query.q_start is not None
    assert query.q_goal is not None
    drawn = query.drawn
    model = kinematics.model
    scene = drawn.scene
    robot = kinematics.robot
    shapes = [
        _shape(s.shape, "", s.shape.T_parent_shape) for s in scene.solids if s.link == "world"
    ]
    for held in scene.attached:
        # roboplan 0.7.0 places a shape relative to the joint that moves the link, not to the link.
        T_joint_link = model.frames[model.getFrameId(held.link)].placement.homogeneous
        shapes.append(_shape(held.shape, held.link, T_joint_link @ held.shape.T_parent_shape))
    checked = set(map(frozenset, scene.checked_pairs))
    near = stream(drawn.seed, "bench/contacts").uniform(-0.8, 0.8, (_STATES_N, robot.dof))
    T_left_right = None
    if drawn.T_world_rod is not None:
        left, right = rod_grasps().values()
        T_left_right = (inverse(left) @ right).tolist()
    return {
        "seed": drawn.seed,
        "q_start": query.q_start.tolist(),
        "q_goal": query.q_goal.tolist(),
        "shapes": shapes,
        "unchecked": [
            pair
            for pair in itertools.combinations(scene.names, 2)
            if frozenset(pair) not in checked
        ],
        "states": np.clip(query.q_start + near, robot.q_lower, robot.q_upper).tolist(),
        "T_left_right": T_left_right,
    }


def _shape(shape: Shape, link: str, T_link_shape: Array) -> dict[str, Any]:
    lengths = {"kind": type(shape).__name__, "lengths_m": shape.lengths()}
    return {"name": shape.name, "link": link, "T_link_shape": T_link_shape.tolist(), **lengths}
