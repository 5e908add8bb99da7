"""Ways to cheat the success test, of every task. Each is refused, by the right name.

Part one moves the object of a real world along a script and reports the grips of the script. Part
two drives two real hands, whose contacts MuJoCo computes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest

from minidual.config.root import Config, replaced
from minidual.config.scene import SceneConfig
from minidual.control.joint_control import JointLoop
from minidual.motion.ik import solvers
from minidual.plant.bodies import NamedObject
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import pose, rot_x, rot_z
from minidual.tasks.catalogue import make_task
from minidual.tasks.judge import Outcome, begin
from minidual.tasks.objects import MOTIONS, OBJECTS
from minidual.tasks.task import Task, Trial, placement
from tests.support.placing import put_at

GRIP = 30.0
"""Enough for every object, too little to break one [N]."""
BOTH = (GRIP, GRIP)
LEFT = (GRIP, 0.0)
RIGHT = (0.0, GRIP)
NONE = (0.0, 0.0)
STEP_M = 0.015
"""Way of 10 ms at a speed that hands may have."""


def rod_task(item: str = "rod", motion: str = "straight") -> Task:
    config = Config()
    return make_task(replaced(config, carry=replaced(config.carry, object=item, motion=motion)))


TASKS: dict[str, Callable[[], Task]] = {
    f"{item} {motion}": cache(lambda item=item, motion=motion: rod_task(item, motion))
    for item in OBJECTS
    for motion in MOTIONS
} | {
    name: cache(lambda name=name: make_task(Config(task=name))) for name in ("handover", "pot_lift")
}


class Felt(NamedObject):
    """An object at which the hands feel what a script says."""

    grips = NONE

    def look(self):
        seen = super().look()
        (left, right) = self.grips
        seen[6:14] = 0.0, 0.1 * left, 0.0, 0.0, -0.1 * right, 0.0, left, right
        return seen


class Puppet(World):
    """A world whose object follows a script."""

    def __init__(self, scene: SceneConfig) -> None:
        super().__init__(scene)
        name = self.objects[0]
        self._objects[name] = self._objects[None] = Felt(self.model, self.data, name, self.robot)


@cache
def puppet(name: str) -> Puppet:
    return Puppet(TASKS[name]().scene)


class Script:
    """Moves the object of a puppet in steps of 10 ms, judged at each."""

    def __init__(self, name: str, trial: Trial | None = None) -> None:
        self.task = TASKS[name]()
        self.world = puppet(name)
        self.name = self.task.carried
        self.trial = trial or self.task.trial(1, "adversary", 0)
        self.judge = begin(self.world, self.task, self.trial)
        self.start, self.goal = (
            placement(place[self.name]) for place in (self.trial.start, self.trial.goal)
        )
        self.now = np.array([*self.start[:2], 0.0, self.start[2]])  # x, y, height, yaw
        self.hand_over = self.task.name == "handover"
        self.rests = (
            self.task.scene.objects[self.name].rest_height_m - 1e-4
        )  # sunk in: a contact with the table
        self.go(NONE, steps=2)

    def go(
        self,
        grips=None,
        *,
        xy=None,
        height=None,
        yaw=None,
        steps: int = 25,
        step_m: float = STEP_M,
    ) -> None:
        """Move on a straight line, in as many steps more as no step is longer than `step_m`."""
        if grips is not None:
            self.world.truth().grips = grips
        end = np.array(self.now)
        for place, value in ((slice(0, 2), xy), (2, height), (3, yaw)):
            if value is not None:
                end[place] = value
        way_m = float(np.linalg.norm(end[:3] - self.now[:3]))
        steps = max(steps, int(np.ceil(way_m / step_m)))
        for state in np.linspace(self.now, end, steps + 1)[1:]:
            x, y, height, yaw = state
            self.world.data.time += 0.01
            put_at(self.world, self.name, pose(rot_z(yaw), (x, y, self.rests + height)))
            self.judge.observe(self.world)
        self.now = end

    def lift(self, height: float = 0.15) -> None:
        self.go(LEFT if self.hand_over else BOTH, steps=5)
        self.go(height=height)

    def transport(self, yaw: float | None = None) -> None:
        """Carry on; a handover exchanges on the way."""
        middle = 0.5 * (self.now[:2] + self.goal[:2])
        self.go(xy=middle)
        if self.hand_over:
            self.go(BOTH, steps=12)
            self.go(RIGHT, steps=5)
        self.go(xy=self.goal[:2], yaw=self.goal[2] if yaw is None else yaw)

    def release(self) -> None:
        self.go(height=0.0)
        self.go(NONE, steps=20)

    def end(self) -> Outcome:
        return self.judge.outcome(self.world)


def failures(outcome: Outcome) -> set[str]:
    return {fault.name for fault in outcome.failures}


def first(outcome: Outcome) -> str:
    """Return the name of the condition that failed first, or "" after a success."""
    return outcome.failures[0].name if outcome.failures else ""


@pytest.mark.parametrize("name", TASKS)
def test_an_honest_script_succeeds(name: str) -> None:
    """Positive control: without it every refusal below might have another cause."""
    script = Script(name)
    script.lift()
    script.transport()
    script.release()
    outcome = script.end()
    assert outcome.success, outcome.reason


def pushed(s: Script) -> None:
    s.go(xy=s.goal[:2], yaw=s.goal[2])


def put_down_then_pushed(s: Script) -> None:
    s.lift(0.06)
    s.go(height=0.0)
    s.go(NONE, steps=5)
    s.go(xy=s.goal[:2], yaw=s.goal[2])


def one_hand_at_2_5_mm(s: Script) -> None:
    s.lift(0.06)
    s.go(height=0.0025)
    s.go(LEFT)
    s.go(xy=s.goal[:2], yaw=s.goal[2])
    s.go(BOTH, steps=2)


def one_hand_at_10_mm(s: Script) -> None:
    s.lift(0.06)
    s.go(height=0.010)
    s.go(LEFT if not s.hand_over else NONE, steps=5)
    s.transport()


def dragged(s: Script) -> None:
    s.lift(0.06)
    s.go(height=0.0)
    s.transport()


def dragged_then_lifted_at_the_goal(s: Script) -> None:
    s.go(BOTH)
    s.transport()
    s.lift(0.06)


def thrown(s: Script) -> None:
    s.lift()
    s.go(NONE, xy=s.goal[:2], yaw=s.goal[2])


def turned_86_degrees(s: Script) -> None:
    s.lift()
    s.transport(yaw=s.goal[2] + np.radians(86.0))


def turned_after_its_release(s: Script) -> None:
    s.lift()
    s.transport()
    s.release()
    s.go(yaw=s.goal[2] + np.radians(86.0))


def dropped_near_the_goal(s: Script) -> None:
    s.lift()
    s.transport()
    s.go(xy=s.goal[:2] + np.array([0.0, 0.01]), height=0.05)
    s.go(NONE)


def one_arm_alone(s: Script) -> None:
    """The other arm stands still: it never takes hold."""
    s.go(LEFT, steps=5)
    s.go(height=0.15)
    s.go(xy=s.goal[:2], yaw=s.goal[2])


def beside_the_goal(s: Script) -> None:
    s.lift()
    s.transport()
    s.go(xy=s.goal[:2] + np.array([s.task.scene.task.goal_tolerance_m + 0.002, 0.0]))


def pushed_the_last_four_centimetres(s: Script) -> None:
    s.lift()
    goal = s.goal
    s.goal = (goal[0], goal[1] + 0.04, goal[2])
    s.transport()
    s.goal = goal
    s.go(height=0.0)
    s.go(NONE)
    s.go(xy=goal[:2])


def hopped_then_carried_low(s: Script) -> None:
    s.lift(0.06)
    s.go(height=0.004)
    s.transport()


def dragged_at_both_ends(s: Script) -> None:
    """47 mm on the table at the start, and as many at the goal."""
    way = np.subtract(s.goal[:2], s.start[:2])
    aside = 0.047 * way / np.linalg.norm(way)
    grip = LEFT if s.hand_over else BOTH
    s.go(grip, xy=s.start[:2] + aside)
    s.lift()
    goal = s.goal
    s.goal = (*(np.array(goal[:2]) - aside), goal[2])
    s.transport()
    s.go(height=0.0)
    s.go(xy=goal[:2])


def pushed_19_mm_after_its_release(s: Script) -> None:
    goal = s.goal
    s.goal = (goal[0], goal[1] + 0.019, goal[2])
    s.lift()
    s.transport()
    s.release()
    s.go(xy=goal[:2])


def let_go_2_mm_over_the_table(s: Script) -> None:
    s.lift()
    s.transport()
    s.go(height=0.002)
    s.go(NONE, steps=10)


def moved_at_25_m_per_s(s: Script) -> None:
    s.lift()
    middle = 0.5 * (s.now[:2] + s.goal[:2])
    s.go(xy=middle, step_m=0.25, steps=1)
    s.transport()


def one_hand_does_all_and_the_other_pinches_for_10_ms(s: Script) -> None:
    s.go(LEFT, steps=5)
    s.go(height=0.15)
    s.go(xy=0.5 * (s.now[:2] + s.goal[:2]))
    s.go(BOTH, steps=1)
    s.go(LEFT, xy=s.goal[:2], yaw=s.goal[2])


def taken_and_given_back(s: Script) -> None:
    """Both hands carry it alone, but the one that fetched it puts it down."""
    s.go(LEFT, steps=5)
    s.go(height=0.15)
    for share, grips in ((0.4, LEFT), (0.0, BOTH), (0.4, RIGHT), (0.0, BOTH), (1.0, LEFT)):
        s.go(grips, xy=(1.0 - share) * s.now[:2] + share * np.array(s.goal[:2]))
    s.go(yaw=s.goal[2])


CHEATS: dict[Callable[[Script], None], tuple[str, str]] = {
    pushed: ("carried", "carried"),
    put_down_then_pushed: ("carried", "carried"),
    one_hand_at_2_5_mm: ("carried", "carried"),
    one_hand_at_10_mm: ("held", "held"),
    dragged: ("carried", "carried"),
    dragged_then_lifted_at_the_goal: ("carried", "carried"),
    dragged_at_both_ends: ("carried", "carried"),
    hopped_then_carried_low: ("carried", "carried"),
    thrown: ("held", "held"),
    turned_86_degrees: ("turned", ""),
    turned_after_its_release: ("settled", "settled"),
    dropped_near_the_goal: ("held", "held"),
    one_arm_alone: ("held", "exchanged"),
    beside_the_goal: ("arrived", "arrived"),
    pushed_the_last_four_centimetres: ("settled", "settled"),
    pushed_19_mm_after_its_release: ("settled", "settled"),
    let_go_2_mm_over_the_table: ("settled", "settled"),
    moved_at_25_m_per_s: ("slow", "slow"),
    one_hand_does_all_and_the_other_pinches_for_10_ms: ("held", "exchanged"),
    taken_and_given_back: ("held", "exchanged"),
}
"""First failure of a carry by both hands, and of a handover, where the bottle's yaw is free."""


