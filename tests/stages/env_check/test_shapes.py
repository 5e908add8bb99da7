"""What is drawn and what collides, and faults in which they differ."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import mujoco
import numpy as np
import pytest

from minidual.config.scene import SceneConfig
from minidual.plant.contact import GROUP_COLLISION
from minidual.plant.model import build_model, build_spec
from minidual.robot.pair import DUAL_PANDA, Robot
from minidual.stages.env_check.shapes import compare_shapes, extent_of
from tests.support.env_check_samples import failing, judged
from tests.support.urdf_files import Change, adding, changed_ur5, setting

VISUAL = "link[@name='forearm_link']/visual"


def test_the_pandas_are_drawn_as_they_collide_in_both_engines(
    visual_model: mujoco.MjModel,
) -> None:
    comparison = compare_shapes(visual_model, DUAL_PANDA)
    assert comparison.unlike == []
    assert comparison.engines_max_m < 1e-6
    hand = comparison.links["left_panda_hand"]
    assert hand.drawn is not None
    assert hand.mujoco is not None
    assert hand.drawn.volume_m3 == pytest.approx(hand.mujoco.volume_m3, rel=0.1)
    assert comparison.record()["left_panda_link8"]["drawn"] is None


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (setting(f"{VISUAL}/geometry/mesh", scale="1000 1000 1000"), "times as large"),
        (setting(f"{VISUAL}/geometry/mesh", scale="0.02 0.02 1"), "times the volume"),
        (adding(VISUAL, "<origin xyz='0 0 0.5'/>"), "beside what collides"),
        (adding(VISUAL, "<origin rpy='1.5708 0 0' xyz='0 0 0'/>"), "or turned against it"),
        (adding(VISUAL, "<origin rpy='3.1416 0 0' xyz='0 0 0'/>"), "or turned against it"),
    ],
)
def test_a_visual_mesh_in_another_unit_place_or_orientation(
    change: Change,
    reason: str,
    tmp_path: Path,
) -> None:
    robot = Robot(changed_ur5(tmp_path, change))
    comparison = compare_shapes(build_model(SceneConfig(), robot), robot)
    checks = judged(shapes=comparison)
    assert failing(checks) == {"shapes.unlike"}
    left, right = comparison.unlike
    assert left.startswith("left_forearm_link is drawn")
    assert reason in left
    assert right.startswith("right_forearm_link")
    assert "left_forearm_link" in checks["shapes.unlike"].remedy


def test_a_link_that_collides_elsewhere_in_one_engine() -> None:
    spec = build_spec(SceneConfig(), visuals=False)
    for geom in spec.body("left_panda_hand").geoms:
        if geom.group == GROUP_COLLISION:
            geom.pos = geom.pos + np.array([0.0, 0.0, 0.01])
    comparison = compare_shapes(spec.compile(), DUAL_PANDA)
    assert comparison.engines_max_m == pytest.approx(0.01, abs=1e-5)
    assert failing(judged(shapes=comparison)) == {"shapes.engines_max_m"}


def test_the_extent_of_flat_points_has_no_volume() -> None:
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    extent = extent_of([square])
    assert extent is not None
    assert extent.volume_m3 == 0.0
    assert extent.diagonal_m == pytest.approx(np.sqrt(2.0))
    assert extent_of([]) is None


def test_a_row_may_say_that_a_link_is_drawn_beside_what_collides(tmp_path: Path) -> None:
    aside = adding(VISUAL, "<origin xyz='0 0 0.5'/>")
    arm = changed_ur5(tmp_path, aside)
    told = Robot(dataclasses.replace(arm, drawn_apart=("forearm_link",)))
    assert compare_shapes(build_model(SceneConfig(), told), told).unlike == []
    other = Robot(dataclasses.replace(arm, drawn_apart=("upper_arm_link",)))
    assert len(compare_shapes(build_model(SceneConfig(), other), other).unlike) == 2
