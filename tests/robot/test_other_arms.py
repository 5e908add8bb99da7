"""The same code plans, follows and carries with two UR5 (6 joints each) and two xArm 7."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.config.scene import RobotConfig, SceneConfig
from minidual.control.joint_control import JointLoop
from minidual.gate.verdict import read_verdict
from minidual.motion.api import Planner
from minidual.plant.world import World
from minidual.robot.pair import pose, robot_from
from minidual.stages.registry import STAGES

BASELINE_TRACKING_RAD = 0.05


@pytest.mark.parametrize("arm", ["ur5", "xarm7"])
def test_another_pair_plans_to_joints_and_poses_and_follows(arm):
    robot = robot_from(RobotConfig(arm=arm))
    planner = Planner(robot=robot)
    world = World(SceneConfig(), robot)
    loop = JointLoop(world, planner.kinematics)
    q = robot.home
    goal = robot.home + np.tile(np.linspace(-0.4, 0.4, robot.dof_per_arm), 2)
    poses = {
        side: pose(np.diag([1.0, -1.0, -1.0]), (0.45, y, 0.3))
        for side, y in (("left", 0.2), ("right", -0.2))
    }
    plans = (
        lambda q: planner.plan_to_joints("both_arms", q, goal, seed=1),
        lambda q: planner.plan_to_poses("both_arms", q, poses, seed=1),
        lambda q: planner.plan_to_joints(
            "left_arm",
            q,
            np.r_[robot.arm.home, q[robot.dof_per_arm :]],
            seed=1,
        ),
    )
    for plan in plans:
        result = plan(q)
        proof = result.verification
        assert proof.ok
        assert (
            max(
                proof.velocity_ratio,
                proof.acceleration_ratio,
                proof.jerk_ratio,
                proof.torque_ratio,
            )
            <= 1.0
        )
        trajectory = result.trajectory
        assert trajectory.q.shape[1] == robot.dof
        for t in np.arange(0.0, trajectory.duration_s, world.dt):
            loop.follow(*trajectory.sample(t), np.ones(2))
            error = np.linalg.norm(world.q - trajectory.sample(t + world.dt)[0])
            assert error < BASELINE_TRACKING_RAD
            assert all("rod" in pair for pair in world.contact_pairs())
        q = trajectory.q[-1]
    for side, T in zip(
        robot.sides,
        planner.kinematics.tcp_poses(plans[1](q).trajectory.q[-1]),
        strict=True,
    ):
        assert np.abs(T - poses[side]).max() < 1e-5


@pytest.mark.slow
def test_two_xarms_pass_env_check_plan_and_carry(tmp_path):
    """The limits are those of the profile."""
    words = [
        "run",
        "--until",
        "carry",
        "--profile",
        "smoke",
        "--runs-dir",
        str(tmp_path),
        "--run",
        "xarm7",
    ]
    words += ["--set", "robot.arm=xarm7", "--set", "carry.trials_n=5"]
    assert run_command_line(words, STAGES) == 0
    for stage in ("env-check", "plan", "carry"):
        verdict, _ = read_verdict(tmp_path / "xarm7" / stage / "verdict.json")
        assert verdict.status == "pass"
    checks = {check.name: check for check in verdict.checks}
    assert checks["success_rate"].observed == 1.0
    assert checks["tilt_max_rad"].observed < np.radians(5.0)
    assert checks["internal_force_min_n"].observed > 20.0
    assert checks["duration_max_s"].observed < 10.0
