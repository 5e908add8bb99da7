"""A batched environment keeps Gymnasium's contract, and runs trials as a single world does."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from minidual.config.root import Config
from minidual.environments.actions import downward_poses
from minidual.environments.batched import BatchedEnv
from minidual.environments.evaluation import evaluate
from minidual.environments.kernels import reach
from minidual.environments.rewards import TOGETHER
from minidual.environments.scripted import LiftScript
from minidual.errors import UsageError
from minidual.trials.conditions import condition
from tests.support.batched_lifts import Pair, TargetRecorder

CONFIG = Config(task="pot_lift")


@pytest.fixture(scope="module")
def env():
    return BatchedEnv(3, CONFIG, fast=True, purpose="test")


def still(env):
    return np.zeros(env.action_space.shape, dtype=np.float32)


def test_gymnasium_makes_it_from_the_name_of_the_task():
    made = gymnasium.make_vec("minidual.environments:minidual/PotLift-v0", num_envs=2, fast=True)
    observation, _ = made.reset(seed=3)
    assert isinstance(made.unwrapped, BatchedEnv)
    assert made.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert observation.shape == made.observation_space.shape == (2, 40)
    assert made.action_space.shape == (2, 10)
    assert made.observation_space.contains(observation)


def test_one_step_returns_a_row_for_each_world(env):
    env.reset(options={"first": 0})
    observation, reward, terminated, truncated, info = env.step(still(env))
    assert env.observation_space.contains(observation)
    assert reward.shape == terminated.shape == truncated.shape == (3,)
    assert info["success"].tolist() == [False] * 3
    assert reward == pytest.approx(np.sum(list(info["reward_terms"].values()), axis=0))


def test_a_trial_is_the_same_whatever_runs_beside_it(env):
    alone = BatchedEnv(1, CONFIG, fast=True, purpose="test")
    rng = np.random.default_rng(0)
    actions = rng.uniform(-0.5, 0.5, (6, 3, 10))
    seen, _ = env.reset(options={"first": 0})
    seen_alone, _ = alone.reset(options={"first": 1})
    for action in actions:
        assert np.array_equal(seen[1], seen_alone[0])
        seen, *_ = env.step(action)
        seen_alone, *_ = alone.step(action[1:2])
    assert np.array_equal(env.worlds.q[1], alone.worlds.q[0])


def test_the_next_trial_begins_in_the_step_in_which_one_ends():
    env = BatchedEnv(2, CONFIG, fast=True, purpose="test")
    env.reset()
    env.worlds._time[0] = env.task.time_limit_s - 0.1
    env.referee._elapsed_s[0] = env.task.time_limit_s - 0.1
    observation, _, terminated, truncated, info = env.step(still(env))
    assert truncated.tolist() == [True, False]
    assert not terminated.any()
    assert info["_final_obs"].tolist() == [True, False]
    assert info["final_info"]["trial"].tolist() == [0, 1]
    assert [trial.index for trial in env.running.trials] == [2, 1]
    assert env.worlds.time_s[0] == 0.0
    assert np.array_equal(info["final_obs"][1], observation[1])
    assert not np.array_equal(info["final_obs"][0], observation[0])


def test_a_world_that_diverges_ends_and_the_others_go_on(env):
    env.reset(options={"first": 0})
    env.step(still(env))
    env.worlds._state.qvel[1, 0] = np.nan
    _, reward, terminated, _, info = env.step(still(env))
    assert terminated.tolist() == [False, True, False]
    assert info["final_info"]["failure"].tolist() == ["", "diverged", ""]
    assert np.isfinite(reward).all()


def test_a_hand_that_presses_on_the_table_stops_the_trial():
    """Joint targets of hands 30 mm below the table top: the supervisor's bounds end the trial."""
    env = BatchedEnv(1, CONFIG, action="joint_targets", rate_hz=10, fast=True, purpose="test")
    env.reset()
    below = np.array([[[0.4, 0.3, -0.03, np.pi / 2.0], [0.4, -0.3, -0.03, np.pi / 2.0]]])
    q = env.worlds.q
    reach(env.arms.rest, downward_poses(below), q)
    way = q - env.arms.robot.home
    for step in range(60):
        targets = env.arms.robot.home + min(1.0, step / 30.0) * way
        _, _, terminated, _, info = env.step(np.c_[targets, 1.0, 1.0])
        if terminated[0]:
            assert info["final_info"]["failure"][0] == "stopped"
            return
    pytest.fail("nothing stopped the hands")


