"""Runs a policy through the command arbiter."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from minidual.config.learning import DeployConfig
from minidual.control.commands import ArbiterState, JointCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.demos.sensed import SensedInputs
from minidual.errors import DataError
from minidual.plant.cameras import CAMERAS
from minidual.plant.protocol import Plant, openings_of
from minidual.policies.chunk_policy import ChunkPolicy, Image
from minidual.policies.facts import Driver, Place, require_fit
from minidual.policies.kinds import load_policy
from minidual.policies.plausible import PolicyStoppedError
from minidual.policies.policy import AS_MEASURED, Latency, PolicyRuntime
from minidual.policies.takes import read_takes, require_arms, require_scene
from minidual.robot.pair import Robot

SOURCE = "policy"
PICTURE_AGE_MAX_S = 0.1
"""Three periods of a 30 Hz camera."""

Picture = Callable[[str], tuple[Image, float]]
"""Returns a camera's image (H, W, 3) and when it was taken [s], on the control clock."""


def load_runtime(
    checkpoint: Path,
    config: DeployConfig,
    robot: Robot,
    place: Place | None = None,
    instruction: str = "",
) -> PolicyRuntime:
    """Load a checkpoint, clamped to the limits of joints and openings.

    With `place` its cameras, joints, rate, statistics and units are compared with what is there.
    A policy that reads an instruction is told `instruction`.

    Raises:
        DataError: Corrupt checkpoint.
        UsageError: One for other arms, cameras, rates or tasks.
    """
    takes = read_takes(checkpoint)
    if takes is not None:
        require_arms(takes, checkpoint, robot, CAMERAS)
        if place is not None:
            require_scene(takes, checkpoint, place.picture_px, place.rate_hz)
    policy = load_policy(checkpoint, config.device, config.threads)
    if instruction:
        policy.instruct(instruction)
    if place is None:
        latency = AS_MEASURED
    else:
        require_fit(driver_of(policy), robot, place, str(checkpoint))
        latency = Latency(place.rate_hz, config.answer_s)
    return PolicyRuntime(
        policy,
        n_action_steps=config.n_action_steps,
        blend_ticks=config.blend_ticks,
        limits=(robot.q_lower, robot.q_upper),
        latency=latency,
    )


def driver_of(policy: ChunkPolicy) -> Driver:
    """Return the inputs, outputs and training facts of a policy."""
    measured = policy.state_dim - policy.inputs_n
    return Driver(policy.cameras, measured, policy.dim, policy.facts.without_inputs(measured))


def next_command(
    runtime: PolicyRuntime,
    plant: Plant,
    picture: Picture,
    sensed: SensedInputs,
    sequence: int,
) -> JointCommand:
    """Return the policy's command for the current images, state and inputs.

    Raises:
        DataError: An input does not fit; PolicyStoppedError: a camera fails, or see
            `PolicyRuntime.act`.
    """
    images = {name: partial(_fresh_image, picture, name, plant) for name in runtime.cameras}
    measured_s = plant.time
    state = np.concatenate([plant.q, openings_of(plant), sensed.read()])
    action = runtime.act(images, state)
    answer_age_s = plant.time - measured_s
    if answer_age_s > PICTURE_AGE_MAX_S:
        raise PolicyStoppedError("late_answer", age_s=answer_age_s, limit_s=PICTURE_AGE_MAX_S)
    n = runtime.joints_n
    return JointCommand(action[:n], action[n:], measured_s, sequence)


def _fresh_image(picture: Picture, camera: str, plant: Plant) -> Image:
    """Return a camera's image; PolicyStoppedError if it fails or its image is old."""
    try:
        image, stamp_s = picture(camera)
    except Exception as error:  # drivers raise anything
        raise PolicyStoppedError(
            "camera_failed",
            camera=camera,
            error=f"{type(error).__name__}: {error}",
        ) from error
    age_s = plant.time - stamp_s
    if not -PICTURE_AGE_MAX_S <= age_s <= PICTURE_AGE_MAX_S:
        raise PolicyStoppedError(
            "stale_picture",
            camera=camera,
            age_s=age_s,
            limit_s=PICTURE_AGE_MAX_S,
        )
    return image


class PolicyPilot:
    """One trial of a policy.

    The stack's plant stands at the start, its rate is as recorded.

    Raises:
        UsageError: The policy reads what is not sensed here.
    """

    def __init__(
        self,
        stack: ControlStack[Plant],
        runtime: PolicyRuntime,
        picture: Picture,
    ) -> None:
        self.stack = stack
        self.aborted: str | None = None
        self._broken: Exception | None = None
        self._runtime = runtime
        self._picture = picture
        self._sensed = SensedInputs(stack, runtime.inputs)
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
            if self.aborted is None:  # else it may follow from what stopped the policy
                self.aborted = error.message
        if self._broken is not None and self.done:
            raise self._broken

    def _tick(self) -> None:
        settling = self.stack.state is ArbiterState.SETTLING
        if not settling and self.aborted is None:
            self._propose()
        self.stack.arbitrate()

    def _propose(self) -> None:
        """Propose the policy's command; an error stops the arms, and this tick has its torque."""
        try:
            command = next_command(
                self._runtime,
                self.stack.plant,
                self._picture,
                self._sensed,
                self._step + 1,
            )
        except DataError as error:
            self.aborted = error.message
            self.stack.halt(SOURCE)
        except Exception as error:  # raised when the arms rest
            self._broken = error
            self.stack.fail(error)
        else:
            self.stack.propose(SOURCE, command)
