"""The campaign can say no: each forbidden outcome is noted by name, and a harmless one is not."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest

from minidual.demos.episode import inspect_episode
from scripts.campaign.broken import broken
from scripts.campaign.case import Case, Place, Ran, Result, judge, run_cases
from scripts.campaign.configuration import override_cases
from scripts.campaign.kinds import KINDS
from scripts.campaign.processes import orphans
from tests.support import data_samples
from tests.support.children import fork_child

Body = Callable[[Place, Result], object]


@pytest.mark.parametrize(
    ("ran", "noted"),
    [
        (Ran(70, "", "minidual: internal error: KeyError"), "exit 70: minidual: internal error"),
        (Ran(0, "", "Traceback (most recent call last):\n  boom"), "a traceback"),
        (Ran(-11, "", ""), "exit -11 is not one of"),
    ],
)
def test_what_a_command_may_not_do_is_noted(ran: Ran, noted: str) -> None:
    result = Result()
    assert not judge(result, "status", ran, [0, 2])
    (text,) = result.forbidden
    assert noted in text


@pytest.mark.parametrize("ran", [Ran(0, "fine", ""), Ran(2, "", "minidual: no such file")])
def test_what_a_command_may_do_is_not_noted(ran: Ran) -> None:
    result = Result()
    assert judge(result, "status", ran, [0, 2])
    assert result.forbidden == []


def run_bodies(folder: Path, **bodies: Body) -> dict[str, Result]:
    """Run cases of 0.2 s; return their results by name."""
    results: dict[str, Result] = {}
    cases = [Case(name, body, limit_s=0.2) for name, body in bodies.items()]

    def done(_index: int, case: Case, result: Result, _seconds: float) -> None:
        results[case.name] = result

    run_cases(list(enumerate(cases)), folder, 1, "test", 2, done)
    return results


def test_a_hang_a_death_and_an_error_of_the_program_are_noted_and_the_next_case_runs(
    tmp_path: Path,
) -> None:
    def raises(_place: Place, _result: Result) -> NoReturn:
        raise KeyError("lost")

    results = run_bodies(
        tmp_path,
        hangs=lambda _place, _result: time.sleep(30),
        dies=lambda _place, _result: os.kill(os.getpid(), signal.SIGKILL),
        leaves=lambda _place, _result: os._exit(3),
        raises=raises,
        works=lambda _place, result: result.saw("fine"),
    )
    assert "a hang: longer than 0.8 s" in results["hangs"].forbidden[0]
    assert results["dies"].forbidden == ["the process died: SIGKILL"]
    assert results["leaves"].forbidden == ["the process died: exit 3"]
    assert results["raises"].forbidden[0].startswith("uncaught: KeyError at test_campaign.py")
    assert results["works"] == Result(outcomes={"fine": 1})


def test_a_case_draws_the_same_numbers_in_every_campaign(tmp_path: Path) -> None:
    def draws(place: Place, result: Result) -> None:
        result.saw(str(place.rng.integers(1 << 60)))

    assert run_bodies(tmp_path, draws=draws) == run_bodies(tmp_path, draws=draws)


def test_an_orphan_is_named_and_ended() -> None:

    def live_apart() -> None:
        os.setsid()
        time.sleep(30)

    child = fork_child(live_apart)
    deadline_s = time.monotonic() + 30.0
    while os.getsid(child) != child and time.monotonic() < deadline_s:
        time.sleep(0.01)
    (named,) = orphans(child, patience_s=0.0)
    assert named.startswith(str(child))
    os.waitpid(child, 0)
    assert orphans(child, patience_s=0.0) == []


def test_the_small_campaign_has_its_size() -> None:
    small = {name: kind.small for name, kind in KINDS.items()}
    files = ("recordings", "scenes", "readers", "broken-files", "caches", "verdicts")
    assert small["publish-kills"] >= 25
    assert small["tampering"] >= 60
    assert small["configuration"] * 30 >= 500
    assert sum(small[name] for name in files) >= 50
    assert small["stage-kills"] >= 3
    assert small["full-disks"] >= 1


def test_every_field_of_the_configuration_is_tried(tmp_path: Path) -> None:
    fields = {case.name for case in override_cases(tmp_path)}
    assert {"plan.queries_n", "carry.limits.tilt_max_rad", "scene"} <= fields


@pytest.fixture
def episode(tmp_path: Path) -> Path:
    """A recorded episode of a source run."""
    path = tmp_path / "smoke" / "teleop-record/episodes/e.hdf5"
    return data_samples.write(path, data_samples.arrays(12, cameras=("high",)))


@pytest.mark.parametrize(
    ("change", "noted"),
    [
        (lambda path, rng: path.write_text("broken"), []),
        (lambda path, rng: None, ["a silent pass"]),
    ],
)
def test_a_broken_file_that_is_read_is_noted_and_the_source_stays_whole(
    episode: Path,
    tmp_path: Path,
    change: Callable[[Path, np.random.Generator], object],
    noted: list[str],
) -> None:
    source = tmp_path / "smoke"
    folder = tmp_path / "place"
    folder.mkdir()
    result = Result()
    name = episode.relative_to(source).as_posix()
    broken("episode", name, change, Place(folder, source, np.random.default_rng(1)), result)
    assert [text.split(":")[0] for text in result.forbidden] == noted
    assert inspect_episode(episode)[1] == []
