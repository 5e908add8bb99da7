"""Drives a policy that was learned in a batched environment, in a trial like any other method.

Observation and action are the environment's own objects, so that training and trial cannot differ
in what the numbers mean.
"""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np

from minidual.config.seeds import stream
from minidual.control.commands import ArbiterState, JointCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.control.supervisor import Supervisor
from minidual.environments.actions import ACTIONS, Arms, arms_of
from minidual.environments.kernels import wrenches
from minidual.environments.observations import OBSERVATIONS, ObservationInputs, observe, size_of
from minidual.environments.senses import JointReadings, Sensed, Senses
from minidual.errors import DataError, UsageError
from minidual.plant.protocol import Plant, openings_of
from minidual.policies.rl.network import RlNetwork
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array, Robot
from minidual.skills.supervised import trial_supervisor
from minidual.skills.things import thing_of
from minidual.tasks.catalogue import make_task
from minidual.tasks.task import Task, Trial, placement
from minidual.trials.methods import Factory, MethodInputs

SOURCE = "policy"
TICK_HZ = 50.0
"""Rate of the joint targets between two actions."""
_ONE = np.zeros(1, dtype=np.int64)
"""The trial is a batch of one."""


class Equipment(NamedTuple):
    """State that the trials of one process share."""

    inputs: MethodInputs
    network: RlNetwork
    task: Task
    arms: Arms
    supervisor: Supervisor


def driver(inputs: MethodInputs, network: RlNetwork) -> Factory:
    """Return the factory of trials.

    Raises:
        UsageError: The policy reads or gives what this version, or these arms, do not know.
    """
    config = inputs.config
    task = make_task(config)
    robot = inputs.robot
    arms = arms_of(robot)
    _check_fits(network, arms, robot)
    supervisor = trial_supervisor(
        config.supervisor,
        inputs.period_s,
        robot,
        shapes=[thing_of(task.objects[task.carried].body).shape],
    )
    equipment = Equipment(inputs, network, task, arms, supervisor)

    def make(plant: Plant, kinematics: Kinematics, trial: Trial) -> ReinforcedPilot:
        stack = ControlStack(
            plant,
            kinematics,
            config.arbiter,
            rate_hz=TICK_HZ,
            supervisor=supervisor,
        )
        return ReinforcedPilot(stack, equipment, trial)

    return make


def _check_fits(network: RlNetwork, arms: Arms, robot: Robot) -> None:
    description = network.description
    privileged = [name for name in description.observation if OBSERVATIONS[name].privileged]
    if privileged:
        raise UsageError(
            f"the policy reads {', '.join(privileged)}, which no sensor gives",
            remedy="train it on terms that are not privileged",
        )
    reads_n = size_of(description.observation, robot)
    gives_n = len(ACTIONS[description.action](arms, 1).names)
    if (reads_n, gives_n) != (network.observation_size, network.action_size):
        raise UsageError(
            f"the policy reads {network.observation_size} numbers and gives {network.action_size}; "
            f"its observation and action have {reads_n} and {gives_n} with these arms",
            remedy="choose the arms that it was trained with: --set robot.arm=NAME",
        )
    if TICK_HZ % description.rate_hz:
        raise UsageError(f"the policy acts at {description.rate_hz} Hz, which must divide 50 Hz")


class ReinforcedPilot:
    """One trial of a policy.

    The stack's plant stands at the start.
    """

    def __init__(self, stack: ControlStack[Plant], equipment: Equipment, trial: Trial) -> None:
        self.stack = stack
        self._plant = stack.plant
        self.aborted: str | None = None
        self._network = equipment.network
        self._task = equipment.task
        self._actions = ACTIONS[equipment.network.description.action](equipment.arms, 1)
        self._ticks_n = round(TICK_HZ / equipment.network.description.rate_hz)
        self._frames = equipment.arms.frames
        self._observer = equipment.supervisor.observer
        self._senses = Senses(self._frames, 1)
        name = self._task.carried
        inputs = equipment.inputs
        rng = stream(inputs.seed, f"sensing/{trial.purpose}", trial.index)
        self._sensors = inputs.sensed.of_object(inputs.config.carry.sensing, rng, name)
        self._goal = np.array([placement(trial.goal[name])])
        self._pose: Array | None = None
        self._began_s: float | None = None
        self._ticks = 0
        self._step = 0
        self._times_s: list[float] = []
        stack.request(SOURCE)
        stack.arbitrate()

    @property
    def phase(self) -> str:
        """State of the arbiter."""
        return str(self.stack.state)

    @property
    def inference_s(self) -> float:
        """Mean time of this trial's inferences, or NaN."""
        return float(np.mean(self._times_s)) if self._times_s else float("nan")

    @property
    def done(self) -> bool:
        """Whether a reflex or invalid data ended the trial, and the arms rest."""
        return self.aborted is not None and not self.stack.stopping

    def step(self) -> None:
        """Run one control step, after a tick of the policy if it is due."""
        pose = self._sensors.sense().pose
        if pose is not None:
            self._pose = pose.T_world_object
        if self._step % self.stack.every == 0:
            self._tick()
        self._step += 1
        try:
            self.stack.advance()
        except ReflexError as error:
            if self.aborted is None:
                self.aborted = error.message

    def _tick(self) -> None:
        settling = self.stack.state is ArbiterState.SETTLING
        if not settling and self.aborted is None and self._pose is not None:
            try:
                self._propose(self._pose)
            except DataError as error:
                self.aborted = error.message
                self.stack.halt(SOURCE)
        self.stack.arbitrate()

    def _propose(self, T_world_object: Array) -> None:
        """Propose the next joint targets; ask the policy where its last action has ended."""
        within = self._ticks % self._ticks_n
        if within == 0:
            self._decide(T_world_object)
        self._actions.step((within + 1) / self._ticks_n)
        self._ticks += 1
        command = JointCommand(
            self._actions.target[0].copy(),
            self._actions.opening[0].copy(),
            self._plant.time,
            self._ticks,
        )
        self.stack.propose(SOURCE, command)

    def _decide(self, T_world_object: Array) -> None:
        sensed = self._sense(T_world_object)
        names = self._network.description.observation
        observation = observe(names, ObservationInputs(sensed, self._actions, self._task))
        began_s = time.perf_counter()
        action = self._network.act(observation)
        self._times_s.append(time.perf_counter() - began_s)
        self._actions.begin(action.astype(float), sensed)

    def _sense(self, T_world_object: Array) -> Sensed:
        plant = self._plant
        if self._began_s is None:
            self._began_s = plant.time
            self._senses.reset(_ONE, T_world_object[None, None], self._goal)
        arms = JointReadings(
            np.array([plant.time - self._began_s]),
            plant.q[None],
            plant.tau[None],
            openings_of(plant)[None],
            plant.grip[None],
            self._wrenches(),
        )
        return self._senses.read(arms, T_world_object[None, None])

    def _wrenches(self) -> Array:
        """Return the wrenches (1, 2, 6) of the surroundings on each hand, as the supervisor sees them."""
        hand_wrenches = np.zeros((1, 2, 6))
        wrenches(self._frames, self._plant.q[None], self._observer.external[None], hand_wrenches)
        return hand_wrenches
