"""Relative pose of two held parts: increments and their bounds, what is sensed, and what is left out."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.control.hand_impedance import HandImpedance, InHand
from minidual.environments.actions import arms_of
from minidual.environments.mating import (
    MATING_TERMS,
    MatingReadings,
    MatingSensed,
    MatingSenses,
    Parts,
    RelativePose,
    mating_columns,
    mating_size,
    mating_terms,
    observe_mating,
)
from minidual.errors import UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array, inverse, pose, rot_z
from minidual.skills.askew import HeldPart, Meeting

HOME = DUAL_PANDA.home
NOTHING = np.zeros(14)
TIP = (0.0, 0.1, 0.0)
MOUTH = (0.0, -0.085, 0.0)
PARTS = Parts(arms_of(DUAL_PANDA).frames, TIP, MOUTH, (0.022, 0.0443))
TIPS = Kinematics().tcp_poses(HOME)


def held_at(place: Array) -> InHand:
    """Return the peg in the right hand so that at home it is at `place` (4, 4) in the socket."""
    T = inverse(TIPS[1]) @ TIPS[0] @ SOCKET.T_tcp_object @ place
    return InHand("peg", T, T, TIP)


SOCKET = InHand("socket", np.eye(4), np.eye(4))
TOUCHING = pose(np.eye(3), tuple(np.array(MOUTH) - TIP))


def senses(own: HeldPart, other: HeldPart | None = None) -> MatingSenses:
    law = HandImpedance(Kinematics(), 1, 0.001)
    socket = HeldPart(SOCKET, 0.0) if other is None else other
    return MatingSenses(PARTS, Meeting(law, own, socket, 1, 0.0))


def readings(q: Array = HOME, time_s: float = 0.0, torque: Array = NOTHING) -> MatingReadings:
    return MatingReadings(q, HOME, np.array([0.0451, 0.0230]), torque, time_s)


def read(own: HeldPart, actions: RelativePose | None = None) -> MatingSensed:
    return senses(own).read(readings(), RelativePose() if actions is None else actions)


def test_increments_are_bounded_and_move_smoothly() -> None:
    actions = RelativePose()
    actions.begin([2.0, -2.0, 0.5, 0.0, -1.0])
    assert actions.action.tolist() == [1.0, -1.0, 0.5, 0.0, -1.0]
    assert actions.value == pytest.approx([0.001, -0.0025, 0.0005, 0.0, -0.012])
    assert actions.at(0.5) == pytest.approx(0.5 * actions.value)
    for _ in range(100):
        actions.begin([1.0, -1.0, 1.0, 1.0, -1.0])
    assert actions.value == pytest.approx([0.006, -0.060, 0.006, 0.10, -0.10])


def test_zeros_move_nothing() -> None:
    actions = RelativePose()
    actions.begin(np.zeros(5))
    assert actions.at(0.3).tolist() == [0.0] * 5


def test_the_relative_pose_is_that_of_encoders_and_grasps() -> None:
    place = TOUCHING @ pose(rot_z(0.02), (0.0, 0.0, 0.0))
    shifted = pose(np.eye(3), (0.002, -0.010, 0.001)) @ place
    sensed = read(HeldPart(held_at(shifted), 0.0))
    tip = shifted[:3, :3] @ TIP + shifted[:3, 3] - MOUTH
    assert sensed.relative == pytest.approx([*tip, 0.02, 0.0], abs=1e-9)
    assert sensed.error == pytest.approx(np.zeros(5), abs=1e-9)


def test_the_error_is_how_far_the_part_is_behind_its_shifted_reference() -> None:
    held = held_at(TOUCHING)
    q = HOME + np.r_[np.zeros(7), 0.01 * np.ones(7)]
    actions = RelativePose()
    actions.begin([1.0, -1.0, 0.0, 0.0, 0.0])
    sensed = senses(HeldPart(held, 0.0)).read(readings(q), actions)
    relative = senses(HeldPart(held, 0.0)).planned(q)
    assert sensed.relative == pytest.approx(relative, abs=1e-9)
    expected = np.array([0.001, -0.0025, 0.0, 0.0, 0.0]) - relative
    assert sensed.error == pytest.approx(expected, abs=1e-9)


def test_a_part_that_stands_askew_has_its_tip_beside() -> None:
    actions = RelativePose()
    actions.begin([0.0, 0.0, 0.0, 1.0, 0.0])
    held = held_at(TOUCHING)
    own, _ = senses(HeldPart(held, 0.0)).held(actions.value)
    turn = inverse(held.T_tcp_object) @ own.T_tcp_object
    assert np.arccos((np.trace(turn[:3, :3]) - 1.0) / 2.0) == pytest.approx(0.012)
    aligned = read(HeldPart(held, 0.0))
    askew = read(HeldPart(held, 0.0), actions)
    assert abs(askew.relative[3] - aligned.relative[3]) == pytest.approx(0.012, abs=1e-6)


def test_gaps_turns_depth_and_time_are_sensed() -> None:
    own = HeldPart(held_at(TOUCHING), 0.03, 0.02)
    other = HeldPart(SOCKET, -0.01, -0.005)
    sense = senses(own, other)
    first = sense.read(readings(), RelativePose())
    assert first.gap_excess_m == pytest.approx([0.0006, 0.0004])
    assert first.seen_rad.tolist() == [0.02, -0.005]
    assert first.guess_rad.tolist() == [0.03, -0.01]
    assert (first.advance_m, first.time_s) == (0.0, 0.0)
    later = sense.read(readings(HOME + 0.001, time_s=0.1), RelativePose())
    assert later.time_s == pytest.approx(0.1)
    assert later.advance_m == pytest.approx(float(later.relative[1] - first.relative[1]))
    assert later.deepest_m == max(first.relative[1], later.relative[1])


def test_terms_have_their_sizes_and_are_clipped() -> None:
    names = mating_terms()
    sensed = read(HeldPart(held_at(TOUCHING), 0.0))
    observation = observe_mating(names, sensed._replace(gap_excess_m=np.array([1.0, -1.0])))
    assert observation.shape == (mating_size(names),) == (41,)
    assert observation.dtype == np.float32
    columns = mating_columns(names)
    assert observation[columns["gaps"]].tolist() == [5.0, -5.0]
    for name in names:
        assert observe_mating([name], sensed).shape == (MATING_TERMS[name].size,)


def test_without_force_an_observation_does_not_depend_on_torques() -> None:
    own = HeldPart(held_at(TOUCHING), 0.0)
    pushed = senses(own).read(readings(torque=5.0 * np.ones(14)), RelativePose())
    free = senses(own).read(readings(), RelativePose())
    assert np.abs(pushed.wrench).max() > 5.0
    assert not np.any(free.wrench)
    blind = mating_terms(senses_force=False)
    assert observe_mating(blind, pushed).tolist() == observe_mating(blind, free).tolist()
    both = mating_terms()
    assert observe_mating(both, pushed).tolist() != observe_mating(both, free).tolist()
    assert set(both) - set(blind) == {"wrenches"}


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ((), "at least one"),
        (("gaps", "gaps"), "different terms"),
        (("gap",), "there are askew_guess"),
    ],
)
def test_other_terms_are_refused(names: tuple[str, ...], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        mating_size(names)
