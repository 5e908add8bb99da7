"""Write the workspace: which file has what content, and how it was checked."""

import shutil
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from minidual.config.root import Config
from minidual.durable import replacing
from minidual.errors import UsageError
from minidual.plant.cameras import CAMERAS
from minidual.robot.files import file_at, packages_of
from minidual.robot.pair import Robot
from minidual.ros2.export import controllers, moveit, templates
from minidual.ros2.export.description import arm_macro, pair_xacro, urdf
from minidual.ros2.export.hardware import hardware_names, hardware_xacro
from minidual.ros2.export.markup import NOT_RUN, xacro, xml_text, yaml_text
from minidual.ros2.export.meshes import MeshFiles
from minidual.ros2.export.rviz import rviz_config
from minidual.ros2.export.scene import scene_xml
from minidual.ros2.export.semantic import srdf, unchecked_pairs
from minidual.ros2.names import FORWARD_CONTROLLER, PackageNames, workspace_names

CAMERA_HZ = 30.0
_SOURCE = "src"
"""Folder of the packages in a workspace."""
_URDF_CHECK = "every body, inertia and limit against Pinocchio and MuJoCo, to 1e-9"
_XACRO_CHECK = "expanded by xacro, against the URDF"
_HARDWARE_CHECK = "expanded by xacro; plugins and parameters against their sources"
_SCENE_CHECK = "loaded and driven in MuJoCo"
_SRDF_CHECK = "links and joints against the URDF, pairs against minidual's planner"
_NAMES_CHECK = "parameter names against the sources of MoveIt 2 and ros2_control"
_FREE_CHECK = "values against minidual's configuration; no program of ROS reads it"


class WrittenFile(NamedTuple):
    """A file of the workspace.

    Attributes:
        path: Below the workspace.
        text: Its content.
        checked: How it was checked without ROS.
    """

    path: str
    text: str
    checked: str


class Export(NamedTuple):
    """The written workspace.

    Attributes:
        folder: The workspace.
        packages: Names of its packages.
        files: Files with text, README without.
        meshes_n: Number of mesh files.
        pairs_n: Number of pairs of links whose collisions are allowed.
    """

    folder: Path
    packages: tuple[str, ...]
    files: tuple[WrittenFile, ...]
    meshes_n: int
    pairs_n: int


def export_workspace(robot: Robot, config: Config, folder: Path) -> Export:
    """Write the workspace into a folder that does not exist yet.

    Raises:
        UsageError: The folder exists and is not empty, or its parent does not exist.
    """
    _check_target(folder)
    names = workspace_names(robot)
    meshes = MeshFiles(names.description)
    files = (
        *_description_files(robot, config, names, meshes),
        *_moveit_files(robot, config, names),
        *_bringup_files(robot, config, names),
    )
    pairs_n = sum(1 for _ in unchecked_pairs(robot))
    if folder.exists():
        folder.rmdir()
    with replacing(folder) as partial:
        partial.mkdir()
        for file in files:
            path = partial / file.path
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(file.text, encoding="utf-8")
        description = partial / _SOURCE / names.description
        mesh_places = meshes.copy_to(description)
        licences = _copy_licences(robot, description)
        text = templates.readme(
            names=names,
            arms=[arm.name for arm in robot.arms],
            not_run=NOT_RUN,
            pairs_n=pairs_n,
            hardware=hardware_names(robot),
            forward=FORWARD_CONTROLLER,
            rows=files,
            sources=sorted({*(arm.urdf for arm in robot.arms), robot.hand.urdf}),
            licences=licences,
        )
        (partial / "README.md").write_text(text, encoding="utf-8")
    return Export(folder, names.packages, files, len(mesh_places), pairs_n)


def _check_target(folder: Path) -> None:
    if folder.is_file() or (folder.is_dir() and any(folder.iterdir())):
        raise UsageError(
            f"--out {folder} exists and is not empty",
            remedy="name a new folder, or remove this one",
        )
    parent = folder.absolute().parent
    if not parent.is_dir():
        raise UsageError(f"there is no folder {parent}", remedy="make it first")


