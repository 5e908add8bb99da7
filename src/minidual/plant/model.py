"""Compile the MuJoCo model: two arms from the URDF, torque motors, grippers, table, rod, cameras, sensors."""

from __future__ import annotations

import mujoco
import numpy as np

from minidual.config.scene import SceneConfig
from minidual.plant.bodies import contact_sensor, free_bodies
from minidual.robot.arms import DUAL_PANDA
from minidual.robot.description import never_touching, pair_urdf
from minidual.robot.pair import Robot
from minidual.robot.visuals import arm_visuals

GROUP_VISUAL, GROUP_COLLISION, GROUP_MARKER = 1, 3, 2
CAMERAS: tuple[str, ...] = ("high", "left", "right")
"""Cameras that are recorded, in the order of their storage; `overview` is for people."""

_URDF_COMPILER = (
    '<mujoco><compiler fusestatic="false" discardvisual="true" strippath="false"/></mujoco><link name="world"'
)
# Stiff contacts with little creep; see docs/simulation.md for the comparison of cone and impratio.
_SOLREF = [0.002, 1.0]
_SOLIMP = [0.99, 0.999, 0.001, 0.5, 2.0]
_FACE_MARGIN_M = 0.0002
"""Distance from which flat faces push. Pads press by micrometres, and between two parallel faces MuJoCo now and then
sees no contact for a step, in which the fingers leap; faces that never overlap do not show it. It makes a box wider by as
much on every side."""
_TABLE_HALF = (0.6, 0.8, 0.02)
_TABLE_CENTRE_X = 0.38
OBSTACLE = "obstacle"
"""Name of the geom that stands in the way, where a task has one."""
_BLUE = [0.10, 0.25, 0.75, 1.0]


def build_spec(scene: SceneConfig, robot: Robot = DUAL_PANDA, *, visuals: bool = True) -> mujoco.MjSpec:
    """Return the editable model of the whole scene.

    Args:
        scene: Physics, rod and task.
        robot: The two arms.
        visuals: Leave out the decimated visual meshes where nothing is rendered (faster to compile).
    """
    spec = mujoco.MjSpec.from_string(pair_urdf(robot).replace('<link name="world"', _URDF_COMPILER, 1))
    spec.modelname = "minidual"
    spec.compiler.discardvisual = False  # it would drop every geom that does not collide, ours included
    _set_options(spec, scene)
    _dress_arms(spec, scene, robot, visuals=visuals)
    _add_surroundings(spec, scene, robot)
    _add_rod(spec, scene)
    _add_actuators(spec, scene, robot)
    _add_cameras(spec, robot)
    _add_contact_sensors(spec, robot)
    return spec


def build_model(scene: SceneConfig, robot: Robot = DUAL_PANDA, *, visuals: bool = True) -> mujoco.MjModel:
    """Compile the scene; see `build_spec`."""
    return build_spec(scene, robot, visuals=visuals).compile()


def _set_options(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    option = spec.option
    option.timestep = scene.physics.timestep_s
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.impratio = scene.physics.impratio
    visual = spec.visual
    visual.global_.offwidth, visual.global_.offheight = 1920, 1080
    visual.quality.shadowsize = 1024  # shadows and multi-sampling cost more than pixels in software
    visual.quality.offsamples = 0
    visual.headlight.ambient = [0.35, 0.35, 0.36]
    visual.headlight.diffuse = [0.35, 0.35, 0.35]
    visual.headlight.specular = [0.1, 0.1, 0.1]
    visual.map.znear = 0.02


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
        for body in spec.bodies:
            if not body.name.startswith(f"{arm}_"):
                continue
            for index, geom in enumerate(body.geoms):
                geom.name = f"{body.name}_collision{index}"
                geom.group = GROUP_COLLISION
                geom.rgba = [0.6, 0.6, 0.65, 1.0]
                if body.name in fingers and abs(geom.pos[2] - robot.hand.pad_height_m) < 1e-6:
                    geom.name = f"{body.name}_pad"
                    geom.condim = 4
                    geom.friction = [scene.rod.friction, 0.01, 0.0001]
                    geom.solref, geom.solimp = _SOLREF, _SOLIMP
        for first, second in never_touching(robot.arm):
            spec.add_exclude(bodyname1=f"{arm}_{first}", bodyname2=f"{arm}_{second}")
    if not visuals:
        return
    for index, mesh in enumerate(arm_visuals(robot.arm)):
        name = f"visual{index}_{mesh.link}"
        spec.add_mesh(name=name, uservert=mesh.vertices.ravel(), userface=mesh.faces.ravel())
        for arm in robot.sides:
            spec.body(f"{arm}_{mesh.link}").add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=name,
                rgba=list(mesh.rgba),
                group=GROUP_VISUAL,
                contype=0,
                conaffinity=0,
                density=0.0,
            )


