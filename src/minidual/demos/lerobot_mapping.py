"""How the recorded fields map to LeRobot's keys: the names, and joining and parting the vectors.

=============================  ==========================================================================
LeRobot key                    from
=============================  ==========================================================================
``observation.state``          (16,) float32: ``observations/qpos`` (14), then ``observations/gripper`` (2)
``action``                     (16,) float32: ``action`` (14), then ``action_gripper`` (2)
``observation.images.cam_*``   ``observations/images/*`` as h264 video
``timestamp``                  LeRobot's own: tick / fps
=============================  ==========================================================================
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from minidual.demos import schema
from minidual.demos.lerobot_reader import IMAGE_PREFIX
from minidual.errors import DataError
from minidual.robot.constants import JOINT_NAMES

STATE_N = schema.JOINTS_N + schema.GRIPPERS_N

#: Names of the 16 values of state and action, in order.
STATE_NAMES: tuple[str, ...] = (*JOINT_NAMES, "left_gripper", "right_gripper")


def camera_key(camera: str) -> str:
    """Return the LeRobot key of a camera: ``high`` gives ``observation.images.cam_high``."""
    return f"{IMAGE_PREFIX}cam_{camera}"


def state_vector(qpos: NDArray[np.floating], gripper: NDArray[np.floating]) -> NDArray[np.float32]:
    """Join joints (..., 14) and grippers (..., 2) into LeRobot's state or action (..., 16) float32."""
    return np.concatenate([qpos, gripper], axis=-1).astype(np.float32)


def split_vector(vector: NDArray[np.floating]) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Part LeRobot's state or action (..., 16) into joints (..., 14) and grippers (..., 2)."""
    if vector.shape[-1] != STATE_N:
        raise DataError(f"state or action has {vector.shape[-1]} values; it must have {STATE_N}")
    return vector[..., : schema.JOINTS_N], vector[..., schema.JOINTS_N :]
