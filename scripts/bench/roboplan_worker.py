"""Plan queries with roboplan: `PYTHON_WITH_ROBOPLAN roboplan_worker.py < job.json > plans.jsonl`.

It runs in an environment of its own, so it imports nothing of this project. `peers.py` writes the job and reads one
plan a line. Settings that the job does not give are roboplan's defaults.
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

GROUP = "arms"
_NODES_MAX = 10_000_000
"""No limit: time ends the search."""
_COLOUR = np.ones(4)
_PATIENCE = 3.0
"""A query is stopped after this many times the budget: the search keeps its time limit, the timing of its path has none."""


def scene_of(job: dict[str, Any], query: dict[str, Any]) -> Any:
    """Return the query's scene."""
    scene = Scene("bench", loadUrdfSceneDescriptionFromXml(job["urdf"]))
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        json.dump({"joint_limits": job["joint_limits"]}, file)  # JSON is YAML
        file.flush()
        scene.importJointLimitsFromConfig(loadJointLimitsConfig(file.name))
    scene.addGroup(GROUP, job["joint_names"])
    for shape in query["shapes"]:
        where = shape["name"], shape["link"] or "universe"
        placed = np.asfortranarray(shape["T_link_shape"]), _COLOUR
        match shape["kind"]:
            case "Box":
                scene.addBoxGeometry(*where, Box(*shape["lengths_m"]), *placed)
            case "Cylinder":
                scene.addCylinderGeometry(*where, Cylinder(*shape["lengths_m"]), *placed)
            case kind:
                raise ValueError(f"no {kind} here: add it beside Box and Cylinder")
    scene.setCollisions([tuple(pair) for pair in query["unchecked"]], False)
    scene.setJointPositions(whole(scene, job, query["q_start"]))
    return scene


def whole(scene: Any, job: dict[str, Any], q: Sequence[float]) -> np.ndarray:
    """Return all positions of the scene: the arms' joints, the fingers open."""
    given = dict(zip(job["joint_names"], q, strict=True)) | job["fingers_m"]
    names = scene.getJointNames()
    out = np.zeros(len(names))
    for name in names:
        out[scene.getJointPositionIndices([name])[0]] = given[name]
    return out


def contacts_of(scene: Any, job: dict[str, Any], query: dict[str, Any]) -> list[bool]:
    """Return at which of the query's states something touches."""
    return [bool(scene.hasCollisions(whole(scene, job, q))) for q in query["states"]]


def plan(job: dict[str, Any], query: dict[str, Any]) -> dict[str, Any]:
    """Return a plan: contacts at the job's states, processor time, and the timed path or why there is none."""
    scene = scene_of(job, query)
    contacts = contacts_of(scene, job, query)
    search = RRTOptions(
        group_name=GROUP,
        max_nodes=_NODES_MAX,
        max_planning_time=job["budget_s"],
        rrt_connect=True,
    )
    shorten = PathShortcuttingOptions(group_name=GROUP, seed=query["seed"])
    limits = {
        "velocity_scale": job["velocity_scale"],
        "acceleration_scale": job["acceleration_scale"],
    }
    timing = TOPPRAOptions(dt=job["dt_s"], mode=SplineFittingMode.Adaptive, **limits)
    start, goal = (
        JointConfiguration(job["joint_names"], np.array(query[end]))
        for end in ("q_start", "q_goal")
    )
    constraints = [] if query["T_left_right"] is None else [_grasp(scene, job, query)]
    began = time.process_time()
    try:
        rrt = RRT(scene, search)
        rrt.setRngSeed(query["seed"])
        path = rrt.plan(start, goal, constraints)
        if not constraints:  # shortcuts would leave them
            path = PathShortcutter(scene, shorten).shortcut(path)
        motion = PathParameterizerTOPPRA(scene, GROUP).generate(path, timing)
    except RuntimeError as error:
        return {"contacts": contacts, "cpu_s": time.process_time() - began, "reason": str(error)}
    cpu_s = time.process_time() - began
    columns = {"q": motion.positions, "v": motion.velocities, "a": motion.accelerations}
    samples = {name: np.array(rows).tolist() for name, rows in columns.items()}
    return {
        "contacts": contacts,
        "cpu_s": cpu_s,
        "reason": "",
        "times": list(motion.times),
        **samples,
    }


def _grasp(scene: Any, job: dict[str, Any], query: dict[str, Any]) -> Any:
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
        "contacts": contacts_of(scene_of(job, query), job, query),
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