def _add_surroundings(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98],
        rgb2=[0.62, 0.70, 0.80],
        width=64,
        height=384,
    )
    world = spec.worldbody
    world.add_light(
        name="key",
        pos=[0.9, 0.7, 2.0],
        dir=[-0.35, -0.4, -1.0],
        castshadow=True,
        diffuse=[0.55, 0.55, 0.53],
        specular=[0.2, 0.2, 0.2],
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
    )
    world.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[4, 4, 0.1],
        pos=[0, 0, -0.75],
        rgba=[0.80, 0.82, 0.85, 1],
        contype=0,
        conaffinity=0,
    )
    table = world.add_body(name="table", pos=[_TABLE_CENTRE_X, 0.0, -_TABLE_HALF[2]])
    table.add_geom(
        name="table_top",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=list(_TABLE_HALF),
        rgba=[0.42, 0.47, 0.50, 1],
        friction=[scene.rod.friction, 0.005, 0.0001],
        solref=_SOLREF,
        solimp=_SOLIMP,
    )
    for x in (-1, 1):
        for y in (-1, 1):
            table.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER,
                size=[0.03, 0.355, 0],
                rgba=[0.25, 0.27, 0.3, 1],
                pos=[x * (_TABLE_HALF[0] - 0.06), y * (_TABLE_HALF[1] - 0.06), -0.375],
                contype=0,
                conaffinity=0,
            )
    for arm in robot.sides:
        spec.add_exclude(bodyname1="table", bodyname2=f"{arm}_{robot.arm.base_link}")  # the bases stand on it
    rod = scene.rod
    for label, xy, yaw, rgba in (
        ("start", scene.task.start_xy_m, 0.0, [0.85, 0.87, 0.9, 1.0]),
        ("goal", scene.task.goal_xy_m, scene.task.goal_yaw_rad, [0.15, 0.62, 0.35, 1.0]),
    ):
        world.add_geom(
            name=f"{label}_mark",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[xy[0], xy[1], 0.0003],
            rgba=rgba,
            size=[1.6 * rod.half_width_m, rod.length_m / 2 + 0.01, 0.0003],
            contype=0,
            conaffinity=0,
            group=GROUP_MARKER,
            quat=_about_z(yaw),
        )
    obstacle = scene.task.obstacle
    if obstacle is not None:
        x, y, z = obstacle.size_m
        world.add_geom(
            name=OBSTACLE,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            size=[x / 2, y / 2, z / 2],
            rgba=[0.75, 0.22, 0.2, 1.0],
            pos=[*obstacle.xy_m, z / 2],
        )


def _about_z(yaw_rad: float) -> list[float]:
    return [float(np.cos(yaw_rad / 2.0)), 0.0, 0.0, float(np.sin(yaw_rad / 2.0))]


def _add_rod(spec: mujoco.MjSpec, scene: SceneConfig) -> None:
    """The rod's own y axis is its long axis; its body frame sits at the centre of mass."""
    rod = scene.rod
    body = spec.worldbody.add_body(name="rod", pos=[*scene.task.start_xy_m, rod.rest_height_m])
    body.add_freejoint(name=f"{body.name}_free")
    along_y = [np.sqrt(0.5), -np.sqrt(0.5), 0.0, 0.0]
    if rod.shape == "cylinder":
        shape = {"type": mujoco.mjtGeom.mjGEOM_CYLINDER, "quat": along_y}
        condim = 6  # with rolling friction: a cylinder without it rolls away untouched
        margin = 0.0
        size, band = [rod.radius_m, rod.length_m / 2, 0], [rod.radius_m + 0.0006, 0.015, 0]
    else:
        shape = {"type": mujoco.mjtGeom.mjGEOM_BOX}
        condim = 4  # a face does not roll, and its many contact points would fight over it
        margin = _FACE_MARGIN_M
        size = [rod.width_m / 2, rod.length_m / 2, rod.height_m / 2]
        band = [rod.width_m / 2 + 0.0006, 0.015, rod.height_m / 2 + 0.0006]
    body.add_geom(
        name="rod",
        size=size,
        mass=rod.mass_kg,
        rgba=list(rod.colour),
        condim=condim,
        friction=[rod.friction, 0.01, rod.rolling_friction],
        solref=_SOLREF,
        solimp=_SOLIMP,
        margin=margin,
        **shape,
    )
    # Bands show where the hands belong and give the camera something to tell the rod's ends by.
    for sign in (-1, 1):
        body.add_geom(
            size=band,
            pos=[0, sign * rod.grasp_offset_m, 0],
            rgba=_BLUE,
            mass=0,
            contype=0,
            conaffinity=0,
            group=GROUP_VISUAL,
            **shape,
        )


