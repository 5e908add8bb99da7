"""The blocks of a standard run: a row a stage, its methods on its own task, and on all tasks."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

from minidual.errors import DataError
from minidual.trials.statistics import wilson_interval
from scripts.results.markdown import origin_line, table
from scripts.results.trials import CONDITIONS
from scripts.results.verdicts import Numbers, numbers_of

STAGES_BLOCK = "standard"
METHODS_BLOCK = "standard-methods"
TASKS_BLOCK = "standard-tasks"
COMMAND = "make all"
RANDOMISED = CONDITIONS[-1]


def _percent(share: float) -> str:
    return f"{100 * share:.4g} %"


def _of(record: dict[str, Any]) -> str:
    return f"{record['successes_n']} of {record['trials']}"


def _env_check(n: Numbers) -> str:
    mapped = n.observed("joints.mapped")
    step_rad = n.observed("tracking.step_error_rad")
    sine_rad = n.observed("tracking.sine_rms_rad")
    return (
        f"{mapped} joints mapped and driven; step error {step_rad:.0e} rad; "
        f"sine RMS {sine_rad:.4f} rad"
    )


def _plan(n: Numbers) -> str:
    rates = [check.observed for check in n.verdict.checks if _is_group_rate(check.name)]
    driven = n.observed("closed_chain.driven_n")
    driven_mm = 1e3 * n.observed("closed_chain.executed_error_max_m")
    states = n.observed("proof.audit_states")
    collisions = n.observed("proof.audit_collisions")
    return (
        f"{_percent(min(rates))} of queries proven; {states:,} audited states, "
        f"{collisions} in collision; {_percent(n.observed('closed_chain.success_rate'))} of held "
        f"moves, {driven} of them driven, within {driven_mm:.1f} mm"
    )


def _is_group_rate(name: str) -> bool:
    return name.endswith(("_arm.success_rate", "_arms.success_rate"))


def _carry(n: Numbers) -> str:
    tilt_deg = math.degrees(n.observed("tilt_max_rad"))
    return (
        f"{_of(n.verdict.data)}; tilt at most {tilt_deg:.2f} deg; internal force at least "
        f"{n.observed('internal_force_min_n'):.1f} N; median {n.observed('duration_median_s'):.1f} "
        f"s, longest {n.observed('duration_max_s'):.1f} s; peak torque "
        f"{_percent(round(n.observed('torque_ratio_max'), 2))} of limit"
    )


def _teleop_record(n: Numbers) -> str:
    return (
        f"{n.observed('episodes')} of {n.observed('attempts')} attempts kept; RMS jerk at most "
        f"{n.observed('jerk_rms_max'):.0f} rad/s³; latency p99 "
        f"{1e3 * n.observed('latency_p99_s'):.1f} ms; {n.observed('episodes_per_min'):.0f} episodes "
        "a minute with conversion"
    )


def _train_act(n: Numbers) -> str:
    error_rad = n.observed("validation_keyframe_rad")
    network = n.data("architecture")
    return f"`{network}`, {n.observed('steps_done'):,} steps; keyframe error {error_rad:.4f} rad"


def _deploy(n: Numbers) -> str:
    return (
        f"{_of(n.verdict.data)} held-out starts from {n.setting('deploy', 'first_start')}, "
        f"{_of(n.data('room'))} in a changed room, "
        f"{_of(n.data('object hidden'))} with the object hidden; "
        f"{n.observed('inference_hz'):.0f} inferences a second on one thread"
    )


def _benchmark(n: Numbers) -> str:
    trials_n = 0
    for of_task in n.data("tasks").values():
        cells = [of_task["methods"]]
        cells += [condition["methods"] for condition in of_task["conditions"].values()]
        trials_n += sum(record.get("trials", 0) for cell in cells for record in cell.values())
    return f"{trials_n} trials, starts from {n.setting('benchmark', 'first_start')}"


_RESULTS: dict[str, Callable[[Numbers], str]] = {
    "env-check": _env_check,
    "plan": _plan,
    "carry": _carry,
    "teleop-record": _teleop_record,
    "train-act": _train_act,
    "deploy": _deploy,
    "benchmark": _benchmark,
    "report": lambda _: "",
}


def blocks(run: Path) -> dict[str, str] | None:
    """Return the blocks; None while a stage has no passing verdict.

    Raises:
        DataError: A verdict lacks a number, or does not count as acceptance.
    """
    of_stages = {stage: numbers_of(run, stage) for stage in _RESULTS}
    numbers = {stage: n for stage, n in of_stages.items() if n is not None}
    if len(numbers) < len(_RESULTS):
        return None
    for stage, n in numbers.items():
        if not n.verdict.acceptance:
            profile = n.verdict.fingerprint.profile
            raise DataError(
                f"{run}: {stage} counts not as acceptance (profile {profile}, waivers or weaker "
                "values)",
                remedy="--standard RUN, with a run of the profile standard as it is shipped",
            )
    line = origin_line([n.made for n in numbers.values()], COMMAND)
    rows = [
        [f"`{stage}`", f"{n.verdict.duration_s:.0f} s", _RESULTS[stage](n)]
        for stage, n in numbers.items()
    ]
    total_min = sum(n.verdict.duration_s for n in numbers.values()) / 60.0
    stages = table(["stage", "took", "result"], rows)
    return {
        STAGES_BLOCK: f"{line}\n\n{stages}\n\nAll stages: {total_min:.1f} min.",
        METHODS_BLOCK: _methods(numbers["benchmark"], numbers["train-act"].data("architecture")),
        TASKS_BLOCK: _tasks(numbers["benchmark"]),
    }


def _methods(n: Numbers, network: str) -> str:
    """Return the table of the run's own task, and what its disturbances cost."""
    task, record = next(iter(n.data("tasks").items()))
    rows = [_method_row(name, of, network) for name, of in record["methods"].items()]
    header = ["", "success", "time", "peak torque", "RMS jerk", "largest tilt", "path"]
    header[0] = f"`{task}`, clean"
    losses: list[str] = []
    for condition, cells in record["conditions"].items():
        for method, cell in cells["methods"].items():
            if cell["applies"] and cell["successes_n"] < cell["trials"]:
                losses.append(f"`{method}` under `{condition}` {_of(cell)}")
    lost = "; ".join(losses) if losses else "none"
    return f"{table(header, rows)}\n\nCells under single disturbances with a failed trial: {lost}."


