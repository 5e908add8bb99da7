"""URDFs that users bring: each is handled, or refused by name with exit code 2."""

from __future__ import annotations

import dataclasses
import re
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.config.scene import RobotConfig, SceneConfig
from minidual.errors import UsageError
from minidual.plant.world import World
from minidual.robot import files
from minidual.robot.description import arm_elements, description_notes, massless_links
from minidual.robot.kinematics import Kinematics
from minidual.robot.models import PANDA, UR5, ArmModel
from minidual.robot.pair import Robot, robot_from
from minidual.robot.visuals import visual_parts
from minidual.stages.env_check.model import model_agreement
from minidual.stages.env_check.shapes import compare_shapes
from minidual.stages.registry import STAGES, TOOLS
from tests.support.urdf_files import (
    FOREARM_MESH,
    WRIST,
    Change,
    add_to_table,
    adding,
    changed_ur5,
    copied_mesh,
    mesh_file,
    part,
    removing,
    setting,
    text_changed_ur5,
)

UPPER_ARM_INERTIA = "link[@name='upper_arm_link']/inertial/inertia"


def both(*changes: Change) -> Change:
    def change(root: ET.Element, folder: Path) -> None:
        for one in changes:
            one(root, folder)

    return change


def package_of_meshes(root: ET.Element, folder: Path) -> None:
    """Name the forearm's mesh in a ROS package that lies beside the URDF."""
    source = mesh_file(root, FOREARM_MESH)
    target = folder / "my_description" / "meshes" / "forearm.stl"
    target.parent.mkdir(parents=True)
    target.write_bytes(source.read_bytes())
    part(root, FOREARM_MESH).set("filename", "package://my_description/meshes/forearm.stl")


HANDLED: dict[str, Change] = {
    "unbalanced inertia": setting(UPPER_ARM_INERTIA, ixx="0.01", iyy="0.01", izz="0.5"),
    "ASCII STL": copied_mesh("forearm_ascii.stl", "{path}", file_type="stl_ascii"),
    "COLLADA collision": copied_mesh("forearm.dae", "{path}"),
    "file:// mesh": copied_mesh("my forearm.stl", "file://{path}"),
    "relative mesh": copied_mesh("meshes/forearm.stl", "meshes/forearm.stl"),
    "relative mesh above": copied_mesh("forearm.stl", "../{path.parent.name}/forearm.stl"),
    "continuous with limits": setting(WRIST, type="continuous"),
    "continuous without limits": both(setting(WRIST, type="continuous"), removing(WRIST, "limit")),
    "wider limits": setting(f"{WRIST}/limit", lower="-9", upper="9", effort="300"),
    "no effort and velocity": setting(f"{WRIST}/limit", effort="0", velocity="0"),
    "mirrored mesh": setting(FOREARM_MESH, scale="1 -1 1"),
    "same file name twice": copied_mesh("other/wrist1.stl", "{path}"),
    "link without inertial": removing("link[@name='base_link']", "inertial"),
}
"""Changes after which the arm works, by name."""


def without(text: str, pattern: str, replacement: str = "") -> str:
    changed = re.sub(pattern, replacement, text, count=1, flags=re.DOTALL)
    assert changed != text
    return changed


def corrupt_mesh(content: bytes) -> Change:
    def change(root: ET.Element, folder: Path) -> None:
        path = folder / "broken.stl"
        path.write_bytes(content)
        part(root, FOREARM_MESH).set("filename", str(path))

    return change


def loop(root: ET.Element, folder: Path) -> None:
    part(root, "joint[@name='shoulder_pan_joint']/parent").set("link", "wrist_3_link")


