"""The weight in each hand: told, or learnt by a hand that holds still.

A hold raises a hand's weight until the reference is met:

    dF/dt = 2000 N/(m s) times how far the hand is below its reference,    0 <= F <= 30 N
"""

from collections.abc import Sequence

import numpy as np

from minidual.control.gripper import CLOSE_BELOW, GRAVITY_M_PER_S2, OPEN_ABOVE
from minidual.control.kernels import within
from minidual.errors import UsageError
from minidual.robot.kinematics import Hands, Kinematics
from minidual.robot.pair import SIDES, Array

LOAD_MAX_N = 30.0
"""The Panda's payload."""
_GAIN_N_PER_M_S = 2000.0  # slow beside the joints' stiffness, about 1.2 kN/m at a hand
_NEAR_M = 2e-4
_RAMP_N_PER_S = 100.0
_EVERY_S = 0.01  # a moving arm's Jacobian in each step makes the step a third longer


class Payload:
    """The load of each hand, for all controllers of a stack.

    Attributes:
        force_n: Weight in each hand [N] that controllers bear; changed in place.
        closed: Whether each hand is told to be closed.
        every: Steps from one update of a moving arm's torques to the next.
    """

    def __init__(self, kinematics: Kinematics, dt_s: float) -> None:
        self._robot = kinematics.robot
        self._hands = Hands(kinematics)
        self._dt = dt_s
        self.every = max(1, round(_EVERY_S / dt_s))
        self.force_n = [0.0] * len(SIDES)
        self.reset()

    def reset(self) -> None:
        """Start without loads, hands open."""
        self.force_n[:] = [0.0] * len(SIDES)
        self._goal_n = [0.0] * len(SIDES)
        self.closed = [False] * len(SIDES)
        self._holds = [False] * len(SIDES)

    def bear(self, arm: int, mass_kg: float, *, at_once: bool = False) -> None:
        """Say what a hand holds; borne at 100 N/s more each second, or `at_once` if another controller bore it.

        Raises:
            UsageError: No such arm, or a mass that it cannot bear.
        """
        weight_n = mass_kg * GRAVITY_M_PER_S2
        if not (arm in range(len(SIDES)) and 0.0 <= weight_n <= LOAD_MAX_N):
            most_kg = LOAD_MAX_N / GRAVITY_M_PER_S2
            raise UsageError(
                f"arm {arm} cannot bear {mass_kg} kg; arms 0 and 1 bear 0 to {most_kg:.2f} kg",
            )
        self._goal_n[arm] = weight_n
        if at_once:
            self.force_n[arm] = weight_n

    def follow(
        self,
        gripper: Array,
        lost: Sequence[bool],
        holds: Sequence[bool],
        *,
        stopped: bool,
    ) -> None:
        """Take commanded openings (2,), and which hands lost their grip or hold something.

        A hand that opens or has lost its object bears nothing; at once if the arms are `stopped`, whose
        torque rate is bounded. Only a hand that holds something learns a weight.
        """
        self._holds = holds
        for arm, opening in enumerate(gripper.tolist()):
            opens = self.closed[arm] and opening > OPEN_ABOVE
            if lost[arm] or opens:
                self._goal_n[arm] = 0.0
            if stopped and self._goal_n[arm] == 0.0:
                self.force_n[arm] = 0.0
            stays_closed = self.closed[arm] and opening <= OPEN_ABOVE
            self.closed[arm] = opening < CLOSE_BELOW or stays_closed

    def torque(self, q: Array, q_ref: Array, arms: Sequence[int], *, learn: bool) -> Array | None:
        """Return the torques (n,) [Nm] that bear these arms' loads, or None.

        Call it in each step with `learn` if the arms hold still, else in `every` so many.
        """
        if not learn and not any(self.force_n) and not any(self._goal_n):
            return None
        self._hands.update(q)
        tau = np.zeros(len(q))
        steps = 1 if learn else self.every
        ramp_n = _RAMP_N_PER_S * self._dt * steps
        for arm in arms:
            joints = self._robot.joints_of(arm)
            rise = self._hands.rise(arm)
            if learn and self._holds[arm]:
                below_m = float(rise @ (q_ref - q)[joints])
                self._learn(arm, below_m)
            force_n = self.force_n[arm]
            self.force_n[arm] = within(self._goal_n[arm], force_n - ramp_n, force_n + ramp_n)
            tau[joints] = self.force_n[arm] * rise
        return tau if any(self.force_n) else None

    def _learn(self, arm: int, below_m: float) -> None:
        if abs(below_m) > _NEAR_M:
            goal_n = self._goal_n[arm] + _GAIN_N_PER_M_S * self._dt * below_m
            self._goal_n[arm] = within(goal_n, 0.0, LOAD_MAX_N)
