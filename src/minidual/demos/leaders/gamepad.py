"""A gamepad leads: a stick and a trigger a hand."""

from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from scipy.spatial.transform import Rotation

from minidual import emergency
from minidual.config.leading import GamepadConfig
from minidual.demos.leader import Features, Feedback, Leader, LeaderSample, LeaderSetup
from minidual.demos.leaders.gamepad_device import EvdevGamepad, Event, GamepadDevice, Range
from minidual.demos.leaders.gamepad_mapping import (
    CLUTCH,
    MOTIONS,
    SHIFTS,
    STOP,
    GamepadMapping,
    Motion,
    read_mapping,
)
from minidual.demos.station import Button
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, Robot
from minidual.tasks.task import Trial

DEFAULT_MAPPING = Path(__file__).with_suffix(".yaml")
_AHEAD_MAX_M = 0.06
"""Most distance of a goal ahead of the hand: a hand that is in the way of something stays there."""
_STEP_MAX_S = 0.1
_CENTRED = Range(-1.0, 1.0)


class GamepadLeader(Leader):
    """Sticks move and turn the hands at a speed, triggers close them.

    Args:
        robot: The arms.
        config: Speeds and dead zone.
        mapping: What does what.
        device: Gives events.
    """

    features: ClassVar[Features] = Features(
        targets="poses",
        buttons=tuple(Button),
        clutch=True,
        realtime=True,
    )
    usage: ClassVar[str] = (
        "gamepad: a stick moves a hand away, back and sideways; with its shoulder button held, up, "
        "down and round; its trigger closes the hand; start starts and ends; the mode button is the "
        "EMERGENCY STOP (the table is demos/leaders/gamepad.yaml)"
    )

    def __init__(
        self,
        robot: Robot,
        config: GamepadConfig,
        mapping: GamepadMapping,
        device: GamepadDevice,
    ) -> None:
        self._config = config
        self._mapping = mapping
        self._device = device
        self._kinematics = Kinematics(robot)
        self._values: dict[str, float] = {}
        self._actions: set[str] = set()
        self._hands = self._poses(robot.home)
        self._Ts = self._poses(robot.home)
        self._last_s = 0.0

    @classmethod
    def connect(cls, setup: LeaderSetup) -> Self:
        """Open the gamepad and read the mapping.

        Raises:
            EnvironmentMissingError: There is none.
            ConfigError: The mapping is wrong.
        """
        config = setup.config.gamepad
        mapping = read_mapping(Path(config.mapping) if config.mapping else DEFAULT_MAPPING)
        return cls(setup.robot, config, mapping, EvdevGamepad(config.device))

    def _poses(self, q: Array) -> list[Array]:
        return [T.copy() for T in self._kinematics.tcp_poses(q)]

    def align(self, trial: Trial, q_follower: Array) -> None:
        """Begin where the arms are; forget earlier presses."""
        self._device.read()
        self._hands = self._poses(q_follower)
        self._Ts = self._poses(q_follower)
        self._last_s = 0.0

    def resume(self, q_follower: Array) -> None:
        """Lead on from where the arms are."""
        self._hands = self._poses(q_follower)
        self._Ts = self._poses(q_follower)

    @property
    def hint(self) -> str:
        """Which hands turn instead of moving."""
        shifted = [shift.split("_")[0] for shift in SHIFTS if shift in self._actions]
        return f"{' and '.join(shifted)} hand: up, down, turn" if shifted else ""

    def read(self, now_s: float) -> LeaderSample | None:
        """Return the hands' goals; None once the gamepad is gone."""
        events = self._device.read()
        if events is None:
            return None
        pressed: list[Button] = []
        for event in events:
            pressed += self._take(event)
        step_s = min(max(now_s - self._last_s, 0.0), _STEP_MAX_S)
        self._last_s = now_s
        clutched = CLUTCH in self._actions
        if not clutched:
            for hand in range(len(SIDES)):
                self._move(hand, step_s)
        return LeaderSample(
            np.array([self._opening(hand) for hand in range(len(SIDES))]),
            Ts_world_tcp=[T.copy() for T in self._Ts],
            pressed=tuple(pressed),
            clutch=clutched,
        )

    def feedback(self, feedback: Feedback) -> None:
        """Remember where the hands are."""
        self._hands = self._poses(feedback.q)

    def close(self) -> None:
        """Release the gamepad."""
        self._device.close()

    def _take(self, event: Event) -> list[Button]:
        """Take an event; return the buttons that were pressed by it."""
        if event.code in self._mapping.axes:
            self._values[event.code] = event.value
            return []
        actions = self._mapping.buttons.get(event.code, "").split()
        if not event.value:
            self._actions -= set(actions)
            return []
        if STOP in actions:
            emergency.press("button of the gamepad")
        newly_pressed = [action for action in actions if action not in self._actions]
        self._actions |= set(actions)
        return [Button(action) for action in newly_pressed if action in list(Button)]

    def _deflection(self, code: str, motion: Motion) -> float:
        """Return how far an axis is pushed: -1 to 1 of a stick, 0 to 1 of a trigger."""
        value = self._values.get(code)
        if value is None:
            return 0.0
        lower, upper = self._device.ranges.get(code, _CENTRED)
        share = float(np.clip((value - lower) / max(upper - lower, 1e-9), 0.0, 1.0))
        if motion == "close":
            return share
        centred = 2.0 * share - 1.0
        dead = self._config.dead_zone
        beyond = max(abs(centred) - dead, 0.0) / (1.0 - dead)
        return float(np.copysign(beyond, centred))

    def _opening(self, hand: int) -> float:
        closed = 0.0
        for code, row in self._mapping.axes.items():
            if SIDES.index(row.hand) == hand and row.moves == "close":
                closed = max(closed, self._deflection(code, "close"))
        return 1.0 - closed

    def _rates(self, hand: int) -> Array:
        """Return how far the sticks push a hand (6,): along x, y, z and about them."""
        rates = np.zeros(6)
        is_shifted = SHIFTS[hand] in self._actions
        for code, row in self._mapping.axes.items():
            if SIDES.index(row.hand) != hand:
                continue
            motion = row.moves
            sign = row.sign
            if is_shifted and row.shifted is not None:
                motion = row.shifted
                sign = row.shifted_sign
            if motion != "close":
                rates[MOTIONS.index(motion)] += sign * self._deflection(code, motion)
        return np.clip(rates, -1.0, 1.0)

    def _move(self, hand: int, step_s: float) -> None:
        rates = self._rates(hand)
        T = self._Ts[hand]
        position_m = T[:3, 3] + step_s * self._config.speed_m_s * rates[:3]
        ahead_m = position_m - self._hands[hand][:3, 3]
        distance_m = float(np.linalg.norm(ahead_m))
        if distance_m > _AHEAD_MAX_M and rates[:3].any():
            position_m = self._hands[hand][:3, 3] + ahead_m * (_AHEAD_MAX_M / distance_m)
        T[:3, 3] = position_m
        turn = Rotation.from_rotvec(step_s * self._config.turn_rad_s * rates[3:]).as_matrix()
        T[:3, :3] = turn @ T[:3, :3]
