"""Action spaces move the hands as their names say, and joint targets follow."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.control import SensingConfig
from minidual.config.root import Config
from minidual.environments.actions import ACTIONS, LEAD_M, arms_of, turned_plane, turned_together
from minidual.environments.kernels import place_hands
from minidual.environments.observations import (
    LIFT,
    OBSERVATIONS,
    ObservationInputs,
    Truth,
    observe,
    size_of,
)
from minidual.environments.senses import JointReadings, PoseSensors, Senses, hand_yaw, rotations
from minidual.errors import UsageError
from minidual.robot.pair import DUAL_PANDA
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import pose_of

ROBOT = DUAL_PANDA
ARMS = arms_of(ROBOT)
TASK = make_task(Config(task="pot_lift"))


def sensed_at(q, pot=(0.48, 0.12, 0.0)):
    """Return the readings of worlds at q (N, n)."""
    n = len(q)
    senses = Senses(ARMS.frames, n)
    T = np.tile(pose_of(TASK.objects["pot"].body, pot), (n, 1, 1, 1))
    senses.reset(np.arange(n), T, np.tile([0.48, -0.15, 0.0], (n, 1)))
    arms = JointReadings(
        np.zeros(n),
        np.array(q),
        np.zeros((n, ROBOT.dof)),
        np.ones((n, 2)),
        np.zeros((n, 2)),
        np.zeros((n, 2, 6)),
    )
    return senses.read(arms, T)


def driven(name: str, action, closed: bool = False):
    """Return the space after one action from home, and the hands' poses (2, 4, 4) before and after."""
    space = ACTIONS[name](ARMS, 1)
    sensed = sensed_at(space.target)
    if closed:
        space.opening[:] = 0.0
    before = space.hands[0].copy()
    space.begin(np.array([action], dtype=float), sensed)
    for share in (0.25, 0.5, 0.75, 1.0):
        space.step(share)
    Ts = np.zeros((1, 2, 4, 4))
    place_hands(ARMS.frames, space.target, Ts)
    return space, before, Ts[0]


@pytest.mark.parametrize(
    "name", ["joint_targets", "hand_increments", "pair_increments", "object_increments"]
)
def test_every_number_of_an_action_has_a_name_and_bounds(name):
    space = ACTIONS[name](ARMS, 2)
    assert len(space.names) == len(set(space.names)) == len(space.low) == len(space.high)
    assert (space.low < space.high).all()


def test_joint_targets_are_held():
    q = ROBOT.home + 0.1
    space, _, after = driven("joint_targets", [*q, 0.0, 1.0])
    assert space.target[0] == pytest.approx(q)
    assert space.opening.tolist() == [[0.0, 1.0]]
    assert after == pytest.approx(space.hands[0])


def test_hand_increments_move_each_hand():
    action = np.zeros(10)
    action[0] = 1.0
    action[6] = -0.4
    _, before, after = driven("hand_increments", action)
    assert after[0, :3, 3] - before[0, :3, 3] == pytest.approx([0.05, 0.0, 0.0], abs=1e-4)
    assert after[1, :3, 3] - before[1, :3, 3] == pytest.approx([0.0, 0.0, -0.02], abs=1e-4)


def test_pair_increments_move_both_and_apart():
    """Apart is along the line between hands over an object: across their fingers."""
    _, before, after = driven("pair_increments", [0, 0.5, 0, 0, 0, 1, 0, 0, 0, 0])
    frame = hand_yaw(before).mean() - np.pi / 2.0
    along = turned_plane(np.array([[0.0, 0.04]]), np.array([frame]))[0]
    moved = (after - before)[:, :3, 3]
    assert moved.mean(axis=0) == pytest.approx([0.0, 0.025, 0.0], abs=1e-4)
    assert moved[0] - moved[1] == pytest.approx([*along, 0.0], abs=1e-4)


def test_closed_hands_turn_about_the_point_between_them_and_open_ones_in_place():
    turn = [0, 0, 0, 0.8, 0, 0, 0, 0, 0, 0]
    _, before, after = driven("pair_increments", turn, closed=True)
    middle = before[:, :3, 3].mean(axis=0)
    assert after[:, :3, 3].mean(axis=0) == pytest.approx(middle, abs=1e-4)
    assert np.linalg.norm(after[0, :2, 3] - before[0, :2, 3]) > 0.01
    _, before, after = driven("pair_increments", turn)
    assert after[:, :3, 3] == pytest.approx(before[:, :3, 3], abs=1e-4)
    assert not np.allclose(after[:, :3, :3], before[:, :3, :3], atol=0.1)


