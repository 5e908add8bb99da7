"""Strict, atomic controller switching: exactly one controller drives each joint.

After a switch the torque difference fades; after a halt it falls at the drives' rate limit.
"""

from collections.abc import Sequence

import numpy as np

from minidual.control.arbiter import ArbiterOutput
from minidual.control.commands import Command, Reason
from minidual.control.controllers import Controller
from minidual.control.soft_stop import TorqueRate
from minidual.errors import MinidualError, check_name
from minidual.robot.pair import SIDES, Array, Robot

_FADE_S = 0.1


class ControllerSwitchError(MinidualError):
    """A refused set; `name` is `unclaimed`, `doubly_claimed`, `not_ready` or `under_way`."""

    def __init__(self, name: str, message: str, *, remedy: str | None = None) -> None:
        super().__init__(f"{name}: {message}", remedy=remedy)
        self.name = name


class ControllerManager:
    """Runs the active controllers."""

    def __init__(self, controllers: Sequence[Controller], dt_s: float, robot: Robot) -> None:
        self._robot = robot
        self._all = {c.name: c for c in controllers}
        self._active: tuple[Controller, ...] = ()
        self.active: tuple[str, ...] = ()
        """Names."""
        self._dt = dt_s
        self._fade_steps = max(1, round(_FADE_S / dt_s))
        self.fade_left = 0
        self._rate: TorqueRate | None = None
        self._offset: Array | None = None
        self.tau = np.zeros(robot.dof)
        """Last torques (n,) [Nm]."""

    def __getitem__(self, name: str) -> Controller:
        check_name("controller", name, self._all)
        return self._all[name]

    def check(self, names: Sequence[str]) -> tuple[Controller, ...]:
        """Return the named controllers.

        Raises:
            ControllerSwitchError: A joint is unclaimed or claimed twice, or a controller is not ready.
        """
        chosen = tuple(self[name] for name in names)
        for arm, arm_name in enumerate(SIDES):
            if not (claims := [c.name for c in chosen if arm in c.arms]):
                left = (
                    f"the {arm_name} arm's joints would be left to nobody by ({', '.join(names)})"
                )
                remedy = "name a whole set: both_arms; left_arm and right_arm; or object_impedance"
                raise ControllerSwitchError("unclaimed", left, remedy=remedy)
            if len(claims) > 1:
                both = " and ".join(claims)
                raise ControllerSwitchError(
                    "doubly_claimed",
                    f"the {arm_name} arm's joints would be driven by {both}",
                )
        for controller in chosen:
            if reason := controller.not_ready():
                raise ControllerSwitchError("not_ready", f"controller {controller.name}: {reason}")
        return chosen

    def switch(self, names: Sequence[str], q: Array, v: Array, *, swiftly: bool = False) -> None:
        """Activate exactly these controllers at measured q, v (n,), or none of them if one raises.

        `swiftly`: change torques at the drives' rate limit instead of fading.
        """
        chosen = self.check(names)
        for controller in chosen:
            if controller not in self._active:
                controller.activate(q, v)
        if self._active and chosen != self._active:
            self.fade_left = self._fade_steps
            self._offset = None
            self._rate = (
                TorqueRate(self.tau, self._dt, self._robot.arm.tau_rate_max) if swiftly else None
            )
        self._active = chosen
        self.active = tuple(names)
        self._claims = [
            (k, self._robot.joints_of(arm)) for k, c in enumerate(chosen) for arm in c.arms
        ]

    def refuses(self, command: Command) -> Reason | None:
        """Return why a command is refused, or None."""
        of_arms = (c for c in self._active if set(c.arms) & set(command.arms))
        return next((reason for c in of_arms if (reason := c.refuses(command)) is not None), None)

    def follow(self, output: ArbiterOutput) -> None:
        """Pass on the arbiter's output."""
        for controller in self._active:
            controller.follow(output)

    def update(self, q: Array, v: Array) -> Array:
        """Run one control step; return torques (n,) [Nm]."""
        active = self._active
        tau = (
            active[0].update(q, v)
            if len(active) == 1
            else self._joined([one.update(q, v) for one in active])
        )
        if self.fade_left:
            tau = self._faded(tau)
        self.tau = tau
        return tau

    @property
    def reference(self) -> Array:
        """Last joint references (n,) [rad]."""
        return self._joined([controller.reference for controller in self._active])

    @property
    def acceleration(self) -> Array | None:
        """Last commanded reference acceleration (n,) [rad/s^2], or None."""
        if len(self._active) == 1:
            return self._active[0].acceleration
        parts = [a for controller in self._active if (a := controller.acceleration) is not None]
        return self._joined(parts) if len(parts) == len(self._active) else None

    def _joined(self, parts: Sequence[Array]) -> Array:
        if len(parts) == 1:
            return parts[0]
        joined = np.empty(self._robot.dof)
        for k, joints in self._claims:
            joined[joints] = parts[k][joints]
        return joined

    def _faded(self, tau: Array) -> Array:
        if self._rate is not None:
            followed = self._rate.limit(tau)
            if np.array_equal(followed, tau):
                self._rate = None
                self.fade_left = 0
            return followed
        if self._offset is None:
            self._offset = np.nan_to_num(self.tau - tau)
        share = self.fade_left / self._fade_steps
        self.fade_left -= 1
        return np.clip(tau + share * self._offset, -self._robot.tau_max, self._robot.tau_max)
