"""Which controllers drive the joints: every joint by exactly one, at all times.

A switch names the whole new set. It is strict: a set that would leave a joint to nobody, or give it to two, or that
names a controller which is not ready, is refused by name and nothing changes. It is atomic: the next control step is
the new set's. What the torques differ by at that instant fades over `fade_s`, so that the motors see no jump; where it
must be gone sooner (a squeeze that has lost its object), as fast as the drives can change their torque.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import cast

import numpy as np

from minidual.control.command_checks import Fault
from minidual.control.commands import Command
from minidual.control.controllers import Controller
from minidual.control.execution import ArbiterOutput
from minidual.control.soft_stop import TorqueRate
from minidual.errors import MinidualError, unknown_name
from minidual.robot.pair import SIDES, Array, Robot


class ControllerSwitchError(MinidualError):
    """A set of controllers was refused; `name` says why: `unclaimed`, `doubly_claimed`, `not_ready`, `under_way`."""

    def __init__(self, name: str, message: str, *, remedy: str | None = None) -> None:
        super().__init__(f"{name}: {message}", remedy=remedy)
        self.name = name


class ControllerManager:
    """Holds all controllers and runs the active ones.

    Args:
        controllers: All that exist.
        dt_s: Control step.
        robot: The two arms.
        fade_s: How long the difference of the torques at a switch takes to fade.
    """

    def __init__(self, controllers: Sequence[Controller], dt_s: float, robot: Robot, *, fade_s: float = 0.1) -> None:
        self._robot = robot
        self._all = {c.name: c for c in controllers}
        self._active: tuple[Controller, ...] = ()
        self._whole: Controller | None = None
        self._fade_steps = max(1, round(fade_s / dt_s))
        self._fade_left = 0
        self._fading = False
        self._dt = dt_s
        self._rate: TorqueRate | None = None
        self._offset = np.zeros(robot.dof)
        self.tau = np.zeros(robot.dof)
        """Torques (n,) [Nm] of the last step."""

    @property
    def names(self) -> tuple[str, ...]:
        """All controllers."""
        return tuple(self._all)

    @property
    def active(self) -> tuple[str, ...]:
        """The controllers that drive now."""
        return tuple(c.name for c in self._active)

    def __getitem__(self, name: str) -> Controller:
        """Return a controller, or say which exist."""
        if name not in self._all:
            raise unknown_name("controller", name, self._all)
        return self._all[name]

    def check(self, names: Sequence[str]) -> tuple[Controller, ...]:
        """Return the set of controllers.

        Raises:
            UsageError: No controller has that name.
            ControllerSwitchError: The set leaves a joint to nobody or gives it to two, or one is not ready.
        """
        chosen = tuple(self[name] for name in names)
        for arm, arm_name in enumerate(SIDES):
            claims = [c.name for c in chosen if arm in c.arms]
            if not claims:
                raise ControllerSwitchError(
                    "unclaimed",
                    f"the {arm_name} arm's joints would be left to nobody by ({', '.join(names)})",
                    remedy="name a whole set: both_arms; left_arm and right_arm; or object_impedance",
                )
            if len(claims) > 1:
                raise ControllerSwitchError(
                    "doubly_claimed", f"the {arm_name} arm's joints would be driven by {' and '.join(claims)}"
                )
        for controller in chosen:
            reason = controller.not_ready()
            if reason:
                raise ControllerSwitchError("not_ready", f"controller {controller.name}: {reason}")
        return chosen

    def switch(self, names: Sequence[str], q: Array, v: Array, *, swiftly: bool = False) -> None:
        """Activate exactly these controllers at measured q (n,) and v (n,); all or nothing.

        `swiftly`: the torques go over at the drives' rate limit and do not fade.

        Raises:
            UsageError, ControllerSwitchError: See `check`; nothing has changed then.
        """
        chosen = self.check(names)
        had_any = bool(self._active)
        for controller in chosen:
            if controller not in self._active:
                controller.activate(q, v)
        if had_any and chosen != self._active:
            self._fade_left = self._fade_steps
            self._fading = False
            self._rate = TorqueRate(self.tau, self._dt, self._robot.arm.tau_rate_max) if swiftly else None
        self._active = chosen
        self._whole = chosen[0] if len(chosen) == 1 else None

    def find_fault(self, command: Command) -> Fault | None:
        """Return why the active controllers cannot take a command, or None."""
        for controller in self._active:
            if set(controller.arms) & set(command.arms):
                fault = controller.find_fault(command)
                if fault is not None:
                    return fault
        return None

    def follow(self, output: ArbiterOutput) -> None:
        """Give the active controllers what the arbiter let through."""
        for controller in self._active:
            controller.follow(output)

    def update(self, q: Array, v: Array) -> Array:
        """Run one control step; return torques (n,) [Nm], each joint's from the one controller that claims it."""
        tau = self._joined(lambda controller: controller.update(q, v))
        if self._fade_left:
            tau = self._faded(tau)
        self.tau = tau
        return tau

    @property
    def reference(self) -> Array:
        """Joint references (n,) [rad] of the last step."""
        return self._joined(lambda controller: controller.reference)

    @property
    def acceleration(self) -> Array | None:
        """Acceleration (n,) [rad/s^2] of the commanded reference in the last step, or None where there is none."""
        if any(controller.acceleration is None for controller in self._active):
            return None
        return self._joined(lambda controller: cast("Array", controller.acceleration))

    def _joined(self, part: Callable[[Controller], Array]) -> Array:
        """Return (n,) numbers, each joint's from the one controller that claims it."""
        if self._whole is not None:
            return part(self._whole)
        joined = np.empty(self._robot.dof)
        for controller in self._active:
            values = part(controller)
            for arm in controller.arms:
                joints = self._robot.joints_of(arm)
                joined[joints] = values[joints]
        return joined

    def _faded(self, tau: Array) -> Array:
        if self._rate is not None:
            followed = self._rate.limit(tau)
            if np.array_equal(followed, tau):
                self._rate, self._fade_left = None, 0
            return followed
        if not self._fading:
            self._offset = self.tau - tau
            self._fading = True
        share = self._fade_left / self._fade_steps
        self._fade_left -= 1
        return np.clip(tau + share * self._offset, -self._robot.tau_max, self._robot.tau_max)