@pytest.mark.parametrize("cheat", CHEATS, ids=lambda cheat: cheat.__name__)
@pytest.mark.parametrize("name", TASKS)
def test_a_scripted_cheat_is_refused(name: str, cheat: Callable[[Script], None]) -> None:
    script = Script(name)
    cheat(script)
    script.release()
    outcome = script.end()
    failure = CHEATS[cheat][script.hand_over]
    assert outcome.success == (not failure)
    if outcome.success:
        return
    assert failure in failures(outcome)
    assert first(outcome) in {failure, "clear"}, (
        outcome.failures
    )  # a long board meets the obstacle first


TRIAL = Trial("adversary", 0, {"rod": (0.5, 0.25, 0.0)}, {"rod": (0.5, -0.25, 0.0)})
"""Real hands carry from here to there."""
POT = Trial("adversary", 0, {"pot": (0.48, 0.1, 0.0)}, {"pot": (0.48, -0.15, 0.0)})
BOTTLE = Trial("adversary", 0, {"bottle": (0.45, 0.35, 0.0)}, {"bottle": (0.45, 0.35, 0.0)})
NAMES = {"rod": "rod straight", "pot": "pot_lift", "bottle": "handover"}


@cache
def real_world(name: str) -> World:
    return World(TASKS[name]().scene)


