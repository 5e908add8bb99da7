"""A criterion makes a check of a value and its limit, or reports the value."""

import pytest

from minidual.gate.criterion import Criterion

SPEED = Criterion(
    "speed_max",
    "<",
    unit="m/s",
    why="{who} would fall",
    remedy="slow {who} down",
)


def test_a_check_fills_in_the_words_and_compares() -> None:
    check = SPEED.check(2.0, 1.5, prefix="left.", who="the rod")
    assert check.sentence() == "left.speed_max is 2 m/s, limit < 1.5 m/s"
    assert (check.why, check.remedy) == ("the rod would fall", "slow the rod down")
    assert check.passed is False
    assert SPEED.check(1.0, 1.5, who="the rod").passed is True


def test_a_value_without_a_limit_is_only_reported() -> None:
    for check in (SPEED.report(2.0, who="the rod"), SPEED.check(2.0, None, who="the rod")):
        assert (check.op, check.limit, check.passed) == (None, None, None)


def test_a_word_that_is_not_given_and_a_limit_without_a_comparison_are_errors() -> None:
    with pytest.raises(KeyError, match="who"):
        SPEED.check(2.0, 1.5)
    with pytest.raises(ValueError, match="without an operator"):
        Criterion("speed", why="reported").check(2.0, 1.5)