def _tasks(n: Numbers) -> str:
    """Return the successes of each method on each task, undisturbed and with all at once."""
    tasks: dict[str, dict[str, Any]] = n.data("tasks")
    names = list(dict.fromkeys(name for record in tasks.values() for name in record["methods"]))
    header = [""]
    header += [f"`{name}` {condition}" for name in names for condition in CONDITIONS]
    rows: list[list[str]] = []
    for task, record in tasks.items():
        disturbed = record["conditions"].get(RANDOMISED, {"methods": {}})
        row = [f"`{task}`"]
        for name in names:
            row += [_rate(record["methods"].get(name)), _rate(disturbed["methods"].get(name))]
        rows.append(row)
    return table(header, rows)


def _rate(record: dict[str, Any] | None) -> str:
    """Return successes with their 95 % Wilson interval; nothing for a cell without trials."""
    if record is None or not record.get("applies", True):
        return ""
    low, high = wilson_interval(record["successes_n"], record["trials"])
    return f"{_of(record)} ({100 * low:.0f}-{100 * high:.0f} %)"


def _method_row(name: str, record: dict[str, Any], network: str) -> list[str]:
    title = f"`{name}` (`{network}`)" if name == "act" else f"`{name}`"
    if not record.get("applies", True):
        return [title, "does not apply", "", "", "", "", ""]
    return [
        title,
        _of(record),
        f"{record['duration_median_s']:.2f} s" if record["successes_n"] else "",
        _percent(round(record["torque_ratio_max"], 2)),
        f"{record['jerk_rms_median']:.0f} rad/s³",
        f"{math.degrees(record['tilt_max_rad']):.2f} deg",
        f"{record['path_length_m']:.2f} m" if record["successes_n"] else "",
    ]
