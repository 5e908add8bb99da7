"""A batched environment: N worlds of one task in one process, as a Gymnasium vector environment.

    from minidual.config.root import Config
    from minidual.environments.batched import BatchedEnv, fast_physics
    from minidual.environments.scripted import LiftScript

    env = BatchedEnv(64, fast_physics(Config(task="pot_lift")), purpose="training")
    script = LiftScript(env)            # demonstrations in the environment's own actions
    observation, info = env.reset()
    while True:
        action = script.action()        # (N, 10); or a policy's
        observation, reward, terminated, truncated, info = env.step(action)
        script.restart(terminated | truncated)

Each world runs one trial after the other. Where one ends, the returned observation is the first of
the next trial; `info["final_obs"]` (N, k) has the last one of the old, and `info["final_info"]`
what became of it, valid where `info["_final_obs"]` is true (Gymnasium's SAME_STEP).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from minidual.config.root import Config, changed
from minidual.environments.actions import ACTIONS, arms_of
from minidual.environments.draws import Disturbed, Draws
from minidual.environments.observations import CLIP, LIFT, ObservationInputs, observe, size_of
from minidual.environments.readings import Readings
from minidual.environments.referee import Flags, Referee
from minidual.environments.rewards import LIFT_REWARD, LiftState, Reward, RewardTerm
from minidual.environments.running import RunningTrials
from minidual.environments.senses import Sensed
from minidual.environments.worlds import Worlds
from minidual.errors import UsageError, check_name, unknown_name
from minidual.robot.pair import SIDES, Array, Indices, robot_from
from minidual.tasks.catalogue import make_task

TICK_S = 0.02
"""Period of joint targets, as in trials (50 Hz)."""
LINGER_S = 0.6
"""A trial ends this long after it is finished, so that a policy lifts its open hands away by itself."""
RATE_HZ = 10
"""Rate of actions."""
FAST_PHYSICS = {"scene.physics.timestep_s": 0.002, "scene.physics.impratio": 10.0}
"""Half the cost of a trial's physics; lifts learnt with it carry over, insertions do not."""
Floats = npt.NDArray[np.float32]


def fast_physics(config: Config) -> Config:
    """Return a configuration with `FAST_PHYSICS`."""
    return changed(config, FAST_PHYSICS)


