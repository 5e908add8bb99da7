"""Compile the MuJoCo model: arms, table, marks, obstacle and objects; its look is in model.yaml.

Joints are found by `actuator_trnid`: ids and names are unreliable.
"""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
import numpy.typing as npt

from minidual.config.scene import (
    DISTRACTOR_HALF_M,
    DISTRACTORS,
    OBSTACLE,
    MarkConfig,
    PartConfig,
    SceneConfig,
)
from minidual.errors import UsageError
from minidual.plant.bodies import contact_sensor
from minidual.registry import rows_beside
from minidual.robot.description import arm_visuals, mujoco_urdf, never_touching
from minidual.robot.pair import DUAL_PANDA, Array, Robot

IntArray = npt.NDArray[np.int64]


class JointAddresses(NamedTuple):
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
        none = "the model has no actuators (model.nu == 0): URDF joints do not become actuators by themselves"
        raise UsageError(none, remedy="add one motor a joint to the MuJoCo model")
    joints = {model.joint(i).name: i for i in range(model.njnt)}
    by_joint = np.flatnonzero(model.actuator_trntype == int(mujoco.mjtTrn.mjTRN_JOINT))
    actuators = {model.joint(int(model.actuator_trnid[i, 0])).name: int(i) for i in by_joint}
    for table, kind in ((joints, "position"), (actuators, "actuator")):
        for name in names:
            if name not in table:
                known = ", ".join(sorted(table)[:8]) or "none at all"
                has = f"it has {len(table)}: {known}{' ...' if len(table) > 8 else ''}"
                remedy = "check the joint's prefix, and that an actuator's transmission drives it"
                raise UsageError(
                    f"the model has no {kind} for joint '{name}'; {has}",
                    remedy=remedy,
                )
    index = np.array([joints[name] for name in names])
    qpos, qvel = (
        addresses[index].astype(np.int64) for addresses in (model.jnt_qposadr, model.jnt_dofadr)
    )
    ctrl = np.array([actuators[name] for name in names])
    for name, index in zip(names, ctrl, strict=True):
        is_servo = int(model.actuator_biastype[index]) != int(mujoco.mjtBias.mjBIAS_NONE)
        if is_servo == torque:
            have, need = (
                ("a position servo", "a torque motor")
                if torque
                else ("a torque motor", "a position servo")
            )
            other = f"actuator '{model.actuator(int(index)).name}' of joint '{name}' is {have}; this needs {need}"
            remedy = "a servo reads ctrl as a position, a motor as a torque: change the actuator, not the command"
            raise UsageError(other, remedy=remedy)
        if (
            torque
            and float(model.actuator_gear[index, 0]) * float(model.actuator_gainprm[index, 0])
            != 1.0
        ):
            raise UsageError(
                f"actuator '{model.actuator(int(index)).name}' scales its torque; gear x gain must be 1",
            )
    return JointAddresses(qpos, qvel, ctrl)


_LOOK = rows_beside(__file__)
GROUP_VISUAL = 1
GROUP_MARKER = 2
GROUP_COLLISION = 3
GOAL_MARK = "goal_mark"
# Stiff contacts with little creep. Stiffer ones lose contact for single steps (docs/simulation.md).
SOLREF = [0.0025, 1.0]
SOLIMP = [0.985, 0.9985, 0.001, 0.5, 2.0]
# condim, margin, solimp. Flat faces share a load between many points, each so shallow that it parts at the slightest
# motion. Softer faces, whose contact begins 0.2 mm before they touch, do not let go (docs/simulation.md).
_ROUND = (6, 0.0, SOLIMP)
_FLAT = (4, 0.0002, [0.955, 0.9955, *SOLIMP[2:]])
_BAND_M = 0.0006
_TABLE_HALF_M = (0.6, 0.8, 0.02)
_TABLE_CENTRE_X_M = 0.38
_BOX = mujoco.mjtGeom.mjGEOM_BOX
_CYLINDER = mujoco.mjtGeom.mjGEOM_CYLINDER
INTANGIBLE: dict[str, int] = {"contype": 0, "conaffinity": 0}
_BLUE = [0.10, 0.25, 0.75, 1.0]
_ALONG_Y = [np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]
CAMERAS: tuple[str, ...] = ("high", "left", "right")
"""Recorded cameras, in storage order; `overview` is not recorded."""

_MARGIN_DEG = 8.0


