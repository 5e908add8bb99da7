"""Checks of `deploy`: the held-out trials, and the sets beside them."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from minidual.config.learning import DeployConfig
from minidual.gate.check import Check
from minidual.gate.criterion import Criterion
from minidual.trials.metrics import MethodSummary, TrialMetrics

HELD_OUT_SET = "held_out"
"""Name of the set of trials from starts that no demonstration has."""
TRAINING_SET = "training"
"""Name of the set of trials from starts of demonstrations."""
HIDDEN = "object hidden"
"""Condition, and set, of trials in which the policy cannot see the object."""

SUCCESS_RATE = Criterion(
    "success_rate",
    ">",
    why="closed-loop success on {trials_n} starts held out from training",
    remedy="record more demonstrations (teleop-record --episodes 200) "
    "or train longer (--set train.steps=...)",
)
SUCCESS_LOW = Criterion("success_low", why="lower end of its 95 % Wilson interval")
SUCCESS_HIGH = Criterion("success_high", why="upper end of its 95 % Wilson interval")
TRIALS = Criterion(
    "trials",
    ">=",
    why="results of held-out trials in trials.csv, each index once",
    remedy="minidual deploy --force runs them all",
)
SETS_COMPLETE = Criterion(
    "sets_complete",
    "==",
    why="sets of trials whose results are all in trials.csv{missing}",
    remedy="minidual deploy --force runs them all",
)
STARTS_SEEN = Criterion(
    "held_out_starts_seen",
    "==",
    why="held-out trials whose start and goal were demonstrated",
    remedy="take other starts with --set deploy.first_start=10000",
)
INFERENCE_RATE = Criterion(
    "inference_hz",
    ">",
    unit="Hz",
    why="whole inferences, with pre- and post-processing, in a second of processor time (all "
    "threads summed) must keep up with the arms",
    remedy="use the policy spatial_act, or a smaller image",
    clocked=True,
)
INFERENCE_WALL_RATE = Criterion(
    "inference_wall_hz",
    unit="Hz",
    why="the same in a second of wall time, in which other programs take their share",
    clocked=True,
)
HIDDEN_RATE = Criterion(
    "hidden_success_rate",
    "<=",
    why="success with an object that no camera sees; a policy that looks fails",
    remedy="look at occlusion.png; the demonstrations may all begin alike",
)
GOAL_ERROR_MEDIAN = Criterion(
    "goal_error_median_m",
    unit="m",
    why="of trials that lifted the object",
)
LOOKS_AT_OBJECT = Criterion(
    "looks_at_object",
    why="change of the joint targets when a patch of the object is covered, "
    "over that of other patches (occlusion.png)",
)
SET_RATE = Criterion(
    "success_rate",
    ">=",
    why='the same on the set "{set}": {interval}',
    remedy="record more demonstrations in changed rooms (teleop-record --episodes 200) "
    "or train longer (--set train.steps=...)",
)
WORST_SEED = Criterion(
    "worst_seed",
    why='success on the set "{set}" of the training seed that did worst',
)
MEDIAN_SEED = Criterion(
    "median_seed",
    why='success on the set "{set}", median of the training seeds',
)


class InferenceRates(NamedTuple):
    """Whole inferences of one policy.

    Attributes:
        processor_hz: Per second of processor time, summed over threads.
        wall_hz: Per second of wall time.
    """

    processor_hz: float
    wall_hz: float


def deploy_checks(
    held_out: MethodSummary,
    seen_n: int,
    inference: InferenceRates,
    settings: DeployConfig,
) -> list[Check]:
    """Return the checks of the held-out trials; `seen_n` of them were demonstrated."""
    return [
        SUCCESS_RATE.check(
            held_out["success_rate"],
            settings.success_rate_min,
            trials_n=held_out.trials_n,
        ),
        SUCCESS_LOW.report(held_out["success_low"]),
        SUCCESS_HIGH.report(held_out["success_high"]),
        STARTS_SEEN.check(seen_n, 0),
        INFERENCE_RATE.check(inference.processor_hz, settings.inference_hz_min),
        INFERENCE_WALL_RATE.report(inference.wall_hz),
    ]


def table_checks(results_n: Mapping[str, int], asked_n: Mapping[str, int]) -> list[Check]:
    """Return the checks of the table of trials; both: {set: results} of all training seeds."""
    missing = [
        f"{name} {results_n.get(name, 0)} of {count}"
        for name, count in asked_n.items()
        if results_n.get(name, 0) != count
    ]
    complete_n = len(asked_n) - len(missing)
    text = f": {', '.join(missing)}" if missing else ""
    return [
        TRIALS.check(results_n.get(HELD_OUT_SET, 0), asked_n[HELD_OUT_SET]),
        SETS_COMPLETE.check(complete_n, len(asked_n), missing=text),
    ]


def set_checks(
    name: str,
    summary: MethodSummary,
    rates: Sequence[float],
    settings: DeployConfig,
) -> list[Check]:
    """Return the checks of a set of trials; `rates`: success of each training seed."""
    success_rate = summary["success_rate"]
    if name == HIDDEN:
        return [HIDDEN_RATE.check(success_rate, settings.hidden_rate_max)]
    prefix = f"{name.replace(' ', '_')}_"
    checks: list[Check] = []
    if name != HELD_OUT_SET:
        limit = settings.condition_rate_min.get(name)
        checks.append(
            SET_RATE.check(
                success_rate,
                limit,
                prefix=prefix,
                set=name,
                interval=summary.interval,
            ),
        )
    if len(rates) > 1:
        median = float(np.median(rates))
        checks.append(WORST_SEED.report(min(rates), prefix=prefix, set=name))
        checks.append(MEDIAN_SEED.report(median, prefix=prefix, set=name))
    return checks


def seed_rates(results: Sequence[TrialMetrics], seeds_n: int) -> list[float]:
    """Return the success rate of each training seed, from equally many results in order."""
    successes = np.reshape([result.success for result in results], (seeds_n, -1))
    return successes.mean(axis=1).tolist()
