"""The arms stop before they touch anything, however fast they approach it: the supervisor looks where a stop would end."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.collision.shapes import Box
from minidual.config.control import SupervisorConfig
from minidual.control.supervisor import Supervisor
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA, Array, pose
from minidual.skills.supervised import SceneClearance, arm_distance, trial_supervisor
from tests.support.guarded_arms import GuardedArms, Reference
from tests.support.panda import DOF, HOME

BOTH = np.eye(DOF)[:7] - np.eye(DOF)[7:]
APART = HOME + 0.3 * BOTH[0]
HIGH = HOME - 0.5 * (np.eye(DOF)[1] + np.eye(DOF)[8])
ALONE = HOME + 1.5 * np.eye(DOF)[0] - 1.2 * np.eye(DOF)[7]
FOLDED = np.r_[1.5, -0.57, -1.59, -1.46, 2.53, 0.46, -0.49, ALONE[7:]]
"""The left hand is in its own forearm; the right arm is out of its way."""


def towards(start: Array, way: Array, speed: float) -> Reference:
    """Accelerate to `speed` of the fastest joint along a straight way, and go on."""
    way = way / np.abs(way).max()

    def at(t: float) -> tuple[Array, Array, Array]:
        s = min(t, speed / 7.0)
        gone = 3.5 * s * s + speed * (t - s)
        return start + gone * way, 7.0 * s * way, (7.0 * (t < speed / 7.0)) * way

    return at


def guarded(world: World, start: Array, clearance: SceneClearance | None) -> GuardedArms:
    world.reset(start)
    return GuardedArms(
        world,
        Supervisor(self_distance=arm_distance(DUAL_PANDA), clearance=clearance),
    )


def touches(arms: GuardedArms, seconds: float = 1.0) -> set[tuple[str, str]]:
    """Go on to rest; return the contacts of arms on the way."""
    found: set[tuple[str, str]] = set()
    for _ in range(round(seconds / 0.005)):
        arms.go_on(0.005)
        found |= {
            (a, b) for a, b, _ in arms.world.contact_pairs() if a.startswith(("left", "right"))
        }
    assert np.abs(arms.world.v).max() < 0.02
    return found


INWARDS = (APART, -BOTH[0], {"left_panda_hand", "right_panda_hand"})
DOWN = (HIGH, np.eye(DOF)[1] + np.eye(DOF)[8], {"table"})
FOLD = (ALONE, FOLDED - ALONE, {"left_panda_hand", "left_panda_link5"})


@pytest.mark.parametrize(
    ("start", "way", "parts", "speed"),
    [
        (*INWARDS, 0.3),
        (*INWARDS, 0.73),
        (*INWARDS, 2.0),
        (*DOWN, 0.73),
        (*DOWN, 2.0),
        (*FOLD, 0.73),
        (*FOLD, 2.0),
    ],
    ids=["arms-0.3", "arms-0.73", "arms-2", "table-0.73", "table-2", "own-0.73", "own-2"],
)
def test_the_arms_rest_before_they_touch(
    world: World,
    start: Array,
    way: Array,
    parts: set[str],
    speed: float,
) -> None:
    arms = guarded(world, start, SceneClearance(DUAL_PANDA))
    error = arms.run(7.0, towards(start, way, speed))
    assert error is not None
    assert error.reflex.label == "clearance.stop", error.reflex.text
    assert parts <= set(error.reflex.where.split(" with ")), error.reflex.text
    assert not touches(arms)


def test_without_the_look_ahead_they_touch(world: World) -> None:
    arms = guarded(world, APART, None)
    error = arms.run(2.0, towards(APART, -BOTH[0], 0.73))
    assert error is not None
    assert error.reflex.label == "clearance.arms"
    assert touches(arms, 0.6)


def test_the_predicted_posture_is_the_one_in_which_the_stop_ends(world: World) -> None:
    arms = guarded(world, ALONE, None)
    arms.run(0.4, towards(ALONE, FOLDED - ALONE, 1.5))
    predicted = arms.supervisor._stop.rest(world.q, world.v)
    arms.supervisor.estop()
    arms.run(0.001)
    arms.go_on(1.5)
    assert np.abs(predicted - ALONE).max() > 0.5
    assert np.abs(world.q - predicted).max() < 0.01


def test_a_held_object_is_kept_off_the_table_and_the_arms(world: World) -> None:
    clearance = SceneClearance(DUAL_PANDA, Box("bar", (0.0, 0.0, 0.0), size_m=(0.03, 0.03, 0.6)))
    hanging = pose(np.eye(3), (0.0, 0.0, 0.2))
    assert clearance(HIGH)[0] == "none"
    clearance.hold(0, hanging)
    lower = HIGH + 0.5 * np.eye(DOF)[1]
    pair, distance, bound = clearance(lower)
    assert pair == "bar in the left hand with table"
    assert distance < bound < 0.0
    clearance.hold(1, hanging)  # the right hand, too
    assert clearance(lower)[0] == "bar in the left hand with table"
    clearance.hold(None)
    clearance.hold(1, hanging)
    assert clearance(lower)[0] == "none"
    clearance.hold(None)
    assert clearance(lower)[0] == "none"


def test_a_fast_descent_with_an_object_stops_above_the_table(world: World) -> None:
    bar = Box("bar", (0.0, 0.0, 0.0), size_m=(0.03, 0.03, 0.6))
    down = towards(HIGH, np.eye(DOF)[1], 1.0)
    bare = guarded(world, HIGH, SceneClearance(DUAL_PANDA, bar)).run(4.0, down)
    held = guarded(world, HIGH, SceneClearance(DUAL_PANDA, bar))
    held.supervisor.hold(0, pose(np.eye(3), (0.0, 0.0, 0.2)))
    error = held.run(4.0, down)
    assert error is not None
    assert bare is not None
    assert error.reflex.where == "bar in the left hand with table"
    assert error.reflex.time_s < bare.reflex.time_s - 0.1
    held.go_on(1.0)
    lowest = Kinematics().tcp_poses(world.q)[0] @ np.array([0.0, 0.0, 0.5, 1.0])
    assert lowest[2] > -0.005

    held.supervisor.reset()
    world.reset(HIGH)
    assert held.supervisor._space_check.clearance(HIGH + 0.6 * np.eye(DOF)[1])[0] == "none", (
        "a reset forgets what was held"
    )


def test_a_clearance_that_fails_is_named_and_the_arms_stop(world: World) -> None:
    class Broken(SceneClearance):
        def __call__(self, q: Array) -> tuple[str, float, float]:
            raise ZeroDivisionError("no scene")

    error = guarded(world, HOME, Broken(DUAL_PANDA)).run(0.1)
    assert error is not None
    assert error.reflex.label == "controller_failed"
    assert "ZeroDivisionError: no scene" in error.message


def test_the_default_supervisor_of_a_trial_looks_ahead() -> None:
    supervisor = trial_supervisor(SupervisorConfig(), 1e-3, DUAL_PANDA)
    assert isinstance(supervisor._space_check.clearance, SceneClearance)
