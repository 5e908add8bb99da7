"""Indices of joints in `qpos`, `qvel` and `ctrl`, mapped through `actuator_trnid`: ids and names are unreliable."""

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from minidual.errors import UsageError

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class JointAddresses:
    """Indices of joints, each (n,)."""

    qpos: IntArray
    qvel: IntArray
    ctrl: IntArray


def map_joints(model: mujoco.MjModel, names: Sequence[str], *, torque: bool) -> JointAddresses:
    """Return the addresses of `names`; require torque motors (gear x gain = 1) or position servos.

    Raises:
        UsageError: A joint or actuator is missing or of the other kind.
    """
    if model.nu == 0:
        raise UsageError(
            "the model has no actuators (model.nu == 0): URDF joints do not become actuators by themselves",
            remedy="add one motor a joint to the MuJoCo model",
        )
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    by_joint = np.flatnonzero(model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT))
    actuators = {model.joint(int(model.actuator_trnid[i, 0])).name: int(i) for i in by_joint}
    for table, kind in ((joints, "position"), (actuators, "actuator")):
        for name in names:
            if name not in table:
                known = ", ".join(sorted(table)[:8]) or "none at all"
                raise UsageError(
                    f"the model has no {kind} for joint '{name}'; it has {len(table)}: "
                    f"{known}{' ...' if len(table) > 8 else ''}",
                    remedy="check the joint's prefix, and that an actuator's transmission drives it",
                )
    index = np.array([joints[name] for name in names])
    addresses = JointAddresses(
        model.jnt_qposadr[index].astype(np.int64),
        model.jnt_dofadr[index].astype(np.int64),
        np.array([actuators[name] for name in names]),
    )
    for name, index in zip(names, addresses.ctrl, strict=True):
        is_servo = int(model.actuator_biastype[index]) != int(mujoco.mjtBias.mjBIAS_NONE)
        if is_servo == torque:
            have, need = ("a position servo", "a torque motor") if torque else ("a torque motor", "a position servo")
            raise UsageError(
                f"actuator '{model.actuator(int(index)).name}' of joint '{name}' is {have}; this needs {need}",
                remedy="a servo reads ctrl as a position, a motor as a torque: change the actuator, not the command",
            )
        if torque and float(model.actuator_gear[index, 0]) * float(model.actuator_gainprm[index, 0]) != 1.0:
            raise UsageError(f"actuator '{model.actuator(int(index)).name}' scales its torque; gear x gain must be 1")
    return addresses
