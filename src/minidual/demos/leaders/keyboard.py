"""Lead the arms from a terminal, hand by hand or joint by joint."""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple, Self

import numpy as np
from scipy.spatial.transform import Rotation

from minidual.config.learning import TeleopConfig
from minidual.demos.hands import HandTracker, Spring
from minidual.demos.leader import Features, Leader, LeaderSample, LeaderSetup
from minidual.demos.leaders.terminal import BUTTON_KEYS, BUTTON_KEYS_USAGE, Terminal
from minidual.demos.station import Button
from minidual.robot.pair import Array, Robot
from minidual.tasks.task import Trial

STEPS_M = (0.002, 0.005, 0.01)
"""Steps of a hand per key press, small to large; turns and joints step in proportion."""
_RAD_PER_M = 6.0
_JOINT_SPEED_MAX_RAD_S = 0.8


class _Motion(NamedTuple):
    """Which of x, y, z a key moves along or turns about, and the sign."""

    axis: int
    sign: int
    turns: bool = False


_MOTIONS = {
    "w": _Motion(0, 1),
    "s": _Motion(0, -1),
    "a": _Motion(1, 1),
    "d": _Motion(1, -1),
    "r": _Motion(2, 1),
    "f": _Motion(2, -1),
    "q": _Motion(2, 1, turns=True),
    "e": _Motion(2, -1, turns=True),
    "t": _Motion(1, 1, turns=True),
    "g": _Motion(1, -1, turns=True),
    "z": _Motion(0, 1, turns=True),
    "c": _Motion(0, -1, turns=True),
}
_SELECTIONS: tuple[tuple[str, list[int]], ...] = (
    ("both hands", [0, 1]),
    ("left hand", [0]),
    ("right hand", [1]),
)


