"""Demonstrations of a carry are moved to other starts and goals, the grasps of both hands kept."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest

from minidual.config.leading import MultiplyConfig
from minidual.config.root import Config, changed
from minidual.demos.augment.moving import carry_progress, distance, moved, moved_hands
from minidual.demos.augment.segments import START, SourceDemo, read_sources, source_demo
from minidual.demos.episode import Episode
from minidual.demos.leader import LeaderSetup
from minidual.demos.leaders.augmented import AugmentedLeader
from minidual.demos.rig import Job, Rig
from minidual.errors import DataError, UsageError
from minidual.motion.ik import PoseUnreachableError
from minidual.robot.pair import DUAL_PANDA, Array, pose, rot_z
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Placement
from tests.support import data_samples
from tests.support.carried_demo import SEED, carried, kinematics, write_carry

NEAR_M = 0.12


@functools.cache
def source() -> SourceDemo:
    return source_demo(carried(), "one", kinematics(), NEAR_M)


def shifted(place: Placement, x: float, y: float, yaw: float) -> Placement:
    return place[0] + x, place[1] + y, place[2] + yaw


def seen_from(place: Placement, T_world_tcp: Array) -> Array:
    """Return a hand's pose in the frame of an object on the table."""
    return np.linalg.inv(pose(rot_z(place[2]), (place[0], place[1], 0.0))) @ T_world_tcp


def test_the_segments_of_a_carry_are_found_in_order() -> None:
    one = source()
    assert max(one.near) < one.held < one.released < len(one.q)
    assert one.gripper[one.held].max() == 0.0
    assert one.gripper[one.held - 1].max() == 1.0
    for side in range(2):
        grasp = one.hands[one.held, side, :3, 3]
        assert np.linalg.norm(one.hands[one.near[side] - 1, side, :3, 3] - grasp) > NEAR_M
        later = one.hands[one.near[side] : one.held, side, :3, 3]
        assert np.linalg.norm(later - grasp, axis=1).max() <= NEAR_M


def test_moved_to_its_own_start_and_goal_it_is_what_was_recorded() -> None:
    one = source()
    np.testing.assert_allclose(moved_hands(one, one.start, one.goal), one.hands, atol=1e-12)
    same = moved(one, one.start, one.goal, kinematics())
    np.testing.assert_allclose(same.q, one.q, atol=1e-3)
    np.testing.assert_array_equal(same.gripper, one.gripper)


@pytest.mark.parametrize(
    ("at_start", "at_goal"),
    [((0.05, -0.04, 0.3), (0.0, 0.0, 0.0)), ((-0.03, 0.02, -0.2), (0.02, -0.06, 0.25))],
)
def test_each_segment_belongs_to_its_object_and_both_hands_keep_their_grasps(
    at_start: tuple[float, float, float],
    at_goal: tuple[float, float, float],
) -> None:
    one = source()
    start = shifted(one.start, *at_start)
    goal = shifted(one.goal, *at_goal)
    hands = moved_hands(one, start, goal)
    np.testing.assert_allclose(hands[0], one.hands[0], atol=1e-12)
    for side in range(2):
        for tick in (one.near[side], one.held - 1, one.held):
            expected = seen_from(one.start, one.hands[tick, side])
            np.testing.assert_allclose(seen_from(start, hands[tick, side]), expected, atol=1e-9)
    for tick in range(one.held, len(hands)):
        left, right = one.hands[tick]
        new_left, new_right = hands[tick]
        np.testing.assert_allclose(
            np.linalg.inv(new_left) @ new_right,
            np.linalg.inv(left) @ right,
            atol=1e-9,
            err_msg="the two hands keep their places on the object",
        )
    for side in range(2):
        expected = seen_from(one.goal, one.hands[-1, side])
        np.testing.assert_allclose(seen_from(goal, hands[-1, side]), expected, atol=5e-3)
    np.testing.assert_allclose(hands[:, :, 2, 3], one.hands[:, :, 2, 3], atol=1e-12)
    steps = np.linalg.norm(np.diff(hands[:, :, :3, 3], axis=0), axis=2).max()
    assert steps < 0.02, "nothing jumps where segments are joined"


def test_the_object_is_not_moved_while_it_stands_on_the_table() -> None:
    one = source()
    from minidual.demos.augment.moving import carried_path

    path = carried_path(one)
    progress = carry_progress(one, path)
    lifted = one.hands[one.held : one.released + 1, 0, 2, 3] > one.hands[one.held, 0, 2, 3] + 0.005
    first, last = np.flatnonzero(lifted)[[0, -1]]
    assert progress[:first].max() < 0.01
    assert progress[last:].min() > 0.99
    assert (progress[0], progress[-1]) == pytest.approx((0.0, 1.0))
    np.testing.assert_allclose(path[-1][:2], one.goal[:2], atol=5e-3)
    still = dataclasses.replace(one, hands=np.repeat(one.hands[:1], len(one.hands), axis=0))
    by_time = carry_progress(still, carried_path(still))
    assert (by_time[0], by_time[-1]) == (0.0, 1.0)


