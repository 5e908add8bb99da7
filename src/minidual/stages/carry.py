"""`minidual carry`: two arms carry a rod 50 cm under object impedance, again and again from random starts."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from minidual.pipeline.check import Check
from minidual.pipeline.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.config.root import Config
    from minidual.evaluation.trials import TrialResult

SUCCESS_RATE_MIN = 0.8
DURATION_MAX_S = 10.0


def carry_checks(
    results: Sequence[TrialResult], *, tilt_limit_rad: float, force_limit_n: float
) -> list[Check]:
    """Return the checks of the stage for a list of judged trials; extremes are over all trials, failed ones too."""
    rate = sum(r.success for r in results) / len(results)
    return [
        Check(
            "success_rate", rate, ">", SUCCESS_RATE_MIN, "",
            "share of trials in which both arms carried the rod to its goal and let go",
            "read trials.csv: `reason` names what failed first; minidual carry --set carry.impedance....",
        ),
        Check(
            "tilt_max_rad", max(r.tilt_max_rad for r in results), "<", tilt_limit_rad, "rad",
            "a tilted rod slips or spills", "raise carry.impedance.stiffness_n_per_m or slow down transport_s",
        ),
        Check(
            "internal_force_min_n", min(r.internal_force_min_n for r in results), ">", force_limit_n, "N",
            "squeeze between the hands while the rod is off the table; below it the rod may slip",
            "raise carry.impedance.internal_force_n (at most 80)",
        ),
        Check(
            "duration_max_s", max(r.duration_s for r in results), "<", DURATION_MAX_S, "s",
            "from the start to the rod released at its goal", "shorten carry.transport_s",
        ),
        Check(
            "torque_ratio_max", max(r.torque_ratio_max for r in results), "<", 1.0, "",
            "largest motor torque over its limit; at 1 the drive saturates and control is lost",
            "lengthen carry.lift_s, transport_s and lower_s",
        ),
    ]  # fmt: skip


class CarryStage:
    """See the module."""

    name = "carry"
    requires = ("plan",)
    summary = "Carry a rod with both arms under object impedance and internal force control"

    def parameters(self, config: Config) -> dict[str, Any]:
        """Return what the result depends on."""
        return {"carry": config.carry, "scene": config.scene}

    def run(self, context: StageContext) -> StageResult:
        """Run the trials, then film and plot the median one (and the worst, if it failed)."""
        from minidual.evaluation.film import film_trial
        from minidual.evaluation.methods import MethodInputs
        from minidual.evaluation.statistics import wilson_interval
        from minidual.evaluation.tables import count_faults, write_trials
        from minidual.evaluation.trial_figures import draw_trial
        from minidual.evaluation.trials import run_trials
        from minidual.tasks.rod_carry import sample_trial

        config, scene = context.config, context.config.scene
        inputs = MethodInputs(config, context.seed)
        trials = [sample_trial(scene, context.seed, "carry", i) for i in range(config.carry.trials_n)]
        results, logs = [], []
        with context.progress.task("carries", len(trials)) as task:
            for result, log in run_trials(
                "impedance", inputs, trials, workers=context.workers, keep_logs=True
            ):
                results.append(result)
                logs.append(log)
                task.advance(note="" if result.success else f"trial {result.index}: {result.reason}")
        write_trials(results, context.folder / "trials.csv", context.folder / "trials.json")

        order = sorted(range(len(results)), key=lambda i: (results[i].success, -results[i].tilt_max_rad))
        shown = {"median": order[len(order) // 2], "worst": order[0]}
        for label, i in shown.items():
            state = "success" if results[i].success else results[i].reason
            if logs[i] is not None:
                draw_trial(
                    logs[i],
                    scene,
                    context.folder / f"{label}.png",
                    title=f"Carry, {label} trial {i}: {state}",
                )
        film_trial("impedance", inputs, trials[shown["median"]], context.folder / "carry.mp4")

        low, high = wilson_interval(sum(r.success for r in results), len(results))
        task_limits = scene.task
        checks = carry_checks(
            results, tilt_limit_rad=task_limits.tilt_max_rad, force_limit_n=task_limits.internal_force_min_n
        )
        checks += [
            Check("success_low", low, unit="", why="lower end of the 95 % Wilson interval"),
            Check(
                "goal_error_max_m",
                max(r.goal_error_m for r in results),
                unit="m",
                why="largest distance from the goal",
            ),
            Check(
                "duration_median_s",
                statistics.median(r.duration_s for r in results),
                unit="s",
                why="median cycle",
            ),
        ]
        return StageResult(
            checks=checks,
            data={
                "trials": len(results),
                "success_low": low,
                "success_high": high,
                "failures": count_faults(results),
                "median_trial": shown["median"],
                "worst_trial": shown["worst"],
            },
        )


STAGE = CarryStage()
