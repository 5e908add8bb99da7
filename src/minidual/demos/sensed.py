"""Forces of a tick: what episodes record, and what a policy may read beside joints and pictures.

All of them come from what the arms measure, never from the simulator's truth.
"""

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from minidual.control.stack import ControlStack
from minidual.errors import UsageError, shortened
from minidual.plant.protocol import Plant
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Array

SENSED = ("joint_torques", "external_torques", "hand_wrench", "internal_force")
"""Signals that a policy may read (`train.inputs`); the others of `teleop.signals` are no senses."""
_RANK_EPS = 1e-3
"""Keeps the wrench finite where a hand has lost a direction of motion."""
_WITHOUT = "train a policy without it: minidual train-act --force --set 'train.inputs=[]'"


class ForceReadings:
    """Reads the forces of the present tick.

    Args:
        stack: Whose plant and supervisor are read.
    """

    def __init__(self, stack: ControlStack[Plant]) -> None:
        self._stack = stack

    @cached_property
    def _kinematics(self) -> Kinematics:
        """Made when it is first needed: most policies read no forces."""
        return Kinematics(self._stack.plant.robot)

    def read(self, name: str) -> Array:
        """Return one of SENSED, with the shape of its row in the schema."""
        match name:
            case "joint_torques":
                return np.array(self._stack.plant.tau, dtype=float)
            case "external_torques":
                return self._stack.supervisor.observer.external.copy()
            case "hand_wrench":
                return self._wrenches()
            case "internal_force":
                return np.array(self._internal_force())
            case _:
                raise KeyError(name)

    def _wrenches(self) -> Array:
        """Return the wrench of contacts on each hand (2, 6) [N, Nm], at the tcp, world axes.

        It is what the external torques of the arm's joints mean at the hand, by damped least
        squares.
        """
        robot = self._kinematics.robot
        external_nm = self._stack.supervisor.touch
        wrenches = np.zeros((2, 6))
        for arm, J in enumerate(self._kinematics.tcp_jacobians(self._stack.plant.q)):
            own = robot.joints_of(arm)
            J_own = J[:, own]
            gram = J_own @ J_own.T + _RANK_EPS * np.eye(6)
            wrenches[arm] = np.linalg.solve(gram, J_own @ external_nm[own])
        return wrenches

    def _internal_force(self) -> float:
        """Return the force [N] of the hands on the object between them, 0 or more."""
        left, right = self._kinematics.tcp_poses(self._stack.plant.q)
        apart = left[:3, 3] - right[:3, 3]
        axis = apart / np.linalg.norm(apart)
        of_left, of_right = self._wrenches()[:, :3]
        return max(0.0, float(min(of_left @ axis, -(of_right @ axis))))


class SensedInputs:
    """Reads what a policy needs beside joints and pictures.

    Args:
        stack: Of the arms that the policy drives.
        inputs: {signal: entries}, in the order of the policy's state.

    Raises:
        UsageError: An input does not exist here, has other entries, or is not measured.
    """

    def __init__(self, stack: ControlStack[Plant], inputs: Mapping[str, int]) -> None:
        self._names = tuple(inputs)
        self._readings = ForceReadings(stack)
        if inputs:
            _require_torques(stack, self._names)
        for name, entries in inputs.items():
            if name not in SENSED:
                raise UsageError(
                    f"the policy reads '{name}', which these arms do not sense; "
                    f"they sense {', '.join(SENSED)}",
                    remedy=_WITHOUT,
                )
            here = self._readings.read(name).size
            if here != entries:
                raise UsageError(
                    f"the policy reads {entries} entries of '{name}'; these arms have {here}",
                    remedy="choose the arm that was recorded: --set robot.arm=NAME",
                )

    def read(self) -> Array:
        """Return all inputs of the present tick, one after the other."""
        values = [self._readings.read(name).ravel() for name in self._names]
        return np.concatenate([np.empty(0), *values])


def _require_torques(stack: ControlStack[Plant], names: tuple[str, ...]) -> None:
    """Refuse arms whose torques are not measured, or whose supervisor observes none."""
    inputs = shortened(names)
    try:
        torques = np.asarray(stack.plant.tau, dtype=float)
    except Exception as error:  # a plant raises anything
        reason = f"{type(error).__name__}: {error}"
        raise UsageError(
            f"the policy reads {inputs}, and the plant measures no joint torques ({reason})",
            remedy=_WITHOUT,
        ) from error
    if torques.shape != (stack.plant.robot.dof,) or not np.isfinite(torques).all():
        raise UsageError(
            f"the policy reads {inputs}, and the plant measures no joint torques ({torques})",
            remedy=_WITHOUT,
        )
    observed = [name for name in names if name != "joint_torques"]
    if observed and not stack.supervisor.observes:
        raise UsageError(
            f"the policy reads {shortened(observed)}, and no supervisor observes the arms' contacts",
            remedy="give the control stack a supervisor with bounds (docs/supervisor.md)",
        )
