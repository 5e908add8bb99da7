"""Failures in words: what failed, then how far it was off."""

from __future__ import annotations

import pytest

from minidual.tasks.failures import FAILURES, FailureName, failure_words, of_limit
from minidual.tasks.movement import Settled
from minidual.tasks.success import Arrived, Level, OnTime, Released, Rose
from tests.support.trial_results import BAD, result


@pytest.mark.parametrize(
    ("counted", "words"),
    [
        ("rose", "object not lifted"),
        ("held (lift)", "grip lost (phase lift)"),
        ("arrived (active)", "object not at its goal"),
        ("too_loud (lift)", "too loud (phase lift)"),
        ("", "unnamed"),
    ],
)
def test_a_counted_failure_has_words(counted: str, words: str) -> None:
    assert failure_words(counted) == words


def test_a_phase_is_told_apart_from_the_condition() -> None:
    assert FailureName.parse("held (set down)") == ("held", "set down")
    assert FailureName.parse("held") == ("held", "")


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0 of 40 mm"), (34.9, "35 of 40 mm"), (39.7, "39.7 of 40 mm")],
)
def test_a_near_miss_is_never_rounded_to_its_limit(value: float, text: str) -> None:
    assert of_limit(value, 40.0, "mm") == text


class _Truth(dict):
    time = 6.12
    duration_s = 17.0


class _Item:
    tilt_rad = 0.2
    clearance_m = 0.002
    airborne = False
    in_fingers = True
    at_an_arm = True

    def distance_m(self, goal: tuple[float, float]) -> float:
        return 0.0321


@pytest.mark.parametrize(
    ("condition", "detail"),
    [
        (Rose("rod", 0.04), "object not lifted (0 of 40 mm)"),
        (Arrived("rod", (0.5, 0.0), 0.02), "object not at its goal (32.1 mm away, limit 20)"),
        (Released("rod"), "object not released (a finger still touches the rod)"),
        (OnTime(15.0), "too late (17.0 s, limit 15)"),
    ],
)
def test_a_final_violation_says_what_failed_before_its_numbers(condition, detail: str) -> None:
    said = condition.end(_Truth(rod=_Item()))
    assert said == detail
    assert said.startswith(FAILURES[condition.name])


def test_a_violation_on_the_way_says_what_failed_before_its_numbers() -> None:
    said = Level("rod", 0.08727).observe(_Truth(rod=_Item()))
    assert said == "object tilted too far (11.5 deg, limit 5.0)"
    assert said.startswith(FAILURES[Level.name])
    assert Settled.name in FAILURES


def test_a_trial_says_what_failed_and_when_without_the_conditions_name() -> None:
    failed = result(0, **BAD)
    assert failed.text == "dropped, at 3.00 s"
    assert result(0, **{**BAD, "reason": ""}).text == "grip lost, at 3.00 s"