def _add_actuators(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    for name, limit in zip(robot.joint_names, robot.tau_max.tolist(), strict=True):
        motor = spec.add_actuator(name=f"{name}_motor", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_motor()
        motor.ctrlrange, motor.ctrllimited = [-limit, limit], True
        motor.forcerange, motor.forcelimited = [-limit, limit], True
    physics = scene.physics
    for name in robot.finger_joint_names:
        servo = spec.add_actuator(name=f"{name}_servo", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        servo.set_to_position(kp=physics.finger_kp_n_per_m, kv=physics.finger_kv_ns_per_m)
        # A target inside the object sets the pinch force, so the range reaches below closed.
        reach = physics.finger_force_max_n / physics.finger_kp_n_per_m
        servo.ctrlrange, servo.ctrllimited = [-reach, robot.hand.travel_m], True
        servo.forcerange = [-physics.finger_force_max_n, physics.finger_force_max_n]
        servo.forcelimited = True


def _look_at(position: tuple[float, float, float], target: tuple[float, float, float]) -> list[float]:
    """Return the quaternion wxyz of a camera (looks along -z, y up) that sees `target` upright."""
    z = np.subtract(position, target)
    z = z / np.linalg.norm(z)
    x = np.cross([0.0, 0.0, 1.0], z)
    x = x / np.linalg.norm(x)
    rotation = np.column_stack([x, np.cross(z, x), z])
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, rotation.ravel())
    return quat.tolist()


def _add_cameras(spec: mujoco.MjSpec, robot: Robot) -> None:
    high = (1.15, 0.0, 0.72)
    spec.worldbody.add_camera(name="high", pos=list(high), quat=_look_at(high, (0.44, 0.0, 0.07)), fovy=42.0)
    overview = (1.75, -0.95, 1.05)
    spec.worldbody.add_camera(
        name="overview", pos=list(overview), quat=_look_at(overview, (0.28, 0.0, 0.18)), fovy=40.0
    )
    for arm in robot.sides:
        tilt = robot.hand.camera_tilt_rad
        about_y = [np.cos(tilt / 2), 0.0, np.sin(tilt / 2), 0.0]
        about_z = [np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)]
        quat = np.empty(4)
        mujoco.mju_mulQuat(quat, np.array(about_y), np.array(about_z))
        palm = spec.body(f"{arm}_{robot.hand.palm_link}")
        palm.add_camera(name=arm, pos=list(robot.hand.camera_position_m), quat=quat.tolist(), fovy=62.0)


def _add_contact_sensors(spec: mujoco.MjSpec, robot: Robot) -> None:
    """One net wrench a finger and object, of the finger on it: force (3,), torque (3,), point (3,), world axes."""
    fields = mujoco.mjtConDataField
    data = sum(1 << int(f) for f in (fields.mjCONDATA_FORCE, fields.mjCONDATA_TORQUE, fields.mjCONDATA_POS))
    netforce = 3
    for name in [body.name for body in free_bodies(spec)]:
        for side in robot.sides:
            for finger in robot.hand.finger_links:
                spec.add_sensor(
                    name=contact_sensor(name, side, finger),
                    type=mujoco.mjtSensor.mjSENS_CONTACT,
                    objtype=mujoco.mjtObj.mjOBJ_BODY,
                    objname=f"{side}_{finger}",
                    reftype=mujoco.mjtObj.mjOBJ_BODY,
                    refname=name,
                    intprm=[data, netforce, 1],
                )
