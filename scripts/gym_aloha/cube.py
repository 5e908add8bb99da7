"""The task TransferCube of gym-aloha, seen by a small camera, and a script that solves it.

Runs in an environment of gym-aloha's own (`pip install gym-aloha`), without minidual: gym-aloha
needs an older MuJoCo. Scene, physics, starts and success test are gym-aloha's, unchanged; only the
picture is another one: a part of what the camera `top` shows, without shadows, which a CPU draws
seven times faster.
"""

from __future__ import annotations

import os
from typing import Any, NamedTuple

os.environ.setdefault("MUJOCO_GL", "egl")

import gym_aloha  # noqa: F401  (registers its environments)
import gymnasium
import mujoco
import numpy as np
import numpy.typing as npt
from way import Array, Hand, Waypoint, pointing, waypoint_at, ways

type Picture = npt.NDArray[np.uint8]

_CAMERA = "top"
_DRAWN_PX = (240, 320)
"""Height and width of what the camera draws."""
_CORNER_PX = (80, 80)
"""Row and column at which the part that a policy sees begins: there the cube lies and is handed over."""
HEIGHT_PX = 120
WIDTH_PX = 192
RATE_HZ = 50.0
STEPS_MAX = 300
"""Steps of an episode, as gym-aloha registers the task."""
_SIDES = ("left", "right")
_ARM = 7
"""Entries of an arm in a state or an action: six joints, and the opening of the gripper."""
_JOINTS_OF_MODEL = 8
"""Joints of an arm in the model: six, and two fingers."""
_SOLVER_STEPS = 20
_SOLVED = 1e-4
"""Error of a hand [m, rad] that is small enough."""
_DAMPING = 1e-4


class Observation(NamedTuple):
    """What a policy gets.

    Attributes:
        state: Joints [rad] and opening of the left, then of the right arm (14,).
        picture: Part of what the camera `top` shows (height, width, 3).
    """

    state: Array
    picture: Picture


class TransferCube:
    """One environment `gym_aloha/AlohaTransferCube-v0`.

    Attributes:
        model, data: MuJoCo's, for the script.
    """

    def __init__(self) -> None:
        made = gymnasium.make("gym_aloha/AlohaTransferCube-v0", obs_type="pixels_agent_pos")
        self._env: Any = made.unwrapped
        physics = self._env._env.physics
        self.model: mujoco.MjModel = physics.model.ptr
        self.data: mujoco.MjData = physics.data.ptr
        self.model.vis.quality.offsamples = 0
        self._renderer = mujoco.Renderer(self.model, *_DRAWN_PX)
        self._renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        task = self._env._env.task
        task.get_observation = lambda physics: {
            "qpos": task.get_qpos(physics),
            "images": {"top": self._picture()},
        }

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()

    def reset(self, seed: int) -> Observation:
        """Begin the episode of a seed, which draws the cube's place."""
        observation, _ = self._env.reset(seed=seed)
        return self._seen(observation)

    def step(self, action: Array) -> tuple[Observation, bool]:
        """Command joints and openings (14,); return what is seen, and gym-aloha's success."""
        observation, _, _, _, info = self._env.step(np.asarray(action, dtype=float))
        return self._seen(observation), bool(info["is_success"])

    def _seen(self, observation: dict[str, Any]) -> Observation:
        return Observation(np.array(observation["agent_pos"]), observation["pixels"]["top"])

    def _picture(self) -> Picture:
        self._renderer.update_scene(self.data, _CAMERA)
        row, column = _CORNER_PX
        return self._renderer.render()[row:, column:][:HEIGHT_PX, :WIDTH_PX].copy()


class Script:
    """Takes the cube with the right hand, brings it to the middle, and takes it with the left hand.

    The script knows where the cube lies. Nothing else differs between episodes: a policy could not
    tell from the picture what was drawn.
    """

    def __init__(self, env: TransferCube) -> None:
        self._model = env.model
        self._solver = mujoco.MjData(env.model)
        self._q = [env.data.qpos[k * _JOINTS_OF_MODEL :][:6].copy() for k in range(2)]
        self._bases_m = [env.data.body(f"vx300s_{side}").xpos.copy() for side in _SIDES]
        hands: list[Hand] = []
        for side, base_m in zip(_SIDES, self._bases_m, strict=True):
            tip_m, R = self._hand_of(env.data, side)
            hands.append(Hand(base_m, tip_m, pitch=-float(np.arcsin(R[2, 0]))))
        self._ways = ways(env.data.body("box").xpos.copy(), *hands)

    def action(self, time_s: float) -> Array:
        """Return joints and openings (14,) for a time of the episode."""
        action = np.empty(2 * _ARM)
        for arm, way in enumerate(self._ways):
            wanted = waypoint_at(way, time_s)
            self._q[arm] = self._joints(arm, wanted)
            action[arm * _ARM :][:6] = self._q[arm]
            action[arm * _ARM + 6] = wanted.opening
        return action

    def _hand_of(self, data: mujoco.MjData, side: str) -> tuple[Array, Array]:
        """Return the tip (3,) and the rotation (3, 3) of a hand."""
        tip_m = data.site(f"cali_{side}_site1").xpos.copy()
        R = data.body(f"vx300s_{side}/gripper_link").xmat.reshape(3, 3).copy()
        return tip_m, R

    def _joints(self, arm: int, wanted: Waypoint) -> Array:
        """Return the joints (6,) of an arm, from those of the step before, by damped least squares."""
        side = _SIDES[arm]
        columns = slice(arm * _JOINTS_OF_MODEL, arm * _JOINTS_OF_MODEL + 6)
        data = self._solver
        q = self._q[arm].copy()
        R_wanted = pointing(self._bases_m[arm], wanted)
        low, high = self._model.jnt_range[columns].T
        jacobian = np.zeros((6, self._model.nv))
        body = self._model.body(f"vx300s_{side}/gripper_link").id
        for _ in range(_SOLVER_STEPS):
            data.qpos[columns] = q
            mujoco.mj_kinematics(self._model, data)
            mujoco.mj_comPos(self._model, data)
            tip_m, R = self._hand_of(data, side)
            error = np.concatenate([wanted.tip_m - tip_m, _turn(R, R_wanted)])
            if np.abs(error).max() < _SOLVED:
                break
            mujoco.mj_jac(self._model, data, jacobian[:3], jacobian[3:], tip_m, body)
            J = jacobian[:, columns]
            q = q + J.T @ np.linalg.solve(J @ J.T + _DAMPING * np.eye(6), error)
            q = np.clip(q, low, high)
        return q


def _turn(R: Array, R_to: Array) -> Array:
    """Return the rotation vector (3,), in the world, that turns one hand into another."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, np.ascontiguousarray(R_to @ R.T).ravel())
    turn = np.empty(3)
    mujoco.mju_quat2Vel(turn, quaternion, 1.0)
    return turn
