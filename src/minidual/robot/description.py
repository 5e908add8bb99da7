"""The one description of the robot: a URDF of two Pandas, made from the pip-installed `panda_description`.

The same string feeds MuJoCo (`minidual.plant`) and Pinocchio (`minidual.robot.kinematics`), so the two cannot
drift apart. Links and joints carry the prefixes `left_` and `right_`; both bases are fixed to the link `world`.
"""

from __future__ import annotations

import copy
import functools
import importlib.metadata
import xml.etree.ElementTree as ET
from pathlib import Path

from minidual.errors import EnvironmentMissingError
from minidual.robot.constants import ARMS, BASE_POSITIONS_M

_DISTRIBUTION = "example-robot-data"
_URDF_SUFFIX = "robots/panda_description/urdf/panda.urdf"
_PACKAGE_SCHEME = "package://example-robot-data/robots/panda_description/"


@functools.cache
def panda_description_dir() -> Path:
    """Return the installed `panda_description` folder.

    Raises:
        EnvironmentMissingError: The distribution or its Panda is not installed.
    """
    remedy = "pip install -r requirements.lock (it holds example-robot-data)"
    try:
        files = importlib.metadata.distribution(_DISTRIBUTION).files or []
    except importlib.metadata.PackageNotFoundError as error:
        raise EnvironmentMissingError(f"the package '{_DISTRIBUTION}' is not installed", remedy=remedy) from error
    for file in files:
        if str(file).endswith(_URDF_SUFFIX):
            folder = Path(str(file.locate())).resolve().parents[1]
            if (folder / "urdf" / "panda.urdf").is_file():
                return folder
    raise EnvironmentMissingError(f"'{_DISTRIBUTION}' holds no {_URDF_SUFFIX}", remedy=remedy)


def _prefixed(element: ET.Element, prefix: str) -> ET.Element:
    """Return a copy of a link or joint with every name it defines or refers to prefixed."""
    element = copy.deepcopy(element)
    element.set("name", prefix + element.attrib["name"])
    for tag in ("parent", "child"):
        for ref in element.iter(tag):
            ref.set("link", prefix + ref.attrib["link"])
    for mimic in element.iter("mimic"):
        mimic.set("joint", prefix + mimic.attrib["joint"])
    return element


@functools.cache
def dual_panda_urdf() -> str:
    """Return the URDF of both arms with absolute mesh paths.

    Visual meshes (DAE) are left out: MuJoCo reads none, and `minidual.robot.visuals` supplies them. The
    coupling of the two fingers (`mimic`) is left out too: each finger is driven by its own position servo.
    """
    folder = panda_description_dir()
    source = ET.parse(folder / "urdf" / "panda.urdf").getroot()
    robot = ET.Element("robot", name="dual_panda")
    ET.SubElement(robot, "link", name="world")
    for arm in ARMS:
        prefix = f"{arm}_"
        for element in source:
            if element.tag not in ("link", "joint"):
                continue
            part = _prefixed(element, prefix)
            for tag in ("visual", "mimic", "safety_controller"):
                for child in part.findall(tag):
                    part.remove(child)
            for mesh in part.iter("mesh"):
                mesh.set("filename", mesh.attrib["filename"].replace(_PACKAGE_SCHEME, f"{folder}/"))
            robot.append(part)
        base = ET.SubElement(robot, "joint", name=f"{prefix}base", type="fixed")
        ET.SubElement(base, "origin", xyz=" ".join(str(v) for v in BASE_POSITIONS_M[arm]), rpy="0 0 0")
        ET.SubElement(base, "parent", link="world")
        ET.SubElement(base, "child", link=f"{prefix}panda_link0")
    return ET.tostring(robot, encoding="unicode")
