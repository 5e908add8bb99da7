"""Compile the MuJoCo model: arms, surroundings, objects, motors, cameras, sensors."""

import itertools

import mujoco
import numpy as np

from minidual.config.scene import ObjectConfig, PartConfig, SceneConfig
from minidual.errors import UsageError
from minidual.plant.bodies import contact_sensor
from minidual.plant.cameras import add_cameras
from minidual.plant.contact import (
    FLAT,
    GROUP_COLLISION,
    GROUP_VISUAL,
    INTANGIBLE,
    ROUND,
    SOLIMP,
    SOLREF,
)
from minidual.plant.surroundings import add_surroundings
from minidual.robot.description import (
    beside_base,
    massless_links,
    mujoco_urdf,
    never_touching,
)
from minidual.robot.pair import DUAL_PANDA, Array, Robot
from minidual.robot.visuals import FACES_PER_ARM, arm_visuals

_BAND_M = 0.0006
"""Thickness of the coloured bands at the grasps."""
_BAND_HALF_LENGTH_M = 0.015
_BLUE = [0.10, 0.25, 0.75, 1.0]
_ALONG_Y = [np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]
_CONTACT_NET_FORCE = 3
"""`reduce` of MuJoCo's contact sensors: the net force of all contacts."""


def build_spec(
    scene: SceneConfig,
    robot: Robot = DUAL_PANDA,
    *,
    visuals: bool = True,
    faces_per_arm: int = FACES_PER_ARM,
) -> mujoco.MjSpec:
    """Return the editable model; it compiles faster without `visuals`."""
    spec = mujoco.MjSpec.from_string(mujoco_urdf(robot))
    spec.modelname = "minidual"
    spec.compiler.discardvisual = False  # keep the non-colliding geoms added here
    spec.option.timestep = scene.physics.timestep_s
    spec.option.impratio = scene.physics.impratio
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    _set_joints(spec, robot)
    _set_arm_geoms(spec, scene, robot)
    if visuals:
        _add_arm_visuals(spec, robot, faces_per_arm)
    add_surroundings(spec, scene, robot)
    _add_objects(spec, scene)
    _add_actuators(spec, scene, robot)
    add_cameras(spec, scene, robot)
    _add_contact_sensors(spec, scene, robot)
    return spec


def build_model(
    scene: SceneConfig,
    robot: Robot = DUAL_PANDA,
    *,
    visuals: bool = True,
) -> mujoco.MjModel:
    """Compile the scene; see `build_spec`.

    Raises:
        UsageError: MuJoCo refuses the description of an arm.
    """
    try:
        return build_spec(scene, robot, visuals=visuals).compile()
    except ValueError as error:  # MuJoCo's only kind of error
        reason = " ".join(str(error).split())
        raise UsageError(
            f"MuJoCo cannot build the arms '{robot.name}': {reason}",
            remedy="correct what it names in the URDF, or in its mesh",
        ) from error


def _set_joints(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Set rotor inertia and friction, which a URDF does not hold."""
    for side, arm in zip(robot.sides, robot.arms, strict=True):
        for name in arm.joints:
            joint = spec.joint(f"{side}_{name}")
            joint.armature = arm.armature
            joint.damping = [arm.damping, 0.0, 0.0]
            joint.frictionloss = arm.friction
    for name in robot.finger_joint_names:
        spec.joint(name).armature = robot.hand.finger_armature_kg


def _set_arm_geoms(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Name the collision geoms, set the finger pads' contact, exclude pairs that never touch."""
    massless = massless_links(robot)
    for side, arm in zip(robot.sides, robot.arms, strict=True):
        _, *fingers = robot.hand_links(side)
        bodies = [body for body in spec.bodies if body.name.startswith(f"{side}_")]
        for body in bodies:
            for index, geom in enumerate(body.geoms):
                geom.name = f"{body.name}_collision{index}"
                if body.name in massless:
                    geom.density = 0.0  # MuJoCo would give it the mass of its shape
                geom.group = GROUP_COLLISION
                geom.rgba = [0.6, 0.6, 0.65, 1.0]
                is_at_pad = abs(geom.pos[2] - robot.hand.pad_height_m) < 1e-6
                if body.name in fingers and is_at_pad:
                    geom.name = f"{body.name}_pad"
                    geom.condim = 4
                    geom.friction = [scene.object.friction, 0.01, 0.0001]
                    geom.solref = SOLREF
                    geom.solimp = SOLIMP
        excluded = {frozenset(pair): pair for pair in (*never_touching(arm), *beside_base(arm))}
        for first, second in excluded.values():
            spec.add_exclude(bodyname1=f"{side}_{first}", bodyname2=f"{side}_{second}")


def _add_arm_visuals(spec: mujoco.MjSpec, robot: Robot, faces_per_arm: int) -> None:
    visuals = [
        (sides, prefix, index, visual)
        for sides, prefix, arm in robot.distinct_arms()
        for index, visual in enumerate(arm_visuals(arm, faces_per_arm))
    ]
    for sides, prefix, index, visual in visuals:
        name = f"{prefix}visual{index}_{visual.link}"
        spec.add_mesh(
            name=name,
            uservert=visual.vertices.ravel(),
            userface=visual.faces.ravel(),
        )
        for side in sides:
            spec.body(f"{side}_{visual.link}").add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=name,
                rgba=visual.rgba,
                group=GROUP_VISUAL,
                density=0.0,
                **INTANGIBLE,
            )


