"""The Gymnasium environment keeps Gymnasium's contract, and the task can be done through it."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AsyncVectorEnv

from minidual.config.scene import CameraConfig, SceneConfig, TaskConfig
from minidual.environments.task_env import TaskEnv
from minidual.errors import UsageError
from minidual.tasks.catalogue import TASKS
from minidual.tasks.task import pose_of
from tests.support.arm_scripts import carry_script
from tests.support.carry_trials import rod_trial
from tests.support.panda import HOME, Q_UPPER


@pytest.fixture(scope="module")
def env():
    made = TaskEnv(object_pose=True)
    yield made
    made.close()


@pytest.mark.parametrize("name", TASKS)
def test_every_task_is_an_environment_that_pays_at_the_goal(name):
    """Also with no grasps (`handover`) and with a goal in the air (`insertion`)."""
    made = TaskEnv(task=name, object_pose=True)
    try:
        _, info = made.reset(seed=0)
        observation, reward, *_ = made.step(action())
        assert made.observation_space.contains(observation)
        assert np.isfinite(reward)
        trial = info["trial"]
        task = made._task
        body = task.objects[task.carried].body
        goal = pose_of(body, trial.goal[task.carried])

        made._world.reset(poses={**trial.start, task.carried: goal})
        tips = dict(
            zip(made._world.robot.sides, made._kinematics.tcp_poses(made._world.q), strict=True),
        )
        grasps = task.objects[task.carried].grasps
        away = [np.linalg.norm((goal @ T - tips[arm])[:3, 3]) for arm, T in grasps.items()]
        # at the goal only the hands' way to their grasps is left
        assert made._measure_potential(trial) == pytest.approx(
            -np.mean(away) if away else 0.0,
            abs=1e-6,
        )
    finally:
        made.close()


def action(q=HOME, hands=(1.0, 1.0)):
    return np.concatenate([q, hands]).astype(np.float32)


def test_gymnasiums_own_checker_passes_with_images_and_rendering():
    small = SceneConfig(camera=CameraConfig(width_px=64, height_px=48))
    made = gymnasium.make(
        "minidual.environments:minidual/RodCarry-v0",
        scene=small,
        images=("high", "left"),
        render_mode="rgb_array",
        object_pose=True,
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            # Raw radians are the interface of the arms: only this advice may be ignored.
            warnings.filterwarnings("ignore", message=".*symmetric and normalized.*")
            warnings.filterwarnings("ignore", category=DeprecationWarning)
            check_env(made.unwrapped)
        observation, _ = made.reset(seed=1)
        assert observation["images"]["left"].shape == (48, 64, 3)
        assert made.render().shape == (480, 640, 3)
        assert made.render().std() > 5.0
    finally:
        made.close()


def test_a_scripted_carry_succeeds_from_a_random_start_and_is_paid_for_it(env, kinematics):
    _, info = env.reset(seed=5)
    total = 0.0
    done = False
    for step in carry_script(env.scene, kinematics, info["trial"]):
        observation, reward, done, truncated, info = env.step(step.astype(np.float32))
        assert env.observation_space.contains(observation)
        total += reward
        if done:
            break
    assert done
    assert not truncated
    assert info["success"]
    assert info["failures"] == ()
    # The potential telescopes: at most its rise from start to end (under 2 m), and 1 for success.
    assert 1.0 < total < 3.0


def test_a_carry_with_one_hand_open_does_not_succeed(env, kinematics):
    _, info = env.reset(seed=5)
    for step in carry_script(env.scene, kinematics, info["trial"]):
        step[15] = 1.0  # the right hand never closes
        _, _, terminated, truncated, info = env.step(step.astype(np.float32))
        assert not info["success"]
        if terminated or truncated:
            break
    assert not info["success"]


def test_the_same_seed_gives_the_same_rollout_and_another_seed_another_start(env):
    def rollout(seed):
        env.action_space.seed(seed)
        observation, info = env.reset(seed=seed)
        states = [np.concatenate([observation["state"], observation["object"]])]
        for _ in range(15):
            observation, reward, *_ = env.step(env.action_space.sample())
            states.append(np.concatenate([observation["state"], observation["object"]]) + reward)
        return np.array(states), info["trial"].start

    first, start = rollout(3)
    again, start_again = rollout(3)
    assert np.array_equal(first, again)
    assert start == start_again
    assert rollout(4)[1] != start


def test_successive_resets_without_a_seed_differ(env):
    env.reset(seed=0)
    starts = [env.reset()[1]["trial"].start["rod"] for _ in range(3)]
    assert len(set(starts)) == 3


def test_a_given_trial_is_the_one_played(env):
    trial = rod_trial("test", 7, (0.47, 0.22, 0.1), (0.5, -0.25, -0.2))
    observation, info = env.reset(options={"trial": trial})
    assert info["trial"] is trial
    assert observation["object"][:2] == pytest.approx([0.47, 0.22], abs=1e-6)
    assert observation["goal"] == pytest.approx([0.5, -0.25, -0.2])


def test_time_runs_at_fifty_hertz_and_out_at_the_limit():
    made = TaskEnv(SceneConfig(task=TaskConfig(time_limit_s=1.5)))
    made.reset(seed=0)
    for k in range(1, 76):
        _, _, terminated, truncated, info = made.step(action())
        assert info["time_s"] == pytest.approx(0.02 * k)
        assert not terminated
        assert truncated == (k == 75)
    assert "rose" in info["failures"]


def test_moving_the_hands_towards_the_rod_pays_and_moving_away_costs(env, kinematics):
    _, info = env.reset(seed=2)
    towards = carry_script(env.scene, kinematics, info["trial"])[:60]
    assert sum(env.step(a.astype(np.float32))[1] for a in towards) > 0.1
    assert sum(env.step(a.astype(np.float32))[1] for a in reversed(towards)) < -0.1


def test_an_action_beyond_the_joint_limits_stops_at_them(env):
    env.reset(seed=0)
    target = HOME.copy()
    target[6] = 50.0
    for _ in range(100):
        observation, *_ = env.step(action(target))
    assert observation["state"][6] == pytest.approx(Q_UPPER[6], abs=1e-3)


@pytest.mark.parametrize("bad", [np.full(16, np.nan, np.float32), np.zeros(14, np.float32)])
def test_a_nan_or_a_wrong_shape_is_refused(env, bad):
    env.reset(seed=0)
    with pytest.raises(UsageError, match="16"):
        env.step(bad)


def test_errors_name_what_exists(env):
    with pytest.raises(UsageError, match="no camera 'top'; there are high, left, right"):
        TaskEnv(images=("top",))
    with pytest.raises(UsageError, match="no render mode 'human'"):
        TaskEnv(render_mode="human")
    with pytest.raises(UsageError, match="no option 'trail'"):
        env.reset(options={"trail": 1})
    with pytest.raises(UsageError, match="Trial"):
        env.reset(options={"trial": (0, 0, 0)})
    with pytest.raises(UsageError, match="before it was reset"):
        TaskEnv().step(action())


def _with_pictures():
    small = SceneConfig(camera=CameraConfig(width_px=32, height_px=24))
    return TaskEnv(small, images=("high",))


def test_forked_workers_with_pictures_end_with_a_message_and_spawned_ones_draw():
    """The parent has drawn: forked workers would hang for ever."""
    made = _with_pictures()
    made.reset(seed=0)
    forked = AsyncVectorEnv([_with_pictures], context="fork")
    with pytest.raises(UsageError, match="forked"):
        forked.reset(seed=0)
    spawned = AsyncVectorEnv([_with_pictures], context="spawn")
    try:
        observation, _ = spawned.reset(seed=0)
        assert observation["images"]["high"].std() > 5.0
    finally:
        spawned.close()
        made.close()
