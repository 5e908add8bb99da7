"""roboplan on the queries of the bench, in an environment of its own.

It gets the same robot, hulls, pairs and limits, and runs with its defaults (`roboplan_worker.py`).
"""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from minidual.collision.shapes import Shape
from minidual.config.seeds import stream
from minidual.errors import EnvironmentMissingError
from minidual.motion.api import Planner
from minidual.motion.held.hands import RESIDUAL_MAX_M, RESIDUAL_MAX_RAD
from minidual.motion.timing import DT_S
from minidual.robot.description import pair_urdf
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.robot.trajectory import Trajectory
from scripts.bench.peers import PeerQuery, Run, core_share, evenly

ROBOPLAN = "0.7.0"
_WORKER = Path(__file__).with_name("roboplan_worker.py")
_STATES_N = 200
"""States per query on which roboplan must see the contacts that MuJoCo sees."""
_OTHER_SHARE = 0.01
"""Of them may differ: roboplan looks at surfaces, and does not see a box wholly inside a hull."""


class Roboplan:
    """roboplan behind the Python of another environment.

    Raises:
        EnvironmentMissingError: That Python does not exist or has no roboplan.
    """

    def __init__(self, python: Path) -> None:
        self._python = python
        if not _has_roboplan(python):
            raise EnvironmentMissingError(
                f"roboplan is not installed for {python}: its rows are left out",
                remedy="python3 -m venv .venv-roboplan && .venv-roboplan/bin/pip install "
                f"roboplan=={ROBOPLAN}, or name another Python with --roboplan",
            )

    def plan(self, queries: Sequence[PeerQuery], planner: Planner, budget_s: float) -> list[Run]:
        """Plan queries of one group.

        Raises:
            RuntimeError: It sees other contacts than MuJoCo: the geometries differ, and nothing is
                comparable.
        """
        if not queries:
            return []
        wall_s = budget_s / core_share()  # it goes by the wall clock
        with _job(queries, planner, wall_s) as job:
            process = subprocess.run(
                [self._python, _WORKER],
                input=json.dumps(job),
                capture_output=True,
                text=True,
                env=_clean_environment(),
                check=False,
            )
        if process.returncode != 0:
            raise RuntimeError(f"roboplan's process failed: {process.stderr[-2000:]}")
        answers = [json.loads(line) for line in process.stdout.splitlines()]
        states = [np.array(query["states"]) for query in job["queries"]]
        return [
            _run(query, q, answer, planner)
            for query, q, answer in zip(queries, states, answers, strict=True)
        ]


def _has_roboplan(python: Path) -> bool:
    if not python.is_file():
        return False
    tried = subprocess.run(
        [python, "-c", "import roboplan.rrt, roboplan.toppra"],
        capture_output=True,
        env=_clean_environment(),
        check=False,
    )
    return tried.returncode == 0


def _clean_environment() -> dict[str, str]:
    """Return the environment without what belongs to this process's Python."""
    own = ("PYTHONPATH", "VIRTUAL_ENV")
    return {name: value for name, value in os.environ.items() if name not in own}


def _run(query: PeerQuery, states: Array, answer: dict[str, Any], planner: Planner) -> Run:
    """Return the worker's answer to a query, after a check that both saw the same scene."""
    contacts = planner.engines(query.scene).engine("mujoco").collisions(states)
    if np.mean(contacts != answer["contacts"]) > _OTHER_SHARE:
        raise RuntimeError(f"roboplan and MuJoCo see other contacts in query {query.index}")
    if answer["reason"]:
        return Run(None, answer["cpu_s"], answer["reason"])
    return Run(_trajectory(query, answer, planner.robot), answer["cpu_s"])


def _trajectory(query: PeerQuery, answer: dict[str, Any], robot: Robot) -> Trajectory:
    """Return the timed path of all joints; those outside the group stay where they start."""
    joints = robot.groups[query.group]
    times = np.array(answer["times"])
    q = np.tile(query.q_start, (len(times), 1))
    v = np.zeros_like(q)
    a = np.zeros_like(q)
    q[:, joints] = answer["q"]
    v[:, joints] = answer["v"]
    a[:, joints] = answer["a"]
    return evenly(times, q, v, a, query.group)


