"""The whole control stack under random interleavings of commands of all kinds, switches, delays and faults.

Never two sources in one tick, never a joint reference that jumps, never silence: one torque a joint every tick, from
exactly one controller. The same checks are then turned on stacks that were broken on purpose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from minidual.config.control import ArbiterConfig
from minidual.config.scene import SceneConfig
from minidual.control import controllers as controllers_module
from minidual.control.commands import (
    HOLD,
    SOURCES,
    ArbiterState,
    JointCommand,
    ObjectCommand,
    TrajectoryCommand,
)
from minidual.control.controller_manager import ControllerManager, ControllerSwitchError
from minidual.control.driving import Driving
from minidual.control.execution import Underway
from minidual.control.mailbox import Mailbox
from minidual.control.reflexes import ReflexError
from minidual.control.stack import ControlStack
from minidual.errors import UsageError
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array
from minidual.skills.object_path import ObjectPath, Waypoint
from tests.support.control_plant import ArmsPlant, HandsObject
from tests.support.panda import GROUPS, HOME, V_MAX
from tests.support.stacks import move

Event = tuple[Any, ...]
CONFIG = ArbiterConfig()
SCENE = SceneConfig()
A = ("both_arms",)
B = ("left_arm", "right_arm")
C = ("object_impedance",)
HAND = ("left_arm", "right_hand")
STOPPING = ("soft_stop",)
BAD_SETS = (("left_arm",), ("both_arms", "left_arm"), ())
# A trajectory at its speed limit, plus what fades of its distance from the reference, plus rounding.
REFERENCE_STEP = (1.02 * V_MAX + 2.0 * CONFIG.switch_step_max_rad / 0.5) * 1e-3 + 1e-9


class Witness:
    """Plays events to a stack and looks at every control step."""

    def __init__(self) -> None:
        self.plant = ArmsPlant(SCENE)
        here = HandsObject(self.plant)
        self.stack = ControlStack(self.plant, Kinematics(), CONFIG, sensor=here)
        self._here = here
        self.stack.impedance.configure(here.held())
        self.stack.on_flush(self._flushed)
        self.sequence = 0
        self.taken: dict[int, str] = {}
        self._kept: list[Any] = []
        self.turn: str | None = None
        self.errors: list[str] = []
        self._alive_s = self._offered_s = 0.0
        self.seen: Counter[Any] = Counter()
        self._updates: Counter[int] = Counter()
        self._last: Array | None = None
        self._active = self.stack.manager.active
        self._taken_over = False
        for controller in self.stack._loop._controllers:
            self._spy(controller)

    def _spy(self, controller: Any) -> None:
        run = controller.update

        def update(q: Array, v: Array) -> Array:
            self._updates.update(controller.arms)
            return run(q, v)

        controller.update = update
        take_over = controller.activate

        def activate(q: Array, v: Array) -> None:
            self._taken_over = True
            take_over(q, v)

        controller.activate = activate

    def _flushed(self, mode: str) -> None:
        self.turn = None
        self.taken.clear()

    def play(self, events: Sequence[Event]) -> None:
        for event in events:
            getattr(self, event[0])(*event[1:])

    # Events ---------------------------------------------------------------------------------------------

    def request(self, mode: str, controllers: Any) -> None:
        if self.stack.reflex is not None and not self._recovered():
            return
        before = self.stack.manager.active
        busy = self.stack.executing or self.stack.stopping
        try:
            self.stack.request(mode, controllers)
        except ControllerSwitchError as error:
            assert controllers in BAD_SETS or (busy and mode == self.stack.source)
            self.seen[error.name] += 1
            assert self.stack.manager.active == before

    def _recovered(self) -> bool:
        """Recover from a reflex; return whether the arms were at rest for it."""
        try:
            self.stack.recover()
        except UsageError:
            return False
        self.turn = None
        self.taken.clear()
        self._last = None
        return True

    def controllers(self, names: tuple[str, ...]) -> None:
        before = self.stack.manager.active
        busy = self.stack.executing or self.stack.stopping
        try:
            self.stack.switch_controllers(names)
        except ControllerSwitchError as error:
            assert names in BAD_SETS or busy
            self.seen[error.name] += 1
            assert self.stack.manager.active == before

    def _offer(self, source: str, command: Any) -> None:
        if self.stack.propose(source, command) is None:
            self._offered_s = self.plant.time
            self.taken[command.sequence] = source
            self._kept.append(command)  # so that no other command gets its id

    def stream(
        self,
        source: str,
        group: str,
        offset: float,
        age: float,
        fault: str,
        ticks: int,
    ) -> None:
        """A source that sends joint targets for a while."""
        corner = 0.15 * (SOURCES.index(source) - 1) + offset
        for _ in range(ticks):
            self.sequence += 1
            q = HOME[GROUPS[group]] + corner
            if fault == "nan":
                q = np.where(np.arange(len(q)) == 2, np.nan, q)
            elif fault == "zero":
                q = np.zeros(len(q))
            elif fault == "limits":
                q = q + 4.0
            stamp = self.plant.time - age
            self._offer(source, JointCommand(q, np.ones(2), stamp, self.sequence, group))
            self.run(20)

    def trajectory(
        self,
        source: str,
        group: str,
        away: float,
        goal: float,
        seconds: float,
        age: float,
    ) -> None:
        self.sequence += 1
        start = self.plant.q + away
        motion = move(start, HOME + goal, seconds, group)
        stamp = self.plant.time - age
        self._offer(source, TrajectoryCommand(motion, np.ones(2), stamp, self.sequence, group))

    def object(self, source: str, dz: float, seconds: float) -> None:
        self.sequence += 1
        x, y, z = (float(value) for value in self._here.pose()[:3, 3])
        path = ObjectPath(Waypoint((x, y, z), 0.0, 0.0), [Waypoint((x, y, z + dz), 0.0, seconds)])
        self._offer(
            source,
            ObjectCommand(path, lambda t: 0.0, np.ones(2), self.plant.time, self.sequence),
        )

    def halt(self, source: str, opens: bool) -> None:
        self.stack.halt(source, np.ones(2) if opens else None)

    def silence(self, steps: int) -> None:
        """Control steps in which no source gives a sign of life."""
        self.run(steps, alive=False)

    def run(self, steps: int, *, alive: bool = True) -> None:
        for _ in range(steps):
            if alive and self.turn is not None:
                self.stack.affirm(self.turn)
                self._alive_s = self.plant.time
            n = len(self.plant.torques)
            self._updates.clear()
            try:
                self.stack.step()
            except (
                ReflexError
            ) as error:  # nothing holds the hands together: they may leave the object
                self.errors.append(error.message)
            self._check(n)

    # Checks ---------------------------------------------------------------------------------------------

    def _check(self, torques_before: int) -> None:
        stack = self.stack
        out = self.stack.output
        assert len(self.plant.torques) == torques_before + 1, "silence"
        assert np.isfinite(self.plant.torques[-1]).all()
        if stack.reflex is None:
            assert self._updates == {0: 1, 1: 1}, f"joints claimed {dict(self._updates)} times"
            self._check_reference()
        if out.switched_to is not None:
            self.turn = None if out.switched_to == HOLD else out.switched_to
        if out.halted:
            assert not out.executions, "a command runs on through a halt"
            assert self.turn is None
        for execution in out.executions:
            source = self.taken.get(execution.command.sequence)
            assert execution.braking or source == self.turn, "a command of another turn runs"
            # The last sign is heard at the next tick, and the silence noticed at one.
            silent_s = self.plant.time - max(self._alive_s, self._offered_s)
            assert execution.braking or silent_s <= CONFIG.stale_s + 0.045, (
                "it runs on without its source"
            )
            self.seen["braked"] += execution.braking and stack.state == ArbiterState.STALE
            self.seen[type(execution.command)] += 1
        assert out.active_source in (None, self.turn), "driven by a source whose turn it is not"
        self.seen[stack.state] += 1
        self.seen[stack.manager.active] += 1
        self.seen.update({r.name for r in out.refusals})

    def _check_reference(self) -> None:
        reference = np.array(self.stack.manager.reference)
        active = self.stack.manager.active
        if self._last is not None and active != C:
            step = np.abs(reference - self._last)
            if active == self._active and not self._taken_over:
                assert (step <= REFERENCE_STEP).all(), f"the reference jumped by {step.max()}"
            else:  # the new controllers start at what is measured, which the old reference may be ahead of
                assert step.max() <= CONFIG.switch_step_max_rad, f"a switch jumped by {step.max()}"
        self._last = reference
        self._active = active
        self._taken_over = False


source = st.sampled_from(SOURCES)
group = st.sampled_from(sorted(GROUPS))
sets = st.sampled_from([A, A, B, C, HAND, *BAD_SETS])
events = st.one_of(
    st.tuples(st.just("request"), st.sampled_from((*SOURCES, HOLD)), st.one_of(st.none(), sets)),
    st.tuples(st.just("controllers"), sets),
    st.tuples(
        st.just("stream"),
        source,
        group,
        st.sampled_from([0.0, 0.05, -0.09, 0.3]),
        st.sampled_from([0.0, 0.0, 0.2]),
        st.sampled_from(["", "", "", "nan", "zero", "limits"]),
        st.integers(1, 4),
    ),
    st.tuples(
        st.just("trajectory"),
        source,
        group,
        st.sampled_from([0.0, 0.0, 0.04, 0.5]),
        st.sampled_from([0.0, 0.2, -0.2]),
        st.sampled_from([0.3, 0.6]),
        st.sampled_from([0.0, 0.0, 0.0, 0.2, -3.0]),
    ),
    st.tuples(st.just("object"), source, st.sampled_from([0.05, -0.03]), st.just(0.4)),
    st.tuples(st.just("run"), st.sampled_from([1, 7, 20, 90])),
    st.tuples(st.just("silence"), st.sampled_from([7, 90, 160])),
    st.tuples(st.just("halt"), source, st.booleans()),
)


def turn(mode: str, controllers: Any = None) -> list[Event]:
    return [("request", mode, controllers), ("run", 60)]


SCRIPTS: list[list[Event]] = [
    [*turn("moveit"), ("trajectory", "moveit", "both_arms", 0.0, 0.1, 0.3, 0.0), ("run", 90)],
    [
        *turn("moveit", B),
        ("trajectory", "moveit", "left_arm", 0.0, 0.1, 0.3, 0.0),
        ("run", 20),
        ("trajectory", "moveit", "right_arm", 0.0, -0.1, 0.3, 0.0),
        ("run", 90),
    ],
    [
        *turn("moveit", HAND),
        ("trajectory", "moveit", "both_arms", 0.0, 0.1, 0.3, 0.0),
        ("run", 90),
    ],
    [
        *turn("moveit"),
        ("trajectory", "moveit", "both_arms", 0.0, 0.2, 0.6, 0.0),
        ("silence", 160),
        ("run", 30),
    ],
    [*turn("moveit", C), ("object", "moveit", 0.05, 0.4), ("run", 90)],
    [*turn("teleop"), ("stream", "teleop", "both_arms", 0.05, 0.0, "", 4)],
    [*turn("teleop"), ("stream", "teleop", "left_arm", 0.0, 0.0, "", 2), ("run", 1150)],
    [*turn("teleop", C), ("stream", "teleop", "both_arms", 0.05, 0.0, "", 2)],
    [*turn("moveit"), ("trajectory", "moveit", "both_arms", 0.5, 0.2, 0.6, 0.0), ("run", 2)],
    [*turn("policy"), ("stream", "policy", "right_arm", 0.3, 0.0, "", 6), ("run", 150)],
    [
        *turn("moveit"),
        ("trajectory", "moveit", "both_arms", 0.0, 0.1, 0.3, 0.0),
        ("run", 90),
        ("halt", "moveit", False),
        ("run", 90),
    ],
    # One mistake each.
    [("controllers", BAD_SETS[0]), ("run", 30)],
    [("controllers", BAD_SETS[1]), ("run", 30)],
    [*turn("teleop"), ("halt", "policy", True), ("run", 30)],
    [*turn("teleop"), ("stream", "teleop", "both_arms", 0.0, 0.0, "nan", 1)],
    [*turn("teleop"), ("stream", "teleop", "both_arms", 0.0, 0.0, "zero", 1)],
    [
        *turn("moveit"),
        ("trajectory", "moveit", "both_arms", 0.0, 0.1, 0.3, 0.0),
        ("run", 20),
        ("controllers", B),
        ("trajectory", "moveit", "both_arms", 0.0, 0.1, 0.3, 0.0),
    ],
]


def whole(parts: Sequence[Sequence[Event]]) -> list[Event]:
    return [("run", 1), *(event for part in parts for event in part), ("run", 30)]


parts = st.one_of(events.map(lambda event: [event]), st.sampled_from(SCRIPTS))
histories = st.lists(parts, max_size=10).map(whole)


@settings(max_examples=100)
@given(histories)
def test_one_source_no_jump_and_never_silence(history: list[Event]) -> None:
    """The witness asserts at every step; what is asserted here is that there were steps, up to the last torque."""
    witness = Witness()
    witness.play(history)
    assert witness.stack.plant.time > 0.0
    assert np.isfinite(witness.stack.applied).all()


def test_the_scripts_in_random_histories_reach_all_that_there_is() -> None:
    """Each script is played alone: what Hypothesis draws depends on the modules that the process has imported."""
    seen: Counter[Any] = Counter()
    for script in SCRIPTS:
        witness = Witness()
        witness.play(whole([script]))
        seen.update(witness.seen)
    wanted = {
        *ArbiterState,
        A,
        B,
        C,
        HAND,
        STOPPING,
        TrajectoryCommand,
        ObjectCommand,
        "not_driving",
        "braked",
        "unclaimed",
        "doubly_claimed",
        "wrong_controller",
        "far_start",
        "busy",
        "under_way",
        "not_finite",
        "all_zero",
    }
    assert wanted <= {key for key, n in seen.items() if n}, f"never reached: {wanted - set(seen)}"


LEFT_BEHIND: list[Event] = [
    ("run", 1),
    ("request", "policy", None),
    ("run", 60),
    ("stream", "policy", "right_arm", 0.3, 0.0, "", 6),
    ("run", 150),
    ("controllers", C),
    ("silence", 320),
    ("run", 1000),
]


def test_hands_that_leave_an_imagined_object_stop_once_by_its_name() -> None:
    witness = Witness()
    witness.play(LEFT_BEHIND)
    assert len(witness.errors) == 1
    assert "away from where the right hand holds it" in witness.errors[0]
    assert np.abs(witness.plant.v).max() < 0.05


ASKED_WHILE_STOPPING: list[Event] = [
    ("run", 1),
    ("request", "teleop", None),
    ("run", 60),
    ("stream", "teleop", "both_arms", 0.05, 0.0, "", 4),
    ("halt", "moveit", False),
    ("request", "teleop", ("object_impedance",)),
]


@settings(max_examples=15)
@given(histories)
@example(ASKED_WHILE_STOPPING)
def test_the_same_history_gives_the_same_torques(history: list[Event]) -> None:
    first = Witness()
    second = Witness()
    for witness in (first, second):
        witness.play(history)
    np.testing.assert_array_equal(first.plant.torques, second.plant.torques)
    assert first.errors == second.errors
    assert all("hand holds it" in text for text in first.errors)


# What the checks say of stacks that are broken ------------------------------------------------------------

DRIVE: list[Event] = [
    ("run", 1),
    *turn("moveit"),
    ("trajectory", "moveit", "both_arms", 0.0, 0.2, 0.6, 0.0),
    ("run", 90),
    *turn("teleop"),
    ("run", 400),
    ("stream", "teleop", "both_arms", 0.0, 0.0, "", 3),
    ("run", 150),
    ("controllers", B),
    ("run", 30),
    ("controllers", A),
    ("run", 30),
]


def test_the_crafted_history_passes_a_whole_stack() -> None:
    witness = Witness()
    witness.play(DRIVE)
    assert {A, B, TrajectoryCommand, ArbiterState.ACTIVE, ArbiterState.STALE} <= set(witness.seen)


def test_the_witness_sees_an_arm_with_two_controllers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        ControllerManager,
        "check",
        lambda self, names: tuple(self[n] for n in names),
    )
    witness = Witness()
    witness.play(DRIVE)
    with pytest.raises(AssertionError, match="claimed"):
        witness.play([("controllers", ("both_arms",)), ("controllers", ("left_arm",)), ("run", 1)])
    with pytest.raises(AssertionError, match="claimed"):
        witness.play([("request", "policy", ("both_arms", "left_arm")), ("run", 700)])


def test_the_witness_sees_a_trajectory_that_starts_elsewhere(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Underway, "_far_start", lambda *_: None)
    monkeypatch.setattr(controllers_module, "_BLEND_S", 1e-3)
    with pytest.raises(AssertionError, match="the reference jumped"):
        Witness().play(
            [
                ("run", 1),
                *turn("moveit"),
                ("trajectory", "moveit", "both_arms", 0.5, 0.2, 0.6, 0.0),
                ("run", 30),
            ],
        )


def test_the_witness_sees_an_old_trajectory_after_a_switch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Mailbox, "flush", lambda self, now_s: None)
    with pytest.raises(AssertionError, match="another turn"):
        Witness().play(
            [
                ("run", 1),
                ("trajectory", "moveit", "both_arms", 0.0, 0.2, 0.6, 0.0),
                ("request", "moveit", None),
                ("run", 60),
            ],
        )


def test_the_witness_sees_a_trajectory_without_its_source(monkeypatch: pytest.MonkeyPatch) -> None:
    history: list[Event] = [
        ("run", 1),
        *turn("moveit"),
        ("trajectory", "moveit", "both_arms", 0.0, 0.2, 0.6, 0.0),
        ("silence", 300),
    ]
    Witness().play(history)
    monkeypatch.setattr(Driving, "is_gone", lambda self, now_s: False)
    with pytest.raises(AssertionError, match="without its source"):
        Witness().play(history)


def test_the_witness_sees_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    advance = ControlStack.advance
    monkeypatch.setattr(
        ControlStack,
        "advance",
        lambda self: None if self.state == ArbiterState.STALE else advance(self),
    )
    with pytest.raises(AssertionError, match="silence"):
        Witness().play(DRIVE)


def test_the_witness_sees_a_reference_without_its_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    class Jumping:
        def __init__(self, *args: Any, **kwargs: Any) -> None:
            self.zero = np.zeros(14)

        def reset(self, q: Array, v: Array | None = None) -> None: ...

        def limit_speed(self, share: float) -> None: ...

        def step(self, target: Array) -> tuple[Array, Array, Array]:
            return target, self.zero, self.zero

    monkeypatch.setattr(controllers_module, "ReferenceFilter", Jumping)
    with pytest.raises(AssertionError, match="the reference jumped"):
        Witness().play(
            [("run", 1), *turn("teleop"), ("stream", "teleop", "both_arms", 0.05, 0.0, "", 2)],
        )