def build_spec(
    scene: SceneConfig,
    robot: Robot = DUAL_PANDA,
    *,
    visuals: bool = True,
) -> mujoco.MjSpec:
    """Return the editable model; it compiles faster without `visuals`."""
    spec = mujoco.MjSpec.from_string(mujoco_urdf(robot))
    spec.modelname = "minidual"
    spec.compiler.discardvisual = False  # keep the non-colliding geoms added here
    spec.option.timestep = scene.physics.timestep_s
    spec.option.impratio = scene.physics.impratio
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    _dress_arms(spec, scene, robot, visuals=visuals)
    _add_surroundings(spec, scene, robot)
    _add_objects(spec, scene)
    _add_actuators(spec, scene, robot)
    _add_cameras(spec, scene, robot)
    _add_contact_sensors(spec, scene, robot)
    return spec


def build_model(
    scene: SceneConfig,
    robot: Robot = DUAL_PANDA,
    *,
    visuals: bool = True,
) -> mujoco.MjModel:
    """Compile the scene; see `build_spec`."""
    return build_spec(scene, robot, visuals=visuals).compile()


def _dress_arms(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot, *, visuals: bool) -> None:
    for name in robot.joint_names:
        joint = spec.joint(name)
        joint.armature = robot.arm.armature
        joint.damping = [robot.arm.damping, 0.0, 0.0]
        joint.frictionloss = robot.arm.friction
    for name in robot.finger_joint_names:
        spec.joint(name).armature = robot.hand.finger_armature_kg
    for arm in robot.sides:
        fingers = robot.hand_links(arm)[1:]
        for body in [body for body in spec.bodies if body.name.startswith(f"{arm}_")]:
            for index, geom in enumerate(body.geoms):
                geom.name = f"{body.name}_collision{index}"
                geom.group = GROUP_COLLISION
                geom.rgba = [0.6, 0.6, 0.65, 1.0]
                if body.name in fingers and abs(geom.pos[2] - robot.hand.pad_height_m) < 1e-6:
                    geom.name = f"{body.name}_pad"
                    geom.condim = 4
                    geom.friction = [scene.object.friction, 0.01, 0.0001]
                    geom.solref = SOLREF
                    geom.solimp = SOLIMP
        for first, second in never_touching(robot.arm):
            spec.add_exclude(bodyname1=f"{arm}_{first}", bodyname2=f"{arm}_{second}")
    for index, (link, vertices, faces, rgba) in enumerate(
        arm_visuals(robot.arm) if visuals else (),
    ):
        name = f"visual{index}_{link}"
        spec.add_mesh(name=name, uservert=vertices.ravel(), userface=faces.ravel())
        looks = {
            "type": mujoco.mjtGeom.mjGEOM_MESH,
            "meshname": name,
            "rgba": rgba,
            "group": GROUP_VISUAL,
        }
        for arm in robot.sides:
            spec.body(f"{arm}_{link}").add_geom(**looks, **INTANGIBLE, density=0.0)


