"""Pictures, chunks and actions of a policy are checked before anything is clamped."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.policies.plausible import SWING_RAD, TURNS_MAX, Plausible, PolicyStoppedError
from tests.support.panda import HOME, Q_LOWER, Q_UPPER

AWAY = np.eye(14)[0]


def _open(q: np.ndarray) -> np.ndarray:
    return np.r_[q, 1.0, 1.0]


def test_slow_swings_are_noticed_too_and_a_task_is_not() -> None:
    check = Plausible(np.r_[Q_LOWER, 0.0, 0.0], np.r_[Q_UPPER, 1.0, 1.0])

    def swing() -> None:
        for tick in range(2000):  # one turn in 20 ticks
            check.action(_open(HOME + 0.6 * SWING_RAD * (1.0 if tick % 40 < 20 else -1.0) * AWAY))

    with pytest.raises(
        PolicyStoppedError,
        match=rf"joint 1 of 14 \[rad\] turned back 9 times .* bound {TURNS_MAX}",
    ):
        swing()
    check.reset()
    for tick in range(2000):  # there and back four times in 20 s
        check.action(_open(HOME + 0.5 * np.sin(2.0 * np.pi * tick / 500) * AWAY))
    for tick in range(2000):  # noise within the swing
        check.action(_open(HOME + 0.4 * SWING_RAD * (1.0 if tick % 2 else -1.0) * AWAY))
    for tick in range(2000):  # hands that open and close twice in 4 s, and tremble by 0.1
        check.action(np.r_[HOME, tick % 100 < 50, 1.0 - 0.1 * (tick % 2)])


def test_arms_that_stand_may_see_the_same_picture() -> None:
    check = Plausible(np.full(16, -np.inf), np.full(16, np.inf))
    image = {"high": np.zeros((4, 4, 3), np.uint8)}
    for _ in range(100):
        check.pictures(image, HOME)
    with pytest.raises(PolicyStoppedError, match="frozen_picture"):
        check.pictures(image, HOME + 0.11)
