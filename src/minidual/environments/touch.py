"""Contacts and shapes for a batched judge: contact counts as sensors, and solids."""

import mujoco
import numpy as np

from minidual.config.scene import OBSTACLE, SceneConfig
from minidual.robot.pair import Array, Robot

_NOT_REDUCED = 0
"""`reduce` of MuJoCo's contact sensors: none."""
FIRST_TOUCH = "touch0"
"""Name of the first sensor that `add_touch_sensors` adds."""


def add_touch_sensors(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> int:
    """Count contacts: object with table, with each arm, and obstacle with anything; return how many counts.

    A trial's judge reads MuJoCo's list of contacts, which a batch does not give.
    """
    count = 1 << int(mujoco.mjtConDataField.mjCONDATA_FOUND)
    body = mujoco.mjtObj.mjOBJ_BODY
    below = mujoco.mjtObj.mjOBJ_XBODY
    name = scene.object.name
    rows: list[dict[str, object]] = [{"objtype": body, "objname": "table"}]
    for joint in robot.joint_names[:: robot.dof_per_arm]:
        link = spec.joint(joint).parent.name
        rows.append({"objtype": below, "objname": link})
    for row in rows:
        row.update(reftype=body, refname=name)
    if scene.task.obstacle is not None:
        rows.append({"objtype": mujoco.mjtObj.mjOBJ_GEOM, "objname": OBSTACLE})
    for index, row in enumerate(rows):
        spec.add_sensor(
            name=f"touch{index}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            intprm=[count, _NOT_REDUCED, 1],
            **row,
        )
    return len(rows)


def solids_of(model: mujoco.MjModel, scene: SceneConfig, body: int) -> Array:
    """Return the rows (k, 8) of the object's parts, see `tasks.truth.ObjectTruth`."""
    first = int(model.body_geomadr[body])
    rows: list[list[float]] = []
    for geom, part in enumerate(scene.object.solids, first):
        position_m = model.geom_pos[geom].tolist()
        rows.append([*position_m, *part.half_m, part.shape == "cylinder", "xyz".index(part.axis)])
    return np.array(rows, dtype=float)