@contextmanager
def _job(
    queries: Sequence[PeerQuery],
    planner: Planner,
    budget_s: float,
) -> Iterator[dict[str, Any]]:
    """Yield what the worker reads; its meshes exist within the block."""
    robot = planner.robot
    config = planner.config
    limits = {
        "max_velocity": robot.v_max,
        "max_acceleration": robot.a_max,
        "max_jerk": robot.jerk_max,
    }
    joint_limits = {
        joint: {limit: [float(values[k])] for limit, values in limits.items()}
        for k, joint in enumerate(robot.joint_names)
    }
    with tempfile.TemporaryDirectory() as folder:
        yield {
            "urdf": _urdf_with_hulls(robot, Path(folder)),
            "joint_names": robot.joint_names,
            "group_joint_names": robot.joint_names[robot.groups[queries[0].group]],
            "tcp_names": robot.tcp_names,
            "joint_limits": joint_limits,
            "fingers_m": dict.fromkeys(robot.finger_joint_names, robot.hand.travel_m),
            "budget_s": budget_s,
            "velocity_scale": config.velocity_scale,
            "acceleration_scale": config.acceleration_scale,
            "dt_s": DT_S,
            "residual_m": RESIDUAL_MAX_M,
            "residual_rad": RESIDUAL_MAX_RAD,
            "queries": [query_record(query, planner.kinematics) for query in queries],
        }


def _urdf_with_hulls(robot: Robot, folder: Path) -> str:
    """Return the URDF with the hulls that the other planners use, written into `folder`.

    roboplan would take the triangles of the meshes.
    """
    root = ET.fromstring(pair_urdf(robot))
    for index, mesh in enumerate(root.iter("mesh")):
        hull = trimesh.load(mesh.attrib["filename"], force="mesh").convex_hull
        file = folder / f"{index}.stl"
        hull.export(file)
        mesh.set("filename", str(file))
    return ET.tostring(root, encoding="unicode")


def query_record(query: PeerQuery, kinematics: Kinematics) -> dict[str, Any]:
    """Return what the worker reads of one query."""
    model = kinematics.model
    robot = kinematics.robot
    scene = query.scene
    joints = robot.groups[query.group]
    shapes = [
        _shape_record(solid.shape, "", solid.shape.T_parent_shape)
        for solid in scene.solids
        if solid.link == "world"
    ]
    for held in scene.attached:
        # roboplan 0.7.0 places a shape relative to the joint that moves the link, not to the link.
        T_joint_link = model.frames[model.getFrameId(held.link)].placement.homogeneous
        T_joint_shape = T_joint_link @ held.shape.T_parent_shape
        shapes.append(_shape_record(held.shape, held.link, T_joint_shape))
    checked = {frozenset(pair) for pair in scene.checked_pairs}
    unchecked = [
        pair for pair in itertools.combinations(scene.names, 2) if frozenset(pair) not in checked
    ]
    offsets = stream(query.seed, "bench/contacts").uniform(-0.8, 0.8, (_STATES_N, robot.dof))
    states = np.clip(query.q_start + offsets, robot.q_lower, robot.q_upper)
    return {
        "seed": query.seed,
        "q_start": query.q_start.tolist(),
        "q_start_group": query.q_start[joints].tolist(),
        "q_goal_group": query.q_goal[joints].tolist(),
        "shapes": shapes,
        "unchecked": unchecked,
        "states": states.tolist(),
        "T_left_right": None if query.T_left_right is None else query.T_left_right.tolist(),
    }


def _shape_record(shape: Shape, link: str, T_link_shape: Array) -> dict[str, Any]:
    return {
        "name": shape.name,
        "link": link,
        "T_link_shape": T_link_shape.tolist(),
        "kind": type(shape).__name__,
        "lengths_m": shape.lengths(),
    }
