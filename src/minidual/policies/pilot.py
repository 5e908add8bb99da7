"""Runs a policy through the command arbiter."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from minidual.config.learning import DeployConfig
from minidual.control.commands import ArbiterState, JointCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.errors import DataError
from minidual.plant.world import World
from minidual.policies.kinds import Image
from minidual.policies.plausible import PolicyStoppedError
from minidual.policies.policy import PolicyRuntime
from minidual.robot.pair import Robot

SOURCE = "policy"
PICTURE_AGE_MAX_S = 0.1  # three periods of a 30 Hz camera


def load_runtime(checkpoint: Path, config: DeployConfig, robot: Robot) -> PolicyRuntime:
    """Load a checkpoint, clamped to the limits of joints and openings.

    Raises:
        DataError, UsageError: Corrupt checkpoint, or one for other arms.
    """
    options = config.model_dump(include={"device", "threads", "n_action_steps", "blend_ticks"})
    return PolicyRuntime.load(checkpoint, limits=(robot.q_lower, robot.q_upper), **options)


Picture = Callable[[str], tuple[Image, float]]
"""Returns a camera's image (H, W, 3) and when it was taken [s], on the control clock."""


def next_command(
    runtime: PolicyRuntime,
    world: World,
    picture: Picture,
    sequence: int,
) -> JointCommand:
    """Return the policy's command for the current images and state.

    Raises:
        DataError: An input does not fit; PolicyStoppedError: a camera fails, or see `PolicyRuntime.act`.
    """
    images = {name: partial(_taken, picture, name, world) for name in runtime.cameras}
    asked_s = world.time
    action = runtime.act(images, np.concatenate([world.q, world.gripper]))
    n = runtime.joints_n
    if world.time - asked_s > PICTURE_AGE_MAX_S:
        raise PolicyStoppedError(
            "late_answer",
            age_s=world.time - asked_s,
            limit_s=PICTURE_AGE_MAX_S,
        )
    return JointCommand(action[:n], action[n:], asked_s, sequence)


def _taken(picture: Picture, name: str, world: World) -> Image:
    try:
        image, stamp_s = picture(name)
    except Exception as error:  # drivers raise anything
        raise PolicyStoppedError(
            "camera_failed",
            camera=name,
            error=f"{type(error).__name__}: {error}",
        ) from error
    age_s = world.time - stamp_s
    if not -PICTURE_AGE_MAX_S <= age_s <= PICTURE_AGE_MAX_S:
        raise PolicyStoppedError(
            "stale_picture",
            camera=name,
            age_s=age_s,
            limit_s=PICTURE_AGE_MAX_S,
        )
    return image


class PolicyPilot:
    """One trial of a policy.

    The stack's world is already reset, its rate as recorded.
    """

    def __init__(
        self,
        stack: ControlStack[World],
        runtime: PolicyRuntime,
        picture: Picture,
    ) -> None:
        self.stack = stack
        self.world = stack.plant
        self.aborted: str | None = None
        self._broken: Exception | None = None
        self._runtime = runtime
        self._picture = picture
        # A mode switch must drop the current chunk, or it would run on afterwards.
        self.stack.on_flush(lambda mode: runtime.reset())
        runtime.reset()
        self._inferred_n = len(runtime.times_s)
        self.stack.request(SOURCE)
        self._step = 0
        self.stack.arbitrate()

    @property
    def phase(self) -> str:
        """State of the arbiter."""
        return str(self.stack.state)

    @property
    def inference_s(self) -> float:
        """Mean time of this trial's inferences, or NaN."""
        times_s = self._runtime.times_s[self._inferred_n :]
        return float(np.mean(times_s)) if times_s else float("nan")

    @property
    def done(self) -> bool:
        """Whether a reflex or invalid data ended the trial, and the arms rest."""
        return self.aborted is not None and not self.stack.stopping

    def step(self) -> None:
        """Run one control step, after a policy tick if due.

        Raises:
            Exception: What failed in the policy, once the arms have stopped.
        """
        if self._step % self.stack.every == 0:
            self._tick()
        self._step += 1
        try:
            self.stack.advance()
        except ReflexError as error:
            self.aborted = (
                self.aborted or error.message
            )  # it may follow from what stopped the policy
        if self._broken is not None and self.done:
            raise self._broken

    def _tick(self) -> None:
        if self.stack.state is not ArbiterState.SETTLING and self.aborted is None:
            try:
                command = next_command(self._runtime, self.world, self._picture, self._step + 1)
            except DataError as error:
                self.aborted = error.message
                self.stack.halt(SOURCE)
            except Exception as error:  # must not take this tick's torque away
                self._broken = error
                self.stack.fail(error)
            else:
                self.stack.propose(SOURCE, command)
        self.stack.arbitrate()
