"""Postures and scripts for tests of robot, plant and control, independent of the planners."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from minidual.config.scene import SceneConfig
from minidual.control.joint_control import JointLoop
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, pose
from minidual.tasks.task import Trial, grasp_offsets, level_pose, placement
from tests.support.panda import HOME, Q_LOWER, Q_UPPER

_OPEN = np.ones(2)
_CLOSED = np.zeros(2)


def solve_hands(kinematics: Kinematics, poses: tuple[Array, Array], q_start: Array) -> Array:
    """Return q (14,) with both tool centre points at the poses: damped Gauss-Newton."""
    q = q_start.copy()
    for _ in range(200):
        error = np.concatenate(
            [
                np.r_[goal[:3, 3] - T[:3, 3], T[:3, :3] @ pin.log3(T[:3, :3].T @ goal[:3, :3])]
                for T, goal in zip(kinematics.tcp_poses(q), poses, strict=True)
            ],
        )
        if np.abs(error).max() < 1e-9:
            return q
        J = np.vstack(kinematics.tcp_jacobians(q))
        q = q + np.clip(J.T @ np.linalg.solve(J @ J.T + 1e-5 * np.eye(12), error), -0.2, 0.2)
        q = np.clip(q, Q_LOWER, Q_UPPER)
    raise AssertionError(f"no posture found, error {np.abs(error).max()}")


def grasp_posture(
    scene: SceneConfig,
    kinematics: Kinematics,
    T_world_level: Array,
    q_start: Array = HOME,
) -> Array:
    """Return q (14,) with the hands on a level rod at T_world_level (4, 4)."""
    left, right = grasp_offsets(scene)
    return solve_hands(kinematics, (T_world_level @ left, T_world_level @ right), q_start)


def pinch_rod(
    loop: JointLoop,
    scene: SceneConfig,
    kinematics: Kinematics,
    *,
    hands: Array = _CLOSED,
) -> Array:
    """Put open hands at the nominal rod, and close those with opening 0; return the posture."""
    x, y = scene.task.start_xy_m
    q = grasp_posture(scene, kinematics, level_pose(x, y, scene.object.radius_m, 0.0))
    loop.world.reset(q)
    loop.reset()
    for _ in range(900):
        loop.step(q, hands)
    return q


def carry_script(scene: SceneConfig, kinematics: Kinematics, trial: Trial) -> list[Array]:
    """Return 50 Hz actions (16,) of a joint-space carry of the rod, without force control."""
    start = placement(trial.start["rod"])
    goal = placement(trial.goal["rod"])
    actions: list[Array] = []
    q = HOME.copy()

    def hold(hands: Array, seconds: float) -> None:
        actions.extend(np.concatenate([q, hands]) for _ in range(round(50 * seconds)))

    def move(a: tuple[float, ...], b: tuple[float, ...], hands: Array, seconds: float) -> None:
        nonlocal q
        n = round(50 * seconds)
        for k in range(1, n + 1):
            u = k / n
            x, y, z, yaw = np.array(a) + u**3 * (10 - 15 * u + 6 * u * u) * (
                np.array(b) - np.array(a)
            )
            q = grasp_posture(
                scene,
                kinematics,
                level_pose(x, y, scene.object.radius_m + z, yaw),
                q,
            )
            actions.append(np.concatenate([q, hands]))

    def at(place: tuple[float, float, float], z: float) -> tuple[float, float, float, float]:
        return place[0], place[1], z, place[2]

    first = grasp_posture(
        scene,
        kinematics,
        level_pose(start[0], start[1], scene.object.radius_m + 0.1, start[2]),
    )
    for k in range(1, 76):
        u = k / 75
        s = u**3 * (10 - 15 * u + 6 * u * u)
        actions.append(np.concatenate([HOME + s * (first - HOME), _OPEN]))
    q = first
    hold(_OPEN, 0.3)
    move(at(start, 0.1), at(start, 0.0), _OPEN, 1.0)
    hold(_OPEN, 0.3)
    hold(_CLOSED, 0.9)
    move(at(start, 0.0), at(start, 0.1), _CLOSED, 1.2)
    move(at(start, 0.1), at(goal, 0.1), _CLOSED, 2.5)
    move(at(goal, 0.1), at(goal, 0.001), _CLOSED, 1.4)
    hold(_CLOSED, 0.3)
    hold(_OPEN, 0.9)
    move(at(goal, 0.0), at(goal, 0.08), _OPEN, 0.8)
    hold(_OPEN, 0.3)
    return actions


def floating(z: float) -> Array:
    """Return a level rod pose (4, 4) at height z, for tests that only need a pose."""
    return pose(np.eye(3), (0.5, 0.25, z))
