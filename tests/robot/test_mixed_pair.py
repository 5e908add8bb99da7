"""Two different arms are a pair like any other: a Panda on the left, a UR5 on the right."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from minidual.collision.acm import acm_report
from minidual.config.root import Config
from minidual.config.scene import RobotConfig, SceneConfig
from minidual.control.braking import BrakingLaw
from minidual.control.joint_control import JointLoop
from minidual.errors import UsageError
from minidual.motion.api import Planner
from minidual.motion.states import NamedStates
from minidual.plant.world import World
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.models import PANDA, UR5, XARM7
from minidual.robot.pair import Robot, pose, robot_from
from minidual.tasks.catalogue import make_task, task_config
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench

CONFIG = RobotConfig(arm="panda", right_arm="ur5")
ROBOT = robot_from(CONFIG)
DOWN = np.diag([1.0, -1.0, -1.0])


def test_storage_is_the_left_arm_then_the_right() -> None:
    assert ROBOT.name == "panda+ur5"
    assert ROBOT.dofs == (7, 6)
    assert ROBOT.dof == 13
    assert ROBOT.joint_names[6:8] == ("left_panda_joint7", "right_shoulder_pan_joint")
    assert ROBOT.groups["right_arm"] == slice(7, 13)
    assert ROBOT.home.tolist() == [*PANDA.home, *UR5.home]
    assert ROBOT.per_joint([1, 2]).tolist() == [1] * 7 + [2] * 6
    assert ROBOT.base_positions_m == ((0.0, 0.25, 0.0), (0.0, -0.3, 0.0))
    assert Robot(PANDA) != ROBOT
    assert Robot(PANDA, PANDA) == Robot(PANDA)
    assert Robot(PANDA).name == "panda"


def test_what_needs_equally_many_joints_says_so() -> None:
    with pytest.raises(UsageError, match=r"'panda\+ur5' has 7 and 6"):
        _ = ROBOT.dof_per_arm


def test_a_pair_has_one_hand_and_one_friction() -> None:
    with pytest.raises(UsageError, match=r"different damping \(0.1 and 0.4\)"):
        Robot(PANDA, dataclasses.replace(UR5, damping=0.4))


def test_named_states_are_those_of_both_arms() -> None:
    states = NamedStates(robot=robot_from(RobotConfig(arm="panda", right_arm="xarm7")))
    assert set(states) == {"home", "ready", "carry", "raised", "folded"}
    assert states.joints("ready", "both_arms", np.zeros(14)).tolist() == [
        *PANDA.postures["ready"][0],
        *XARM7.postures["ready"][1],
    ]
    assert set(NamedStates(robot=ROBOT)) == {"home"}


def test_unchecked_pairs_are_those_of_each_arm() -> None:
    pairs = acm_report(ROBOT).acm
    of_pandas = acm_report(Robot(PANDA)).acm
    of_ur5s = acm_report(Robot(UR5)).acm
    left = {pair for pair in pairs if pair[0].startswith("left_")}
    assert left == {pair for pair in of_pandas if pair[0].startswith("left_")}
    assert pairs - left == {pair for pair in of_ur5s if pair[0].startswith("right_")}


def test_compiled_laws_know_where_the_right_arm_begins() -> None:
    kinematics = Kinematics(ROBOT)
    hands = Hands(kinematics)
    hands.update(ROBOT.home)
    assert hands.views[5] == 7
    law = BrakingLaw(ROBOT, 1.0)
    v = np.zeros(13)
    v[7] = 1.0
    apart = law.slopes(ROBOT.home, v, together=False)
    assert apart[:7].min() > apart[7:].min(), "the left arm need not brake as slowly"
    assert len(set(law.slopes(ROBOT.home, v).tolist())) == 1


def test_a_mixed_pair_plans_to_joints_and_poses_and_follows() -> None:
    planner = Planner(robot=ROBOT)
    world = World(SceneConfig(), ROBOT)
    loop = JointLoop(world, planner.kinematics)
    poses = {side: pose(DOWN, (0.45, y, 0.3)) for side, y in (("left", 0.2), ("right", -0.2))}
    result = planner.plan_to_poses("both_arms", ROBOT.home, poses, seed=1)
    assert result.verification.ok
    trajectory = result.trajectory
    for t in np.arange(0.0, trajectory.duration_s, world.dt):
        loop.follow(*trajectory.sample(t), np.ones(2))
        assert np.linalg.norm(world.q - trajectory.sample(t + world.dt)[0]) < 0.05
    reached = planner.kinematics.tcp_poses(trajectory.q[-1])
    for side, T in zip(ROBOT.sides, reached, strict=True):
        assert np.abs(T - poses[side]).max() < 1e-5
    one_arm = planner.plan_to_joints("right_arm", trajectory.q[-1], ROBOT.home[7:], seed=1)
    assert one_arm.verification.ok


@pytest.mark.slow
def test_a_mixed_pair_hands_a_box_over() -> None:
    config = task_config(Config(task="handover", robot=CONFIG))
    trial = make_task(config).trial(7, "mixed-pair", 0)
    result, _ = Bench("moveit", MethodInputs(config, 7)).run(trial)
    assert result.success, result.text
