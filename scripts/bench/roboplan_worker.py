"""Plan queries with roboplan: `PYTHON_WITH_ROBOPLAN roboplan_worker.py < job.json > plans.jsonl`.

It runs in an environment of its own, so it imports nothing of this project. `peer_roboplan.py` writes
the job and reads one plan a line. Settings that the job does not give are roboplan's defaults.
"""

from __future__ import annotations

import json
import multiprocessing
import sys
import tempfile
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from roboplan.core import (
    Box,
    Cylinder,
    JointConfiguration,
    PathShortcutter,
    PathShortcuttingOptions,
    Scene,
    loadJointLimitsConfig,
    loadUrdfSceneDescriptionFromXml,
)
from roboplan.rrt import RRT, PoseConstraint, RRTOptions
from roboplan.toppra import PathParameterizerTOPPRA, SplineFittingMode, TOPPRAOptions

GROUP = "planned"
_NODES_MAX = 10_000_000
"""No limit: time ends the search."""
_COLOUR = np.ones(4)
_PATIENCE = 3.0
"""A query is stopped after this many times the budget: the search keeps its time limit, the timing
of its path has none."""


def make_scene(job: dict[str, Any], query: dict[str, Any]) -> Any:
    """Return the query's scene."""
    scene = Scene("bench", loadUrdfSceneDescriptionFromXml(job["urdf"]))
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        json.dump({"joint_limits": job["joint_limits"]}, file)  # JSON is YAML
        file.flush()
        scene.importJointLimitsFromConfig(loadJointLimitsConfig(file.name))
    scene.addGroup(GROUP, job["group_joint_names"])
    for shape in query["shapes"]:
        add_shape(scene, shape)
    scene.setCollisions([tuple(pair) for pair in query["unchecked"]], False)
    scene.setJointPositions(positions(scene, job, query["q_start"]))
    return scene


def add_shape(scene: Any, shape: dict[str, Any]) -> None:
    """Add a shape to its link."""
    name = shape["name"]
    link = shape["link"] or "universe"
    T_link_shape = np.asfortranarray(shape["T_link_shape"])
    match shape["kind"]:
        case "Box":
            scene.addBoxGeometry(name, link, Box(*shape["lengths_m"]), T_link_shape, _COLOUR)
        case "Cylinder":
            cylinder = Cylinder(*shape["lengths_m"])
            scene.addCylinderGeometry(name, link, cylinder, T_link_shape, _COLOUR)
        case kind:
            raise ValueError(f"no {kind} here: add it beside Box and Cylinder")


def positions(scene: Any, job: dict[str, Any], q: Sequence[float]) -> np.ndarray:
    """Return all positions of the scene: the arms' joints, the fingers open."""
    by_name = dict(zip(job["joint_names"], q, strict=True)) | job["fingers_m"]
    joint_names = scene.getJointNames()
    out = np.zeros(len(joint_names))
    for name in joint_names:
        (index,) = scene.getJointPositionIndices([name])
        out[index] = by_name[name]
    return out


def contacts(scene: Any, job: dict[str, Any], query: dict[str, Any]) -> list[bool]:
    """Return at which of the query's states something touches."""
    return [bool(scene.hasCollisions(positions(scene, job, q))) for q in query["states"]]


def plan(job: dict[str, Any], query: dict[str, Any]) -> dict[str, Any]:
    """Return contacts at the job's states, processor time, and the timed path or why there is none."""
    scene = make_scene(job, query)
    touches = contacts(scene, job, query)
    began = time.process_time()
    try:
        motion = timed_path(scene, job, query)
    except RuntimeError as error:
        cpu_s = time.process_time() - began
        return {"contacts": touches, "cpu_s": cpu_s, "reason": str(error)}
    return {
        "contacts": touches,
        "cpu_s": time.process_time() - began,
        "reason": "",
        "times": list(motion.times),
        "q": np.array(motion.positions).tolist(),
        "v": np.array(motion.velocities).tolist(),
        "a": np.array(motion.accelerations).tolist(),
    }


def timed_path(scene: Any, job: dict[str, Any], query: dict[str, Any]) -> Any:
    """Return the timed path; RuntimeError if there is none in time."""
    search = RRTOptions(
        group_name=GROUP,
        max_nodes=_NODES_MAX,
        max_planning_time=job["budget_s"],
        rrt_connect=True,
    )
    timing = TOPPRAOptions(
        dt=job["dt_s"],
        mode=SplineFittingMode.Adaptive,
        velocity_scale=job["velocity_scale"],
        acceleration_scale=job["acceleration_scale"],
    )
    names = job["group_joint_names"]
    start = JointConfiguration(names, np.array(query["q_start_group"]))
    goal = JointConfiguration(names, np.array(query["q_goal_group"]))
    constraints = [] if query["T_left_right"] is None else [grasp(scene, job, query)]
    rrt = RRT(scene, search)
    rrt.setRngSeed(query["seed"])
    path = rrt.plan(start, goal, constraints)
    if not constraints:  # shortcuts would leave them
        shortcuts = PathShortcuttingOptions(group_name=GROUP, seed=query["seed"])
        path = PathShortcutter(scene, shortcuts).shortcut(path)
    return PathParameterizerTOPPRA(scene, GROUP).generate(path, timing)


def grasp(scene: Any, job: dict[str, Any], query: dict[str, Any]) -> Any:
    """Return the constraint that keeps the right hand where it is in the left."""
    left, right = job["tcp_names"]
    return PoseConstraint(
        scene,
        GROUP,
        right,
        tform=np.asfortranarray(query["T_left_right"]),
        reference_frame=left,
        lower_bounds=np.zeros(6),
        upper_bounds=np.zeros(6),
        position_tolerance=job["residual_m"],
        orientation_tolerance=job["residual_rad"],
    )


def bounded(job: dict[str, Any], query: dict[str, Any]) -> dict[str, Any]:
    """Return `plan` of a process of its own, or that it did not end."""
    fork = multiprocessing.get_context("fork")
    limit_s = _PATIENCE * job["budget_s"]
    receiver, sender = fork.Pipe(duplex=False)
    child = fork.Process(target=lambda: sender.send(plan(job, query)))
    child.start()
    sender.close()
    try:
        if receiver.poll(limit_s):
            return receiver.recv()
    except EOFError:
        raise RuntimeError(f"planning ended with exit code {child.exitcode}") from None
    finally:
        child.kill()
        child.join()
    return {
        "contacts": contacts(make_scene(job, query), job, query),
        "cpu_s": limit_s,
        "reason": f"no end within {limit_s:.0f} s",
    }


def main() -> None:
    """Plan every query of the job, one after the other."""
    job = json.load(sys.stdin)
    for query in job["queries"]:
        print(json.dumps(bounded(job, query)), flush=True)


if __name__ == "__main__":
    main()
