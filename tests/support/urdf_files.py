"""URDFs of an arm that are changed on purpose, and arm models of them."""

from __future__ import annotations

import dataclasses
import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from minidual.robot.files import file_at
from minidual.robot.models import ARM_MODELS, UR5, ArmModel

Change = Callable[[ET.Element, Path], None]
"""Changes the root of the UR5's URDF; the folder is that of the new file."""

FOREARM_MESH = "link[@name='forearm_link']/collision/geometry/mesh"
WRIST = "joint[@name='wrist_3_joint']"


def changed_ur5(folder: Path, change: Change | None, name: str = "own", **row: Any) -> ArmModel:
    """Return the model of a UR5 whose URDF in `folder` was changed; `row`: fields of the model."""
    tree = ET.parse(file_at(UR5.urdf))
    root = tree.getroot()
    if change is not None:
        change(root, folder)
    path = folder / f"{name}.urdf"
    tree.write(path)
    return dataclasses.replace(UR5, name=name, urdf=str(path), **row)


def text_changed_ur5(folder: Path, change: Callable[[str], str], name: str = "own") -> ArmModel:
    """Return the model of a UR5 whose URDF was changed as text."""
    path = folder / f"{name}.urdf"
    path.write_text(change(file_at(UR5.urdf).read_text(encoding="utf-8")), encoding="utf-8")
    return dataclasses.replace(UR5, name=name, urdf=str(path))


def add_to_table(monkeypatch: pytest.MonkeyPatch, *arms: ArmModel) -> None:
    """Add arm models to the table until the end of the test."""
    monkeypatch.setattr(ARM_MODELS, "_rows", {**ARM_MODELS, **{arm.name: arm for arm in arms}})


def part(root: ET.Element, path: str) -> ET.Element:
    """Return the first element at a path, which must exist.

    Raises:
        ValueError: There is none.
    """
    element = root.find(path)
    if element is None:
        raise ValueError(f"the URDF has no {path}")
    return element


def mesh_file(root: ET.Element, path: str) -> Path:
    """Return the file of a mesh."""
    return file_at(part(root, path).attrib["filename"])


def setting(path: str, **attributes: str) -> Change:
    """Return a change that sets attributes of an element."""

    def change(root: ET.Element, folder: Path) -> None:
        part(root, path).attrib.update(attributes)

    return change


def removing(parent: str, child: str) -> Change:
    """Return a change that removes an element."""

    def change(root: ET.Element, folder: Path) -> None:
        owner = root if not parent else part(root, parent)
        owner.remove(part(owner, child))

    return change


def adding(parent: str, xml: str) -> Change:
    """Return a change that adds an element."""

    def change(root: ET.Element, folder: Path) -> None:
        owner = root if not parent else part(root, parent)
        owner.append(ET.fromstring(xml))

    return change


def copied_mesh(suffix: str, address: str, **export: Any) -> Change:
    """Return a change that collides the forearm with a copy of its mesh.

    Args:
        suffix: Name of the copy in the folder of the URDF.
        address: How the URDF names it; "{path}" is its path.
        export: Arguments of trimesh's export.
    """

    def change(root: ET.Element, folder: Path) -> None:
        import trimesh

        mesh = trimesh.load_mesh(mesh_file(root, FOREARM_MESH))
        path = folder / suffix
        path.parent.mkdir(parents=True, exist_ok=True)
        mesh.export(path, **export)
        part(root, FOREARM_MESH).set("filename", address.format(path=path))

    return change
