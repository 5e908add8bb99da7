"""Turn a leader's readings into targets of the arms."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from minidual.config.leading import MirrorConfig
from minidual.config.learning import TeleopConfig
from minidual.demos.alignment import AlignmentGate, nearest_turn
from minidual.demos.hands import HandTracker
from minidual.demos.leader import Leader, LeaderSample
from minidual.demos.station import Button
from minidual.errors import UsageError
from minidual.robot.pair import Array, Robot, pose


def check_start(robot: Robot, config: MirrorConfig, q_leader: Array, q_follower: Array) -> None:
    """Raise UsageError if a joint of leader and follower differs by more than the limit."""
    difference = nearest_turn(leader_joints(robot, q_leader), q_follower) - q_follower
    worst = int(np.argmax(np.abs(difference)))
    limit = config.start_error_max_rad
    if abs(difference[worst]) > limit:
        joints_over_n = int(np.sum(np.abs(difference) > limit))
        raise UsageError(
            f"the leader starts {difference[worst]:+.3f} rad away from the follower "
            f"at {robot.joint_names[worst]} "
            f"({joints_over_n} of {robot.dof} joints over the limit of {limit} rad)",
            remedy=(
                "bring the leader to the follower's posture; "
                "check the joint order, the signs and the offsets"
            ),
        )


def leader_joints(robot: Robot, q_leader: Array) -> Array:
    """Return a leader's joints (n,) [rad] as numbers.

    Raises:
        UsageError: Another shape.
    """
    q = np.asarray(q_leader, dtype=float)
    if q.shape != (robot.dof,):
        raise UsageError(
            f"the leader gives joints of shape {q.shape}; "
            f"it must be ({robot.dof},), left then right",
        )
    return q


def _is_lost(q: Array) -> bool:
    """Return whether joints are no reading: NaN, infinite, or all zero."""
    return not np.isfinite(q).all() or not q.any()


class Mirrored(NamedTuple):
    """Targets of the arms.

    Attributes:
        target: Joints (n,) [rad].
        openings: Of the hands (2,).
        pressed: Buttons of the leader.
        age_s: See `LeaderSample`.
        clutch: Whether the leader moves without the arms.
    """

    target: Array
    openings: Array
    pressed: tuple[Button, ...]
    age_s: float | None
    clutch: bool = False


class Mirror:
    """Reads a leader for arms that begin at some posture.

    Attributes:
        gate: Decides whether the arms follow.
        leader: Who leads.
    """

    def __init__(self, leader: Leader, robot: Robot, config: TeleopConfig) -> None:
        self.leader = leader
        self._robot = robot
        self._config = config.mirror
        self.gate = AlignmentGate(robot, config.mirror)
        self._tracker = HandTracker(robot, config.mirror, 1.0 / config.rate_hz)
        self._Ts_offset = [np.eye(4), np.eye(4)]
        self._is_clutched = False

    def begin(self, q_follower: Array) -> None:
        """Start with arms that stand at (n,) [rad]."""
        self.gate.begin(q_follower)
        self._tracker.begin(q_follower)
        self._Ts_offset = [np.eye(4), np.eye(4)]
        self._is_clutched = False

    @property
    def hint(self) -> str:
        """Hints for a person about the leader and its hands."""
        return "; ".join(text for text in (self.leader.hint, self._tracker.hint) if text)

    def check_start(self, sample: LeaderSample) -> None:
        """Raise UsageError if a leader of joints begins elsewhere than the arms."""
        if sample.q is not None:
            check_start(self._robot, self._config, sample.q, self.gate.target)

    def read(self, now_s: float) -> Mirrored | None:
        """Return the newest target; None if the leader gives none."""
        return self._read(now_s, moves=True)

    def poll(self, now_s: float) -> Mirrored | None:
        """Compare the newest reading with the arms, which stay; see `read`."""
        return self._read(now_s, moves=False)

    def _read(self, now_s: float, *, moves: bool) -> Mirrored | None:
        sample = self.leader.read(now_s)
        if sample is None:
            return None
        if sample.q is not None:
            target = self._joint_target(sample, moves=moves)
        elif sample.Ts_world_tcp is not None:
            target = self._hand_target(sample, sample.Ts_world_tcp, moves=moves)
        else:
            raise UsageError("the leader gives neither joints nor hand poses")
        openings = np.clip(np.asarray(sample.openings, dtype=float), 0.0, 1.0)
        return Mirrored(target, openings, sample.pressed, sample.age_s, sample.clutch)

    def _joint_target(self, sample: LeaderSample, *, moves: bool) -> Array:
        q = leader_joints(self._robot, np.asarray(sample.q))
        if _is_lost(q):  # the arbiter refuses and names it
            return q
        if moves:
            return self.gate.admit(q, clutch=sample.clutch)
        self.gate.check(q, clutch=sample.clutch)
        return self.gate.target

    def _hand_target(
        self,
        sample: LeaderSample,
        Ts_world_tcp: Sequence[Array],
        *,
        moves: bool,
    ) -> Array:
        Ts = list(Ts_world_tcp)
        gate = self.gate
        if not all(np.isfinite(T).all() for T in Ts):
            return np.full(self._robot.dof, np.nan)
        if sample.clutch:
            self._is_clutched = True
            gate.is_open = False
            gate.held = "the clutch is held"
            return gate.target
        if self._is_clutched:
            self._is_clutched = False
            self._rebase(Ts)
        if not moves or not gate.is_open:
            self._check_hands(self._offset_poses(Ts))
        if moves and gate.is_open:
            gate.target = self._tracker.follow(self._offset_poses(Ts))
        return gate.target

    def _check_hands(self, Ts: list[Array]) -> None:
        """Open or close the gate by where the hands of the leader are."""
        q = self._tracker.joints_at(Ts)
        if q is None:
            self.gate.is_open = False
            self.gate.held = "the hands of the leader are out of the arms' reach"
            return
        self.gate.check(q)

    def _rebase(self, Ts: list[Array]) -> None:
        """Follow from where the hands are: translations add up, turns are of the world."""
        for arm, T_hand in enumerate(self._tracker.Ts_world_tcp):
            R = T_hand[:3, :3] @ Ts[arm][:3, :3].T
            self._Ts_offset[arm] = pose(R, T_hand[:3, 3] - Ts[arm][:3, 3])

    def _offset_poses(self, Ts: list[Array]) -> list[Array]:
        poses: list[Array] = []
        for T, T_offset in zip(Ts, self._Ts_offset, strict=True):
            position_m = T[:3, 3] + T_offset[:3, 3]
            poses.append(pose(T_offset[:3, :3] @ T[:3, :3], position_m))
        return poses
