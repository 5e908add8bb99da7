"""`benchmark` films a start of each task, all methods that can do it side by side."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from minidual.config.root import Config
from minidual.stages import benchmark_films
from minidual.stages.benchmark_films import FilmJob, caption, film_jobs, write_films
from minidual.trials.methods import MethodInputs
from tests.support import trial_results
from tests.support.tool_contexts import tool_context


def inputs(task: str) -> MethodInputs:
    return MethodInputs(Config(task=task), 0)


def outcome(method: str, index: int, *, success: bool = True) -> Any:
    return trial_results.result(index, method=method, success=success)


def test_the_start_that_tells_methods_apart_is_filmed_else_the_first() -> None:
    alike = [outcome(method, k) for method in ("moveit", "impedance") for k in (3, 4)]
    apart = [*alike, outcome("moveit", 6), outcome("impedance", 6, success=False)]
    given = {"rod_carry": inputs("rod_carry"), "pot_lift": inputs("pot_lift")}
    jobs = film_jobs(
        given,
        ("moveit", "impedance"),
        {"rod_carry": alike, "pot_lift": apart},
    )
    assert [(job.name, job.index) for job in jobs] == [
        ("film-rod_carry.mp4", 3),
        ("film-pot_lift.mp4", 6),
    ]


def test_only_methods_that_can_do_a_task_are_filmed() -> None:
    trials = {"sort": [outcome("impedance", 0), outcome("moveit", 0)]}
    given = {"sort": inputs("sort")}
    (job,) = film_jobs(given, ("moveit", "impedance", "act"), trials)
    assert job.methods == ("moveit", "impedance")
    assert film_jobs(given, ("act",), trials) == []


def test_a_long_trial_is_shown_faster_and_its_caption_says_so(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    filmed: list[tuple[int, str, float]] = []

    def film(takes: Any, path: Path, *, speed: float, fps: int, size_px: Any) -> None:
        filmed.append((len(takes), path.name, speed))

    monkeypatch.setattr(benchmark_films, "film_takes", film)
    monkeypatch.setattr(
        benchmark_films,
        "take",
        lambda method, *_: SimpleNamespace(end_s=40.0 if method == "moveit" else 8.0),
    )
    context: Any = tool_context(tmp_path, "benchmark", "rod_carry")
    job = FilmJob(inputs("rod_carry"), ("moveit", "impedance", "hold"), 5)
    captions = write_films(
        SimpleNamespace(folder=tmp_path, workers=1, progress=context.progress),  # type: ignore[arg-type]
        [job],
    )
    assert filmed == [(3, "film-rod_carry.mp4", 4)]
    words = "start 5, undisturbed, by moveit, impedance and hold, 4 times as fast"
    assert captions == {"film-rod_carry.mp4": f"rod_carry: {words}"}
    alone = FilmJob(inputs("rod_carry"), ("moveit",), 5)
    assert caption(alone, 1) == "rod_carry: start 5, undisturbed, by moveit"