def test_a_rod_that_lies_the_other_way_round_is_the_same_rod() -> None:
    one = source()
    turned = shifted(one.start, 0.0, 0.0, np.pi)
    assert distance(one, turned, one.goal, symmetry=2) == pytest.approx(0.0, abs=1e-9)
    assert distance(one, turned, one.goal, symmetry=1) > 0.5
    hands = moved_hands(one, turned, one.goal, symmetry=2)
    np.testing.assert_allclose(hands, one.hands, atol=1e-9)


def test_a_place_out_of_reach_is_said() -> None:
    one = source()
    with pytest.raises(PoseUnreachableError, match="hand cannot reach"):
        moved(one, shifted(one.start, 0.6, 0.0, 0.0), one.goal, kinematics())


def _no_goal(episode: Episode) -> Episode:
    meta = dataclasses.replace(episode.meta, extra={START: [0.4, 0.0, 0.0]})
    return dataclasses.replace(episode, meta=meta)


def _grasps_again(episode: Episode) -> Episode:
    gripper = episode.action_gripper.copy()
    gripper[220:225, 1] = 1.0
    return dataclasses.replace(episode, action_gripper=gripper)


def _out_of_order(episode: Episode) -> Episode:
    gripper = np.ones_like(episode.action_gripper)
    gripper[100:150, 0] = 0.0
    gripper[200:250, 1] = 0.0
    return dataclasses.replace(episode, action_gripper=gripper)


def _begins_at_the_grasp(episode: Episode) -> Episode:
    action = np.repeat(episode.action[200:201], len(episode.action), axis=0)
    return dataclasses.replace(episode, action=action)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (_no_goal, "does not say 'goal_x_y_yaw'"),
        (_grasps_again, "the right hand closes and opens 4 times"),
        (_out_of_order, "opens before the other one has closed"),
        (_begins_at_the_grasp, "begins within 0.12 m of its grasp"),
    ],
)
def test_what_is_no_carry_is_refused(change: object, words: str) -> None:
    with pytest.raises(DataError, match=words):
        source_demo(change(carried()), "one", kinematics(), NEAR_M)  # type: ignore[operator]


def test_episodes_that_cannot_be_moved_are_left_out_and_named(tmp_path: Path) -> None:
    write_carry(tmp_path)
    bad = data_samples.arrays(20, cameras=())
    data_samples.write(tmp_path / "episode_000001.hdf5", bad)
    sources, refused = read_sources(str(tmp_path), kinematics(), NEAR_M, 0)
    assert [each.name for each in sources] == ["episode_000000.hdf5"]
    assert len(refused) == 1
    assert "episode_000001.hdf5: it does not say" in refused[0]
    (tmp_path / "episode_000000.hdf5").unlink()
    with pytest.raises(UsageError, match="none of 1 episodes"):
        read_sources(str(tmp_path), kinematics(), NEAR_M, 0)
    with pytest.raises(UsageError, match="no HDF5 episodes"):
        read_sources(str(tmp_path / "nowhere"), kinematics(), NEAR_M, 0)


def setup(task: str, path: Path) -> LeaderSetup:
    config = changed(Config(task=task), {"teleop.augment": MultiplyConfig(path=str(path))})
    made = make_task(config)
    return LeaderSetup(DUAL_PANDA, made, made.config.teleop, SEED)


def test_a_moved_demonstration_leads_each_trial_and_says_which(tmp_path: Path) -> None:
    write_carry(tmp_path)
    leader = AugmentedLeader.connect(setup("rod_carry", tmp_path))
    assert leader.sources_n == 1
    task = make_task(Config())
    leader.align(task.trial(SEED, "demonstrations", 3), DUAL_PANDA.home)
    first = leader.read(0.0)
    assert first is not None
    assert first.q is not None
    np.testing.assert_allclose(first.q, source().q[1], atol=5e-3)
    assert leader.facts == {"source": "episode_000000.hdf5"}
    with pytest.raises(UsageError, match="in the task 'handover' they do not"):
        AugmentedLeader.connect(setup("handover", tmp_path))


@pytest.mark.slow
def test_a_moved_demonstration_carries_the_rod_from_another_start(tmp_path: Path) -> None:
    write_carry(tmp_path / "sources")
    config = changed(
        Config(),
        {
            "teleop.leader": "augmented",
            "teleop.augment.path": str(tmp_path / "sources"),
            "teleop.cameras": ("high",),
        },
    )
    task = make_task(config)
    job = Job(tmp_path / "new", task, config.teleop, config.arbiter, SEED)
    rig = Rig(job, ())
    try:
        results = [rig.lead(job.trial(index), lambda tick: None) for index in range(1, 4)]
    finally:
        rig.close()
    assert sum(result.success for result in results) >= 2, [r.reason for r in results]
