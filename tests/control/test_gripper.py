"""Grippers ramp, remember, and close by force on whatever lies between the fingers."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

from minidual.control import gripper
from minidual.control.gripper import CLOSE_BELOW, OPEN_ABOVE, Grippers
from minidual.plant.world import World
from minidual.robot.pair import DUAL_PANDA

DT = 0.001
TRAVEL_M = DUAL_PANDA.hand.travel_m
KP_N_PER_M = 5000.0


class Hands:
    """Two hands without mass: a servo of 5000 N/m, and between the fingers something rigid of a half width each."""

    robot = DUAL_PANDA
    dt = DT
    grip_max_n = 70.0

    def __init__(
        self,
        left_m: float = 0.009,
        right_m: float = 0.009,
        motor_n: float = 70.0,
    ) -> None:
        self.half_m = np.array([left_m, right_m])
        self.motor_n = motor_n
        self.targets = np.full(2, TRAVEL_M)

    @property
    def fingers(self):
        return np.maximum(self.targets, self.half_m)

    @property
    def grip(self):
        return np.clip(KP_N_PER_M * (self.fingers - self.targets), -self.motor_n, self.motor_n)


def run(hands, grippers, command, steps=1000):
    targets = []
    for _ in range(steps):
        hands.targets = grippers.step(np.array(command), hands.fingers, hands.grip)
        targets.append(hands.targets.copy())
    return np.array(targets)


@pytest.fixture
def hands():
    return Hands()


@pytest.fixture
def grippers(hands):
    return Grippers(hands, pinch_force_n=50.0, speed_m_per_s=0.08)


@pytest.mark.parametrize(
    ("usual_n", "firm_n"),
    [(24.0, 31.2), (50.0, 65.0), (60.0, 66.5), (70.0, 70.0)],
)
def test_a_firmer_pinch_stays_within_what_the_motors_give_and_opens_in_time(hands, usual_n, firm_n):
    """Beyond the motors' limit the targets would run ahead of the fingers, and the hands open late."""
    grippers = Grippers(hands, pinch_force_n=usual_n)
    run(hands, grippers, [0.0, 0.0])
    np.testing.assert_allclose(hands.grip, usual_n, rtol=0.01)
    grippers.firmer()
    run(hands, grippers, [0.0, 0.0])
    np.testing.assert_allclose(hands.grip, firm_n, rtol=0.01)
    steps = 0
    while firm_n < hands.grip_max_n and hands.grip.max() > 0.0:
        run(hands, grippers, [1.0, 1.0], steps=1)
        steps += 1
    assert steps * DT < 0.17, "13 mm at 8 cm/s"


def test_a_hand_whose_object_slides_out_holds_nothing_though_its_fingers_press(hands, grippers):
    """Fingers that press on one another feel the whole force."""
    run(hands, grippers, [0.0, 0.0])
    assert [grippers.holds(hand, hands.fingers, hands.grip) for hand in (0, 1)] == [True, True]
    assert [grippers.lost(hand, hands.fingers) for hand in (0, 1)] == [False, False]
    hands.half_m[:] = 0.0
    run(hands, grippers, [0.0, 0.0])
    np.testing.assert_allclose(hands.grip, 50.0, rtol=0.01)
    assert [grippers.holds(hand, hands.fingers, hands.grip) for hand in (0, 1)] == [False, False]
    assert [grippers.lost(hand, hands.fingers) for hand in (0, 1)] == [True, True]
    run(hands, grippers, [1.0, 1.0])
    assert [grippers.lost(hand, hands.fingers) for hand in (0, 1)] == [False, False], (
        "an open hand has lost nothing"
    )


def test_a_reset_forgets_the_firmer_pinch(hands, grippers):
    grippers.firmer()
    grippers.reset(hands.fingers, hands.grip)
    run(hands, grippers, [0.0, 0.0])
    np.testing.assert_allclose(hands.grip, 50.0, rtol=0.01)


def test_fingers_move_as_fast_as_they_are_told(hands):
    grippers = Grippers(hands, pinch_force_n=50.0, speed_m_per_s=0.03)
    assert np.diff(run(hands, grippers, [0.0, 0.0], steps=300), axis=0).min() == pytest.approx(
        -0.03 * DT,
    )
    assert np.diff(run(hands, grippers, [1.0, 1.0], steps=50), axis=0).max() == pytest.approx(
        0.03 * DT,
    )


def test_targets_ramp_and_never_jump(hands, grippers):
    targets = np.vstack([run(hands, grippers, [0.0, 1.0]), run(hands, grippers, [1.0, 0.0])])
    assert np.abs(np.diff(targets, axis=0)).max() <= 0.08 * DT + 1e-12


