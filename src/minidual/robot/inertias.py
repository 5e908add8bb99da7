"""Inertias that some distribution of mass has.

The principal moments of a body with mass satisfy A + B >= C: the second moments of mass,
S = tr(I)/2 - I, are not negative along any axis.
"""

import xml.etree.ElementTree as ET

import numpy as np

from minidual.errors import UsageError
from minidual.robot.pair import Array

_ROUNDING = 1e-9
"""Share of the trace by which a second moment may be negative: numbers of a file are rounded."""
_LEAST = 1e-6
"""Share of the trace that a mended second moment gets: the moments must not be on the bound."""
_ENTRIES = (
    ("ixx", 0, 0),
    ("ixy", 0, 1),
    ("ixz", 0, 2),
    ("iyy", 1, 1),
    ("iyz", 1, 2),
    ("izz", 2, 2),
)


def balanced(inertia: Array) -> Array:
    """Return the inertia (3, 3) [kg m^2] of the nearest second moments of mass that can be.

    Negative second moments become nearly zero, so that two principal moments rise and the largest
    stays. An inertia that can be is returned as it is.
    """
    half_trace = 0.5 * float(np.trace(inertia))
    moments, axes = np.linalg.eigh(half_trace * np.eye(3) - inertia)
    least = _LEAST * abs(half_trace)
    if moments[0] >= -_ROUNDING * abs(half_trace):
        return inertia
    moments = np.maximum(moments, least)
    second = (axes * moments) @ axes.T
    return float(np.trace(second)) * np.eye(3) - second


def mend_inertia(link: ET.Element, owner: str) -> str:
    """Balance the inertia of a link of a URDF; return a note, or "".

    Raises:
        UsageError: Mass or inertia is negative.
    """
    mass_kg = mass_of(link)
    if mass_kg < 0.0:
        raise UsageError(f"{owner}: its mass is {mass_kg:g} kg; it must not be negative")
    element = link.find("inertial/inertia")
    if element is None:
        return ""
    inertia = np.zeros((3, 3))
    for name, row, column in _ENTRIES:
        inertia[row, column] = inertia[column, row] = float(element.get(name, "0"))
    principal = np.linalg.eigvalsh(inertia)
    if principal[0] < 0.0:
        raise UsageError(
            f"{owner}: a principal moment of its inertia is {principal[0]:g} kg m^2; "
            "it must not be negative",
            remedy="correct <inertia> in the URDF",
        )
    mended = balanced(inertia)
    if mended is inertia:
        return ""
    for name, row, column in _ENTRIES:
        element.set(name, repr(float(mended[row, column])))
    texts = [f"{moment:.3g}" for moment in principal]
    after = [f"{moment:.3g}" for moment in np.linalg.eigvalsh(mended)]
    return (
        f"{owner}: no distribution of mass has the principal moments {', '.join(texts)} kg m^2 "
        f"(A + B >= C); used are {', '.join(after)}"
    )


def mass_of(link: ET.Element) -> float:
    """Return the mass of a link of a URDF [kg], 0 if it has none."""
    element = link.find("inertial/mass")
    return 0.0 if element is None else float(element.get("value", "0"))


def has_inertia(link: ET.Element) -> bool:
    """Return whether a link of a URDF has mass and inertia about every axis."""
    element = link.find("inertial/inertia")
    if element is None or not mass_of(link) > 0.0:
        return False
    return all(float(element.get(name, "0")) > 0.0 for name in ("ixx", "iyy", "izz"))