DOWN = rot_z(np.pi / 2.0) @ rot_x(np.pi)


class Hands:
    """Two real hands, driven by position, whose contacts MuJoCo computes.

    Openings: 1 open, 0 closed.
    """

    frozen: tuple[int, ...] = ()

    def __init__(self, trial: Trial = TRIAL) -> None:
        (carried,) = trial.start
        name = NAMES[carried]
        self.task = TASKS[name]()
        self.world = real_world(name)
        self.judge = begin(self.world, self.task, trial)
        kinematics = Kinematics()
        self.solvers = [*solvers(kinematics.robot).values()]
        self.loop = JointLoop(self.world, kinematics)
        self.q = self.world.q
        x, y, _ = placement(trial.start[self.task.carried])
        offset = self.task.scene.object.grasp_offset_m
        above_m = 0.30 if trial is BOTTLE else 0.15
        self.at = [np.array([x, y + by, above_m]) for by in (offset, -offset)]
        self.openings = np.ones(2)
        self.go(0.6)

    def go(self, seconds: float, left=None, right=None, grips=None) -> None:
        """Move each hand by (x, y, z) [m] on a line; the openings change at once."""
        by = [np.zeros(3) if move is None else np.array(move) for move in (left, right)]
        goals = [at + move for at, move in zip(self.at, by, strict=True)]
        self.openings = self.openings if grips is None else np.array(grips, dtype=float)
        steps = round(seconds / 0.02)
        for k in range(1, steps + 1):
            s = k / steps
            blend = s * s * (3.0 - 2.0 * s)
            for arm, solver in enumerate(self.solvers):
                if arm not in self.frozen:
                    T = pose(DOWN, self.at[arm] + blend * (goals[arm] - self.at[arm]))
                    part = slice(7 * arm, 7 * arm + 7)
                    solved = solver.solve(T, self.q[part])
                    assert solved.reached
                    self.q[part] = solved.q
            for _ in range(20):
                self.loop.step(self.q, self.openings)
                self.judge.observe(self.world)
        self.at = goals

    def both(self, seconds: float, *move: float) -> None:
        self.go(seconds, move, move)

    def lift(self) -> None:
        self.both(0.5, 0.0, 0.0, -0.138)
        self.go(0.4, grips=(0.0, 0.0))
        self.both(0.5, 0.0, 0.0, 0.06)

    def let_go(self) -> None:
        self.go(0.4, grips=(1.0, 1.0))
        self.both(0.3, 0.0, 0.0, 0.09)

    def end(self) -> Outcome:
        self.go(0.3)
        return self.judge.outcome(self.world)