@pytest.mark.parametrize("half_m", [0.0, 0.004, 0.025, 0.038])
def test_the_force_does_not_depend_on_the_width(half_m):
    hands = Hands(half_m, half_m)
    run(hands, Grippers(hands, pinch_force_n=50.0), [0.0, 0.0])
    assert hands.grip == pytest.approx([50.0, 50.0], abs=1e-3)
    assert hands.fingers == pytest.approx([half_m, half_m])


def test_it_knows_no_object_and_no_servo():
    source = inspect.getsource(gripper)
    assert "scene" not in source
    assert "kp" not in source


def test_the_pinch_is_limited_to_what_the_motors_give(hands):
    run(hands, Grippers(hands, pinch_force_n=500.0), [0.0, 0.0])
    assert hands.grip == pytest.approx([70.0, 70.0])


def test_a_motor_too_weak_does_not_wind_the_target_up():
    hands = Hands(motor_n=20.0)
    grippers = Grippers(hands, pinch_force_n=50.0)
    run(hands, grippers, [0.0, 0.0], 5000)
    assert (hands.targets >= hands.fingers - 0.5 * TRAVEL_M - 1e-12).all()
    run(hands, grippers, [1.0, 1.0], 700)
    assert hands.targets == pytest.approx([TRAVEL_M] * 2)


def test_hands_are_independent(hands, grippers):
    left, right = run(hands, grippers, [0.0, 1.0])[-1]
    assert left < 0.009
    assert right == TRAVEL_M


def test_an_object_that_leaves_is_followed_inwards(hands, grippers):
    run(hands, grippers, [0.0, 0.0])
    hands.half_m[:] = 0.005
    run(hands, grippers, [0.0, 0.0])
    assert hands.grip == pytest.approx([50.0, 50.0], abs=1e-3)


def opened(grippers) -> list[bool]:
    """Return what each hand was told last."""
    return (grippers._hands[0] == 1.0).tolist()


def test_a_wavering_command_does_not_flutter(hands, grippers):
    run(hands, grippers, [0.0, 0.0])
    middle = 0.5 * (CLOSE_BELOW + OPEN_ABOVE)
    for value in (middle, CLOSE_BELOW + 0.01, OPEN_ABOVE - 0.01, CLOSE_BELOW, OPEN_ABOVE):
        grippers.step(np.array([value, value]), hands.fingers, hands.grip)
        assert opened(grippers) == [False, False]
    grippers.step(np.array([OPEN_ABOVE + 0.01, middle]), hands.fingers, hands.grip)
    assert opened(grippers) == [True, False]
    grippers.step(np.array([middle, middle]), hands.fingers, hands.grip)
    assert opened(grippers) == [True, False]


def test_a_reset_opens_at_once(hands, grippers):
    run(hands, grippers, [0.0, 0.0])
    hands.targets = np.full(2, TRAVEL_M)  # the plant was reset
    grippers.reset(hands.fingers, hands.grip)
    assert grippers.targets_m.tolist() == [TRAVEL_M] * 2
    assert opened(grippers) == [True, True]


def test_hands_that_hold_something_at_the_start_go_on_holding_it(hands, grippers):
    run(hands, grippers, [0.0, 0.0])
    again = Grippers(hands, pinch_force_n=50.0)
    least_n = np.inf
    assert again.closed.tolist() == [True, True]
    for _ in range(500):
        hands.targets = again.step(np.zeros(2), hands.fingers, hands.grip)
        least_n = min(least_n, hands.grip.min())
    assert least_n > 45.0
    np.testing.assert_allclose(hands.grip, 50.0, rtol=0.01)
    run(hands, again, [1.0, 1.0])
    assert opened(again) == [True, True]


def test_fingers_that_meet_nothing_press_on_each_other_without_a_slam(scene, compiled_model):
    """In the simulator, motors and inertia included; the force never passes what was asked for by much."""
    world = World(scene, model=compiled_model)
    grippers = Grippers(world, pinch_force_n=40.0)
    forces = []
    for _ in range(1500):
        world.command(np.zeros(14), grippers.step(np.zeros(2), world.fingers, world.grip))
        world.step()
        forces.append(world.grip)
    assert np.array(forces)[-200:] == pytest.approx(40.0, abs=1.0)
    assert np.max(forces) < 48.0