def _add_surroundings(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Set the look; add everything but arms and objects."""
    for section, values in _LOOK["visual"].items():
        for name, value in values.items():
            setattr(getattr(spec.visual, section), name, value)
    world = spec.worldbody
    gradient = mujoco.mjtBuiltin.mjBUILTIN_GRADIENT
    spec.add_texture(type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, builtin=gradient, **_LOOK["sky"])
    world.add_light(type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL, **_LOOK["light"])
    world.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, **_LOOK["floor"], **INTANGIBLE)
    table = world.add_body(name="table", pos=[_TABLE_CENTRE_X_M, 0.0, -_TABLE_HALF_M[2]])
    top = table.add_geom(
        name="table_top",
        type=_BOX,
        size=list(_TABLE_HALF_M),
        rgba=[0.42, 0.47, 0.50, 1],
    )
    top.friction = [scene.object.friction, 0.005, 0.0001]
    top.solref = SOLREF
    top.solimp = SOLIMP
    for x, y in itertools.product((-1, 1), repeat=2):
        pos = [x * (_TABLE_HALF_M[0] - 0.06), y * (_TABLE_HALF_M[1] - 0.06), -0.375]
        table.add_geom(
            type=_CYLINDER,
            size=[0.03, 0.355, 0],
            rgba=[0.25, 0.27, 0.3, 1],
            pos=pos,
            **INTANGIBLE,
        )
    for arm in robot.sides:
        spec.add_exclude(
            bodyname1="table",
            bodyname2=f"{arm}_{robot.arm.base_link}",
        )  # the bases stand on it
    for fiducial in _LOOK["fiducials"]:
        world.add_geom(type=_BOX, group=GROUP_MARKER, **fiducial, **INTANGIBLE)
    for layer, mark in enumerate(marks(scene)):
        rgba = list(mark.colour)
        place = [*mark.xy_m, 0.0003 * (1 + (layer if scene.marks else 0))]
        geom = world.add_geom(
            name=mark.name,
            type=_BOX,
            pos=place,
            rgba=rgba,
            group=GROUP_MARKER,
            **INTANGIBLE,
        )
        half_x = mark.size_m[0] / 2
        half_y = mark.size_m[1] / 2
        geom.size = [half_x, half_y, 0.0003]
        geom.quat = [np.cos(mark.yaw_rad / 2.0), 0.0, 0.0, np.sin(mark.yaw_rad / 2.0)]
        if mark.round:
            geom.type = _CYLINDER
            geom.size = [half_x, 0.0003, 0.0]
    asked = scene.task
    for name, kind in zip(DISTRACTORS, (_BOX, _CYLINDER), strict=True):
        size = [DISTRACTOR_HALF_M] * 3
        world.add_geom(
            name=name,
            type=kind,
            size=size,
            pos=[_TABLE_CENTRE_X_M, 0, -0.3],
            rgba=[0] * 4,
            **INTANGIBLE,
        )
    if asked.obstacle is not None:
        size = np.array(asked.obstacle.size_m) / 2
        xy = asked.obstacle.xy_m
        world.add_geom(
            name=OBSTACLE,
            type=_BOX,
            size=size,
            rgba=[0.75, 0.22, 0.2, 1.0],
            pos=[*xy, size[2]],
        )


def marks(scene: SceneConfig) -> tuple[MarkConfig, ...]:
    """Return the scene's marks, by default those of start and goal."""
    if scene.marks:
        return scene.marks
    asked = scene.task
    part = scene.object.solids[0]
    size = 3.2 * part.half_m[0], 2.0 * part.half_m[1] + 0.02
    plate = part.shape == "cylinder" and part.axis == "z"
    start = asked.start_xy_m
    goal = asked.goal_xy_m
    pale = (0.85, 0.87, 0.9, 1.0)
    green = (0.15, 0.62, 0.35, 1.0)
    return (
        MarkConfig(name="start_mark", xy_m=start, size_m=size, round=plate, colour=pale),
        MarkConfig(
            name=GOAL_MARK,
            xy_m=goal,
            size_m=size,
            yaw_rad=asked.goal_yaw_rad,
            round=plate,
            colour=green,
        ),
    )


def _add_objects(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Add the objects as free bodies, frames at the centre of mass."""
    for item in scene.objects.values():
        xy_m = scene.task.start_xy_m if item.xy_m is None else item.xy_m
        body = spec.worldbody.add_body(name=item.name, pos=[*xy_m, item.rest_height_m])
        body.add_freejoint(name=f"{item.name}_free")
        for index, part in enumerate(item.solids):
            half = np.array(part.half_m)
            shape, size = _geom(part, half)
            # Rolling friction: without it a cylinder rolls away by itself. Faces do not roll; rolling friction at many
            # contact points over-constrains them.
            condim, margin, solimp = _ROUND if part.shape == "cylinder" else _FLAT
            name, mass = (f"{item.name}_part{index}", 0.0) if index else (item.name, item.mass_kg)
            geom = body.add_geom(
                name=name,
                size=size,
                mass=mass,
                rgba=part.colour,
                pos=part.position_m,
                **shape,
            )
            geom.condim = condim
            geom.margin = margin
            geom.solref = SOLREF
            geom.solimp = solimp
            geom.friction = [item.friction, 0.01, item.rolling_friction]
        if item.parts:
            continue
        # Bands mark the grasps and make the ends visible to the camera.
        (part,) = item.solids
        long = 2 if item.upright else 1
        half = np.array(part.half_m) + _BAND_M
        half[long] = 0.015
        shape, size = _geom(part, half)
        for offset in (-item.grasp_offset_m, item.grasp_offset_m) if item.grasp_offset_m else ():
            pos = [0.0, 0.0, offset] if item.upright else [0.0, offset, 0.0]
            body.add_geom(
                size=size,
                pos=pos,
                rgba=_BLUE,
                mass=0,
                group=GROUP_VISUAL,
                **shape,
                **INTANGIBLE,
            )


def _geom(part: PartConfig, half: Array) -> tuple[dict[str, Any], list[float]]:
    if part.shape == "box":
        return {"type": _BOX}, half.tolist()
    if part.axis == "z":
        return {"type": _CYLINDER}, [half[0], half[2], 0.0]
    return {"type": _CYLINDER, "quat": _ALONG_Y}, [half[0], half[1], 0.0]


def _add_actuators(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    for name, limit in zip(robot.joint_names, robot.tau_max.tolist(), strict=True):
        motor = spec.add_actuator(
            name=f"{name}_motor",
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
        )
        motor.set_to_motor()
        motor.ctrlrange = [-limit, limit]
        motor.ctrllimited = True
        motor.forcerange = [-limit, limit]
        motor.forcelimited = True
    physics = scene.physics
    for name in robot.finger_joint_names:
        servo = spec.add_actuator(
            name=f"{name}_servo",
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
        )
        servo.set_to_position(kp=physics.finger_kp_n_per_m, kv=physics.finger_kv_ns_per_m)
        # The pinch force comes from a target inside the object, so the range extends below closed.
        reach = physics.finger_force_max_n / physics.finger_kp_n_per_m
        servo.ctrlrange = [-reach, robot.hand.travel_m]
        servo.ctrllimited = True
        servo.forcerange = [-physics.finger_force_max_n, physics.finger_force_max_n]
        servo.forcelimited = True


def _facing(position: tuple[float, float, float], target: tuple[float, float, float]) -> Array:
    """Return the axes (3, 3) of an upright camera facing `target`."""
    z: Array = np.subtract(position, target)
    z /= np.linalg.norm(z)
    x: Array = np.array([-z[1], z[0], 0.0])
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z], dtype=np.float64).T


def _opening_deg(
    scene: SceneConfig,
    position: tuple[float, float, float],
    R: Array,
    usual_deg: float,
) -> float:
    """Return the usual vertical opening, or one that has every start and goal well in the picture, and what stands there."""
    reach = 2.0 * max(scene.task.start_range_m, scene.task.goal_range_m)
    top_m = 2.0 * scene.object.rest_height_m
    ends = np.array([(x, y) for x in (-0.5, 0.5) for y in (-0.5, 0.5)])
    places = [np.add(m.xy_m, ends * np.add(m.size_m, reach)) for m in marks(scene)]
    corners = np.vstack([np.insert(place, 2, z, axis=1) for place in places for z in (0.0, top_m)])
    right, up, back = ((corners - position) @ R).T
    tangents = np.abs([right * scene.camera.height_px / scene.camera.width_px, up]) / -back
    needed_deg = float(2.0 * np.degrees(np.arctan(tangents.max())))
    return usual_deg if needed_deg <= usual_deg else needed_deg + _MARGIN_DEG


def _add_cameras(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    for name, (position, target, fovy) in _LOOK["cameras"].items():
        R = _facing(position, target)
        quat = np.empty(4)
        mujoco.mju_mat2Quat(quat, R.ravel())
        opening = _opening_deg(scene, position, R, fovy) if name in CAMERAS else fovy
        spec.worldbody.add_camera(name=name, pos=position, quat=quat.tolist(), fovy=opening)
    cos = np.cos(robot.hand.camera_tilt_rad / 2)
    sin = np.sin(robot.hand.camera_tilt_rad / 2)
    quat = np.sqrt(0.5) * np.array(
        [cos, sin, sin, cos],
    )  # the tilt about y, then a quarter turn about z
    for arm in robot.sides:
        palm = spec.body(f"{arm}_{robot.hand.palm_link}")
        palm.add_camera(name=arm, pos=robot.hand.camera_position_m, quat=quat, fovy=62.0)


def _add_contact_sensors(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Add each finger's net force (3,) on each object, world axes."""
    data = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
    netforce = 3
    body = mujoco.mjtObj.mjOBJ_BODY
    kind = {
        "type": mujoco.mjtSensor.mjSENS_CONTACT,
        "objtype": body,
        "reftype": body,
        "intprm": [data, netforce, 1],
    }
    for name, side, finger in itertools.product(
        scene.objects,
        robot.sides,
        robot.hand.finger_links,
    ):
        spec.add_sensor(
            name=contact_sensor(name, side, finger),
            objname=f"{side}_{finger}",
            refname=name,
            **kind,
        )
