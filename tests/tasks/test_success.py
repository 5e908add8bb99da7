"""The judge says yes to a clean cycle and no, with the right reason, to each way of missing it."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot.pair import pose, rot_x, rot_z
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Judge
from minidual.tasks.movement import BroughtBy, Carried, Exchanged, Settled, Slow
from minidual.tasks.success import Held, Turned
from minidual.tasks.truth import ObjectTruth
from tests.support.carry_trials import carry_task, rod_judge, rod_trial

RADIUS = 0.00887
START = (0.5, 0.25)
GOAL = (0.5, -0.25)
TRIAL = rod_trial("test", 0, (*START, 0.0), (*GOAL, 0.0))
DT = 0.01


@dataclass
class Instant:
    """What the judge may ask of a world, at one instant."""

    time: float = 0.0
    xy: tuple[float, float] = START
    height: float = 0.0
    tilt: float = 0.0
    yaw: float = 0.0
    pinches: tuple[float, float] = (0.0, 0.0)
    squeeze: float = 0.0
    speed: float = 0.0
    rests: bool | None = None
    touch: tuple[float, float] | None = None
    palm: bool = False

    def at_an_arm(self, name=None):
        return self.palm

    def truth(self, name=None):
        return self

    def pose(self):
        return pose(rot_z(self.yaw) @ rot_x(self.tilt), (*self.xy, RADIUS + self.height))

    def twist(self):
        return np.array([self.speed, 0.0, 0.0, 0.0, 0.0, 0.0])

    def solids(self, parts):
        return [(part.position_m, part.half_m) for part in parts]

    def look(self):
        T = self.pose()
        (left, right) = self.pinches if self.touch is None else self.touch
        return np.r_[
            T[:3, 3],
            T[2, :3],
            0.0,
            0.0,
            left,
            0.0,
            0.0,
            right,
            self.pinches,
            self.squeeze,
            self.yaw,
        ]

    def on_table(self, name=None):
        return self.height < 1e-3 if self.rests is None else self.rests


def cycle(**held: object) -> list[Instant]:
    """A clean cycle: grasp 1 s, lift to 10 cm, carry 50 cm, lower, release, rest.

    `held` overrides values while the object is in the air.
    """
    grip = {"pinches": (60.0, 60.0), "squeeze": 40.0}
    instants = [Instant() for _ in range(50)]
    instants += [Instant(**grip) for _ in range(50)]
    instants += [Instant(height=0.1 * k / 100, speed=0.1, **grip) for k in range(1, 101)]
    y = np.linspace(START[1], GOAL[1], 200)
    instants += [Instant(xy=(0.5, float(v)), height=0.1, speed=0.25, **grip) for v in y]
    instants += [
        Instant(xy=GOAL, height=0.1 * (1 - k / 100), speed=0.1, **grip) for k in range(1, 101)
    ]
    instants += [Instant(xy=GOAL, **grip) for _ in range(20)]
    instants += [Instant(xy=GOAL) for _ in range(30)]
    for k, instant in enumerate(instants):
        instant.time = k * DT
        if instant.height > 0.003:
            instants[k] = replace(instant, **held)
    return instants


def judge(instants: list[Instant], scene, **options: object):
    referee = rod_judge(scene, TRIAL, **options)
    for instant in instants:
        referee.observe(instant)
    return referee, referee.outcome(instants[-1])


def faults(outcome) -> set[str]:
    return {fault.name for fault in outcome.failures}


def test_a_clean_cycle_succeeds(scene):
    referee, outcome = judge(cycle(), scene, demand_internal_force=True)
    assert outcome.success
    assert referee.finished
    assert outcome.failures == ()
    assert outcome.reason == ""
    assert outcome.number("goal_error_m") == pytest.approx(0.0, abs=1e-12)
    assert outcome.number("rise_m") == pytest.approx(0.1)
    assert (outcome.number("pinch_min_n"), outcome.number("internal_force_min_n")) == (60.0, 40.0)
    assert outcome.duration_s < cycle()[-1].time


def test_a_rod_pushed_along_the_table_did_not_rise(scene):
    pushed = [replace(i, height=0.0) for i in cycle()]
    referee, outcome = judge(pushed, scene)
    assert not outcome.success
    assert not referee.finished
    assert faults(outcome) == {"carried", "rose"}


def test_one_that_rises_too_little_did_not_rise(scene):
    low = [replace(i, height=0.3 * i.height) for i in cycle()]
    _, outcome = judge(low, scene)
    assert faults(outcome) == {"rose"}
    assert outcome.number("rise_m") == pytest.approx(0.03)


@pytest.mark.parametrize(
    ("pinch", "hand"),
    [((60.0, 0.0), "right"), ((0.0, 60.0), "left"), ((20.0, 60.0), "left")],
)
def test_one_hand_alone_does_not_hold(scene, pinch, hand):
    _, outcome = judge(cycle(pinches=pinch), scene)
    assert faults(outcome) == {"held"}
    assert hand in outcome.reason


def test_a_grip_lost_for_an_instant_in_the_air_counts(scene):
    instants = cycle()
    instants[300] = replace(instants[300], pinches=(60.0, 3.0))
    _, outcome = judge(instants, scene)
    assert faults(outcome) == {"held"}
    assert outcome.failures[0].at_s == pytest.approx(3.0)


@pytest.mark.parametrize("height", [0.004, 0.01, 0.02])
def test_a_grip_lost_low_over_the_table_counts(scene, height):
    low = [
        replace(i, height=min(i.height, height), pinches=(60.0, 3.0)) if k == 260 else i
        for k, i in enumerate(cycle())
    ]
    assert "held" in faults(judge(low, scene)[1])


def test_tilt_over_five_degrees_is_refused_and_just_under_is_not(scene):
    limit = np.radians(5.0)
    assert judge(cycle(tilt=0.98 * limit), scene)[1].success
    _, outcome = judge(cycle(tilt=1.02 * limit), scene)
    assert faults(outcome) == {"level"}
    assert outcome.number("tilt_max_rad") == pytest.approx(1.02 * limit)


def test_one_end_lifted_with_the_other_on_the_table_does_not_count_as_lifted(scene):
    levered = [
        replace(i, height=0.15 * np.sin(0.3), tilt=0.3) if i.height > 0.05 else i for i in cycle()
    ]
    levered = [i if i.tilt else replace(i, height=0.0) for i in levered]
    _, outcome = judge(levered, scene)
    assert {"level", "rose"} <= faults(outcome)


@pytest.mark.parametrize(
    ("off_m", "missed"),
    [(0.019, set()), (0.021, {"arrived"}), (0.03, {"arrived"})],
)
def test_two_centimetres_beside_the_goal_is_not_there(scene, off_m, missed):
    away = [replace(i, xy=(i.xy[0] + off_m, i.xy[1])) for i in cycle()]
    _, outcome = judge(away, scene)
    assert faults(outcome) == missed
    assert outcome.number("goal_error_m") == pytest.approx(off_m)


def test_a_trial_is_finished_after_a_tenth_of_a_second_of_rest_and_no_earlier(scene):
    instants = cycle()
    let_go = instants[520].time
    for k, finished in ((525, False), (529, False), (531, True)):
        referee, outcome = judge(instants[: k + 1], scene)
        assert (referee.finished, outcome.success) == (finished, finished)
    assert outcome.duration_s == pytest.approx(let_go + 0.1, abs=1.1 * DT)


def test_a_rod_still_held_is_not_released(scene):
    held = [replace(i, pinches=(60.0, 60.0)) if k > 500 else i for k, i in enumerate(cycle())]
    referee, outcome = judge(held, scene)
    assert faults(outcome) == {"released"}
    assert not referee.finished


def test_a_finger_leaning_on_the_rod_is_not_released(scene):
    leaning = [replace(i, touch=(0.5, 0.0)) if i.pinches == (0.0, 0.0) else i for i in cycle()]
    assert faults(judge(leaning, scene)[1]) == {"released"}


def test_a_rolling_rod_is_not_at_rest(scene):
    rolling = [replace(i, speed=0.05) if k > 500 else i for k, i in enumerate(cycle())]
    referee, outcome = judge(rolling, scene)
    assert faults(outcome) == {"at_rest"}
    assert not referee.finished


def test_a_rod_let_go_in_the_air_is_not_put_down_for_the_instant_it_hangs(scene):
    instants = cycle()
    hanging = Instant(time=instants[-1].time + DT, xy=GOAL, height=0.002, rests=False)
    released = [i for i in instants if i.time < 5.2 - 1e-9] + [replace(hanging, time=5.2)]
    referee, outcome = judge(released, scene)
    assert not referee.finished
    assert "at_rest" in faults(outcome)


def test_touching_the_rod_again_takes_the_finish_back(scene):
    instants = cycle()
    touched = replace(instants[-1], time=instants[-1].time + DT, pinches=(30.0, 0.0))
    referee, outcome = judge([*instants, touched], scene)
    assert not referee.finished
    assert faults(outcome) == {"released"}


def test_late_is_late(scene):
    slow = [replace(i, time=3.0 * i.time) for i in cycle()]
    _, outcome = judge(slow, scene)
    assert faults(outcome) == {"on_time"}


def test_the_squeeze_is_judged_where_it_is_demanded_and_only_there(scene):
    weak = cycle(squeeze=15.0)
    assert judge(weak, scene)[1].success
    _, outcome = judge(weak, scene, demand_internal_force=True)
    assert faults(outcome) == {"squeezed"}
    assert outcome.number("internal_force_min_n") == 15.0


def test_a_dropped_rod_is_named_by_the_hold_first(scene):
    dropped = cycle()[:350]
    t = dropped[-1].time
    dropped += [
        Instant(
            time=t + k * DT,
            xy=dropped[-1].xy,
            height=max(0.0, 0.1 - 4.9 * (k * DT) ** 2),
            speed=1.0,
        )
        for k in range(1, 30)
    ]
    _, outcome = judge(dropped, scene)
    assert outcome.reason.startswith("grip lost (")
    assert {"held", "arrived", "at_rest"} <= faults(outcome)


@pytest.mark.parametrize(
    ("yaw_deg", "missed"),
    [(4.9, set()), (5.1, {"turned"}), (86.0, {"turned"}), (178.0, set())],
)
def test_a_rod_must_point_where_the_task_asks_and_its_ends_are_equal(scene, yaw_deg, missed):
    referee, outcome = judge([replace(i, yaw=np.radians(yaw_deg)) for i in cycle()], scene)
    assert faults(outcome) == missed
    assert referee.finished == (not missed)


def test_an_object_without_symmetry_turned_round_is_turned(scene):
    instants = [replace(i, yaw=np.pi) for i in cycle()]
    for symmetry, error in ((1, np.pi), (2, 0.0), (4, 0.0)):
        outcome = judged(instants, scene, Turned("rod", 0.0, 0.1, symmetry)).outcome(instants[-1])
        assert outcome.number("yaw_error_rad") == pytest.approx(error, abs=1e-12)
        assert outcome.success == (symmetry > 1)


def _rolled(angle_deg: float):
    """A rotation about the long axis, y."""
    return rot_z(np.pi / 2) @ rot_x(np.radians(angle_deg)) @ rot_z(-np.pi / 2)


def test_a_board_on_its_edge_is_as_low_as_its_edge(scene):
    board = scene.object.model_copy(update={"shape": "box", "width_m": 0.05, "height_m": 0.03})
    truth = ObjectTruth("rod", board)
    rolled = _rolled(90.0)
    upright = rot_z(0.3)
    for R, lowest in ((upright, 0.015), (rolled, 0.025), (_rolled(45.0), 0.04 / np.sqrt(2.0))):
        world = Instant()
        world.pose = lambda R=R, lowest=lowest: pose(R, (0.0, 0.0, lowest))
        truth.refresh(world)
        assert truth.clearance_m == pytest.approx(0.0, abs=1e-12)
        assert not truth.airborne


def test_the_error_of_a_direction_is_the_short_way_round(scene):
    around = rod_trial("test", 0, (*START, 0.0), (*GOAL, 3.1))
    referee = rod_judge(scene, around)
    assert referee.outcome(Instant(yaw=-3.1)).number("yaw_error_rad") == pytest.approx(
        2 * np.pi - 6.2,
    )


@pytest.mark.parametrize(("off_m", "missed"), [(0.029, set()), (0.031, {"carried"})])
def test_hands_may_shift_a_rod_on_the_table_by_three_centimetres(scene, off_m, missed):
    """The rod lies there, held by both hands, until they lift it."""
    instants = [
        replace(i, xy=(START[0] + off_m * min(1.0, k / 90), i.xy[1])) for k, i in enumerate(cycle())
    ]
    away = rod_trial("test", 0, (*START, 0.0), (GOAL[0] + off_m, GOAL[1], 0.0))
    referee = rod_judge(scene, away)
    for instant in instants:
        referee.observe(instant)
    assert faults(referee.outcome(instants[-1])) == missed


@pytest.mark.parametrize("height", [0.0, 0.004, 0.019])
def test_an_object_near_the_table_is_not_carried_however_it_is_held(scene, height):
    low = cycle()
    for k, instant in enumerate(low):
        if instant.xy not in (START, GOAL):
            low[k] = replace(instant, height=height)
    failure = judged(low, scene, Carried("rod", 0.02)).failures["carried"]
    assert "less than 20 mm over the table" in failure.detail


def test_the_way_of_an_object_s_ends_counts_as_its_own(scene):
    """A rod of 30 cm that turns by 0.1 rad moves its ends by 1.5 cm."""
    truth = ObjectTruth("rod", scene.object)
    truth.refresh(Instant())
    assert truth.moved_m((*START, 0.1)) == pytest.approx(0.1 * truth.reach_m)
    turned = [replace(i, yaw=0.0 if k < 60 else 0.25) for k, i in enumerate(cycle())]
    assert [*judged(turned, scene, Carried("rod", 0.02)).failures] == ["carried"]


@pytest.mark.parametrize(("speed", "missed"), [(1.6, set()), (1.8, {"slow"}), (25.0, {"slow"})])
def test_an_object_faster_than_a_hand_is_too_fast(scene, speed, missed):
    instants = cycle()
    for k in range(300, len(instants)):
        x, y = instants[k].xy
        instants[k] = replace(instants[k], xy=(x + speed * DT, y))
    assert {*judged(instants, scene, Slow("rod")).failures} == missed


@pytest.mark.parametrize(("after_m", "missed"), [(0.004, set()), (0.006, {"settled"})])
def test_an_object_that_was_let_go_stays_where_it_is(scene, after_m, missed):
    instants = cycle()
    for k in range(len(instants) - 15, len(instants)):
        x, y = instants[k].xy
        instants[k] = replace(instants[k], xy=(x + after_m, y))
    assert faults(judge(instants, scene)[1]) == missed


def test_fingers_that_touch_again_at_once_have_not_let_go(scene):
    """A pad that bounces while the object is put down is no release."""
    instants = cycle()
    down = next(k for k, i in enumerate(instants) if i.xy == GOAL and i.height == 0.0)
    instants[down + 2] = replace(instants[down + 2], pinches=(0.0, 0.0))
    for k in range(down + 4, len(instants)):
        instants[k] = replace(instants[k], xy=(GOAL[0] + 0.01, GOAL[1]))
    assert faults(judge(instants, scene)[1]) == set()


@pytest.mark.parametrize(("over_m", "missed"), [(0.0009, set()), (0.0011, {"settled"})])
def test_an_object_is_let_go_where_it_stands(scene, over_m, missed):
    instants = cycle()
    down = [k for k, i in enumerate(instants) if i.xy == GOAL and i.height == 0.0]
    for k in down[:25]:  # five instants after the release it falls
        instants[k] = replace(instants[k], height=over_m, rests=False)
    assert faults(judge(instants, scene)[1]) == missed


def test_an_object_that_is_lifted_again_may_move_after_its_release(scene):
    """It is put down for another grasp."""
    first = cycle()
    again = [replace(i, xy=(GOAL[0], GOAL[1] - 0.5 + i.xy[1])) for i in first]
    offset = first[-1].time + DT
    again = [replace(i, time=i.time + offset, xy=(i.xy[0], i.xy[1] + 0.25)) for i in again]
    instants = [*first, *again]
    assert {*judged(instants, scene, Settled("rod", 0.02)).failures} == set()


def test_an_arm_that_leans_on_the_rod_has_not_released_it(scene):
    """A palm or a link, though no finger touches it."""
    leaning = [replace(i, palm=i.pinches == (0.0, 0.0)) for i in cycle()]
    referee, outcome = judge(leaning, scene)
    assert faults(outcome) == {"released"}
    assert "an arm still touches" in outcome.reason
    assert not referee.finished


def test_a_broken_object_stays_broken(scene):
    glass = scene.model_copy(
        update={"object": scene.object.model_copy(update={"break_pinch_n": 65.0})},
    )
    assert judge(cycle(), glass)[1].success
    instants = cycle()
    instants[120] = replace(
        instants[120],
        pinches=(66.0, 60.0),
    )  # for an instant, while it is lifted
    _, outcome = judge(instants, glass)
    assert faults(outcome) == {"whole"}
    assert outcome.failures[0].at_s == pytest.approx(1.2)


def test_touching_the_obstacle_counts_where_there_is_one(scene):
    from minidual.config.scene import ObstacleConfig

    blocked = scene.model_copy(
        update={"task": scene.task.model_copy(update={"obstacle": ObstacleConfig()})},
    )

    @dataclass
    class Near(Instant):
        struck: bool = False

        def touches(self, geom):
            assert geom == "obstacle"
            return self.struck

    instants = [Near(**vars(i)) for i in cycle()]
    assert judge(instants, blocked)[1].success
    instants[300] = replace(instants[300], struck=True)
    assert faults(judge(instants, blocked)[1]) == {"clear"}


def judged(instants: list[Instant], scene, *conditions) -> Judge:
    """Judge instants by these conditions alone."""
    referee = Judge(
        dataclasses.replace(carry_task(scene), success=lambda task, trial: conditions),
        TRIAL,
    )
    for instant in instants:
        referee.observe(instant)
    return referee


def test_one_hand_is_enough_where_the_task_says_so_and_none_is_not(scene):
    instants = cycle(pinches=(60.0, 0.0))
    assert judged(instants, scene, Held("rod", 20.0, both=False)).failures == {}
    assert [*judged(instants, scene, Held("rod", 20.0)).failures] == ["held"]
    assert (
        "firmer hand"
        in judged(cycle(pinches=(5.0, 1.0)), scene, Held("rod", 20.0, both=False))
        .failures["held"]
        .detail
    )


LEFT_HOLDS = (60.0, 0.0)
RIGHT_HOLDS = (0.0, 60.0)
BOTH_HOLD = (60.0, 60.0)


def exchange(*parts: tuple[tuple[float, float], int]) -> list[Instant]:
    """A cycle in which these hands hold the object in the air, each for a number of instants."""
    instants = cycle()
    airborne = [k for k, i in enumerate(instants) if i.height > 0.003]
    grips = [pinches for pinches, count in parts for _ in range(count)]
    grips += [grips[-1]] * (len(airborne) - len(grips))
    for k, pinches in zip(airborne, grips, strict=True):
        instants[k] = replace(instants[k], pinches=pinches)
    return instants


@pytest.mark.parametrize(
    ("parts", "reason"),
    [
        ([(LEFT_HOLDS, 180), (BOTH_HOLD, 11), (RIGHT_HOLDS, 1)], ""),
        ([(RIGHT_HOLDS, 180), (BOTH_HOLD, 11), (LEFT_HOLDS, 1)], ""),
        ([(LEFT_HOLDS, 180), (BOTH_HOLD, 9), (RIGHT_HOLDS, 1)], "both hands never pinched"),
        ([(LEFT_HOLDS, 180), (BOTH_HOLD, 1), (LEFT_HOLDS, 1)], "both hands never pinched"),
        ([(LEFT_HOLDS, 180), (RIGHT_HOLDS, 1)], "both hands never pinched"),
        ([(LEFT_HOLDS, 1)], "both hands never pinched"),
        ([(BOTH_HOLD, 1)], "no hand carried it"),
        ([(LEFT_HOLDS, 180), (BOTH_HOLD, 20), (LEFT_HOLDS, 1)], "the right hand did not carry"),
        (
            [
                (LEFT_HOLDS, 130),
                (BOTH_HOLD, 20),
                (RIGHT_HOLDS, 50),
                (BOTH_HOLD, 20),
                (LEFT_HOLDS, 1),
            ],
            "both hands never pinched",
        ),
    ],
)
def test_an_exchange_is_a_carry_by_each_hand_with_both_between(scene, parts, reason):
    instants = exchange(*parts)
    outcome = judged(instants, scene, Exchanged("rod", 20.0)).outcome(instants[-1])
    assert outcome.success == (not reason)
    assert reason in outcome.reason


def test_the_hand_that_carried_it_last_brought_it(scene):
    instants = exchange((LEFT_HOLDS, 180), (BOTH_HOLD, 11), (RIGHT_HOLDS, 1))
    for hand, reason in ((1, ""), (0, "the right hand brought it, not the left one")):
        outcome = judged(instants, scene, BroughtBy("rod", hand, 20.0)).outcome(instants[-1])
        assert outcome.success == (not reason)
        assert reason in outcome.reason


def test_progress_counts_the_stages_that_were_reached_in_order(scene):
    referee, outcome = judge(cycle(), scene)
    assert referee.stages == ("held", "rose", "arrived", "released")
    assert outcome.measured["progress"] == 1.0
    never_lifted = [replace(i, height=0.0) for i in cycle()]
    referee, outcome = judge(never_lifted, scene)
    assert referee.stages == ("held",)
    assert outcome.measured["progress"] == 0.25


def test_a_task_may_not_have_two_conditions_of_one_name(scene):
    with pytest.raises(ValueError, match="two conditions of one name"):
        judged([], scene, Held("rod", 20.0), Held("rod", 30.0))


def test_an_unknown_task_is_refused_with_the_nearest_one():
    with pytest.raises(UsageError, match="no task 'rod_cary'") as refused:
        make_task(Config(task="rod_cary"))
    assert refused.value.remedy == "did you mean 'rod_carry'?"


def test_the_goal_is_drawn_about_its_nominal_place_and_the_start_stays(scene):
    still = scene.task.model_copy(update={"goal_range_m": 0.0, "goal_range_rad": 0.0})
    task = carry_task(scene.model_copy(update={"task": still}))
    fixed, drawn = (t.trial(3, "goals", 0) for t in (task, carry_task(scene)))
    assert fixed.start == drawn.start
    assert fixed.goal == {"rod": (*GOAL, 0.0)} == task.trial(3, "goals", 1).goal
    goals = np.array([carry_task(scene).trial(3, "goals", k).goal["rod"] for k in range(300)]) - (
        *GOAL,
        0.0,
    )
    bound = np.array([0.05, 0.05, np.radians(15.0)])
    assert np.all(np.abs(goals) <= bound + 1e-5)
    assert np.all(np.ptp(goals, axis=0) > 1.9 * bound)


@pytest.mark.parametrize("yaw", [-3.0, -1.2, 0.0, 0.4, 2.9])
def test_the_yaw_that_is_judged_is_that_of_the_bodys_y_axis(scene: SceneConfig, yaw: float) -> None:
    world = World(scene)
    item = ObjectTruth(scene.object.name, scene.object)
    world.reset(poses={scene.object.name: pose(rot_z(yaw) @ rot_x(0.3), (0.5, 0.0, 0.4))})
    item.refresh(world)
    along = world.object_pose()[:3, 1]
    assert item.yaw_rad == pytest.approx(math.atan2(-along[0], along[1]))
    assert item.yaw_rad == pytest.approx(yaw)
