"""A task as a Gymnasium environment, at 50 Hz by default, with pictures (docs/gymnasium.md)."""

from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.control.joint_control import JointLoop
from minidual.errors import UsageError, check_name, unknown_name
from minidual.plant.cameras import CAMERAS
from minidual.plant.render import Camera, Image
from minidual.plant.world import SimulationDivergedError, World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, robot_from
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Judge, begin
from minidual.tasks.task import Trial, level_part, placement, pose_of

CONTROL_HZ = 50
"""Usual rate of actions and observations."""
_RATES_HZ = 1.0, 200.0

# Observed joints may exceed their limits by this, after a collision.
_OVERTRAVEL_RAD = 0.1
# Bounds of an object's position [m] and quaternion.
_FAR = np.array([10.0, 10.0, 10.0, 1.0, 1.0, 1.0, 1.0], dtype=np.float32)
_RENDERED_PX = 640, 480
# An object below this height has left the table.
_FALLEN_M = -0.1

Observation = dict[str, Any]


class TaskEnv(gymnasium.Env[Observation, npt.NDArray[np.float32]]):
    """One task.

    Observation:
        state: (n + 2,) float32, joints of the left and right arm [rad], then gripper openings
            (0..1).
        images: {camera: (H, W, 3) uint8}, optional.
        object: (7,) float32, true position [m] and quaternion wxyz, optional.
        goal: (3,) float32, where it shall lie: x, y [m], yaw [rad], optional.

    Action: (n + 2,) float32, joint targets [rad], then gripper openings (below 0.4 closes, above
    0.6 opens); held for one period.

    Reward: gain of the potential -(mean distance of the hands from their grasps + distance of the
    object from its goal) [m], plus 1 on success. Source: Ng, Harada, Russell 1999 (keeps the
    optimal policy for a discount of 1).

    `terminated`: trial finished, object has left the table, or simulation diverged. `truncated`:
    time limit. `info` has `success`, and at the end `failures` (violated conditions) and `stages`.

    Args:
        scene: Replaces the task's default.
        task: Row of TASKS.
        render_mode: None or "rgb_array".
        images: Cameras out of high, left, right.
        object_pose: Observe `object` and `goal`.
        rate_hz: Of actions and observations.

    Raises:
        UsageError: Unknown task, camera or render mode, or a rate outside of 1 to 200 Hz.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 (Gymnasium's; an instance has its own rate)
        "render_modes": ["rgb_array"],
        "render_fps": CONTROL_HZ,
    }

    def __init__(
        self,
        scene: SceneConfig | None = None,
        *,
        task: str = "rod_carry",
        render_mode: str | None = None,
        images: Sequence[str] = (),
        object_pose: bool = False,
        rate_hz: float = CONTROL_HZ,
    ) -> None:
        for name in images:
            check_name("camera", name, CAMERAS)
        slowest_hz, fastest_hz = _RATES_HZ
        if not slowest_hz <= rate_hz <= fastest_hz:
            raise UsageError(f"rate_hz is {rate_hz}; {slowest_hz:g} <= value <= {fastest_hz:g}")
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise unknown_name("render mode", render_mode, self.metadata["render_modes"])
        config = Config(task=task) if scene is None else Config(task=task, scene=scene)
        self._task = make_task(config)
        self.scene = self._task.scene
        self.render_mode = render_mode
        self._images = tuple(images)
        self._object_pose = object_pose
        robot = robot_from(self._task.config.robot)
        self._world = World(self.scene, robot, visuals=bool(images) or render_mode is not None)
        self._kinematics = Kinematics(robot)
        self._loop = JointLoop(self._world, self._kinematics)
        self.metadata = {**type(self).metadata, "render_fps": round(rate_hz)}
        self._period_steps = 1.0 / (rate_hz * self._world.dt)
        self._steps_due = 0.0
        self._camera: Camera | None = None
        self._render_camera: Camera | None = None
        self._judge: Judge | None = None
        self._potential = 0.0
        low = np.r_[robot.q_lower, 0.0, 0.0]
        high = np.r_[robot.q_upper, 1.0, 1.0]
        beyond = np.r_[np.full(robot.dof, _OVERTRAVEL_RAD), 0.1, 0.1]
        self._actions = _box(low, high)
        self.action_space = self._actions
        self._states = _box(low - beyond, high + beyond)
        self.observation_space = self._observations()

    def _observations(self) -> spaces.Dict:
        members: dict[str, spaces.Space[Any]] = {"state": self._states}
        if self._object_pose:
            members["object"] = spaces.Box(-_FAR, _FAR)
            members["goal"] = spaces.Box(-10.0, 10.0, (3,))
        if self._images:
            shape = (self.scene.camera.height_px, self.scene.camera.width_px, 3)
            pictures: dict[str, spaces.Space[Any]] = {
                name: spaces.Box(0, 255, shape, dtype=np.uint8) for name in self._images
            }
            members["images"] = spaces.Dict(pictures)
        return spaces.Dict(members)

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Observation, dict[str, Any]]:
        """Start a random trial, or `options["trial"]`.

        Raises:
            UsageError: Unknown option, or not a Trial.
        """
        super().reset(seed=seed)
        options = {} if options is None else options
        for name in options.keys() - {"trial"}:
            raise unknown_name("option", name, ["trial"])
        trial = options.get("trial")
        if trial is None:
            trial = self._task.trial(int(self.np_random.integers(2**62)), "gym", 0)
        if not isinstance(trial, Trial):
            raise UsageError(f"options['trial'] is a {type(trial).__name__}; it must be a Trial")
        self._judge = begin(self._world, self._task, trial)
        self._loop.reset()
        self._steps_due = 0.0
        self._potential = self._measure_potential(trial)
        return self._observe(trial), {"trial": trial}

    def step(
        self,
        action: npt.NDArray[np.float32],
    ) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold one action, clipped to its space.

        Raises:
            UsageError: Wrong shape, not finite, or not reset.
        """
        judge = self._judge
        if judge is None:
            raise UsageError(
                "the environment was stepped before it was reset",
                remedy="call env.reset() first",
            )
        trial = judge.trial
        diverged = not self._hold(self._checked(action), judge)
        if diverged:
            self._world.reset(poses=trial.start)  # so that the last observation is finite
        outcome = judge.outcome(self._world)
        success = outcome.success and not diverged
        fallen = bool(self._world.object_pose(self._task.carried)[2, 3] < _FALLEN_M)
        terminated = diverged or fallen or judge.finished
        truncated = not terminated and self._world.time >= self.scene.task.time_limit_s - 1e-9
        potential = self._potential if diverged else self._measure_potential(trial)
        reward = float(success) + (potential - self._potential)
        self._potential = potential
        info: dict[str, Any] = {
            "success": success,
            "trial": trial,
            "time_s": self._world.time,
        }
        if terminated or truncated:
            failures = tuple(failure.name for failure in outcome.failures)
            info["outcome"] = outcome
            info["stages"] = judge.stages
            info["failures"] = ("diverged",) if diverged else failures
        return self._observe(trial), reward, terminated, truncated, info

    def _checked(self, action: npt.NDArray[np.float32]) -> Array:
        """Return an action (n + 2,), clipped to its space."""
        targets = np.asarray(action, dtype=float)
        finite = np.isfinite(targets)
        if targets.shape != self.action_space.shape or not finite.all():
            raise UsageError(
                f"an action is {self.action_space.shape} finite numbers;"
                f" {targets.shape} has {np.count_nonzero(finite)}",
            )
        return np.clip(targets, self._actions.low, self._actions.high)

    def _hold(self, targets: Array, judge: Judge) -> bool:
        """Hold targets for one control period; return whether the simulation survived."""
        # A period need not be a whole number of physics steps: what is left is due next time.
        self._steps_due += self._period_steps
        steps_n = int(self._steps_due + 1e-9)
        self._steps_due -= steps_n
        try:
            for _ in range(steps_n):
                self._loop.step(targets[:-2], targets[-2:])
                judge.observe(self._world)
        except SimulationDivergedError:
            return False
        return True

    def _measure_potential(self, trial: Trial) -> float:
        name = self._task.carried
        item = self._task.objects[name]
        T_world_object = self._world.object_pose(name)
        level = level_part(T_world_object)
        tcp_poses = self._kinematics.tcp_poses(self._world.q)
        hands_m: list[float] = []
        for side, T_world_tcp in zip(self._world.robot.sides, tcp_poses, strict=True):
            if side in item.grasps:
                to_grasp = level @ item.grasps[side] - T_world_tcp
                hands_m.append(float(np.linalg.norm(to_grasp[:3, 3])))
        to_goal = T_world_object - pose_of(item.body, trial.goal[name])
        goal_m = float(np.linalg.norm(to_goal[:3, 3]))
        return -(sum(hands_m) / max(len(hands_m), 1) + goal_m)

    def _observe(self, trial: Trial) -> Observation:
        world = self._world
        state = np.concatenate([world.q, world.gripper]).astype(np.float32)
        observation: Observation = {"state": np.clip(state, self._states.low, self._states.high)}
        if self._object_pose:
            body = world.data.body(self._task.carried)
            pose = np.concatenate([body.xpos, body.xquat]).astype(np.float32)
            goal = placement(trial.goal[self._task.carried])
            observation["object"] = np.clip(pose, -_FAR, _FAR)
            observation["goal"] = np.array(goal, dtype=np.float32)
        if self._images:
            if self._camera is None:
                self._camera = Camera.recorded(world.model, self.scene.camera)
            camera = self._camera
            observation["images"] = {
                name: camera.picture(world.data, name) for name in self._images
            }
        return observation

    def render(self) -> Image | None:  # type: ignore[override]
        """Return the overview image, or None without a render mode."""
        if self.render_mode is None:
            return None
        if self._render_camera is None:
            self._render_camera = Camera(self._world.model, *_RENDERED_PX)
        return self._render_camera.picture(self._world.data, "overview")

    def close(self) -> None:
        """Free the OpenGL contexts."""
        for camera in (self._camera, self._render_camera):
            if camera is not None:
                camera.close()
        self._camera = None
        self._render_camera = None


def _box(low: Array, high: Array) -> Any:  # generic in numpy's types, which pyright cannot match
    return spaces.Box(low.astype(np.float32), high.astype(np.float32))
