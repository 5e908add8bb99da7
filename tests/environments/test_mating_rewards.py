"""Each term of the mating's reward pays for what it is named after, and what both hands do needs both."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from minidual.environments import mating_rewards as rewards
from minidual.environments.mating_rewards import MATED_TOGETHER, MATING_REWARD, MatingState
from minidual.environments.rewards import Reward


def state(**changes: Any) -> MatingState:
    """Return one world: both parts held in the air, the tip 10 mm before the mouth, on the axis."""
    values: dict[str, Any] = {
        "beside_m": np.zeros(1),
        "before_m": np.array([0.010]),
        "depth_m": np.zeros(1),
        "needed_m": 0.03,
        "pinch_n": np.full((1, 2), 60.0),
        "aloft": np.ones(1, dtype=bool),
        "force_n": np.zeros(1),
        "violated": np.zeros(1, dtype=bool),
        "succeeded": np.zeros(1, dtype=bool),
    }
    return MatingState(**{**values, **changes})


def value(term: Any, **changes: Any) -> float:
    return float(term(state(**changes))[0])


def paid(before: MatingState, after: MatingState) -> dict[str, float]:
    reward: Reward[MatingState] = Reward(MATING_REWARD, 1)
    reward.restart(before, np.ones(1, dtype=bool))
    return {name: float(row[0]) for name, row in reward.pay(after).items()}


def test_near_counts_what_is_beside_the_axis_until_the_tip_is_inside() -> None:
    assert value(rewards.near) == pytest.approx(1.0)
    assert value(rewards.near, beside_m=np.array([0.004])) < 0.3
    inside = {"beside_m": np.array([0.004]), "depth_m": np.array([0.005])}
    assert value(rewards.near, **inside) == pytest.approx(1.0)


def test_depth_is_paid_as_a_gain_and_taken_back() -> None:
    deep = state(depth_m=np.array([0.02]))
    gained = paid(state(), deep)["depth"]
    assert gained == pytest.approx(4.0 * 0.02 / 0.033)
    assert paid(deep, state())["depth"] == pytest.approx(-gained)
    assert value(rewards.depth, depth_m=np.array([0.05])) == 1.0


@pytest.mark.parametrize("missing", ["left", "right", "table"])
def test_one_hand_alone_earns_nothing_for_what_both_do(missing: str) -> None:
    pinch = np.full((1, 2), 60.0)
    aloft = np.ones(1, dtype=bool)
    if missing == "table":
        aloft[0] = False
    else:
        pinch[0, ("left", "right").index(missing)] = 0.0
    alone = {"pinch_n": pinch, "aloft": aloft}
    deep = state(depth_m=np.array([0.033]), **alone)
    earned = paid(state(beside_m=np.array([0.02]), **alone), deep)
    assert [earned[name] for name in MATED_TOGETHER] == [0.0, 0.0, 0.0]
    both = paid(state(beside_m=np.array([0.02])), state(depth_m=np.array([0.033])))
    assert both["near"] > 1.0
    assert both["depth"] > 3.0


def test_force_is_paid_for_above_15_newtons() -> None:
    assert value(rewards.force, force_n=np.array([15.0])) == 0.0
    assert value(rewards.force, force_n=np.array([25.0])) == pytest.approx(1.0)
    assert value(rewards.force, force_n=np.array([500.0])) == 2.0


def test_events_pay_once() -> None:
    over = state(succeeded=np.ones(1, dtype=bool))
    stopped = state(violated=np.ones(1, dtype=bool))
    assert paid(state(), over)["success"] == 3.0
    assert paid(state(), stopped)["violation"] == -2.0
    assert paid(state(), state())["time"] == -0.01
