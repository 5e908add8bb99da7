"""One mating as an episode: the trial up to it is run once, and branches into many tries."""

from __future__ import annotations

import contextlib
import math
from typing import NamedTuple, NoReturn

import numpy as np

from minidual.config.root import Config
from minidual.config.seeds import stream
from minidual.environments.mating import Floats, MatingSensed, RelativePose, observe_mating
from minidual.environments.mating_rewards import MATING_REWARD, MatingState
from minidual.environments.rewards import Reward
from minidual.errors import MinidualError
from minidual.robot.pair import SIDES, Array
from minidual.tasks.insertion import DEPTH_M, HAND_OF, MOUTH, PEG, SOCKET, TIP, depth_m
from minidual.tasks.judge import Judge, begin
from minidual.tasks.truth import Truth
from minidual.trials.branching import BranchPoint
from minidual.trials.lessons.mating_pilot import (
    MATING_S,
    LearnedInsertion,
    Policy,
    learned_insertions,
)
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench

_WARM = "rl-warm"
"""Random stream of the start on which a process makes itself ready."""
_METHOD = "impedance"
"""Its conditions and demands are those of the trials."""
_HELD = tuple(sorted(HAND_OF, key=lambda name: SIDES.index(HAND_OF[name])))
"""Parts in the left and the right hand."""


class Start(NamedTuple):
    """A trial to be tried: row of CONDITIONS, random stream and number."""

    condition: str
    purpose: str
    index: int


class Report(NamedTuple):
    """Result of an action.

    Attributes:
        observation: (k,).
        reward: Of the action; 0 before the first.
        ended: Whether the episode is over, by an end of its own.
        late: Whether it is over because its time is.
        success: By the judge of all methods.
    """

    observation: Floats
    reward: float
    ended: bool = False
    late: bool = False
    success: bool = False


class Tried(NamedTuple):
    """How a try goes: largest force of a hand [N], whether it was stopped, and whether it succeeded."""

    force_n: float
    aborted: bool
    success: bool


class _WarmError(Exception):
    """The process is ready."""


class _WarmingUp(BranchPoint):
    """Answers a few actions itself."""

    def __init__(self) -> None:
        self._left = 3

    def here(self) -> None:
        """Go on."""

    def tell(self, message: Report) -> None:
        """Listen to nobody."""

    def exchange(self, message: Report) -> Array:
        """Answer with zeros; stop after a few."""
        self._left -= 1
        if not self._left:
            raise _WarmError
        return np.zeros(len(RelativePose.names))

    def end(self, message: Report) -> NoReturn:
        """Stop."""
        raise _WarmError


class MatingRuns:
    """Trials that branch where the policy takes over; see `trials.branching.Runs`.

    Args:
        config: Of the task.
        seed: Of the random streams.
        terms: Of the observation.
    """

    def __init__(self, config: Config, seed: int, terms: tuple[str, ...]) -> None:
        self._config = config
        self._seed = seed
        self._terms = terms
        self._benches: dict[str, Bench] = {}
        self._policy: Policy | None = None

    def prepare(self, request: Start) -> None:
        """See `Runs`: compile, load and plan once, so that no trunk has to."""
        if request.condition in self._benches:
            return
        inputs = MethodInputs(self._config, self._seed)
        bench = Bench(_METHOD, inputs, request.condition)
        bench.factory = learned_insertions(bench.inputs, lambda: self._policy)
        self._benches[request.condition] = bench
        if len(self._benches) == 1:
            with contextlib.suppress(_WarmError):
                self.run(request._replace(purpose=_WARM, index=0), _WarmingUp())

    def run(self, request: Start, branches: BranchPoint) -> str:
        """See `Runs`."""
        bench = self._benches[request.condition]
        trial = bench.task.trial(
            self._seed,
            request.purpose,
            request.index,
            widen=bench.condition.widen,
        )
        rng = stream(
            self._seed,
            f"disturbance/{request.purpose}/{request.condition}",
            request.index,
        )
        with bench.condition.applied(bench.world.model, bench.task, trial, rng):
            judge = begin(bench.world, bench.task, trial, bench.spec.demands)
            high_m = bench.task.scene.task.clear_height_m
            episode = MatingEpisode(bench, judge, high_m, self._terms, branches)
            self._policy = episode.act
            method = bench.factory(bench.world, bench.kinematics, trial)
            if not isinstance(method, LearnedInsertion):
                raise TypeError(f"the method is a {type(method).__name__}")
            return episode.drive(method, bench.task.time_limit_s)


