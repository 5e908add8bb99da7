"""What each condition changes of the model, and within which range it draws."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from minidual.config.root import Config
from minidual.config.scene import DISTRACTORS
from minidual.plant.model import build_model
from minidual.tasks.catalogue import make_task
from minidual.trials.changes import DRY_NM, OBJECT_COLOURS, TABLE_COLOURS
from minidual.trials.conditions import CONDITIONS, condition

if TYPE_CHECKING:
    import mujoco

TASK = make_task(Config())
TRIALS_N = 24
ROD = "rod"


@functools.cache
def plain() -> mujoco.MjModel:
    """Return the model that no condition has changed."""
    return build_model(TASK.scene, visuals=False)


def light(model: mujoco.MjModel) -> float:
    ratios = np.r_[
        model.light_diffuse / plain().light_diffuse,
        [model.vis.headlight.diffuse / plain().vis.headlight.diffuse],
    ]
    assert np.ptp(ratios) < 1e-6, "all lights alike"
    return float(ratios.mean())


def camera_m(model: mujoco.MjModel) -> float:
    high = model.camera("high").id
    return float(np.linalg.norm(model.cam_pos[high] - plain().cam_pos[high]))


def camera_rad(model: mujoco.MjModel) -> float:
    high = model.camera("high").id
    cosine = min(1.0, abs(float(model.cam_quat[high] @ plain().cam_quat[high])))
    return 2.0 * float(np.arccos(cosine))


def mass(model: mujoco.MjModel) -> float:
    return float(model.body(ROD).mass[0] / plain().body(ROD).mass[0])


def friction(model: mujoco.MjModel) -> float:
    return float(model.geom(ROD).friction[0] / plain().geom(ROD).friction[0])


def size(model: mujoco.MjModel) -> float:
    return float(model.geom(ROD).size[0] / plain().geom(ROD).size[0])


def joint_friction_nm(model: mujoco.MjModel) -> float:
    """Return the dry friction of the first joint that has some, or 0."""
    rough = model.dof_frictionloss[model.dof_frictionloss > 0.0]
    return float(rough[0]) if len(rough) else 0.0


def joints_n(model: mujoco.MjModel) -> float:
    return float(np.count_nonzero(model.dof_frictionloss))


def opacity(model: mujoco.MjModel) -> float:
    return float(model.geom(ROD).rgba[3])


def distractors_n(model: mujoco.MjModel) -> float:
    return float(sum(model.geom(name).rgba[3] == 1.0 for name in DISTRACTORS))


def object_colour(model: mujoco.MjModel) -> float:
    return _number(model, ROD, OBJECT_COLOURS)


def table_colour(model: mujoco.MjModel) -> float:
    return _number(model, "table_top", TABLE_COLOURS)


def _number(model: mujoco.MjModel, geom: str, colours: tuple[tuple[float, ...], ...]) -> float:
    """Return which of the colours a geom has, -1 for its own."""
    rgb = model.geom(geom).rgba[:3]
    matches = [k for k, colour in enumerate(colours) if np.allclose(rgb, colour, atol=1e-6)]
    own = np.allclose(rgb, plain().geom(geom).rgba[:3])
    assert matches or own, f"{geom} has a colour that is not in the table"
    return float(matches[0]) if matches else -1.0


PROBES: dict[str, Callable[[mujoco.MjModel], float]] = {
    "light": light,
    "camera_m": camera_m,
    "camera_rad": camera_rad,
    "mass": mass,
    "friction": friction,
    "size": size,
    "joint_friction_nm": joint_friction_nm,
    "joints_n": joints_n,
    "opacity": opacity,
    "distractors_n": distractors_n,
    "object_colour": object_colour,
    "table_colour": table_colour,
}
CAMERA_RAD = np.radians(3.0)
OBJECT_COLOUR = {"object_colour": (0.0, len(OBJECT_COLOURS) - 1.0)}
TABLE_COLOUR = {"table_colour": (0.0, len(TABLE_COLOURS) - 1.0)}
ROOM = {
    "light": (0.7, 1.4),
    "camera_m": (0.02, 0.02),
    "camera_rad": (CAMERA_RAD, CAMERA_RAD),
    "distractors_n": (2.0, 2.0),
    **OBJECT_COLOUR,
    **TABLE_COLOUR,
}
# {condition: {probe: (least, largest)}}; what is not named keeps its own value.
DRAWS: dict[str, dict[str, tuple[float, float]]] = {
    "mass -50 %": {"mass": (0.5, 0.5)},
    "mass +50 %": {"mass": (1.5, 1.5)},
    "friction 0.3": {"friction": (0.3 / 0.5, 0.3 / 0.5)},
    "friction 0.7": {"friction": (0.7 / 0.5, 0.7 / 0.5)},
    "light -30 %": {"light": (0.7, 0.7)},
    "light +40 %": {"light": (1.4, 1.4)},
    "camera moved": {"camera_m": (0.02, 0.02), "camera_rad": (CAMERA_RAD, CAMERA_RAD)},
    "object colour": OBJECT_COLOUR,
    "table colour": TABLE_COLOUR,
    "object hidden": {"opacity": (0.0, 0.0)},
    "distractors": {"distractors_n": (2.0, 2.0)},
    "room": ROOM,
    "unseen object": {
        "size": (0.85, 1.15),
        "mass": (0.5, 1.5),
        "friction": (0.7, 1.3),
        **OBJECT_COLOUR,
    },
    "joint friction x2": {
        "joint_friction_nm": (2.0 * DRY_NM, 2.0 * DRY_NM),
        "joints_n": (1.0, 1.0),
    },
    "randomised": {
        **ROOM,
        "camera_m": (0.0, 0.02),
        "camera_rad": (0.0, CAMERA_RAD),
        "mass": (0.5, 1.5),
        "friction": (0.4, 1.3),
        "joint_friction_nm": (0.5 * DRY_NM, 1.5 * DRY_NM),
        "joints_n": (14.0, 14.0),
    },
}


@functools.cache
def drawn(name: str) -> dict[str, np.ndarray]:
    """Return what each probe reads in the trials of a condition, (TRIALS_N,) each."""
    model = build_model(TASK.scene, visuals=False)
    values: dict[str, list[float]] = {probe: [] for probe in PROBES}
    for index in range(TRIALS_N):
        trial = TASK.trial(3, "draws", index)
        with condition(name).applied(model, TASK, trial, np.random.default_rng(index)):
            for probe, read in PROBES.items():
                values[probe].append(read(model))
    return {probe: np.array(readings) for probe, readings in values.items()}


def test_every_condition_that_changes_the_model_is_in_the_table() -> None:
    assert set(DRAWS) == {name for name, row in CONDITIONS.items() if row.change is not None}


@pytest.mark.parametrize("name", DRAWS)
def test_a_condition_draws_all_it_names_over_the_whole_range(name: str) -> None:
    """Least and largest of 24 draws are within a fifth of the range from its ends."""
    for probe, (least, largest) in DRAWS[name].items():
        values = drawn(name)[probe]
        tolerance = 1e-6 + 1e-6 * abs(largest)  # the camera's turn, read from its cosine
        assert values.min() >= least - tolerance, probe
        assert values.max() <= largest + tolerance, probe
        margin = 0.2 * (largest - least) + tolerance
        assert values.min() <= least + margin, probe
        assert values.max() >= largest - margin, probe


@pytest.mark.parametrize("name", DRAWS)
def test_a_condition_changes_nothing_that_it_does_not_name(name: str) -> None:
    own = {probe: read(plain()) for probe, read in PROBES.items()}
    for probe, values in drawn(name).items():
        if probe not in DRAWS[name]:
            np.testing.assert_allclose(values, own[probe], atol=1e-9, err_msg=probe)


@pytest.mark.parametrize("name", ["object colour", "table colour", "room", "randomised"])
def test_colours_are_drawn_from_all_of_the_table(name: str) -> None:
    for probe in DRAWS[name].keys() & {"object_colour", "table_colour"}:
        assert set(drawn(name)[probe]) == {0.0, 1.0, 2.0, 3.0, 4.0}