def test_object_increments_keep_the_hands_apart_as_they_are():
    space, before, after = driven("object_increments", [0.3, -0.2, 0.1, 1.0, -1.0])
    apart = [np.linalg.norm(T[0, :3, 3] - T[1, :3, 3]) for T in (before, after)]
    assert apart[0] == pytest.approx(apart[1], abs=2e-4)
    assert space.opening.tolist() == [[0.0, 0.0]]


def test_grips_have_hysteresis():
    space = ACTIONS["pair_increments"](ARMS, 1)
    sensed = sensed_at(space.target)
    told = []
    for grip in (0.4, -0.4, -0.6, -0.4, 0.4, 0.6):
        space.begin(np.r_[np.zeros(8), grip, grip][None], sensed)
        told.append(space.opening[0, 0])
    assert told == [1.0, 1.0, 0.0, 0.0, 0.0, 1.0]


def test_targets_of_closed_hands_do_not_run_ahead_downwards():
    space = ACTIONS["pair_increments"](ARMS, 1)
    sensed = sensed_at(space.target)
    space.opening[:] = 0.0
    space.begin(np.array([[0, 0, -1, 0, 0, 0, 0, 0, 0, 0]], dtype=float), sensed)
    lead = sensed.hands[0, :, 2, 3] - space.wanted[0, :, 2]
    assert lead == pytest.approx([LEAD_M, LEAD_M])


def test_the_way_to_a_place_can_be_written_as_an_action():
    space = ACTIONS["pair_increments"](ARMS, 1)
    wanted = space.wanted + np.array([[[0.02, 0.01, -0.02, 0.1], [0.03, 0.0, -0.03, 0.05]]])
    action = space.action_to(wanted, np.ones(1))
    action[:, 8:] = 1.0
    space.begin(action, sensed_at(space.target))
    assert space.wanted == pytest.approx(wanted)


def test_turning_together_keeps_the_middle():
    hands = np.array([[[0.5, 0.2, 0.1, 0.0], [0.4, -0.2, 0.1, 0.0]]])
    turned = turned_together(hands, np.array([0.7]))
    assert turned[:, :, :3].mean(axis=1) == pytest.approx(hands[:, :, :3].mean(axis=1))


def test_an_observation_has_the_size_of_its_terms():
    space = ACTIONS["pair_increments"](ARMS, 2)
    inputs = ObservationInputs(sensed_at(space.target), space, TASK)
    for name, term in OBSERVATIONS.items():
        if term.privileged or "relative" in name:
            continue
        assert observe((name,), inputs).shape == (2, term.size(ROBOT)), name
    assert size_of(LIFT, ROBOT) == 40
    assert not any(OBSERVATIONS[name].privileged for name in LIFT)


def test_privileged_terms_need_the_truth():
    space = ACTIONS["pair_increments"](ARMS, 1)
    sensed = sensed_at(space.target)
    with pytest.raises(UsageError, match="needs the truth"):
        observe(("privileged_object",), ObservationInputs(sensed, space, TASK))
    truth = Truth(sensed.objects, np.zeros((1, 6)), np.zeros((1, 2)), np.zeros((1, 6)))
    assert observe(("privileged_object",), ObservationInputs(sensed, space, TASK, truth)).shape == (
        1,
        13,
    )


def test_to_grasps_is_zero_at_the_grasps():
    """Hands at the grasps of a pot that is turned."""
    space = ACTIONS["pair_increments"](ARMS, 1)
    sensed = sensed_at(space.target, (0.5, 0.1, 0.3))
    T_pot = sensed.objects[0, 0]
    grasps = TASK.objects["pot"].grasps
    hands = np.stack([T_pot @ grasps[side] for side in ROBOT.sides])[None]
    at_them = sensed._replace(hands=hands)
    assert observe(("to_grasps",), ObservationInputs(at_them, space, TASK)) == pytest.approx(
        0.0, abs=1e-6
    )
    assert np.abs(observe(("to_grasps",), ObservationInputs(sensed, space, TASK))).max() > 0.5


def test_sensed_poses_are_late_and_off_as_configured():
    config = SensingConfig(
        pose_noise_m=0.0, pose_noise_rad=0.0, pose_bias_m=0.01, pose_bias_rad=0.02, delay_s=0.02
    )
    sensors = PoseSensors(config, 1, 0.001)
    sensors.reset(0, np.random.default_rng(0))
    T = np.eye(4)[None]
    sensors.begin(np.arange(1), T)
    R = np.eye(3)[None]
    for step in range(50):
        sensors.note(R, np.array([[1e-3 * step, 0.0, 0.0]]))
    read = sensors.read(np.arange(1))[0]
    offset = sensors.offset[0]
    assert read[0, 3] - offset[0] == pytest.approx(0.049 - 0.020, abs=1e-9)
    assert read[:3, :3] == pytest.approx(rotations(offset[None, 3:])[0])
    assert np.abs(offset[:3]).max() > 1e-3