class KeyboardLeader(Leader):
    """Jogs hands or joints. Keys move a goal that is followed at bounded speed.

    Keys that are pressed while time stands still move the goal too: the arms follow when it runs.

    Raises:
        EnvironmentMissingError: The descriptor is not a terminal.
    """

    features: ClassVar[Features] = Features(
        grips="binary",
        buttons=tuple(Button),
        realtime=True,
        terminal=True,
    )
    usage: ClassVar[str] = (
        "keys: w/s away/back  a/d left/right  r/f up/down  q/e turn  t/g pitch  z/c roll  "
        "space opens/closes  tab both/left/right hand  ,/. smaller/larger steps\n"
        "keys: 1 to 9 one joint, which w/s then move  0 back to the hands\n" + BUTTON_KEYS_USAGE
    )

    def __init__(self, robot: Robot, config: TeleopConfig, *, descriptor: int = 0) -> None:
        self._terminal = Terminal(descriptor, "the keyboard leader")
        self._robot = robot
        period_s = 1.0 / config.rate_hz
        self._tracker = HandTracker(robot, config.mirror, period_s)
        self._spring = Spring(config.mirror.hand_lag_s, period_s)
        self._selected = 0
        self._step = 1
        self._dropped_n = 0
        self._stand(robot.home)

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Take over the terminal."""
        return cls(setup.robot, setup.config)

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Begin where the arms are; drop keys that were pressed between two episodes."""
        self._dropped_n = len(self._terminal.read_keys())
        self._stand(q_follower)

    def resume(self, q_follower: Array) -> None:
        """Jog on from where the arms are; the hands stay."""
        self._q = np.array(q_follower, dtype=float)
        self._aim_hands()

    def _stand(self, q: Array) -> None:
        self._q = np.array(q, dtype=float)
        self._joint: int | None = None
        self._open = np.ones(2)
        self._last_s = 0.0
        self._aim_hands()

    def _aim_hands(self) -> None:
        """Make the hands' present poses their goals."""
        self._tracker.begin(self._q)
        self._goals = self._tracker.Ts_world_tcp
        self._joint = None

    def _aim_joint(self, joint: int) -> None:
        """Make the present joints the goal; keys move one of them."""
        self._joint = joint
        self._q_goal = self._q.copy()
        self._speed_rad_s = np.zeros(self._robot.dof)

    @property
    def hint(self) -> str:
        """The motion of the keys, and what limits it."""
        name, hands = _SELECTIONS[self._selected]
        if self._joint is not None:
            sides = " and ".join(self._robot.sides[hand] for hand in hands)
            name = f"joint {self._joint + 1}, {sides}"
        texts = [f"{name}, steps of {1e3 * STEPS_M[self._step]:g} mm", self._tracker.hint]
        if self._dropped_n:
            texts.append(f"{self._dropped_n} keys pressed between the episodes were dropped")
        return ", ".join(text for text in texts if text)

    def read(self, now_s: float) -> LeaderSample | None:
        """Process keys; see `Leader`. None once the terminal is gone."""
        pressed: list[Button] = []
        for key in self._terminal.read_keys():
            pressed += self._press(key.lower())
        if self._terminal.is_gone:
            return None
        if now_s > self._last_s:
            self._last_s = now_s
            self._follow()
        return LeaderSample(self._open.copy(), q=self._q.copy(), pressed=tuple(pressed))

    def close(self) -> None:
        """Restore the terminal."""
        self._terminal.close()

    def _press(self, key: str) -> Sequence[Button]:
        """Process a key; return the buttons that it is."""
        hands = _SELECTIONS[self._selected][1]
        if key in BUTTON_KEYS:
            return BUTTON_KEYS[key]
        if key in _MOTIONS:
            self._move(_MOTIONS[key], hands)
        elif key == " ":
            self._open[hands] = 1.0 - self._open[hands[0]]
        elif key == "\t":
            self._selected = (self._selected + 1) % len(_SELECTIONS)
        elif key in ",.":
            change = 1 if key == "." else -1
            self._step = min(max(self._step + change, 0), len(STEPS_M) - 1)
        elif key == "0":
            self._aim_hands()
        elif key.isdigit() and int(key) <= self._robot.dof_most:
            self._aim_joint(int(key) - 1)
        return ()

    def _move(self, motion: _Motion, hands: list[int]) -> None:
        step_m = motion.sign * STEPS_M[self._step]
        if self._joint is not None:
            self._move_joint(motion, step_m, hands)
        elif motion.turns:
            self._turn(motion.axis, _RAD_PER_M * step_m, hands)
        else:
            for hand in hands:
                self._goals[hand][motion.axis, 3] += step_m
        for hand in hands:
            self._goals[hand] = self._tracker.above_table(self._goals[hand])

    def _move_joint(self, motion: _Motion, step_m: float, hands: list[int]) -> None:
        if motion.axis == 0 and not motion.turns:
            for hand in hands:
                joints = self._robot.joints_of(hand)
                joint = joints.start + (self._joint or 0)
                if joint < joints.stop:
                    self._q_goal[joint] += _RAD_PER_M * step_m
            self._q_goal = np.clip(self._q_goal, self._robot.q_lower, self._robot.q_upper)

    def _turn(self, axis: int, angle_rad: float, hands: list[int]) -> None:
        """Turn hands about the point in their middle: a held object turns with them."""
        middle = np.mean([self._goals[hand][:3, 3] for hand in hands], axis=0)
        R = Rotation.from_rotvec(angle_rad * np.eye(3)[axis]).as_matrix()
        for hand in hands:
            T = self._goals[hand]
            T[:3, :3] = R @ T[:3, :3]
            T[:3, 3] = middle + R @ (T[:3, 3] - middle)

    def _follow(self) -> None:
        """Move one period towards the goal; a hand that cannot reach it stays."""
        if self._joint is not None:
            away, self._speed_rad_s = self._spring.step(
                self._q - self._q_goal,
                self._speed_rad_s,
                _JOINT_SPEED_MAX_RAD_S,
            )
            self._q = self._q_goal + away
            return
        self._q = self._tracker.follow(self._goals)
        for hand in self._tracker.blocked:
            self._goals[hand] = self._tracker.Ts_world_tcp[hand]