class BatchedEnv(gymnasium.vector.VectorEnv[Floats, Floats, Array]):
    """N worlds of one task; all arrays have N rows.

    Observation: (N, k) float32, the terms `observation` (environments/observations.py).
    Action: (N, k), in the space `action` (environments/actions.py), held 1 / `rate_hz`.
    Reward: (N,), the sum of `reward` (environments/rewards.py).
    `terminated`: the trial is finished for `linger_s`, a condition of success is violated, the
    supervisor would have stopped, or the simulation diverged. `truncated`: the task's time limit.
    `info`: `success` (N,), and `reward_terms`, {name: (N,)}. `final_info` has `success`,
    `failure` (name of what was violated first, or ""), `trial`, `time_s`, `highest_m`, `tilt_max_rad`
    and `pinch_min_n`.

    Args:
        num_envs: Worlds, N.
        config: Names the task; see `fast_physics`.
        task: Replaces the configuration's.
        purpose: Of the random stream of trials; training and tests use different ones.
        first: Number of the first trial.
        condition: What disturbs the trials, as in the benchmark.
        privileged: Terms of the observation `info["privileged"]`, for critics.
        frozen: An arm that stays at home, "left" or "right", or None.
        supervised: Whether a bound of the supervisor ends a trial.
        fast: Use `FAST_PHYSICS`.
        threads: Of the physics; 0 for all cores.

    Raises:
        UsageError: A name is unknown, the rate does not divide 50 Hz, or the task is no transport of
            one object by both hands.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": [],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    # All are options.
    def __init__(
        self,
        num_envs: int = 1,
        config: Config | None = None,
        *,
        task: str | None = None,
        action: str = "pair_increments",
        observation: Sequence[str] = LIFT,
        privileged: Sequence[str] = (),
        reward: Sequence[RewardTerm[LiftState]] = LIFT_REWARD,
        rate_hz: int = RATE_HZ,
        purpose: str = "training",
        first: int = 0,
        condition: Disturbed | None = None,
        frozen: str | None = None,
        supervised: bool = True,
        end_at_violation: bool = True,
        linger_s: float = LINGER_S,
        discount: float = 1.0,
        fast: bool = False,
        threads: int = 1,
    ) -> None:
        config = Config() if config is None else config
        if task is not None:
            config = changed(config, {"task": task})
        if fast:
            config = fast_physics(config)
        config = config if condition is None else condition.config_under(config)
        if frozen is not None:
            check_name("arm", frozen, SIDES)
        self.num_envs = num_envs
        self.task = make_task(config)
        self.config = self.task.config
        self.draws = Draws(self.task, purpose, first, condition)
        self.frozen = None if frozen is None else SIDES.index(frozen)
        self._end_at_violation = end_at_violation
        self._ticks_n = _ticks(rate_hz)
        self.arms = arms_of(robot_from(self.config.robot))
        self.worlds = self._make_worlds(threads)
        self._substeps = round(TICK_S / self.worlds.dt)
        first_trial = self.task.trial(self.draws.seed, self.draws.purpose, 0)
        self.referee = Referee(self.task, self.worlds, first_trial, linger_s, supervised)
        readings = Readings(self.worlds, self.config.carry.sensing, self.arms.frames)
        self.running = RunningTrials(self.draws, first_trial, self.worlds, self.referee, readings)
        self.actions = ACTIONS[action](self.arms, num_envs)
        self.terms = tuple(observation)
        self.privileged = tuple(privileged)
        self._reward = Reward(reward, num_envs, discount)
        self._make_spaces()
        self._all = np.arange(num_envs)
        self._started = False

    def _make_worlds(self, threads: int) -> Worlds:
        return Worlds(
            self.task.scene,
            self.arms.robot,
            self.num_envs,
            self.arms.frames,
            supervisor=self.config.supervisor,
            threads=threads,
        )

    def _make_spaces(self) -> None:
        size = size_of(self.terms, self.arms.robot)
        low = self.actions.low.astype(np.float32)
        high = self.actions.high.astype(np.float32)
        self.single_observation_space = spaces.Box(-CLIP, CLIP, (size,), np.float32)
        self.single_action_space = spaces.Box(low, high)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    # Gymnasium's interface ---------------------------------------------------------------------

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Start the next trial in every world.

        Args:
            seed: Of the random streams; begins at trial 0.
            options: `purpose` of the stream of trials, and the number of the `first`.

        Raises:
            UsageError: Unknown option.
        """
        options = {} if options is None else options
        for name in options.keys() - {"purpose", "first"}:
            raise unknown_name("option", name, ["purpose", "first"])
        if seed is not None:
            self.draws.seed = seed
            self.draws.next_index = 0
        self.draws.purpose = options.get("purpose", self.draws.purpose)
        self.draws.next_index = options.get("first", self.draws.next_index)
        self._begin(self._all)
        self._started = True
        return self._observe(), self._info(self.running.state)

    def step(self, actions: npt.ArrayLike) -> tuple[Floats, Array, Flags, Flags, dict[str, Any]]:
        """Hold actions (N, k) for one period.

        Raises:
            UsageError: Not reset, wrong shape, or not finite.
        """
        action = self._checked(actions)
        self.actions.begin(action, self.sensed)
        self.worlds.loads.relax()
        for tick in range(self._ticks_n):
            self.actions.step((tick + 1) / self._ticks_n)
            target, opening = self._commanded()
            self.running.advance(target, opening, self._substeps)
        state = self.running.measure(self._ticks_n * TICK_S)
        paid = self._reward.pay(state)
        reward = np.sum(list(paid.values()), axis=0)
        terminated = self.referee.finished | self.referee.diverged
        if self._end_at_violation:
            terminated |= state.violated
        truncated = self.referee.late & ~terminated
        observation = self._observe()
        info = self._info(state)
        info["reward_terms"] = paid
        ended = terminated | truncated
        if ended.any():
            observation = self._restart(ended, observation, info)
        return observation, reward, terminated, truncated, info

    def close_extras(self, **kwargs: Any) -> None:
        """Free the simulations."""

    @property
    def sensed(self) -> Sensed:
        """Present readings for policies, a row a world."""
        return self.running.readings.latest

    # One step ----------------------------------------------------------------------------------

    def _checked(self, actions: npt.ArrayLike) -> Array:
        if not self._started:
            raise UsageError(
                "the environment was stepped before it was reset",
                remedy="call env.reset() first",
            )
        action = np.asarray(actions, dtype=float)
        shape = (self.num_envs, len(self.actions.names))
        finite = np.isfinite(action)
        if action.shape != shape or not finite.all():
            raise UsageError(
                f"actions are {shape} finite numbers; {action.shape} has {np.count_nonzero(finite)}"
            )
        return np.clip(action, self.actions.low, self.actions.high)

    def _commanded(self) -> tuple[Array, Array]:
        """Return joint targets (N, n) and openings (N, 2); a frozen arm stays at home."""
        if self.frozen is None:
            return self.actions.target, self.actions.opening
        robot = self.arms.robot
        target = self.actions.target.copy()
        opening = self.actions.opening.copy()
        own = robot.joints_of(self.frozen)
        target[:, own] = robot.home[own]
        opening[:, self.frozen] = 1.0
        return target, opening

    def _observe(self) -> Floats:
        return observe(self.terms, self._inputs())

    def _inputs(self) -> ObservationInputs:
        """Return what terms of observations are computed from."""
        return ObservationInputs(self.sensed, self.actions, self.task, self.running.truth())

    def _info(self, state: LiftState) -> dict[str, Any]:
        info: dict[str, Any] = {"success": state.succeeded.copy()}
        if self.privileged:
            info["privileged"] = observe(self.privileged, self._inputs())
        return info

    # Trials ------------------------------------------------------------------------------------

    def _restart(self, ended: Flags, observation: Floats, info: dict[str, Any]) -> Floats:
        """Start new trials in some worlds; return the observations of all, and fill `info`."""
        info["final_obs"] = observation
        info["_final_obs"] = ended.copy()
        info["final_info"] = self.referee.outcomes(self.running.trials, info["success"])
        info["_final_info"] = ended.copy()
        if self.privileged:
            info["final_privileged"] = info["privileged"]
        self._begin(np.flatnonzero(ended))
        first = self._observe()
        if self.privileged:
            info["privileged"] = self._info(self.running.state)["privileged"]
        return np.where(ended[:, None], first, observation)

    def _begin(self, worlds: Indices) -> None:
        """Start the next trials in some worlds."""
        self.running.begin(worlds)
        self.actions.reset(worlds)
        begun = np.zeros(self.num_envs, dtype=bool)
        begun[worlds] = True
        self._reward.restart(self.running.state, begun)


def _ticks(rate_hz: int) -> int:
    """Return the ticks of one action.

    Raises:
        UsageError: The rate does not divide 50 Hz.
    """
    ticks = 1.0 / (TICK_S * rate_hz)
    if abs(ticks - round(ticks)) > 1e-9 or ticks < 1.0:
        raise UsageError(f"actions at {rate_hz} Hz: the rate must divide {round(1.0 / TICK_S)} Hz")
    return round(ticks)
