"""Text of XML and YAML files, each with the note that it was not run under ROS 2."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from typing import Any

import yaml

import minidual

NOT_RUN = "Not run under ROS 2"
"""First words of the note in each file; the exported README lists the files."""
XACRO = "http://www.ros.org/wiki/xacro"
ET.register_namespace("xacro", XACRO)


def note(checked: str) -> str:
    """Return the note at the head of a file.

    Args:
        checked: How its content was checked instead.
    """
    return f"Written by minidual {minidual.__version__}. {NOT_RUN}. Checked: {checked}."


def xacro(tag: str) -> str:
    """Return the name of an element of xacro."""
    return f"{{{XACRO}}}{tag}"


def xml_text(root: ET.Element, checked: str) -> str:
    """Return an indented XML document; see `note`."""
    ET.indent(root)
    body = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0"?>\n<!-- {note(checked)} -->\n{body}\n'


def yaml_text(document: Mapping[str, Any], checked: str) -> str:
    """Return a YAML document; see `note`."""
    body = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=100)
    return f"# {note(checked)}\n{body}"


def number(value: float) -> str:
    """Return a number that reads back to the same float."""
    return repr(float(value))


def numbers(values: tuple[float, ...]) -> str:
    """Return numbers separated by spaces."""
    return " ".join(map(number, values))