def _description_files(
    robot: Robot,
    config: Config,
    names: PackageNames,
    meshes: MeshFiles,
) -> Iterator[WrittenFile]:
    place = f"{_SOURCE}/{names.description}"
    package, _, _ = templates.packages(robot, names)
    yield from _package_files(place, package)
    documents = {
        f"{names.robot}.urdf": (urdf(robot, meshes, names), _URDF_CHECK),
        **{
            f"{arm.name}_arm.xacro": (arm_macro(arm, meshes), _XACRO_CHECK)
            for arm in dict.fromkeys(robot.arms)
        },
        f"{names.robot}.urdf.xacro": (
            pair_xacro(robot, names, hardware_names(robot)),
            _XACRO_CHECK,
        ),
        f"{names.robot}.ros2_control.xacro": (hardware_xacro(robot, names), _HARDWARE_CHECK),
    }
    for file, (root, checked) in documents.items():
        yield WrittenFile(f"{place}/urdf/{file}", xml_text(root, checked), checked)
    scene = scene_xml(robot, config, meshes, _SCENE_CHECK)
    yield WrittenFile(f"{place}/mjcf/scene.xml", scene, _SCENE_CHECK)


def _moveit_files(robot: Robot, config: Config, names: PackageNames) -> Iterator[WrittenFile]:
    place = f"{_SOURCE}/{names.moveit}"
    _, package, _ = templates.packages(robot, names)
    yield from _package_files(place, package)
    place = f"{place}/config"
    root = _including(f"$(find {names.description})/urdf/{names.robot}.urdf.xacro", names)
    yield WrittenFile(
        f"{place}/{names.robot}.urdf.xacro",
        xml_text(root, _XACRO_CHECK),
        _XACRO_CHECK,
    )
    yield WrittenFile(
        f"{place}/{names.robot}.srdf",
        xml_text(srdf(robot, names), _SRDF_CHECK),
        _SRDF_CHECK,
    )
    documents = {
        "kinematics.yaml": moveit.kinematics(),
        "joint_limits.yaml": moveit.joint_limits(robot, config),
        "ompl_planning.yaml": moveit.ompl_planning(),
        "pilz_industrial_motion_planner_planning.yaml": moveit.pilz_planning(),
        "pilz_cartesian_limits.yaml": moveit.pilz_limits(config),
        "moveit_controllers.yaml": moveit.switching_controllers(),
        "moveit_simple_controllers.yaml": moveit.fixed_controllers(robot),
        "moveit.rviz": rviz_config(CAMERAS),
    }
    for file, document in documents.items():
        yield WrittenFile(f"{place}/{file}", yaml_text(document, _NAMES_CHECK), _NAMES_CHECK)


def _bringup_files(robot: Robot, config: Config, names: PackageNames) -> Iterator[WrittenFile]:
    place = f"{_SOURCE}/{names.bringup}"
    *_, package = templates.packages(robot, names)
    yield from _package_files(place, package)
    documents = {
        "ros2_controllers.yaml": controllers.simulated_controllers(robot, config),
        "mujoco_plugins.yaml": controllers.camera_plugin(CAMERAS, CAMERA_HZ),
    }
    if "franka" in hardware_names(robot):
        documents["ros2_controllers_real.yaml"] = controllers.real_controllers(robot, config)
    for file, document in documents.items():
        text = yaml_text(document, _NAMES_CHECK)
        yield WrittenFile(f"{place}/config/{file}", text, _NAMES_CHECK)
    text = yaml_text(controllers.impedance_parameters(config), _FREE_CHECK)
    yield WrittenFile(f"{place}/config/impedance_params.yaml", text, _FREE_CHECK)
    for name in templates.LAUNCH_FILES:
        text = templates.launch_file(name, robot, names)
        yield WrittenFile(f"{place}/launch/{name}.launch.py", text, templates.launch_check())


def _package_files(place: str, package: templates.Package) -> Iterator[WrittenFile]:
    checked = templates.PACKAGE_CHECK
    yield WrittenFile(f"{place}/package.xml", templates.package_xml(package), checked)
    yield WrittenFile(f"{place}/CMakeLists.txt", templates.cmake_lists(package), checked)


def _including(file: str, names: PackageNames) -> ET.Element:
    """Return a xacro file that only includes another one."""
    root = ET.Element("robot", name=names.robot)
    ET.SubElement(root, xacro("include"), filename=file)
    return root


def _copy_licences(robot: Robot, folder: Path) -> list[str]:
    """Copy the licence texts that lie above the descriptions; return their names."""
    copied: dict[str, Path] = {}
    for arm in robot.arms:
        for address in (arm.urdf, arm.hand.urdf):
            for above in file_at(address, packages_of(arm.packages)).parents[:3]:
                licence = above / "LICENSE"
                if licence.is_file():
                    copied[f"LICENSE.{above.name}"] = licence
                    break
    for name, source in copied.items():
        shutil.copyfile(source, folder / name)
    return [f"{_SOURCE}/{folder.name}/{name}" for name in copied]