REFUSED: dict[str, tuple[Change, str]] = {
    "xacro left": (setting(f"{WRIST}/limit", upper="${pi}"), r"xacro FILE\.xacro > FILE\.urdf"),
    "missing mesh": (
        setting(FOREARM_MESH, filename="/nowhere/forearm.stl"),
        r"link 'forearm_link'.*no file /nowhere/forearm\.stl",
    ),
    "missing relative mesh": (
        setting(FOREARM_MESH, filename="meshes/forearm.stl"),
        r"no file /.*meshes/forearm\.stl \(address 'meshes/forearm\.stl'\)",
    ),
    "ROS package": (
        package_of_meshes,
        r"where the package 'my_description'.*--set robot\.packages\.my_description=FOLDER",
    ),
    "unknown scheme": (
        setting(FOREARM_MESH, filename="model://ur5/forearm.stl"),
        r"no files are read from model://; there are package://",
    ),
    "unknown format": (
        copied_mesh("forearm.stl", "{path}.step"),
        r"no file .*forearm\.stl\.step",
    ),
    "corrupt mesh": (corrupt_mesh(b"solid cut off"), r"link 'forearm_link'.*broken\.stl"),
    "empty mesh": (corrupt_mesh(b""), r"link 'forearm_link'.*broken\.stl"),
    "scale of zero": (setting(FOREARM_MESH, scale="1 0 1"), r"scale 1 0 1; no factor may be 0"),
    "scale of two numbers": (setting(FOREARM_MESH, scale="1 1"), r"must hold 3 finite numbers"),
    "NaN": (setting(f"{WRIST}/origin", xyz="0 nan 0"), r"joint 'wrist_3_joint': <origin xyz="),
    "limit of 0 to 0": (
        setting(f"{WRIST}/limit", lower="0", upper="0"),
        r"'wrist_3_joint': the URDF's limits are 0 to 0 rad; the joint cannot move",
    ),
    "no limit": (removing(WRIST, "limit"), r"'wrist_3_joint' is revolute and has no <limit>"),
    "narrower limits": (
        setting(f"{WRIST}/limit", lower="-1", upper="1"),
        r"q_lower and q_upper are -6\.28\d* to 6\.28\d* rad, the URDF's limits -1 to 1 rad",
    ),
    "less effort": (
        setting(f"{WRIST}/limit", effort="5"),
        r"tau_max is 28 Nm, the URDF's effort 5",
    ),
    "less velocity": (setting(f"{WRIST}/limit", velocity="1"), r"v_max is 3\.2 rad/s"),
    "fixed joint": (setting(WRIST, type="fixed"), r"'wrist_3_joint' is fixed in the URDF"),
    "sliding joint": (setting(WRIST, type="prismatic"), r"'wrist_3_joint' is of type 'prismatic'"),
    "mimic": (
        adding(WRIST, "<mimic joint='wrist_2_joint'/>"),
        r"'wrist_3_joint' mimics 'wrist_2_joint'",
    ),
    "axis of zero": (setting(f"{WRIST}/axis", xyz="0 0 0"), r"axis of joint 'wrist_3_joint'"),
    "another moving joint": (
        setting("joint[@name='wrist_3_link-tool0_fixed_joint']", type="continuous"),
        r"joint 'wrist_3_link-tool0_fixed_joint' moves between 'base_link' and 'tool0'",
    ),
    "no mass": (
        removing("link[@name='forearm_link']", "inertial"),
        r"joint 'elbow_joint' moves link 'forearm_link', which has no mass",
    ),
    "negative mass": (
        setting("link[@name='forearm_link']/inertial/mass", value="-1"),
        r"link 'forearm_link': its mass is -1 kg",
    ),
    "negative inertia": (
        setting(UPPER_ARM_INERTIA, ixx="-0.1"),
        r"link 'upper_arm_link': a principal moment of its inertia is -0\.1",
    ),
    "two links of a name": (adding("", "<link name='forearm_link'/>"), "two links are named"),
    "joint without parent": (removing(WRIST, "parent"), "'wrist_3_joint' .*has no parent link"),
    "unknown parent": (
        setting(f"{WRIST}/parent", link="wrist_2_lnk"),
        r"no link \(of joint 'wrist_3_joint'\) 'wrist_2_lnk'.*did you mean 'wrist_2_link'",
    ),
    "two parents": (
        adding(
            "",
            "<joint name='x' type='fixed'><parent link='base_link'/><child link='tool0'/></joint>",
        ),
        "two joints move link 'tool0'",
    ),
    "loop": (loop, "hangs on itself; a URDF is a tree"),
}
"""Changes that are refused, and a pattern of the message, by name."""

ROWS: dict[str, tuple[dict[str, object], str]] = {
    "misspelt joint": (
        {"joints": (*UR5.joints[:5], "wrist_3_jiont")},
        r"no joint of arm 'own'.*'wrist_3_jiont'; there are.*did you mean 'wrist_3_joint'",
    ),
    "reordered joints": (
        {"joints": (*UR5.joints[:4], UR5.joints[5], UR5.joints[4])},
        r"`joints` is in another order than the URDF.*joints=\('shoulder_pan_joint'",
    ),
    "missing flange": ({"flange_link": "tool1"}, r"no link 'tool1'.*did you mean 'tool0'"),
    "missing SRDF": ({"srdf": "/nowhere/ur5.srdf"}, r"no file /nowhere/ur5\.srdf"),
    "missing URDF": ({"urdf": "/nowhere/ur5.urdf"}, r"no file /nowhere/ur5\.urdf"),
    "relative URDF": ({"urdf": "ur5.urdf"}, r"'ur5\.urdf' is no absolute path"),
}
"""Fields of an arm model that are refused."""