def carries(h: Hands) -> None:
    h.lift()
    h.both(1.2, 0.0, -0.5, 0.0)
    h.both(0.4, 0.0, 0.0, -0.062)
    h.let_go()


def pushes(h: Hands) -> None:
    """The left hand's closed fingers push the rod's end; the right hand gets out of the way."""
    h.go(0.5, left=(0.0, 0.06, 0.0), right=(-0.1, -0.3, 0.2), grips=(0.0, 0.0))
    h.go(0.4, left=(0.0, 0.0, 0.015 - h.at[0][2]))
    h.go(2.0, left=(0.0, -0.525, 0.0))
    h.go(0.3, left=(0.0, 0.03, 0.1))


def lifts_puts_down_and_pushes(h: Hands) -> None:
    h.lift()
    h.both(0.4, 0.0, 0.0, -0.062)
    h.let_go()
    pushes(h)


def lets_go_and_pushes(h: Hands) -> None:
    """By 15 mm, to a goal that is near enough already."""
    carries(h)
    h.go(0.5, left=(0.0, 0.06, 0.0), right=(-0.1, -0.3, 0.2), grips=(0.0, 0.0))
    h.go(0.4, left=(0.0, 0.0, 0.015 - h.at[0][2]))
    h.go(0.5, left=(0.0, -0.035, 0.0))
    h.go(0.3, left=(0.0, 0.03, 0.1))


def carries_low_with_one_hand(h: Hands) -> None:
    h.lift()
    h.both(0.4, 0.0, 0.0, -0.0595)
    h.go(0.3, grips=(0.0, 1.0))
    h.go(0.5, right=(-0.1, -0.3, 0.2))
    h.go(1.2, left=(0.0, -0.5, 0.0))
    h.let_go()


def drags(h: Hands) -> None:
    h.lift()
    h.both(0.4, 0.0, 0.0, -0.063)
    h.both(1.2, 0.0, -0.5, 0.0)
    h.let_go()


def throws(h: Hands) -> None:
    h.lift()
    h.both(0.3, 0.0, -0.25, 0.05)
    h.go(0.3, grips=(1.0, 1.0), left=(0.0, -0.1, 0.0), right=(0.0, -0.1, 0.0))


def drops_near_the_goal(h: Hands) -> None:
    h.lift()
    h.both(1.2, 0.0, -0.49, -0.02)
    h.go(0.6, grips=(1.0, 1.0))


def freezes_the_right_arm(h: Hands) -> None:
    h.lift()
    h.frozen = (1,)
    h.both(1.2, 0.0, -0.5, 0.0)


def never_moves_the_right_arm(h: Hands) -> None:
    h.frozen = (1,)
    carries(h)


def grasps_the_pot(h: Hands) -> None:
    h.both(0.4, 0.0, 0.0, -0.07)
    h.go(0.4, grips=(0.0, 0.0))


