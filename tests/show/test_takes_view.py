"""Takes are played in the browser side by side, each in its own room."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest

from minidual.config.root import Config
from minidual.plant.world import World
from minidual.robot.pair import DUAL_PANDA
from minidual.show import takes_view
from minidual.show.figures.side_by_side import Moment, Take
from minidual.show.takes_view import APART_M, play_takes, room_offset, rooms_model, takes_overlay
from minidual.show.view.overlay import Arrow, Overlay
from minidual.tasks.catalogue import make_task
from tests.support import trial_results


class FakeView:
    """Counts what it is told; closes after three pictures."""

    def __init__(self) -> None:
        self.models: list[mujoco.MjModel] = []
        self.shown: list[tuple[np.ndarray, Overlay]] = []

    @property
    def alive(self) -> bool:
        return len(self.shown) < 3

    def open(self, model: mujoco.MjModel, *, rooms_n: int) -> None:
        assert rooms_n == 2
        self.models.append(model)

    def due(self) -> bool:
        return True

    def update(self, data: mujoco.MjData, overlay: Overlay) -> None:
        self.shown.append((data.qpos.copy(), overlay))


@pytest.fixture(scope="module")
def world() -> World:
    return World(make_task(Config(task="rod_carry")).scene)


@pytest.fixture
def takes(world: World) -> list[Take]:
    arrow = Arrow(np.zeros(3), np.array([0.0, 40.0, 0.0]), (1, 2, 3))
    home = world.data.qpos.copy()
    moments = [Moment(0.1 * k, home, f"phase {k}", (41.0, 40.0), 39.0, (arrow,)) for k in range(6)]
    model: Any = None
    return [
        Take("moveit", model, moments, trial_results.result(0, method="moveit")),
        Take("impedance", model, moments[:3], trial_results.result(0, method="impedance")),
    ]


def test_each_room_shows_its_own_posture(world: World) -> None:
    model = rooms_model(world.scene, DUAL_PANDA, 2)
    data = mujoco.MjData(model)
    assert model.nq == 2 * world.model.nq
    bent = world.data.qpos.copy()
    bent[0] += 0.4
    data.qpos[:] = np.concatenate([world.data.qpos, bent])
    mujoco.mj_kinematics(model, data)
    for number, qpos in enumerate((world.data.qpos, bent)):
        alone = mujoco.MjData(world.model)
        alone.qpos[:] = qpos
        mujoco.mj_kinematics(world.model, alone)
        for body in ("left_panda_link7", "right_panda_link7"):
            expected = alone.body(body).xpos + room_offset(number, 2)
            np.testing.assert_allclose(data.body(f"{number}/{body}").xpos, expected, atol=1e-9)
    np.testing.assert_allclose(room_offset(1, 2) - room_offset(0, 2), (0.0, APART_M, 0.0))


def test_the_panel_has_a_line_for_each_method_and_arrows_stand_in_their_rooms(
    takes: list[Take],
) -> None:
    shown = takes_overlay(takes, 0.1)
    (first, words), (second, _) = shown.lines
    assert (first, second) == ("moveit", "impedance")
    assert words == "phase 1, pinch 41 N, 40 N   squeeze 39 N"
    starts = [arrow.start for arrow in shown.arrows]
    np.testing.assert_allclose(starts, [room_offset(0, 2), room_offset(1, 2)])
    ended = takes_overlay(takes, 99.0)
    assert ended.time_s == takes[0].end_s
    assert "success in" in ended.lines[0][1]


def test_they_are_played_until_the_view_is_closed(
    takes: list[Take],
    world: World,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    view: Any = FakeView()
    monkeypatch.setattr(takes_view, "_PAUSE_S", 0.0)
    play_takes(view, takes, world.scene, DUAL_PANDA, rounds_n=None)
    assert len(view.models) == 1
    assert len(view.shown) == 3
    qpos, overlay = view.shown[0]
    np.testing.assert_allclose(qpos, np.tile(takes[0].moments[0].qpos, 2))
    assert len(overlay.lines) == 2
