"""Strict, atomic controller switching: exactly one controller drives each joint.

After a switch the torque difference fades; after a halt it falls at the drives' rate limit.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from minidual.control.arbiter import ArbiterOutput
from minidual.control.commands import Command, Reason
from minidual.control.controllers import Controller
from minidual.control.joint_control import towards_torque
from minidual.errors import MinidualError, check_name
from minidual.robot.pair import SIDES, Array, Robot

_FADE_S = 0.1


class ControllerSwitchError(MinidualError):
    """A refused set; `name` is `unclaimed`, `doubly_claimed`, `not_ready`, `wrong_plant` or `under_way`."""

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
        self._swiftly = False
        self._tau_step = robot.tau_rate_max * dt_s
        self._offset: Array | None = None
        self.forbidden: Mapping[str, str] = {}
        """Why a controller cannot drive this plant, by name."""
        self.tau = np.zeros(robot.dof)
        """Last torques (n,) [Nm]."""

    def __getitem__(self, name: str) -> Controller:
        check_name("controller", name, self._all)
        return self._all[name]

    def check(self, names: Sequence[str]) -> tuple[Controller, ...]:
        """Return the named controllers.

        Raises:
            ControllerSwitchError: A joint is unclaimed or claimed twice, or a controller is not ready or not for
                this plant.
        """
        chosen = tuple(self[name] for name in names)
        for arm, side in enumerate(SIDES):
            claims = [controller.name for controller in chosen if arm in controller.arms]
            if not claims:
                raise ControllerSwitchError(
                    "unclaimed",
                    f"the {side} arm's joints would be left to nobody by ({', '.join(names)})",
                    remedy="name a whole set: both_arms; left_arm and right_arm; or object_impedance",
                )
            if len(claims) > 1:
                raise ControllerSwitchError(
                    "doubly_claimed",
                    f"the {side} arm's joints would be driven by {' and '.join(claims)}",
                )
        for controller in chosen:
            if controller.name in self.forbidden:
                raise ControllerSwitchError(
                    "wrong_plant",
                    f"controller {controller.name}: {self.forbidden[controller.name]}",
                    remedy="name both_arms, or left_arm and right_arm; "
                    "or drive a plant that takes torques, such as sim",
                )
            reason = controller.not_ready()
            if reason:
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
            self._swiftly = swiftly
        self._active = chosen
        self.active = tuple(names)
        self._claims = [
            (index, self._robot.joints_of(arm))
            for index, controller in enumerate(chosen)
            for arm in controller.arms
        ]

    def refuses(self, command: Command) -> Reason | None:
        """Return why a command is refused, or None."""
        for controller in self._active:
            if set(controller.arms) & set(command.arms):
                reason = controller.refuses(command)
                if reason is not None:
                    return reason
        return None

    def follow(self, output: ArbiterOutput) -> None:
        """Pass on the arbiter's output."""
        for controller in self._active:
            controller.follow(output)

    def update(self, q: Array, v: Array) -> Array:
        """Run one control step; return torques (n,) [Nm]."""
        tau = self._joined([controller.update(q, v) for controller in self._active])
        if self.fade_left:
            tau = self._faded(tau)
        self.tau = tau
        return tau

    @property
    def compliant(self) -> bool:
        """Whether an active controller lets its arms leave their reference."""
        return any(controller.compliant for controller in self._active)

    @property
    def reference(self) -> Array:
        """Last joint references (n,) [rad]."""
        return self._joined([controller.reference for controller in self._active])

    @property
    def acceleration(self) -> Array | None:
        """Last commanded reference acceleration (n,) [rad/s^2], or None."""
        parts: list[Array] = []
        for controller in self._active:
            if controller.acceleration is None:
                return None
            parts.append(controller.acceleration)
        return self._joined(parts)

    def _joined(self, parts: Sequence[Array]) -> Array:
        if len(parts) == 1:
            return parts[0]
        joined = np.empty(self._robot.dof)
        for k, joints in self._claims:
            joined[joints] = parts[k][joints]
        return joined

    def _faded(self, tau: Array) -> Array:
        if self._swiftly:
            reached = towards_torque(self.tau, tau, self._tau_step)
            if np.array_equal(reached, tau):
                self.fade_left = 0
            return reached
        if self._offset is None:
            self._offset = np.nan_to_num(self.tau - tau)
        share = self.fade_left / self._fade_steps
        self.fade_left -= 1
        return np.clip(tau + share * self._offset, -self._robot.tau_max, self._robot.tau_max)
