"""`minidual benchmark`: the same task, the same starts and the same success test for every method."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from minidual.data.smoothness import JERK_FILTER
from minidual.pipeline.check import Check
from minidual.pipeline.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.config.evaluation import BenchmarkConfig
    from minidual.config.root import Config
    from minidual.evaluation.metrics import MethodSummary

PURPOSE = "benchmark"
"""Random stream of the trials: all methods get the same ones, and no stage before has seen them."""

_UNITS = {
    "duration_median_s": ("s", "median over successful trials, start to released at rest"),
    "torque_ratio_max": ("", "largest motor torque over its limit, all trials"),
    "jerk_rms_median": ("rad/s^3", JERK_FILTER),
    "tilt_max_rad": ("rad", "largest tilt of the rod, all trials, failed ones too"),
    "path_length_m": ("m", "median path of both hands together over successful trials"),
}


def benchmark_checks(summaries: Sequence[MethodSummary], config: BenchmarkConfig) -> list[Check]:
    """Return the checks of the stage.

    Every method must have run and reached its least success rate (none is asked in profiles that do not judge
    learned success). The other indicators are reported: they compare, they do not gate.
    """
    checks = []
    for summary in summaries:
        limit = config.success_rate_min.get(summary.method)
        checks.append(
            Check(
                f"{summary.method}.success_rate", summary.success_rate, None if limit is None else ">", limit, "",
                f"{summary.successes_n} of {summary.trials_n} trials, 95 % Wilson interval "
                f"{summary.success_low:.3f} to {summary.success_high:.3f}",
                "benchmark.csv names what failed first in each trial",
            )
        )  # fmt: skip
        for name, (unit, why) in _UNITS.items():
            checks.append(Check(f"{summary.method}.{name}", getattr(summary, name), unit=unit, why=why))
    evaluated = min((s.trials_n for s in summaries), default=0)
    checks.append(
        Check(
            "trials_per_method", evaluated, ">=", config.trials_n, "",
            "every method must have run every trial, or the rows cannot be compared",
        )
    )  # fmt: skip
    return checks


class BenchmarkStage:
    """See the module."""

    name = "benchmark"
    requires = ("carry", "deploy")
    summary = "Compare planning, object impedance and the policy on one task"

    def parameters(self, config: Config) -> dict[str, Any]:
        """Return what the result depends on."""
        return {
            "benchmark": config.benchmark,
            "carry": config.carry,
            "plan": config.plan.planner,
            "deploy": config.deploy,
            "scene": config.scene,
            "arbiter": config.arbiter,
            "supervisor": config.supervisor,
        }

    def validate(self, config: Config) -> None:
        """Refuse unknown and repeated methods, and limits for methods that do not exist."""
        from minidual.evaluation.methods import method_spec, parse_methods

        parse_methods(config.benchmark.methods)
        for name in config.benchmark.success_rate_min:
            method_spec(name)

    def run(self, context: StageContext) -> StageResult:
        """Run all trials of all methods and write the tables."""
        from minidual.config.seeds import stream
        from minidual.evaluation.methods import MethodInputs, parse_methods
        from minidual.evaluation.metrics import summarise
        from minidual.evaluation.tables import write_csv, write_json
        from minidual.evaluation.trials import run_trials
        from minidual.tasks.rod_carry import sample_trial

        config = context.config
        methods = parse_methods(config.benchmark.methods)
        inputs = MethodInputs(config, context.seed, context.upstream["train-act"] / "checkpoint")
        trials = [
            sample_trial(config.scene, context.seed, PURPOSE, i) for i in range(config.benchmark.trials_n)
        ]
        metrics, summaries = [], []
        rng = stream(context.seed, "bootstrap/benchmark")
        with context.progress.task("benchmark trials", len(methods) * len(trials)) as task:
            for method in methods:
                rows = []
                for result, _ in run_trials(
                    method, inputs, trials, workers=context.workers, view=context.view
                ):
                    rows.append(result.metrics)
                    task.advance(note=f"{method} {sum(r.success for r in rows)}/{len(rows)}")
                metrics += rows
                summaries.append(summarise(rows, rng))
        write_csv(context.folder / "benchmark.csv", metrics)
        write_csv(context.folder / "methods.csv", summaries)
        write_json(context.folder / "benchmark.json", summaries, metrics, {"seed": context.seed})
        return StageResult(
            checks=benchmark_checks(summaries, config.benchmark),
            data={"methods": {s.method: _finite(s) for s in summaries}, "jerk_filter": JERK_FILTER},
        )


def _finite(summary: MethodSummary) -> dict[str, Any]:
    """Return a summary for the report: a number that does not exist becomes the word nan."""
    values = {
        k: v for k, v in summary.__dict__.items() if k not in ("method", "condition", "trials_n", "failures")
    }
    plain = {k: "nan" if isinstance(v, float) and math.isnan(v) else v for k, v in values.items()}
    return {"trials": summary.trials_n, **plain, "failures": dict(summary.failures)}


STAGE = BenchmarkStage()
