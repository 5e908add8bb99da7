"""Compile the MuJoCo model, and find its joints: ids and names are unreliable, `actuator_trnid` is not."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import numpy.typing as npt

from minidual.config.scene import SceneConfig
from minidual.errors import UsageError
from minidual.plant.bodies import contact_sensor
from minidual.plant.scenery import GROUP_VISUAL, INTANGIBLE, SOLIMP, SOLREF, add_objects, add_surroundings, marks
from minidual.robot.description import arm_visuals, mujoco_urdf, never_touching
from minidual.robot.pair import DUAL_PANDA, Array, Robot

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


GROUP_COLLISION = 3
CAMERAS: tuple[str, ...] = ("high", "left", "right")
"""Recorded cameras, in storage order; `overview` is not recorded."""

_MARGIN_DEG = 8.0


def build_spec(scene: SceneConfig, robot: Robot = DUAL_PANDA, *, visuals: bool = True) -> mujoco.MjSpec:
    """Return the editable model; it compiles faster without `visuals`."""
    spec = mujoco.MjSpec.from_string(mujoco_urdf(robot))
    spec.modelname = "minidual"
    spec.compiler.discardvisual = False  # keep the non-colliding geoms added here
    spec.option.timestep, spec.option.impratio = scene.physics.timestep_s, scene.physics.impratio
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    _dress_arms(spec, scene, robot, visuals=visuals)
    add_surroundings(spec, scene, robot)
    add_objects(spec, scene)
    _add_actuators(spec, scene, robot)
    _add_cameras(spec, scene, robot)
    _add_contact_sensors(spec, scene, robot)
    return spec


def build_model(scene: SceneConfig, robot: Robot = DUAL_PANDA, *, visuals: bool = True) -> mujoco.MjModel:
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
                    geom.friction = [scene.object.friction, 0.01, 0.0001]
                    geom.solref, geom.solimp = SOLREF, SOLIMP
        for first, second in never_touching(robot.arm):
            spec.add_exclude(bodyname1=f"{arm}_{first}", bodyname2=f"{arm}_{second}")
    for index, (link, vertices, faces, rgba) in enumerate(arm_visuals(robot.arm) if visuals else ()):
        name = f"visual{index}_{link}"
        spec.add_mesh(name=name, uservert=vertices.ravel(), userface=faces.ravel())
        looks = {"type": mujoco.mjtGeom.mjGEOM_MESH, "meshname": name, "rgba": rgba, "group": GROUP_VISUAL}
        for arm in robot.sides:
            spec.body(f"{arm}_{link}").add_geom(**looks, **INTANGIBLE, density=0.0)


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
        # The pinch force comes from a target inside the object, so the range extends below closed.
        reach = physics.finger_force_max_n / physics.finger_kp_n_per_m
        servo.ctrlrange, servo.ctrllimited = [-reach, robot.hand.travel_m], True
        servo.forcerange = [-physics.finger_force_max_n, physics.finger_force_max_n]
        servo.forcelimited = True


def _facing(position: tuple[float, float, float], target: tuple[float, float, float]) -> Array:
    """Return the axes (3, 3) of an upright camera facing `target`."""
    z: Array = np.subtract(position, target)
    z /= np.linalg.norm(z)
    x: Array = np.array([-z[1], z[0], 0.0])
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z], dtype=np.float64).T


def _opening_deg(scene: SceneConfig, position: tuple[float, float, float], R: Array, usual_deg: float) -> float:
    """Return the usual vertical opening, or one that has all marks well in the picture."""
    ends = [(m, x, y) for m in marks(scene) for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    corners = np.array([(m.xy_m[0] + x * m.size_m[0], m.xy_m[1] + y * m.size_m[1], 0.0) for m, x, y in ends])
    right, up, back = ((corners - position) @ R).T
    tangents = np.abs([right * scene.camera.height_px / scene.camera.width_px, up]) / -back
    needed_deg = float(2.0 * np.degrees(np.arctan(tangents.max())))
    return usual_deg if needed_deg <= usual_deg else needed_deg + _MARGIN_DEG


def _add_cameras(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    for name, position, target, fovy in (
        ("high", (1.15, 0.0, 0.72), (0.44, 0.0, 0.07), 42.0),
        ("overview", (1.75, -0.95, 1.05), (0.28, 0.0, 0.18), 40.0),
    ):
        R, quat = _facing(position, target), np.empty(4)
        mujoco.mju_mat2Quat(quat, R.ravel())
        opening = _opening_deg(scene, position, R, fovy) if name in CAMERAS else fovy
        spec.worldbody.add_camera(name=name, pos=position, quat=quat.tolist(), fovy=opening)
    cos, sin = np.cos(robot.hand.camera_tilt_rad / 2), np.sin(robot.hand.camera_tilt_rad / 2)
    quat = np.sqrt(0.5) * np.array([cos, sin, sin, cos])  # the tilt about y, then a quarter turn about z
    for arm in robot.sides:
        palm = spec.body(f"{arm}_{robot.hand.palm_link}")
        palm.add_camera(name=arm, pos=robot.hand.camera_position_m, quat=quat, fovy=62.0)


def _add_contact_sensors(spec: mujoco.MjSpec, scene: SceneConfig, robot: Robot) -> None:
    """Add each finger's net force (3,) on each object, world axes."""
    data, netforce = 1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3
    body = mujoco.mjtObj.mjOBJ_BODY
    kind = {"type": mujoco.mjtSensor.mjSENS_CONTACT, "objtype": body, "reftype": body, "intprm": [data, netforce, 1]}
    for name, side, finger in itertools.product(scene.objects, robot.sides, robot.hand.finger_links):
        spec.add_sensor(name=contact_sensor(name, side, finger), objname=f"{side}_{finger}", refname=name, **kind)
