"""The arms under the whole control stack, driven by one source of commands."""

import itertools
from contextlib import suppress

import numpy as np

from minidual.config.root import Config
from minidual.control.commands import JointCommand, TrajectoryCommand
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.robot.trajectory import Trajectory
from minidual.skills.supervised import trial_supervisor

_SOURCE = "policy"
_OPEN = np.ones(2)
_WAIT_STEPS = 240
"""Steps within which a requested source gets the arms."""
_STEP_MAX_RAD = 0.5
"""The arbiter's bound on a step of the target: a step response needs a step, not a ramp."""


class TrackingRig:
    """One command source, arbiter, controller, supervisor and world.

    Measuring continues after a stop.

    Attributes:
        target: (n,) [rad], proposed at every arbiter tick.
        period: Control steps in a tick of the arbiter.
    """

    def __init__(self, world: World, kinematics: Kinematics, config: Config) -> None:
        self.world = world
        self.supervisor = trial_supervisor(config.supervisor, world.dt, world.robot)
        self.stack = ControlStack(
            world,
            kinematics,
            config.arbiter.model_copy(update={"switch_step_max_rad": _STEP_MAX_RAD}),
            rate_hz=config.teleop.rate_hz,
            supervisor=self.supervisor,
        )
        self.period = self.stack.every
        self._sequence = itertools.count(1)
        self.reset()

    def reset(self, q: Array | None = None) -> None:
        """Start at rest at `q` (n,), by default home, and request the source."""
        self.world.reset(q)
        self.stack.reset()
        self.target = self.world.q
        self._swinging = False
        self.stack.request(_SOURCE)
        for _ in range(_WAIT_STEPS):
            if self.stack.source != _SOURCE:
                self.step()

    @property
    def stopped(self) -> str:
        """The supervisor's reflex, or why the source does not drive; "" if it does."""
        if self.stack.reflex is not None:
            return self.stack.reflex.message
        if self.stack.source != _SOURCE:
            return f"the arms were not given: the arbiter is {self.stack.state}"
        return ""

    def propose(self) -> None:
        """Propose the target, stamped with the present time."""
        command = JointCommand(
            self.target.copy(),
            _OPEN,
            self.world.time,
            next(self._sequence),
        )
        self.stack.propose(_SOURCE, command)

    def swing(self, motion: Trajectory) -> None:
        """Start a trajectory from the current posture."""
        self._swinging = True
        command = TrajectoryCommand(motion, _OPEN, self.world.time, next(self._sequence))
        self.stack.propose(_SOURCE, command)

    def step(self) -> None:
        """Run one control step; keep the source alive."""
        if self.stack.tick_next and self._swinging:
            self.stack.affirm(_SOURCE)
        elif self.stack.tick_next:
            self.propose()
        with suppress(ReflexError):
            self.stack.step()

    def run(self, steps: int) -> None:
        """Run control steps."""
        for _ in range(steps):
            self.step()

    def run_to_tick(self) -> None:
        """Run until the next step has an arbiter tick."""
        while not self.stack.tick_next:
            self.step()
