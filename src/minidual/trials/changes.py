"""Changes of the compiled model that conditions make, each by random draws of the trial.

A change takes (model, task, trial, rng) and, by keyword, its amounts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from minidual.config.scene import DISTRACTOR_HALF_M, DISTRACTORS, ObstacleConfig
from minidual.tasks.task import ObjectPose, Task, Trial, beside, placement
from minidual.trials.condition import Change

if TYPE_CHECKING:  # the table must be readable without importing MuJoCo
    import mujoco

type Amount = float | tuple[float, float]
"""A number, or the least and largest value of a draw."""

_HINGE = 3  # mujoco.mjtJoint.mjJNT_HINGE: arm joints; fingers slide
DRY_NM = 0.36
"""Coulomb friction of a Panda's joint [Nm], mean of seven: half of phi_1 (0.30 to 1.28 Nm) in
Gaz et al., IEEE RA-L 4(4), 2019."""
_SHADE = (0.6, 1.4)  # factors of an object's colour
# Discrete colours, unlike those of the trainer's augmentation.
OBJECT_COLOURS = (
    (0.78, 0.12, 0.12),
    (0.15, 0.55, 0.20),
    (0.50, 0.18, 0.60),
    (0.10, 0.65, 0.70),
    (0.88, 0.88, 0.86),
)
TABLE_COLOURS = (
    (0.60, 0.45, 0.30),
    (0.85, 0.85, 0.83),
    (0.18, 0.18, 0.20),
    (0.35, 0.50, 0.38),
    (0.28, 0.38, 0.56),
)
_BESIDE_M = (0.64, -0.35), (0.80, 0.35)  # least and largest (x, y) of the distractors' places
_DRAWS_MAX = 100


def in_turn(*changes: Change) -> Change:
    """Return the change that makes all of these, one after the other."""

    def change_all(
        model: mujoco.MjModel,
        task: Task,
        trial: Trial,
        rng: np.random.Generator,
    ) -> None:
        for change in changes:
            change(model, task, trial, rng)

    return change_all


def _drawn(rng: np.random.Generator, amount: Amount) -> float:
    if isinstance(amount, float | int):
        return amount
    return float(rng.uniform(*amount))


def mass(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
) -> None:
    """Scale the mass and inertia of every object."""
    for name in task.objects:
        body = model.body(name).id
        scale = _drawn(rng, factor)
        model.body_mass[body] *= scale
        model.body_inertia[body] *= scale


def size(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
) -> None:
    """Scale all objects alike, so that parts still fit, about where they stand.

    Frames and centres of mass stay.
    """
    scale = _drawn(rng, factor)
    for name in task.objects:
        body = model.body(name)
        rest_height_m = task.objects[name].body.rest_height_m
        height_m, up = _stands(trial.start[name], rest_height_m)
        geoms = model.geom_bodyid == body.id
        model.geom_pos[geoms] = scale * model.geom_pos[geoms] + (scale - 1.0) * height_m * up
        for values in (model.geom_size, model.geom_rbound, model.geom_aabb):
            values[geoms] *= scale
        first = model.body_bvhadr[body.id]
        boxes = slice(first, first + model.body_bvhnum[body.id])
        model.bvh_aabb[boxes, 3:] += 0.1  # too large a box loses no contact


def _stands(start: ObjectPose, rest_height_m: float) -> tuple[float, np.ndarray]:
    """Return the height [m] of an object's centre at its start, and the vertical (3,) there."""
    if isinstance(start, tuple):
        return rest_height_m, np.eye(3)[2]
    return start[2, 3], start[2, :3]


def friction(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    value: float,
) -> None:
    """Set the friction of objects, pads and table."""
    model.geom_friction[_rubbing(model, task), 0] = value


def slip(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
) -> None:
    """Scale the friction of objects, pads and table."""
    model.geom_friction[_rubbing(model, task), 0] *= _drawn(rng, factor)


def _rubbing(model: mujoco.MjModel, task: Task) -> list[int]:
    """Return the geoms of objects, pads and table.

    MuJoCo takes the larger friction of two geoms, so all must change.
    """
    objects = {int(model.body(name).id) for name in task.objects}
    geoms: list[int] = []
    for geom in range(model.ngeom):
        name = model.geom(geom).name
        of_an_object = int(model.geom_bodyid[geom]) in objects
        if of_an_object or name == "table_top" or name.endswith("_pad"):
            geoms.append(geom)
    return geoms