def _add_objects(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """Add the objects as free bodies, frames at the centre of mass."""
    for item in scene.objects.values():
        xy_m = scene.task.start_xy_m if item.xy_m is None else item.xy_m
        body = spec.worldbody.add_body(name=item.name, pos=[*xy_m, item.rest_height_m])
        body.add_freejoint(name=f"{item.name}_free")
        for index, part in enumerate(item.solids):
            _add_part(body, item, part, index)
        if not item.parts:
            _add_grasp_bands(body, item)


def _add_part(body: mujoco.MjsBody, item: ObjectConfig, part: PartConfig, index: int) -> None:
    """Add a part of an object; the first one has the object's name and all its mass."""
    geom = body.add_geom(
        name=f"{item.name}_part{index}" if index else item.name,
        mass=0.0 if index else item.mass_kg,
        rgba=part.colour,
        pos=part.position_m,
    )
    _set_shape(geom, part, np.array(part.half_m))
    surface = ROUND if part.shape == "cylinder" else FLAT
    geom.condim = surface.condim
    geom.margin = surface.margin
    geom.solref = SOLREF
    geom.solimp = surface.solimp
    geom.friction = [item.friction, 0.01, item.rolling_friction]


def _add_grasp_bands(body: mujoco.MjsBody, item: ObjectConfig) -> None:
    """Mark the grasps of an object of one part, so that the camera sees its ends."""
    if not item.grasp_offset_m:
        return
    (part,) = item.solids
    long_axis = 2 if item.upright else 1
    half_m = np.array(part.half_m) + _BAND_M
    half_m[long_axis] = _BAND_HALF_LENGTH_M
    for offset_m in (-item.grasp_offset_m, item.grasp_offset_m):
        position_m = [0.0, 0.0, 0.0]
        position_m[long_axis] = offset_m
        geom = body.add_geom(
            pos=position_m,
            rgba=_BLUE,
            mass=0,
            group=GROUP_VISUAL,
            **INTANGIBLE,
        )
        _set_shape(geom, part, half_m)


def _set_shape(geom: mujoco.MjsGeom, part: PartConfig, half_m: Array) -> None:
    """Give a geom the shape of a part with these half extents (3,) [m]."""
    if part.shape == "box":
        geom.type = mujoco.mjtGeom.mjGEOM_BOX
        geom.size = half_m.tolist()
        return
    geom.type = mujoco.mjtGeom.mjGEOM_CYLINDER
    if part.axis == "z":
        geom.size = [half_m[0], half_m[2], 0.0]
    else:
        geom.quat = _ALONG_Y
        geom.size = [half_m[0], half_m[1], 0.0]


def _add_actuators(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Add a torque motor for each joint, and a position servo for each finger."""
    for name, limit_nm in zip(robot.joint_names, robot.tau_max.tolist(), strict=True):
        motor = spec.add_actuator(
            name=f"{name}_motor",
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
        )
        motor.set_to_motor()
        motor.ctrlrange = [-limit_nm, limit_nm]
        motor.ctrllimited = True
        motor.forcerange = [-limit_nm, limit_nm]
        motor.forcelimited = True
    physics = scene.physics
    force_max_n = physics.finger_force_max_n
    # The pinch force comes from a target inside the object, so the range extends below closed.
    beyond_closed_m = force_max_n / physics.finger_kp_n_per_m
    for name in robot.finger_joint_names:
        servo = spec.add_actuator(
            name=f"{name}_servo",
            target=name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
        )
        servo.set_to_position(kp=physics.finger_kp_n_per_m, kv=physics.finger_kv_ns_per_m)
        servo.ctrlrange = [-beyond_closed_m, robot.hand.travel_m]
        servo.ctrllimited = True
        servo.forcerange = [-force_max_n, force_max_n]
        servo.forcelimited = True


def _add_contact_sensors(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Add each finger's net force (3,) on each object, world axes."""
    force_alone = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE)
    for name, side, finger in itertools.product(
        scene.objects,
        robot.sides,
        robot.hand.finger_links,
    ):
        spec.add_sensor(
            name=contact_sensor(name, side, finger),
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=f"{side}_{finger}",
            reftype=mujoco.mjtObj.mjOBJ_BODY,
            refname=name,
            intprm=[force_alone, _CONTACT_NET_FORCE, 1],
        )
