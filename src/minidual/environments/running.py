"""The trials that run in many worlds at once."""

from __future__ import annotations

import numpy as np

from minidual.environments.draws import Draws
from minidual.environments.observations import Truth
from minidual.environments.readings import Readings
from minidual.environments.referee import Referee
from minidual.environments.rewards import LiftState
from minidual.environments.transport_kernel import Scene
from minidual.environments.worlds import Worlds
from minidual.robot.pair import Array, Indices
from minidual.tasks.task import Trial, placement


class RunningTrials:
    """One trial in each of N worlds: drawn, simulated, sensed and judged.

    Args:
        first: Trial from which the judges were made.

    Attributes:
        trials: Of each world.
    """

    def __init__(
        self, draws: Draws, first: Trial, worlds: Worlds, referee: Referee, readings: Readings
    ) -> None:
        self._draws = draws
        self.worlds = worlds
        self.referee = referee
        self.readings = readings
        self.trials = [first] * worlds.worlds_n
        if draws.condition is not None:
            worlds.differ()

    def begin(self, worlds: Indices) -> None:
        """Start the next trials in some worlds."""
        name = self._draws.task.carried
        starts = []
        goals = []
        for world in worlds.tolist():
            trial = self._draw(world)
            starts.append(placement(trial.start[name]))
            goals.append(placement(trial.goal[name]))
        self.worlds.reset(worlds, starts, goals)
        self.referee.reset(worlds, np.array(starts), np.array(goals))
        self.readings.begin(worlds, np.array(goals))

    def _draw(self, world: int) -> Trial:
        """Draw the next trial for a world, with its sensor's offset and its model."""
        draw = self._draws.next()
        self.trials[world] = draw.trial
        self.readings.draw(world, draw.sensing)
        condition = self._draws.condition
        if condition is not None:
            model = self.worlds.model
            with condition.applied(model, self._draws.task, draw.trial, draw.disturbance):
                self.worlds.set_model(world, model)
        return draw.trial

    def advance(self, target: Array, opening: Array, steps_n: int) -> None:
        """Simulate, judge and sense physics steps; see `Worlds.advance`."""

        def watch(scene: Scene) -> None:
            self.referee.observe(scene)
            self.readings.note(scene)

        self.worlds.advance(target, opening, steps_n, watch)

    def measure(self, period_s: float) -> LiftState:
        """Read the sensors at the end of a period of simulated time; return the state."""
        self.readings.read()
        self.referee.note(period_s)
        return self.state

    @property
    def state(self) -> LiftState:
        """State for the rewards."""
        return self.referee.state(self.readings.latest)

    def truth(self) -> Truth:
        """Return the true state, for critics."""
        return Truth(
            self.worlds.object_poses()[:, None],
            self.worlds.object_twists(),
            self.referee.judges.state["pinch"].copy(),
            self.readings.offset,
        )
