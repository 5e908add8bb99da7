"""`minidual carry`: two arms carry a rod 50 cm under object impedance, again and again from random starts."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from minidual.data.smoothness import JERK_FILTER
from minidual.pipeline.check import Check
from minidual.pipeline.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.config.root import Config
    from minidual.evaluation.metrics import TrialMetrics

SUCCESS_RATE_MIN = 0.8
DURATION_MAX_S = 10.0


def carry_checks(
    trials: Sequence[TrialMetrics], *, tilt_limit_rad: float, force_limit_n: float, time_limit_s: float
) -> list[Check]:
    """Return the checks of the stage for judged trials; extremes are over all trials, failed ones too."""
    import numpy as np  # np.max and np.min pass a NaN on, so that its check fails; the built-ins may lose it

    return [
        Check(
            "success_rate", sum(t.success for t in trials) / len(trials), ">", SUCCESS_RATE_MIN, "",
            "share of trials in which both arms carried the rod to its goal and let go",
            "trials.csv names what failed first; minidual carry --set carry.impedance.internal_force_n=...",
        ),
        Check(
            "tilt_max_rad", float(np.max([t.tilt_max_rad for t in trials])), "<", tilt_limit_rad, "rad",
            "a tilted rod slips or spills", "raise carry.impedance.stiffness_n_per_m or lengthen carry.transport_s",
        ),
        Check(
            "internal_force_min_n", float(np.min([t.internal_force_min_n for t in trials])), ">", force_limit_n, "N",
            "squeeze between the hands while the rod is off the table; below it the rod may slip",
            "raise carry.impedance.internal_force_n (at most 80)",
        ),
        Check(
            "duration_max_s", float(np.max([t.duration_s if t.success else time_limit_s for t in trials])), "<", DURATION_MAX_S,
            "s", "from the start to the rod released at its goal; a failed trial counts as the time limit",
            "shorten carry.transport_s",
        ),
        Check(
            "torque_ratio_max", float(np.max([t.torque_ratio_max for t in trials])), "<", 1.0, "",
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
        """Run the trials, plot the median and the worst, film the median one."""
        import numpy as np

        from minidual.config.seeds import stream
        from minidual.evaluation.film import film_trial
        from minidual.evaluation.methods import MethodInputs
        from minidual.evaluation.metrics import summarise
        from minidual.evaluation.tables import write_csv, write_json
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
                task.advance(note="" if result.success else f"trial {result.metrics.index}: {result.text}")
        metrics = [r.metrics for r in results]
        summary = summarise(metrics, stream(context.seed, "bootstrap/carry"))
        write_csv(context.folder / "trials.csv", metrics)
        write_json(context.folder / "trials.json", [summary], metrics)

        order = np.argsort([-m.tilt_max_rad if m.success else -np.inf for m in metrics], kind="stable")
        shown = {"median": int(order[len(order) // 2]), "worst": int(order[0])}
        for label, i in shown.items():
            draw_trial(
                logs[i],
                scene,
                context.folder / f"{label}.png",
                title=f"{label} trial ({i}): {results[i].text}",
            )
        film_trial("impedance", inputs, trials[shown["median"]], context.folder / "carry.mp4")

        limits = scene.task
        checks = carry_checks(
            metrics,
            tilt_limit_rad=limits.tilt_max_rad,
            force_limit_n=limits.internal_force_min_n,
            time_limit_s=limits.time_limit_s,
        )
        checks += [
            Check("success_low", summary.success_low, unit="", why="lower end of the 95 % Wilson interval"),
            Check(
                "goal_error_max_m",
                max(m.goal_error_m for m in metrics),
                unit="m",
                why="largest distance from the goal",
            ),
            Check(
                "pinch_force_min_n",
                min(m.pinch_force_min_n for m in metrics),
                unit="N",
                why="least grip in the air",
            ),
            Check(
                "duration_median_s",
                summary.duration_median_s,
                unit="s",
                why="median of the successful trials",
            ),
            Check("jerk_rms_median", summary.jerk_rms_median, unit="rad/s^3", why=JERK_FILTER),
        ]
        data = {
            "trials": len(metrics),
            "success_low": summary.success_low,
            "success_high": summary.success_high,
            "failures": dict(summary.failures),
            "shown": shown,
        }
        return StageResult(checks=checks, data=data)


STAGE = CarryStage()
