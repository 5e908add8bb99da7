"""Addresses of joints and their actuators in a MuJoCo model.

Actuators are found by the joint that they drive (`actuator_trnid`): ids and names are unreliable.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from minidual.errors import UsageError

IntArray = npt.NDArray[np.int64]

_NAMES_SHOWN = 8


class JointAddresses(NamedTuple):
    """Indices of joints, each (n,)."""

    qpos: IntArray
    qvel: IntArray
    ctrl: IntArray


def map_joints(model: mujoco.MjModel, names: Sequence[str], *, torque: bool) -> JointAddresses:
    """Return the addresses of the joints `names`.

    Args:
        model: Compiled model.
        names: Joints, in the order of the addresses.
        torque: Whether to require torque motors with gear x gain = 1, or position servos.

    Raises:
        UsageError: A joint or actuator is missing or of the other kind.
    """
    if model.nu == 0:
        raise UsageError(
            "the model has no actuators (model.nu == 0): "
            "URDF joints do not become actuators by themselves",
            remedy="add one motor a joint to the MuJoCo model",
        )
    joint_ids = {model.joint(i).name: i for i in range(model.njnt)}
    actuator_ids = _actuators_by_joint(model)
    for name in names:
        _require(name, joint_ids, "position")
    for name in names:
        _require(name, actuator_ids, "actuator")
    joints = np.array([joint_ids[name] for name in names])
    actuators = np.array([actuator_ids[name] for name in names])
    for name, actuator in zip(names, actuators.tolist(), strict=True):
        _require_kind(model, name, actuator, torque=torque)
    return JointAddresses(
        model.jnt_qposadr[joints].astype(np.int64),
        model.jnt_dofadr[joints].astype(np.int64),
        actuators,
    )


def _actuators_by_joint(model: mujoco.MjModel) -> dict[str, int]:
    """Return the ids of the actuators by the name of the joint that they drive."""
    drives_joint = model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT)
    ids: dict[str, int] = {}
    for actuator in np.flatnonzero(drives_joint).tolist():
        joint = int(model.actuator_trnid[actuator, 0])
        ids[model.joint(joint).name] = actuator
    return ids


def _require(name: str, ids: Mapping[str, int], kind: str) -> None:
    """Raise UsageError unless there is a joint or actuator of this name."""
    if name in ids:
        return
    existing = ", ".join(sorted(ids)[:_NAMES_SHOWN]) or "none at all"
    more = " ..." if len(ids) > _NAMES_SHOWN else ""
    raise UsageError(
        f"the model has no {kind} for joint '{name}'; it has {len(ids)}: {existing}{more}",
        remedy="check the joint's prefix, and that an actuator's transmission drives it",
    )


def _require_kind(model: mujoco.MjModel, joint: str, actuator: int, *, torque: bool) -> None:
    """Raise UsageError unless an actuator is a torque motor (of gear x gain 1) or a servo."""
    name = model.actuator(actuator).name
    is_servo = int(model.actuator_biastype[actuator]) != int(mujoco.mjtBias.mjBIAS_NONE)
    if is_servo == torque:
        kinds = ("a torque motor", "a position servo")
        actual = kinds[is_servo]
        needed = kinds[not is_servo]
        raise UsageError(
            f"actuator '{name}' of joint '{joint}' is {actual}; this needs {needed}",
            remedy="a servo reads ctrl as a position, a motor as a torque: "
            "change the actuator, not the command",
        )
    gear = float(model.actuator_gear[actuator, 0])
    gain = float(model.actuator_gainprm[actuator, 0])
    if torque and gear * gain != 1.0:
        raise UsageError(f"actuator '{name}' scales its torque; gear x gain must be 1")
