"""Scripted demonstrations of `pot_lift` in the batched environment's own actions.

The script reads what a policy may read (`env.sensed`), not the truth, and acts in the space
`pair_increments`. A trainer clones it:

    env = BatchedEnv(64, fast_physics(Config(task="pot_lift")), purpose="demonstrations")
    samples = record(env, episodes_n=150, rng=stream(seed, "demonstrations/noise"))
    samples.observations    # (m, 40) float32
    samples.actions         # (m, 10) float32, without the noise that was added while recording

`LiftScript(env).action()` returns the script's actions (N, 10) for the present state of all worlds;
`restart(ended)` tells it in which a new trial began.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from minidual.environments.actions import PairIncrements, turned_plane
from minidual.environments.batched import BatchedEnv
from minidual.environments.senses import hand_yaw, nearest_turn, yaw_of
from minidual.errors import UsageError
from minidual.robot.pair import SIDES, Array

_ABOVE_M = 0.08
"""Height over the grasps at which hands arrive."""
_LIFT_M = 0.12
_HIGH_M = 0.108
_THERE_M = 0.012
_ROUGHLY_THERE_M = 0.062
_PATIENCE = 12
"""Steps along the way after which a rougher arrival is good enough."""
_LANDED_M = 0.0005
_PRESSED_M = 0.003
"""How far below its rest height the pot is led: it must not be let go in the air."""
_LANDING_STEPS = 4
"""Steps at this height after which it counts as landed, even if a noisy reading disagrees."""
_FIRM_N = 57.0
_RISE_STEP_M = 0.03
_RISE_TO_M = 0.25
_STEP = np.array([0.05, 0.05, 0.05, 0.25])
_APPROACH_APART_M = 0.012
_APART_SHIFT = slice(4, 7)
"""Numbers of an action that move the hands apart along x, y and z."""


class Phase(IntEnum):
    """Phases of the script in a world."""

    REACH = 0
    DESCEND = 1
    GRASP = 2
    LIFT = 3
    ALONG = 4
    LOWER = 5
    OPEN = 6
    RISE = 7


_PACE = {
    Phase.REACH: 1.0,
    Phase.DESCEND: 0.5,
    Phase.GRASP: 1.0,
    Phase.LIFT: 0.6,
    Phase.ALONG: 0.6,
    Phase.LOWER: 0.25,
    Phase.OPEN: 1.0,
    Phase.RISE: 0.6,
}
"""Share of the largest increments, by phase."""
_RAMP_STEPS = 3
"""Steps over which hands that hold something take up their pace: a jerk shakes it out of the grip."""
_LEAST_STEPS = 2.5
"""They go at most one part in so many of the way left, so that they arrive slowly."""
_OPEN_WIDE = 0.9


class LiftScript:
    """Reach, descend, grasp, lift, along, lower, open, rise.

    Attributes:
        phase: Of each world (N,), see Phase.

    Raises:
        UsageError: The environment has other actions than pair_increments.
    """

    def __init__(self, env: BatchedEnv) -> None:
        if not isinstance(env.actions, PairIncrements):
            raise UsageError("the script acts in the space 'pair_increments'")
        self._env = env
        self._actions = env.actions
        task = env.task
        grasps = task.objects[task.carried].grasps
        self._grasps = np.stack([grasps[side] for side in SIDES])
        self._rest_m = task.objects[task.carried].body.rest_height_m
        self._symmetry = task.objects[task.carried].symmetry
        self.phase = np.zeros(env.num_envs, dtype=int)
        self._wanted = np.zeros((env.num_envs, 2, 4))
        self._waited = np.zeros(env.num_envs, dtype=int)
        self._since = np.zeros(env.num_envs, dtype=int)

    def restart(self, ended: npt.NDArray[np.bool_]) -> None:
        """Begin anew in worlds where a trial began (N,)."""
        self.phase[ended] = Phase.REACH
        self._waited[ended] = 0
        self._since[ended] = 0

    def action(self) -> npt.NDArray[np.float32]:
        """Return actions (N, 10) for the present state."""
        before = self.phase.copy()
        for world in range(self._env.num_envs):
            self._decide(world)
        self._since = np.where(self.phase == before, self._since + 1, 0)
        return self._towards_wanted()

    # Phases ------------------------------------------------------------------------------------

    def _decide(self, world: int) -> None:
        """Choose the phase of a world and where its hands shall be."""
        step = (
            self._reach,
            self._descend,
            self._grasp,
            self._lift,
            self._along,
            self._lower,
            self._open,
            self._rise,
        )[self.phase[world]]
        step(world)

    def _at_grasps(self, world: int, above_m: float) -> Array:
        """Return the hands (2, 4) over the grasps of the first reading."""
        T = self._env.sensed.first[world, 0]
        yaw = float(yaw_of(T))
        turn = np.array([yaw])
        hands = np.empty((2, 4))
        for hand, T_grasp in enumerate(self._grasps):
            hands[hand, :2] = T[:2, 3] + turned_plane(T_grasp[None, :2, 3], turn)[0]
            hands[hand, 2] = self._rest_m + T_grasp[2, 3] + above_m
            hands[hand, 3] = yaw + hand_yaw(T_grasp)
        return hands

    def _off(self, world: int) -> Array:
        """Return how far the hands (2, 4) are from where they shall be."""
        Ts = self._env.sensed.hands[world]
        hands = np.concatenate([Ts[:, :3, 3], hand_yaw(Ts)[:, None]], axis=1)
        return np.abs(self._wanted[world] - hands)

    def _reach(self, world: int) -> None:
        self._wanted[world] = self._at_grasps(world, _ABOVE_M)
        if self._off(world).max() < 0.03:
            self.phase[world] = Phase.DESCEND

    def _descend(self, world: int) -> None:
        self._wanted[world] = self._at_grasps(world, 0.0)
        if self._off(world)[:, :3].max() < 0.010:
            self.phase[world] = Phase.GRASP

    def _grasp(self, world: int) -> None:
        if self._env.sensed.grip_n[world].min() > _FIRM_N:
            self.phase[world] = Phase.LIFT
            self._wanted[world] = self._actions.wanted[world]
            self._wanted[world, :, 2] += _LIFT_M

    def _lift(self, world: int) -> None:
        if self._rise_m(world) > _HIGH_M:
            self.phase[world] = Phase.ALONG
            self._aim_at_goal(world)

    def _aim_at_goal(self, world: int) -> None:
        """Turn and shift the hands with the object, to bring it over its goal."""
        sensed = self._env.sensed
        T = sensed.objects[world, 0]
        goal = sensed.goal[world]
        turn = nearest_turn(np.array([goal[2] - float(yaw_of(T))]), self._symmetry)
        held = self._actions.wanted[world]
        self._wanted[world, :, :2] = goal[:2] + turned_plane(
            held[:, :2] - T[:2, 3], np.repeat(turn, 2)
        )
        self._wanted[world, :, 3] += turn

    def _along(self, world: int) -> None:
        sensed = self._env.sensed
        way_m = np.linalg.norm(sensed.objects[world, 0, :2, 3] - sensed.goal[world, :2])
        near_m = _THERE_M if self._waited[world] <= _PATIENCE else _ROUGHLY_THERE_M
        if way_m < near_m:
            self.phase[world] = Phase.LOWER
            grasp_m = self._rest_m + self._grasps[:, 2, 3]
            self._wanted[world, :, 2] = grasp_m - _PRESSED_M
            self._waited[world] = 0
            return
        self._waited[world] += 1

    def _lower(self, world: int) -> None:
        way_m = np.abs(self._actions.wanted[world, :, 2] - self._wanted[world, :, 2])
        self._waited[world] += way_m.max() < 1e-3
        if self._rise_m(world) < _LANDED_M or self._waited[world] >= _LANDING_STEPS:
            self.phase[world] = Phase.OPEN
            self._wanted[world] = self._actions.wanted[world]

    def _open(self, world: int) -> None:
        if self._env.sensed.gripper[world].min() > _OPEN_WIDE:
            self.phase[world] = Phase.RISE

    def _rise(self, world: int) -> None:
        higher_m = self._actions.wanted[world, :, 2] + _RISE_STEP_M
        self._wanted[world, :, 2] = np.minimum(higher_m, _RISE_TO_M)

    def _rise_m(self, world: int) -> float:
        sensed = self._env.sensed
        return float(sensed.objects[world, 0, 2, 3] - sensed.first[world, 0, 2, 3])

    # Actions -----------------------------------------------------------------------------------

    def _towards_wanted(self) -> npt.NDArray[np.float32]:
        """Return the actions that bring both hands to where they shall be at the same time."""
        actions = self._actions
        way = self._wanted - actions.wanted
        pace = np.array([_PACE[Phase(phase)] for phase in self.phase])
        steps = np.abs(way.mean(axis=1) / _STEP).max(axis=1)
        apart_m = np.abs(0.5 * (way[:, 0] - way[:, 1])[:, :2]).max(axis=1)
        free = self.phase <= Phase.DESCEND
        steps = np.maximum(steps, np.where(free, apart_m / _APPROACH_APART_M, 0.0))
        holding = (self.phase >= Phase.LIFT) & (self.phase <= Phase.LOWER)
        ramp = np.minimum((self._since + 1.0) / _RAMP_STEPS, 1.0)
        pace *= np.where(holding, ramp, 1.0)
        steps = np.maximum(steps / pace, np.where(holding, _LEAST_STEPS, 1.0))
        action = actions.action_to(self._wanted, 1.0 / steps)
        on_the_way = (self.phase == Phase.ALONG) & (steps > 1.0)
        action[on_the_way, _APART_SHIFT] = 0.0  # a rigid turn: hands that hold do not move apart
        closing = (self.phase >= Phase.GRASP) & (self.phase <= Phase.LOWER)
        action[:, 8:] = np.where(closing, -1.0, 1.0)[:, None]
        return np.clip(action, -1.0, 1.0).astype(np.float32)


class Samples(NamedTuple):
    """Demonstrations.

    Attributes:
        observations: (m, k).
        actions: (m, j), without the noise that was added.
        ends: Index past the last sample of each episode.
        tried_n: Episodes that were run; those that failed are left out.
    """

    observations: npt.NDArray[np.float32]
    actions: npt.NDArray[np.float32]
    ends: npt.NDArray[np.int64]
    tried_n: int


_NOISE = np.r_[[0.25] * 3, 0.2, [0.25] * 4]
"""Standard deviation of the noise on actions, as a share of their range."""
_NOISE_KEPT = 0.7
"""Share of the noise that stays for the next step."""
_NOISE_REACHING = 0.5
"""Share of the noise while hands are free to move."""
_NOISE_HOLDING = 0.15
"""Share of the noise afterwards."""
_CLEAN_EVERY = 4
"""Every fourth world runs without noise."""


def record(env: BatchedEnv, episodes_n: int, rng: np.random.Generator) -> Samples:
    """Record successful episodes of the script.

    Noise on the executed actions shows how to come back to the way; the recorded ones are clean.
    """
    script = LiftScript(env)
    observation, _ = env.reset()
    script.restart(np.ones(env.num_envs, dtype=bool))
    open_rows: list[list[tuple[Array, Array]]] = [[] for _ in range(env.num_envs)]
    episodes: list[list[tuple[Array, Array]]] = []
    noise = np.zeros((env.num_envs, len(_NOISE)))
    noisy = np.arange(env.num_envs) % _CLEAN_EVERY != 0
    tried_n = 0
    while len(episodes) < episodes_n:
        action = script.action()
        for world, rows in enumerate(open_rows):
            rows.append((observation[world].copy(), action[world].copy()))
        fresh = rng.standard_normal(noise.shape)
        noise = _NOISE_KEPT * noise + np.sqrt(1.0 - _NOISE_KEPT**2) * fresh
        share = np.where(script.phase == Phase.REACH, _NOISE_REACHING, _NOISE_HOLDING) * noisy
        executed = action.copy()
        executed[:, : len(_NOISE)] += noise * _NOISE * share[:, None]
        observation, _, terminated, truncated, info = env.step(executed)
        ended = terminated | truncated
        for world in np.flatnonzero(ended).tolist():
            tried_n += 1
            if info["final_info"]["success"][world] and len(episodes) < episodes_n:
                episodes.append(open_rows[world])
            open_rows[world] = []
        script.restart(ended)
    samples = [sample for episode in episodes for sample in episode]
    return Samples(
        np.array([row[0] for row in samples], dtype=np.float32),
        np.array([row[1] for row in samples], dtype=np.float32),
        np.cumsum([len(episode) for episode in episodes]),
        tried_n,
    )
