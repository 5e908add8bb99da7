"""The MuJoCo scene for mujoco_ros2_control: minidual's own world with position servos."""

import xml.etree.ElementTree as ET
from pathlib import Path

import mujoco
import numpy as np

from minidual.config.root import Config
from minidual.plant.cameras import CAMERAS
from minidual.plant.model import build_spec
from minidual.robot.pair import SIDES, Robot
from minidual.ros2.export.hardware import KEYFRAME
from minidual.ros2.export.markup import note
from minidual.ros2.export.meshes import MeshFiles
from minidual.ros2.names import workspace_names

FULL_TORQUE_ERROR_RAD = 0.02
"""Error at which a servo reaches its torque limit; its stiffness follows."""
_MESH_FOLDER = "../meshes/collision"


def scene_xml(robot: Robot, config: Config, meshes: MeshFiles, checked: str) -> str:
    """Return mjcf/scene.xml: arms, table, objects and cameras.

    The servos of ros2_control replace minidual's torque motors. MuJoCo cancels the arms' weight, as
    a Franka's controller does.
    """
    spec = build_spec(config.scene, robot)
    spec.modelname = workspace_names(robot).robot
    _replace_actuators(spec, robot)
    _couple_fingers(spec, robot)
    for body in spec.bodies:
        if body.name.startswith(tuple(f"{side}_" for side in SIDES)):
            body.gravcomp = 1.0
    images = config.scene.camera
    for camera in spec.cameras:
        if camera.name in CAMERAS:
            camera.resolution = [images.width_px, images.height_px]
    _add_home(spec, robot)
    root = ET.fromstring(spec.to_xml())
    _name_meshes(root, meshes)
    body = ET.tostring(root, encoding="unicode")
    return f"<!-- {note(checked)} -->\n{body}\n"


def _name_meshes(root: ET.Element, meshes: MeshFiles) -> None:
    """Point the meshes of the URDF to the package."""
    compiler = root.find("compiler")
    if compiler is None:
        compiler = ET.SubElement(root, "compiler")
    compiler.set("meshdir", _MESH_FOLDER)
    for mesh in root.iterfind("asset/mesh"):
        file = mesh.get("file")
        if file is not None:
            mesh.set("file", Path(meshes.place("collision", Path(file))).name)


def _replace_actuators(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Put a position servo on each joint; its actuator has the joint's name."""
    for name in robot.joint_names:
        spec.delete(spec.actuator(f"{name}_motor"))
    for k, name in enumerate(robot.joint_names):
        servo = spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        torque_nm = float(robot.tau_max[k])
        servo.set_to_position(kp=torque_nm / FULL_TORQUE_ERROR_RAD, dampratio=1.0)
        servo.ctrlrange = [float(robot.q_lower[k]), float(robot.q_upper[k])]
        servo.ctrllimited = True
        servo.forcerange = [-torque_nm, torque_nm]
        servo.forcelimited = True


def _couple_fingers(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Couple the second finger to the first, the only one with a servo."""
    for side in SIDES:
        leading, following = (f"{side}_{joint}" for joint in robot.hand.finger_joints)
        spec.delete(spec.actuator(f"{following}_servo"))
        spec.actuator(f"{leading}_servo").name = leading
        coupling = spec.add_equality(
            type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT,
            name1=following,
            name2=leading,
        )
        coupling.data[:5] = [0.0, 1.0, 0.0, 0.0, 0.0]


def _add_home(spec: mujoco.MjSpec, robot: Robot) -> None:
    """Add the keyframe of the home posture with open hands."""
    model = spec.compile()
    data = mujoco.MjData(model)
    for name, position_rad in zip(robot.joint_names, robot.home, strict=True):
        data.joint(name).qpos[0] = position_rad
    for name in robot.finger_joint_names:
        data.joint(name).qpos[0] = robot.hand.travel_m
    targets = np.array(
        [data.joint(model.actuator(k).name).qpos[0] for k in range(model.nu)],
    )
    spec.add_key(name=KEYFRAME, qpos=data.qpos.tolist(), ctrl=targets.tolist())
    spec.compile()