def carries_the_pot(h: Hands) -> None:
    grasps_the_pot(h)
    h.both(0.6, 0.0, 0.0, 0.12)
    h.both(0.8, 0.0, -0.25, 0.0)
    h.both(0.6, 0.0, 0.0, -0.12)
    h.let_go()


def pushes_the_pot(h: Hands) -> None:
    """The left hand's closed fingers push a handle's end."""
    h.go(0.4, left=(0.0, 0.06, 0.0), right=(-0.1, -0.2, 0.1), grips=(0.0, 0.0))
    h.go(0.3, left=(0.0, 0.0, -0.07))
    h.go(1.5, left=(0.0, -0.27, 0.0))


def drags_the_pot(h: Hands) -> None:
    grasps_the_pot(h)
    h.both(1.0, 0.0, -0.25, 0.0)
    h.let_go()


def drops_the_pot(h: Hands) -> None:
    grasps_the_pot(h)
    h.both(0.6, 0.0, 0.0, 0.12)
    h.both(0.8, 0.0, -0.25, 0.0)
    h.go(0.6, grips=(1.0, 1.0))


def throws_the_pot(h: Hands) -> None:
    grasps_the_pot(h)
    h.both(0.6, 0.0, 0.0, 0.12)
    h.both(0.3, 0.0, -0.12, 0.02)
    h.go(0.4, grips=(1.0, 1.0), left=(0.0, -0.06, 0.0), right=(0.0, -0.06, 0.0))


def lifts_the_pot_with_one_hand(h: Hands) -> None:
    h.frozen = (1,)
    grasps_the_pot(h)
    h.both(0.6, 0.0, 0.0, 0.12)
    h.both(0.6, 0.0, -0.12, 0.0)


TURNED = Trial("adversary", 0, TRIAL.start, {"rod": (0.5, -0.25, np.radians(86.0))})
OPPOSITE = Trial("adversary", 0, TRIAL.start, {"rod": (0.5, -0.25, np.radians(-178.0))})


@pytest.mark.parametrize(
    ("does", "trial", "failure"),
    [
        (carries, TRIAL, ""),
        (carries, OPPOSITE, ""),
        (carries, TURNED, "turned"),
        (pushes, TRIAL, "carried"),
        (lets_go_and_pushes, TRIAL, "settled"),
        (lifts_puts_down_and_pushes, TRIAL, "settled"),
        (carries_low_with_one_hand, TRIAL, "carried"),
        (drags, TRIAL, "carried"),
        (throws, TRIAL, "held"),
        (drops_near_the_goal, TRIAL, "held"),
        (freezes_the_right_arm, TRIAL, "held"),
        (never_moves_the_right_arm, TRIAL, "held"),
        (carries_the_pot, POT, ""),
        (pushes_the_pot, POT, "carried"),
        (drags_the_pot, POT, "carried"),
        (drops_the_pot, POT, "held"),
        (throws_the_pot, POT, "held"),
        (lifts_the_pot_with_one_hand, POT, "held"),
    ],
)
def test_real_hands_succeed_only_by_carrying(
    does: Callable[[Hands], None],
    trial: Trial,
    failure: str,
) -> None:
    hands = Hands(trial)
    does(hands)
    outcome = hands.end()
    assert first(outcome) == failure, outcome.failures
    assert outcome.success == (failure == "")


def lifts_the_bottle_and_stands_it(h: Hands) -> None:
    """With the left hand alone, where it stood."""
    h.frozen = (1,)
    h.go(0.4, left=(0.0, -0.07, 0.0))
    h.go(0.4, left=(0.0, 0.0, -0.13))
    h.go(0.5, grips=(0.0, 1.0))
    h.go(0.8, left=(0.0, 0.0, 0.1))
    h.go(0.8, left=(0.0, 0.0, -0.1))
    h.go(0.4, grips=(1.0, 1.0))


@pytest.mark.parametrize("presses", [False, True])
def test_a_palm_on_the_bottle_is_no_release(presses: bool) -> None:
    """The open fingers stand beside it and touch nothing."""
    hands = Hands(BOTTLE)
    lifts_the_bottle_and_stands_it(hands)
    hands.go(0.5, left=(0.0, 0.0, -0.02 if presses else 0.05))
    outcome = hands.end()
    assert failures(outcome) == {"exchanged", *(["released"] if presses else [])}
    assert not hands.judge.truth["bottle"].in_fingers
    assert hands.judge.truth["bottle"].at_an_arm == presses
