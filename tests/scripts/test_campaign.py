"""The campaign can say no: each forbidden outcome is noted by name, and a harmless one is not."""

from __future__ import annotations

import os
import signal
import time

import numpy as np
import pytest

from minidual.demos.episode import inspect_episode
from scripts.campaign.broken import broken
from scripts.campaign.case import Case, Place, Ran, Result, judge, run_cases
from scripts.campaign.configuration import override_cases
from scripts.campaign.kinds import KINDS
from scripts.campaign.processes import orphans
from tests.support import data_samples


@pytest.mark.parametrize(
    ("ran", "noted"),
    [
        (Ran(70, "", "minidual: internal error: KeyError"), "exit 70: minidual: internal error"),
        (Ran(0, "", "Traceback (most recent call last):\n  boom"), "a traceback"),
        (Ran(-11, "", ""), "exit -11 is not one of"),
        (Ran(0, "fine", ""), None),
        (Ran(2, "", "minidual: no such file"), None),
    ],
)
def test_what_a_command_may_not_do_is_noted(ran, noted):
    result = Result()
    assert judge(result, "status", ran, [0, 2]) is (noted is None)
    assert [noted in text for text in result.forbidden] == [True] * (noted is not None)


def outcomes(tmp_path, **bodies) -> dict[str, Result]:
    found: dict[str, Result] = {}
    cases = [(i, Case(name, body, limit_s=0.2)) for i, (name, body) in enumerate(bodies.items())]
    run_cases(
        cases,
        tmp_path,
        1,
        "test",
        2,
        lambda index, case, result, seconds: found.update({case.name: result}),
    )
    return found


def test_a_hang_a_death_and_an_error_of_the_program_are_noted_and_the_next_case_runs(tmp_path):
    def raises(place, result):
        raise KeyError("lost")

    found = outcomes(
        tmp_path,
        hangs=lambda place, result: time.sleep(30),
        dies=lambda place, result: os.kill(os.getpid(), signal.SIGKILL),
        leaves=lambda place, result: os._exit(3),
        raises=raises,
        works=lambda place, result: result.saw("fine"),
    )
    assert "a hang: longer than 0.8 s" in found["hangs"].forbidden[0]
    assert found["dies"].forbidden == ["the process died: SIGKILL"]
    assert found["leaves"].forbidden == ["the process died: exit 3"]
    assert found["raises"].forbidden[0].startswith("uncaught: KeyError at test_campaign.py")
    assert found["works"] == Result(outcomes={"fine": 1})


def test_a_case_draws_the_same_numbers_in_every_campaign(tmp_path):
    drawn = [
        outcomes(tmp_path, draws=lambda place, result: result.saw(str(place.rng.integers(1 << 60))))
        for _ in range(2)
    ]
    assert drawn[0] == drawn[1]


def test_an_orphan_is_named_and_ended():
    child = os.fork()
    if child == 0:
        os.setsid()
        time.sleep(30)
        os._exit(0)
    deadline = time.monotonic() + 30.0
    while os.getsid(child) != child and time.monotonic() < deadline:
        time.sleep(0.01)
    (named,) = orphans(child, patience_s=0.0)
    assert named.startswith(str(child))
    os.waitpid(child, 0)
    assert orphans(child, patience_s=0.0) == []


def test_the_small_campaign_has_its_size(tmp_path):
    small = {name: kind.small for name, kind in KINDS.items()}
    assert small["publish-kills"] >= 25
    assert small["tampering"] >= 60
    assert small["configuration"] * 30 >= 500
    assert (
        sum(
            small[name]
            for name in ("recordings", "scenes", "readers", "broken-files", "caches", "verdicts")
        )
        >= 50
    )
    assert small["stage-kills"] >= 3
    assert small["full-disks"] >= 1
    fields = [case.name for case in override_cases(tmp_path)]
    assert {"plan.queries_n", "carry.limits.tilt_max_rad", "scene"} <= {*fields}


def test_a_broken_file_that_is_read_is_noted(tmp_path):
    source = tmp_path / "smoke"
    place = tmp_path / "place"
    episode = data_samples.write(
        source / "teleop-record/episodes/e.hdf5",
        data_samples.arrays(12, cameras=("high",)),
    )
    place.mkdir()
    name = episode.relative_to(source).as_posix()
    for change, noted in (
        (lambda path, rng: path.write_text("broken"), []),
        (lambda path, rng: None, ["a silent pass"]),
    ):
        result = Result()
        broken("episode", name, change, Place(place, source, np.random.default_rng(1)), result)
        assert [text.split(":")[0] for text in result.forbidden] == noted
    assert inspect_episode(episode)[1] == []  # the source stays whole