class MatingEpisode:
    """Drives one trial; from the branch point on, its actions come from the other end of a pipe.

    Args:
        bench: Where it runs.
        judge: Of the trial, begun.
        high_m: Height over the table at which the parts are in the air.
        terms: Of the observation.
        branches: Where it branches.
    """

    def __init__(
        self,
        bench: Bench,
        judge: Judge,
        high_m: float,
        terms: tuple[str, ...],
        branches: BranchPoint,
    ) -> None:
        self._plant = bench.plant
        self._ground = bench.world
        self._judge = judge
        self._high_m = high_m
        self._terms = terms
        self._branches = branches
        self._reward: Reward[MatingState] = Reward(MATING_REWARD, 1)
        self._began_s: float | None = None
        self._force_n = 0.0
        self._observation: Floats | None = None
        self._aborted = False

    def act(self, sensed: MatingSensed) -> Array:
        """Return the next action (5,): the policy of the trial."""
        observation = observe_mating(self._terms, sensed)
        self._observation = observation
        if self._began_s is None:
            self._began_s = self._judge.truth.time
            self._branches.here()
            self._reward.restart(self._state(), np.ones(1, dtype=bool))
            report = Report(observation, 0.0)
        else:
            report = Report(observation, self._paid())
        self._force_n = 0.0
        return np.asarray(self._branches.exchange(report), dtype=float)

    def drive(self, method: LearnedInsertion, limit_s: float) -> str:
        """Run the trial; return why it ended before the branch point, else end the copy."""
        plant = self._plant
        judge = self._judge
        reason = "the time is over"
        while plant.time < limit_s:
            try:
                method.step()
            except MinidualError as error:
                self._aborted = True
                reason = error.message
                break
            judge.observe(self._ground)
            self._feel(judge.truth)
            if method.aborted is not None or judge.failures:
                self._aborted = True
                reason = method.aborted or next(iter(judge.failures.values())).detail
                break
            if judge.finished or method.done or self._is_late(plant.time):
                break
        if self._began_s is not None:
            self._end(method, judge.finished and judge.outcome(self._ground).success)
        return reason

    def _is_late(self, now_s: float) -> bool:
        return self._began_s is not None and now_s > self._began_s + MATING_S

    def _feel(self, truth: Truth) -> None:
        """Note the largest force of a hand on its part."""
        for hand, name in enumerate(_HELD):
            self._force_n = max(self._force_n, math.hypot(*truth[name].hand_forces[hand]))

    def _end(self, method: LearnedInsertion, success: bool) -> None:
        """Tell how the episode ended; the copy ends."""
        over = self._aborted or success
        report = Report(
            self._last_observation(method),
            self._paid(success),
            ended=over,
            late=not over,
            success=success,
        )
        self._branches.end(report)

    def _last_observation(self, method: LearnedInsertion) -> Floats:
        """Return the observation (k,) of this moment, or the latest one where the trial broke."""
        latest = self._observation
        if latest is None or method.mating is None:
            raise RuntimeError("an episode ended before its first observation")
        if self._aborted:
            return latest
        plant = self._plant
        sensed = method.mating.sense(plant.q, method.stack.manager.reference, plant.time)
        return observe_mating(self._terms, sensed)

    def _paid(self, success: bool = False) -> float:
        paid = self._reward.pay(self._state(success))
        return float(sum(value[0] for value in paid.values()))

    def _state(self, success: bool = False) -> MatingState:
        tried = Tried(self._force_n, self._aborted, success)
        return mating_state(self._judge.truth, self._high_m, tried)


def mating_state(truth: Truth, high_m: float, tried: Tried) -> MatingState:
    """Return the true state of one trial, as the reward reads it."""
    peg = truth[PEG]
    socket = truth[SOCKET]
    R_peg, p_peg = peg.frame
    R_socket, p_socket = socket.frame
    tip = p_peg + R_peg @ TIP
    from_mouth = R_socket.T @ (tip - p_socket) - MOUTH
    pinch = [truth[name].pinch[hand] for hand, name in enumerate(_HELD)]
    aloft = min(peg.clearance_m, socket.clearance_m) > high_m
    return MatingState(
        beside_m=np.array([math.hypot(from_mouth[0], from_mouth[2])]),
        before_m=np.array([-from_mouth[1]]),
        depth_m=np.array([depth_m(truth)]),
        needed_m=DEPTH_M,
        pinch_n=np.array([pinch]),
        aloft=np.array([aloft]),
        force_n=np.array([tried.force_n]),
        violated=np.array([tried.aborted]),
        succeeded=np.array([tried.success]),
    )