def joint_friction(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
    every: bool = False,
) -> None:
    """Scale the friction of every joint, or of one, another each trial.

    A joint without dry friction counts as one with `DRY_NM`.
    """
    hinges: list[int] = np.flatnonzero(model.jnt_type == _HINGE).tolist()
    if not every:
        hinges = [hinges[trial.index % len(hinges)]]
    for hinge in hinges:
        joint = model.joint(hinge)
        scale = _drawn(rng, factor)
        joint.damping[0] *= scale
        joint.frictionloss[0] = scale * (joint.frictionloss[0] or DRY_NM)


def light(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    factor: Amount,
) -> None:
    """Scale every light."""
    headlight = model.vis.headlight
    scale = _drawn(rng, factor)
    for values in (
        model.light_diffuse,
        model.light_specular,
        headlight.ambient,
        headlight.diffuse,
        headlight.specular,
    ):
        values *= scale


def camera_moved(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
    *,
    distance_m: Amount,
    angle_rad: Amount,
) -> None:
    """Shift and turn every camera of the room in a random direction."""
    import mujoco

    shift_m = _drawn(rng, distance_m)
    half_rad = _drawn(rng, angle_rad) / 2.0
    for camera in np.flatnonzero(model.cam_bodyid == 0):
        direction, axis = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
        model.cam_pos[camera] += shift_m * direction
        turn = np.r_[np.cos(half_rad), np.sin(half_rad) * axis]
        original = model.cam_quat[camera].copy()
        mujoco.mju_mulQuat(model.cam_quat[camera], turn, original)


def object_colour(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
) -> None:
    """Paint an object, not its bands; of several, change the shades."""
    if len(task.objects) == 1:
        model.geom(task.carried).rgba[:3] = OBJECT_COLOURS[rng.integers(len(OBJECT_COLOURS))]
        return
    for name in task.objects:
        rgba = model.geom(name).rgba
        rgba[:3] = np.minimum(1.0, rgba[:3] * rng.uniform(*_SHADE, 3))


def object_hidden(
    model: mujoco.MjModel,
    task: Task,
    trial: Trial,
    rng: np.random.Generator,
) -> None:
    """Make the objects invisible."""
    for name in task.objects:
        model.geom_rgba[model.geom_bodyid == model.body(name).id, 3] = 0.0


def table_colour(model: mujoco.MjModel, task: Task, trial: Trial, rng: np.random.Generator) -> None:
    """Paint the table."""
    model.geom("table_top").rgba[:3] = TABLE_COLOURS[rng.integers(len(TABLE_COLOURS))]


def distractors(model: mujoco.MjModel, task: Task, trial: Trial, rng: np.random.Generator) -> None:
    """Put the distractors before the camera, away from starts and goals."""
    for name in DISTRACTORS:
        geom = model.geom(name)
        yaw = rng.uniform(-np.pi, np.pi)
        x, y = _free_place(task, trial, rng)
        geom.pos[:] = x, y, DISTRACTOR_HALF_M
        geom.quat[:] = np.cos(yaw / 2.0), 0.0, 0.0, np.sin(yaw / 2.0)
        geom.rgba[:] = *OBJECT_COLOURS[rng.integers(len(OBJECT_COLOURS))], 1.0


def _free_place(task: Task, trial: Trial, rng: np.random.Generator) -> tuple[float, float]:
    """Draw a place (x, y) [m] of a distractor, the last draw if none of them is free."""
    size_m = 2.0 * DISTRACTOR_HALF_M
    x = y = np.nan
    for _ in range(_DRAWS_MAX):
        x, y = rng.uniform(*_BESIDE_M).tolist()
        block = ObstacleConfig(size_m=(size_m, size_m, size_m), xy_m=(x, y))
        if all(
            beside(task.objects[name].body, block, placement(pose))
            for poses in (trial.start, trial.goal)
            for name, pose in poses.items()
        ):
            break
    return x, y