def test_bad_input_gets_a_message(env):
    env.reset(options={"first": 0})
    with pytest.raises(UsageError, match="finite numbers"):
        env.step(np.full((3, 10), np.nan))
    with pytest.raises(UsageError, match="finite numbers"):
        env.step(np.zeros((2, 10)))
    with pytest.raises(UsageError, match="there are first, purpose"):
        env.reset(options={"trial": 1})
    with pytest.raises(UsageError, match="before it was reset"):
        BatchedEnv(1, CONFIG, fast=True).step(np.zeros((1, 10)))
    with pytest.raises(UsageError, match="must divide 50 Hz"):
        BatchedEnv(1, CONFIG, rate_hz=20)
    with pytest.raises(UsageError, match="cannot be judged in a batch"):
        BatchedEnv(1, Config(task="handover"))
    with pytest.raises(UsageError, match="no action space 'magic'"):
        BatchedEnv(1, CONFIG, action="magic")


def test_a_lift_with_one_arm_frozen_earns_nothing_for_what_both_hands_do():
    env = BatchedEnv(2, CONFIG, fast=True, purpose="test", frozen="right", supervised=False)
    script = LiftScript(env)
    env.reset()
    paid = dict.fromkeys(TOGETHER, 0.0)
    reached = 0.0
    for _ in range(40):
        _, _, _, _, info = env.step(script.action())
        for name in paid:
            paid[name] += float(np.abs(info["reward_terms"][name]).sum())
        reached += float(info["reward_terms"]["reach"].sum())
    assert reached > 0.1
    assert paid == dict.fromkeys(TOGETHER, 0.0)


def test_a_condition_changes_each_world_and_the_offset_of_its_sensor():
    env = BatchedEnv(2, CONFIG, fast=True, purpose="test", condition=condition("randomised"))
    env.reset()
    masses = env.worlds._own["body_mass"][:, env.worlds._body]
    assert len(set(masses)) == 2
    assert env.worlds.model.body_mass[env.worlds._body] == pytest.approx(1.0)
    offset = env.running.readings.offset
    assert (np.abs(offset[:, :3]) > 0.0).all()
    away = env.sensed.objects[:, 0, :3, 3] - env.worlds.object_poses()[:, :3, 3]
    assert np.abs(away - offset[:, :3]).max() < 0.003


def test_the_script_lifts_the_pot_and_the_judge_counts_it():
    env = BatchedEnv(2, CONFIG, fast=True)
    script = LiftScript(env)
    outcomes = evaluate(env, lambda _: script.action(), 2, "script", script.restart)
    assert [outcome["failure"] for outcome in outcomes] == ["", ""]
    assert all(outcome["success"] for outcome in outcomes)
    assert all(outcome["highest_m"] > 0.1 for outcome in outcomes)


def equal(pair: Pair, recorder: TargetRecorder, episode: int) -> bool:
    """Play an episode in both environments; check what must agree and return whether all does.

    Both end within two control steps; after 2 s their joints differ by 2 mrad at most.
    """
    targets = recorder.targets(episode)
    batched = pair.play_batched(episode, targets)
    single = pair.play_single(targets)
    same_end = abs(batched.steps_n - single.steps_n) <= 2
    same_faults = bool(batched.failures) == bool(single.failures)
    same_joints = float(np.abs(batched.q - single.q).max()) < 0.002
    return same_end and same_faults and same_joints and batched.success == single.success


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_a_hundred_random_episodes_end_as_in_a_single_environment():
    """Scripted lifts under noise of three sizes; contacts amplify rounding: two may part at a limit."""
    pair = Pair()
    recorder = TargetRecorder()
    equals = [equal(pair, recorder, episode) for episode in range(100)]
    assert sum(equals) >= 98


def test_random_episodes_end_as_in_a_single_environment():
    pair = Pair()
    recorder = TargetRecorder()
    assert [equal(pair, recorder, episode) for episode in (2, 3)] == [True, True]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("fast", [True, False])
def test_the_script_succeeds_from_nearly_all_starts(fast):
    env = BatchedEnv(32, CONFIG, fast=fast)
    script = LiftScript(env)
    outcomes = evaluate(env, lambda _: script.action(), 64, "script", script.restart)
    assert sum(outcome["success"] for outcome in outcomes) >= 61