TEXTS = {
    "truncated": (lambda text: text[: len(text) // 2], r"line \d+, column \d+: this is no XML"),
    "xacro tag": (
        lambda text: text.replace("</robot>", "<xacro:ur5 prefix=''/></robot>"),
        r"holds <xacro:ur5>, which xacro replaces",
    ),
    "xacro tag without namespace": (
        lambda _: "<robot name='x'><xacro:include filename='y'/></robot>",
        r"run xacro first: xacro FILE\.xacro > FILE\.urdf",
    ),
    "web page": (lambda _: "<html></html>", r"begins with <html>; a URDF begins with <robot>"),
}


def env_check(tmp_path: Path, *words: str) -> int:
    options = ["--profile", "smoke", "--runs-dir", str(tmp_path / "runs"), "--json"]
    options += ["--set", "robot.arm=own", "--set", "env_check.sine_duration_s=2"]
    return run_command_line(["env-check", *options, *words], STAGES, TOOLS)


def assert_refused(
    arm: ArmModel,
    pattern: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    add_to_table(monkeypatch, arm)
    assert env_check(tmp_path) == 2
    message = " ".join(capsys.readouterr().err.split())
    assert re.search(pattern, message), message
    assert "pip install" not in message


@pytest.mark.parametrize("fault", REFUSED)
def test_a_fault_of_a_urdf_is_refused_by_name(
    fault: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    change, pattern = REFUSED[fault]
    assert_refused(changed_ur5(tmp_path, change), pattern, tmp_path, capsys, monkeypatch)


@pytest.mark.parametrize("fault", ROWS)
def test_a_fault_of_the_arm_model_is_refused_by_name(
    fault: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fields, pattern = ROWS[fault]
    arm = dataclasses.replace(changed_ur5(tmp_path, None), **fields)
    assert_refused(arm, pattern, tmp_path, capsys, monkeypatch)


@pytest.mark.parametrize("fault", TEXTS)
def test_a_file_that_is_no_urdf_is_refused_by_name(
    fault: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    change, pattern = TEXTS[fault]
    assert_refused(text_changed_ur5(tmp_path, change), pattern, tmp_path, capsys, monkeypatch)


@pytest.mark.parametrize("name", HANDLED)
def test_a_urdf_that_engines_read_differently_is_one_robot_for_both(
    name: str,
    tmp_path: Path,
) -> None:
    """Positions, inertia and bias agree, and so do the shapes that collide."""
    robot = Robot(changed_ur5(tmp_path, HANDLED[name]))
    world = World(SceneConfig(), robot)
    kinematics = Kinematics(robot)
    assert kinematics.model.nq == robot.dof
    assert np.allclose(kinematics.model.lowerPositionLimit, robot.q_lower, atol=1e-6)
    assert np.allclose(kinematics.model.upperPositionLimit, robot.q_upper, atol=1e-6)
    joints = [world.model.joint(joint) for joint in robot.joint_names]
    assert np.allclose([joint.range[0] for joint in joints], robot.q_lower, atol=1e-6)
    assert np.allclose([joint.range[1] for joint in joints], robot.q_upper, atol=1e-6)
    agreement = model_agreement(world, kinematics, np.random.default_rng(0), 3)
    assert max(agreement.values()) < 1e-10
    assert compare_shapes(world.model, robot).engines_max_m < 1e-5


@pytest.mark.slow
@pytest.mark.parametrize("name", HANDLED)
def test_a_urdf_that_is_handled_passes_env_check(
    name: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    add_to_table(monkeypatch, changed_ur5(tmp_path, HANDLED[name]))
    status = env_check(tmp_path)
    assert status == 0, capsys.readouterr().err


def test_the_setting_says_where_a_ros_package_lies(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    add_to_table(monkeypatch, changed_ur5(tmp_path, package_of_meshes))
    folder = tmp_path / "my_description"
    robot = robot_from(RobotConfig(arm="own", packages={"my_description": str(folder)}))
    meshes = [
        mesh.get("filename") for link in arm_elements(robot.arm) for mesh in link.iter("mesh")
    ]
    assert str(folder / "meshes" / "forearm.stl") in meshes
    wrong = robot_from(RobotConfig(arm="own", packages={"my_description": "/nowhere"}))
    with pytest.raises(UsageError, match=r"robot\.packages\.my_description: there is no folder"):
        arm_elements(wrong.arm)


def test_a_mended_inertia_is_noted(tmp_path: Path) -> None:
    robot = Robot(changed_ur5(tmp_path, HANDLED["unbalanced inertia"]))
    (note,) = description_notes(robot)
    assert "link 'upper_arm_link'" in note
    assert "0.01, 0.01, 0.5" in note
    assert description_notes(Robot(PANDA)) == ()


def test_a_link_without_inertial_has_no_mass(tmp_path: Path) -> None:
    robot = Robot(changed_ur5(tmp_path, HANDLED["link without inertial"]))
    assert "left_base_link" in massless_links(robot)
    world = World(SceneConfig(), robot)
    assert float(world.model.body("left_base_link").mass[0]) == 0.0


def test_a_mirrored_visual_keeps_its_outside(tmp_path: Path) -> None:
    """Volume by the divergence theorem: negative where the surface is inside out."""
    import trimesh

    visual = "link[@name='forearm_link']/visual/geometry/mesh"
    plain = changed_ur5(tmp_path, None, "plain")
    mirrored = changed_ur5(tmp_path, setting(visual, scale="1 -1 1"), "mirrored")

    def volume(arm: ArmModel) -> float:
        parts = [part for part in visual_parts(arm) if part.link == "forearm_link"]
        return sum(trimesh.Trimesh(p.vertices, p.faces).volume for p in parts)

    assert volume(plain) > 0.0
    assert volume(mirrored) == pytest.approx(volume(plain), rel=1e-3)


def test_the_unit_of_a_collada_file_counts(tmp_path: Path) -> None:
    def in_millimetres(root: ET.Element, folder: Path) -> None:
        import trimesh

        mesh = trimesh.load_mesh(mesh_file(root, FOREARM_MESH))
        mesh.apply_scale(1000.0)
        path = folder / "forearm_mm.dae"
        mesh.export(path)
        text = path.read_text(encoding="utf-8")
        unit = '<unit name="millimeter" meter="0.001"/>'
        text, count = re.subn(r"<unit[^>]*/>", unit, text, count=1)
        if not count:
            text = text.replace("</asset>", f"{unit}</asset>", 1)
        path.write_text(text, encoding="utf-8")
        part(root, FOREARM_MESH).set("filename", str(path))
        part(root, "link[@name='forearm_link']/visual/geometry/mesh").set("filename", str(path))

    def extent_m(arm: ArmModel) -> np.ndarray:
        parts = [part.vertices for part in visual_parts(arm) if part.link == "forearm_link"]
        return np.ptp(np.vstack(parts), axis=0)

    arm = changed_ur5(tmp_path, in_millimetres)
    assert extent_m(arm) == pytest.approx(extent_m(UR5), abs=0.01)
    robot = Robot(arm)
    world = World(SceneConfig(), robot, visuals=True)
    comparison = compare_shapes(world.model, robot)
    assert comparison.engines_max_m < 1e-5
    assert comparison.unlike == []


def test_primitive_visuals_and_inline_colours_are_drawn(tmp_path: Path) -> None:
    box = (
        "<visual><geometry><box size='0.1 0.1 0.3'/></geometry>"
        "<material name=''><color rgba='1 0 0 1'/></material></visual>"
    )
    link = "link[@name='forearm_link']"
    arm = changed_ur5(tmp_path, both(removing(link, "visual"), adding(link, box)))
    (drawn,) = [part for part in visual_parts(arm) if part.link == "forearm_link"]
    assert np.ptp(drawn.vertices, axis=0) == pytest.approx([0.1, 0.1, 0.3])
    assert drawn.rgba == (1.0, 0.0, 0.0, 1.0)


def test_an_arm_without_visuals_shows_what_collides(tmp_path: Path) -> None:
    def bare(root: ET.Element, folder: Path) -> None:
        for link in root.findall("link"):
            for visual in link.findall("visual"):
                link.remove(visual)

    arm = changed_ur5(tmp_path, bare)
    hand = {part.link for part in visual_parts(UR5)} - {
        link.attrib["name"] for link in ET.parse(files.file_at(arm.urdf)).getroot().iter("link")
    }
    assert {part.link for part in visual_parts(arm)} >= hand


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"q_lower": (0.0,) * 6}, "home -0.308 rad must lie between"),
        ({"v_max": (0.0,) * 6}, "v_max must be above 0"),
        ({"tau_max": (float("nan"),) * 6}, "tau_max is not finite"),
        ({"home": (0.0,) * 5}, "home has 5 of 6 entries"),
    ],
)
def test_impossible_numbers_of_an_arm_model_are_refused(
    fields: dict[str, tuple[float, ...]],
    message: str,
) -> None:
    with pytest.raises(ValueError, match=message):
        dataclasses.replace(UR5, **fields)