@pytest.mark.parametrize(
    ("grip_n", "moved_m", "lost"),
    [(20.0, 0.0, True), (20.0, -0.002, False), (30.0, 0.0, False)],
)
def test_a_grip_is_lost_when_its_force_falls_and_the_object_is_still_there(
    hands,
    grippers,
    monkeypatch,
    grip_n,
    moved_m,
    lost,
):
    run(hands, grippers, [0.0, 0.0])
    assert grippers.fault == ""
    fingers = hands.fingers
    monkeypatch.setattr(Hands, "grip", np.array([grip_n, 50.0]))
    monkeypatch.setattr(Hands, "fingers", fingers + np.array([moved_m, 0.0]))
    grippers.step(np.zeros(2), hands.fingers, hands.grip)
    assert grippers.fault == "", "one reading"
    run(hands, grippers, [0.0, 0.0], 5)
    assert grippers.fault.startswith("the left hand: 20 of 50 N") == lost
    grippers.forget_grip()
    run(hands, grippers, [0.0, 0.0], 10)
    assert grippers.fault == ""


def test_single_bad_readings_with_good_ones_between_do_not_add_up(hands, grippers, monkeypatch):
    run(hands, grippers, [0.0, 0.0])
    for _ in range(20):
        for grip_n in (5.0, 50.0, 50.0):
            monkeypatch.setattr(Hands, "grip", np.array([grip_n, 50.0]))
            grippers.step(np.zeros(2), hands.fingers, hands.grip)
    assert grippers.fault == ""


def test_a_hand_holds_what_it_has_closed_on_and_feels(hands, grippers):
    hands.half_m[:] = 0.009, 0.0
    assert [grippers.holds(hand, hands.fingers, hands.grip) for hand in (0, 1)] == [False, False]
    run(hands, grippers, [0.0, 0.0])
    assert hands.grip == pytest.approx([50.0, 50.0], abs=1.0), (
        "nothing between the fingers presses back as well"
    )
    assert [grippers.holds(hand, hands.fingers, hands.grip) for hand in (0, 1)] == [True, False]
    hands.motor_n = 10.0
    assert not grippers.holds(0, hands.fingers, hands.grip)
    run(hands, grippers, [1.0, 0.0])
    hands.motor_n = 70.0
    assert not grippers.holds(0, hands.fingers, hands.grip)


@pytest.mark.parametrize("wrong_m", [0.03, 0.04, 1.0])
def test_one_wrong_reading_of_the_fingers_opens_no_hand(hands, grippers, wrong_m):
    run(hands, grippers, [0.0, 0.0])
    held_m = grippers.targets_m.copy()
    targets_m = grippers.step(np.zeros(2), np.array([wrong_m, 0.009]), hands.grip)
    assert np.abs(targets_m - held_m).max() < 1e-4
    assert np.abs(run(hands, grippers, [0.0, 0.0], 20)[-1] - held_m).max() < 1e-4
    assert grippers.fault == ""


def test_a_pinch_at_50_hz_settles_although_the_grip_is_a_period_old():
    hands = Hands(0.0125, 0.0125)
    hands.dt = 0.02
    grippers = Grippers(hands)
    felt_n = [np.full(2, 40.0)] * 2
    for _ in range(200):
        targets_m = grippers.step(np.zeros(2), hands.fingers, felt_n[-2])
        felt_n.append(np.clip(KP_N_PER_M * (0.0125 - targets_m), 0.0, 70.0))
        hands.targets = targets_m
    assert np.abs(np.array(felt_n[-50:]) - 60.0).max() < 0.1


@pytest.mark.parametrize("wrong_m", [0.0, 0.04])
def test_a_stop_leaves_closing_fingers_near_their_target(hands, grippers, wrong_m):
    """The reading at the moment of the stop may be wrong."""
    run(hands, grippers, [0.0, 0.0], 200)
    target_m = grippers.targets_m.copy()
    assert (target_m > 0.01).all()
    openings = grippers.stop(np.full(2, wrong_m), np.zeros(2))
    assert np.isnan(openings).all()
    targets_m = grippers.step(openings, hands.fingers, hands.grip)
    assert np.abs(targets_m - target_m).max() < 0.0051


@pytest.mark.parametrize("rate_hz", [1000, 100])
def test_one_sample_without_grip_loses_nothing_at_any_rate(rate_hz):
    hands = Hands()
    hands.dt = 1.0 / rate_hz
    grippers = Grippers(hands)
    run(hands, grippers, [0.0, 0.0])
    slipped_n = np.array([0.0, 60.0])
    grippers.step(np.zeros(2), hands.fingers, slipped_n)
    assert grippers.fault == ""
    run(hands, grippers, [0.0, 0.0], 20)
    for _ in range(6):
        grippers.step(np.zeros(2), hands.fingers, slipped_n)
    assert grippers.fault.startswith("the left hand: 0 of 60 N")
