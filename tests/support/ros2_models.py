"""The exported URDF in three readers: Pinocchio, MuJoCo and xacro."""

from __future__ import annotations

import re
import sys
import types
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pinocchio as pin


class Bodies(NamedTuple):
    """Bodies of a model at one posture, by name.

    Attributes:
        poses: (4, 4) in world.
        masses: [kg], of each link, or of what each joint carries rigidly.
        inertias: (3, 3) about the centre of mass, world axes [kg m^2].
        centres: Centres of mass (3,) in world [m].
        limits: {joint: (lower, upper)}.
    """

    poses: dict[str, np.ndarray]
    masses: dict[str, float]
    inertias: dict[str, np.ndarray]
    centres: dict[str, np.ndarray]
    limits: dict[str, tuple[float, float]]


def differences(first: Bodies, second: Bodies, tolerance: float) -> list[str]:
    """Return what differs by more than the tolerance, or is in one of them only."""
    found: list[str] = []
    for field in Bodies._fields:
        one = getattr(first, field)
        other = getattr(second, field)
        found += [f"{field}: {name} is in one only" for name in sorted(set(one) ^ set(other))]
        for name in sorted(set(one) & set(other)):
            gap = float(np.abs(np.asarray(one[name]) - np.asarray(other[name])).max())
            if not gap <= tolerance:
                found.append(f"{field}: {name} differs by {gap:.3g}")
    return found


def in_mujoco(urdf: str, positions: dict[str, float], *, by_joint: bool = False) -> Bodies:
    """Return MuJoCo's bodies; a massless link is none of the masses.

    Args:
        urdf: Text, with paths of meshes.
        positions: {joint: position}.
        by_joint: Whether links that do not move against each other are one, named by their joint.
    """
    options = (
        '<mujoco><compiler fusestatic="false" discardvisual="true" strippath="false"/></mujoco>'
    )
    text = re.sub(r"(<robot [^>]*>)", rf"\1{options}", urdf, count=1)
    text = re.sub(r"<visual>.*?</visual>", "", text, flags=re.DOTALL)
    model = mujoco.MjSpec.from_string(text).compile()
    data = mujoco.MjData(model)
    for name, position in positions.items():
        data.joint(name).qpos[0] = position
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    poses: dict[str, np.ndarray] = {}
    masses: dict[str, float] = {}
    inertias: dict[str, np.ndarray] = {}
    centres: dict[str, np.ndarray] = {}
    for body in range(1, model.nbody):
        name = model.body(body).name
        poses[name] = _pose(data.xmat[body], data.xpos[body])
        if model.body_mass[body] > 0.0:
            R = data.ximat[body].reshape(3, 3)
            masses[name] = float(model.body_mass[body])
            inertias[name] = R @ np.diag(model.body_inertia[body]) @ R.T
            centres[name] = data.xipos[body].copy()
    limits = {
        model.joint(k).name: (float(model.jnt_range[k, 0]), float(model.jnt_range[k, 1]))
        for k in range(model.njnt)
    }
    bodies = Bodies(poses, masses, inertias, centres, limits)
    return _joined(bodies, model) if by_joint else bodies


def _joined(bodies: Bodies, model: mujoco.MjModel) -> Bodies:
    """Return rigid pieces instead of links; "universe" is what no joint moves."""
    pieces: dict[str, list[str]] = {}
    for body in range(1, model.nbody):
        name = model.body(body).name
        if name in bodies.masses:
            pieces.setdefault(_joint_above(model, body), []).append(name)
    masses = {joint: sum(bodies.masses[n] for n in names) for joint, names in pieces.items()}
    centres: dict[str, np.ndarray] = {}
    inertias: dict[str, np.ndarray] = {}
    for joint, names in pieces.items():
        moments = [bodies.masses[name] * bodies.centres[name] for name in names]
        centre = np.sum(moments, axis=0) / masses[joint]
        centres[joint] = centre
        inertias[joint] = np.zeros((3, 3))
        for name in names:
            r = bodies.centres[name] - centre
            shift = bodies.masses[name] * (r @ r * np.eye(3) - np.outer(r, r))
            inertias[joint] += bodies.inertias[name] + shift
    return bodies._replace(masses=masses, inertias=inertias, centres=centres)


def _joint_above(model: mujoco.MjModel, body: int) -> str:
    while body and model.body_jntnum[body] == 0:
        body = int(model.body_parentid[body])
    return model.joint(model.body_jntadr[body]).name if body else "universe"


def in_pinocchio(urdf: str, positions: dict[str, float]) -> Bodies:
    """Return Pinocchio's frames, and the inertia of what each joint carries rigidly."""
    model = pin.buildModelFromXML(urdf)
    data = model.createData()
    q = pin.neutral(model)
    for name, position in positions.items():
        q[model.joints[model.getJointId(name)].idx_q] = position
    pin.framesForwardKinematics(model, data, q)
    poses: dict[str, np.ndarray] = {}
    masses: dict[str, float] = {}
    inertias: dict[str, np.ndarray] = {}
    centres: dict[str, np.ndarray] = {}
    for frame, placement in zip(model.frames, data.oMf, strict=True):
        if frame.type != pin.FrameType.BODY or frame.name in ("universe", "world"):
            continue
        poses[frame.name] = placement.homogeneous.copy()
    for name, inertia, placement in zip(model.names, model.inertias, data.oMi, strict=True):
        if inertia.mass > 0.0:
            R = placement.rotation
            masses[name] = float(inertia.mass)
            inertias[name] = R @ inertia.inertia @ R.T
            centres[name] = placement.act(inertia.lever)
    limits = {}
    for joint in range(1, model.njoints):
        row = model.joints[joint].idx_q
        limits[model.names[joint]] = (
            float(model.lowerPositionLimit[row]),
            float(model.upperPositionLimit[row]),
        )
    return Bodies(poses, masses, inertias, centres, limits)


def _pose(R: np.ndarray, p: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = R.reshape(3, 3)
    T[:3, 3] = p
    return T


def with_mesh_files(urdf: str, workspace: Path) -> str:
    """Return a URDF whose package:// addresses are paths in the workspace."""
    return urdf.replace("package://", f"{workspace}/src/")


def expanded(workspace: Path, file: Path, **arguments: str) -> ET.Element:
    """Return what xacro makes of a file; `$(find PACKAGE)` is a folder of the workspace."""
    import xacro

    packages = types.ModuleType("ament_index_python.packages")
    packages.get_package_share_directory = lambda name: str(workspace / "src" / name)
    packages.PackageNotFoundError = KeyError
    parent = types.ModuleType("ament_index_python")
    parent.packages = packages
    stubs = {"ament_index_python": parent, "ament_index_python.packages": packages}
    sys.modules |= stubs
    try:
        document = xacro.process_file(str(file), mappings=arguments)
    finally:
        for name in stubs:
            del sys.modules[name]
    return ET.fromstring(document.toxml())


def canonical(element: ET.Element) -> tuple:
    """Return an element without comments, white space and order of attributes; numbers as floats."""
    children = [canonical(child) for child in element if isinstance(child.tag, str)]
    attributes = {name: _value(text) for name, text in element.attrib.items()}
    return (
        element.tag,
        tuple(sorted(attributes.items())),
        (element.text or "").strip(),
        (*children,),
    )


def _value(text: str) -> object:
    try:
        return tuple(float(word) for word in text.split())
    except ValueError:
        return text
