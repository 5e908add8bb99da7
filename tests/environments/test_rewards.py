"""Each term of the reward pays for what it is named after, and what both hands do needs both."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.environments import rewards
from minidual.environments.actions import downward_poses
from minidual.environments.rewards import LIFT_REWARD, TOGETHER, LiftState, Reward, RewardTerm
from minidual.robot.pair import SIDES
from minidual.tasks.catalogue import make_task

TASK = make_task(Config(task="pot_lift"))
POT = TASK.objects["pot"]
GRASPS = np.stack([POT.grasps[side] for side in SIDES])
REST_M = POT.body.rest_height_m
HELD = {"pinch_n": np.full((1, 2), 60.0)}
UP = {**HELD, "lifted_m": np.array([0.11])}
GOAL = np.array([[0.48, -0.15, 0.0]])


def state(**changes) -> LiftState:
    """Return one world: the pot at its start, open hands 10 cm over its grasps."""
    xyz = changes.pop("xyz", np.array([[0.48, 0.12, REST_M]]))
    above_m = changes.pop("above_m", 0.10)
    apart_m = changes.pop("apart_m", np.zeros(2))
    hands = np.zeros((1, 2, 4))
    for hand, T_grasp in enumerate(GRASPS):
        hands[0, hand, :3] = xyz[0] + T_grasp[:3, 3] + [apart_m[hand], 0.0, above_m]
        hands[0, hand, 3] = np.pi / 2.0
    values = {
        "hands": downward_poses(hands),
        "opening": np.ones((1, 2)),
        "grasps": GRASPS,
        "xyz": xyz,
        "yaw": np.zeros(1),
        "tilt": np.zeros(1),
        "clearance": xyz[:, 2] - REST_M,
        "rest_m": REST_M,
        "pinch_n": np.zeros((1, 2)),
        "lifted_m": np.zeros(1),
        "goal": GOAL,
        "rise_m": 0.1,
        "tilt_max": 0.087,
        "symmetry": 2,
        "strain": np.zeros(1),
        "violated": np.zeros(1, dtype=bool),
        "succeeded": np.zeros(1, dtype=bool),
    }
    return LiftState(**{**values, **changes})


def value(term, **changes) -> float:
    return float(term(state(**changes))[0])


def test_reach_counts_mostly_the_hand_that_is_further():
    there = value(rewards.reach, above_m=0.0)
    assert there == pytest.approx(1.0)
    one_off = value(rewards.reach, above_m=0.0, apart_m=np.array([0.2, 0.0]))
    both_off = value(rewards.reach, above_m=0.0, apart_m=np.array([0.2, 0.2]))
    assert both_off < one_off < 0.5 * (there + both_off)


def test_reach_leads_over_the_grasp_before_it_leads_down():
    beside = np.array([0.1, 0.1])
    high = value(rewards.reach, above_m=0.08, apart_m=beside)
    low = value(rewards.reach, above_m=0.0, apart_m=beside)
    assert high > low


def test_reach_is_kept_where_the_pot_was_lifted():
    assert value(rewards.reach, above_m=0.3, **UP) == 1.0


def test_one_pinch_pays_half_and_both_pinches_pay_together():
    one = np.array([[60.0, 0.0]])
    assert value(rewards.grasp_each, pinch_n=one) == 0.5
    assert value(rewards.grasp_both, pinch_n=one) == 0.0
    assert value(rewards.grasp_both, **HELD) == 1.0


def test_grasps_are_kept_over_the_goal_so_that_letting_go_costs_nothing():
    over = np.array([[0.48, -0.15, REST_M]])
    lifted = np.array([0.11])
    assert value(rewards.grasp_both, xyz=over, lifted_m=lifted) == 1.0
    assert value(rewards.grasp_each, xyz=over, lifted_m=lifted) == 1.0
    assert value(rewards.grasp_both, lifted_m=lifted) == 0.0


def test_lift_pays_what_both_hands_have_lifted():
    assert value(rewards.lift) == 0.0
    assert value(rewards.lift, clearance=np.array([0.2])) == 0.0
    assert value(rewards.lift, lifted_m=np.array([0.0525])) == pytest.approx(0.5)
    assert value(rewards.lift, lifted_m=np.array([0.2])) == 1.0


def test_along_pays_the_lifted_pot_alone():
    near = np.array([[0.48, -0.10, REST_M + 0.1]])
    assert value(rewards.along, xyz=near) == 0.0
    assert value(rewards.along, xyz=near, **UP) > value(rewards.along, **UP) > 0.0


def test_lower_and_release_pay_over_the_goal():
    high = np.array([[0.48, -0.15, REST_M + 0.12]])
    down = np.array([[0.48, -0.15, REST_M]])
    assert value(rewards.lower, xyz=high, **UP) == pytest.approx(0.0, abs=1e-9)
    assert value(rewards.lower, xyz=down, **UP) == 1.0
    assert value(rewards.lower, xyz=down) == 0.0
    assert value(rewards.release, xyz=down, **UP) == 1.0
    assert value(rewards.release, xyz=down, opening=np.zeros((1, 2)), **UP) == 0.5
    assert value(rewards.release, xyz=high, **UP) == 0.0


def test_level_is_the_share_of_the_limit():
    assert value(rewards.level, tilt=np.array([0.0435])) == pytest.approx(0.5)


def test_contact_pays_strain_beyond_seven_tenths():
    assert value(rewards.contact, strain=np.array([0.7])) == 0.0
    assert value(rewards.contact, strain=np.array([0.9])) == pytest.approx(0.2)
    assert value(rewards.contact, strain=np.array([np.inf])) == 2.0


def test_time_violation_and_success():
    assert value(rewards.time) == 1.0
    assert value(rewards.violation) == value(rewards.success) == 0.0
    assert value(rewards.violation, violated=np.ones(1, dtype=bool)) == 1.0
    assert value(rewards.success, succeeded=np.ones(1, dtype=bool)) == 1.0


def test_a_gain_is_paid_back_and_an_event_is_paid_once():
    reward = Reward(LIFT_REWARD, 1)
    start = state()
    reward.restart(start, np.ones(1, dtype=bool))
    grasped = state(above_m=0.0, **HELD)
    there = reward.pay(grasped)
    back = reward.pay(start)
    for term in LIFT_REWARD:
        if term.kind == "gain":
            assert there[term.name] + back[term.name] == pytest.approx(0.0)
    failed = state(violated=np.ones(1, dtype=bool))
    assert reward.pay(failed)["violation"] == pytest.approx(-0.5)
    assert reward.pay(failed)["violation"] == 0.0


def test_a_discount_scales_the_new_potential():
    term = RewardTerm("lift", 1.0, "gain", rewards.lift)
    reward = Reward((term,), 1, discount=0.9)
    reward.restart(state(lifted_m=np.array([0.0525])), np.ones(1, dtype=bool))
    paid = reward.pay(state(lifted_m=np.array([0.0525])))
    assert paid["lift"] == pytest.approx(-0.05)


def test_worlds_that_diverge_pay_a_number():
    reward = Reward(LIFT_REWARD, 1)
    reward.restart(state(), np.ones(1, dtype=bool))
    paid = reward.pay(state(xyz=np.full((1, 3), np.nan)))
    assert all(np.isfinite(values).all() for values in paid.values())


def test_terms_of_both_hands_pay_nothing_to_one_hand():
    """The left hand alone: it pinches, and has lifted and carried what it can."""
    rows = {term.name: term for term in LIFT_REWARD}
    one = state(
        xyz=np.array([[0.48, -0.15, REST_M + 0.11]]),
        pinch_n=np.array([[60.0, 0.0]]),
        clearance=np.array([0.11]),
    )
    for name in TOGETHER:
        assert rows[name].value(one)[0] == 0.0
