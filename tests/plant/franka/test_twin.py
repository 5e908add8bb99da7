"""The emulator's window: its world is mirrored in the client, and objects are put down through it."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import numpy as np
import pytest

from minidual.config.root import Config, changed
from minidual.config.scene import SceneConfig
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.plant.bodies import NamedObject
from minidual.plant.franka.cell import EmulatedCell
from minidual.plant.franka.server import EmulatorServer, Pace
from minidual.plant.franka.twin import EmulatorTwin
from minidual.plant.franka.twin_messages import Kind, MessageError, MessageReader, packed
from minidual.plant.protocol import PlantEndedError
from minidual.robot.models import XARM7
from minidual.robot.pair import DUAL_PANDA, Robot

HOSTS = ("127.0.0.43", "127.0.0.44")


@pytest.fixture(scope="module")
def cell() -> EmulatedCell:
    return EmulatedCell(SceneConfig(), DUAL_PANDA)


@pytest.fixture
def served(cell: EmulatedCell) -> Iterator[threading.Event]:
    server = EmulatorServer(cell, HOSTS, Pace.CLIENT)
    stop = threading.Event()
    running = threading.Thread(target=server.run, args=(stop,))
    running.start()
    yield stop
    stop.set()
    running.join(timeout=30.0)


@pytest.fixture
def twin(served: threading.Event) -> Iterator[EmulatorTwin]:
    seen = EmulatorTwin(HOSTS[0], SceneConfig(), DUAL_PANDA)
    yield seen
    seen.close()


def test_a_refresh_takes_over_arms_objects_contacts_and_time(
    cell: EmulatedCell, twin: EmulatorTwin
) -> None:
    before_s = twin.world.time
    for _ in range(20):
        twin.refresh()
    assert twin.world.time > before_s
    assert np.allclose(twin.world.q, DUAL_PANDA.home, atol=1e-3)
    assert np.allclose(twin.world.object_pose(), cell.world.object_pose(), atol=1e-6)
    assert twin.world.on_table()


def test_an_object_is_put_down_and_the_arms_stay(cell: EmulatedCell, twin: EmulatorTwin) -> None:
    twin.place({"rod": (0.5, 0.05, 0.4)})
    assert np.allclose(twin.world.object_pose()[:2, 3], (0.5, 0.05), atol=2e-3)
    assert np.allclose(cell.world.object_pose()[:2, 3], (0.5, 0.05), atol=2e-3)
    T = twin.world.object_pose()
    T[0, 3] = 0.45
    twin.place({"rod": T})
    assert twin.world.object_pose()[0, 3] == pytest.approx(0.45, abs=2e-3)
    assert np.allclose(cell.world.q, DUAL_PANDA.home, atol=1e-3)


def test_a_held_or_unknown_object_is_not_put_down(
    twin: EmulatorTwin, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UsageError, match="no object 'pot'"):
        twin.place({"pot": (0.5, 0.0, 0.0)})
    monkeypatch.setattr(NamedObject, "pinch", lambda self: np.array([0.0, 20.0]))
    with pytest.raises(UsageError, match="a hand holds 'rod'"):
        twin.place({"rod": (0.5, 0.0, 0.0)})


def test_another_scene_is_refused_by_the_value_that_differs(served: threading.Event) -> None:
    heavier = changed(Config(), {"scene.object.mass_kg": 0.9}).scene
    with pytest.raises(UsageError, match=r"scene\.object\.mass_kg is \S+ there and 0\.9 here"):
        EmulatorTwin(HOSTS[0], heavier, DUAL_PANDA)
    other_picture = changed(Config(), {"scene.camera.width_px": 64}).scene
    EmulatorTwin(HOSTS[0], other_picture, DUAL_PANDA).close()


def test_other_arms_are_refused(served: threading.Event) -> None:
    with pytest.raises(UsageError, match="the emulator's arms are 'panda'"):
        EmulatorTwin(HOSTS[0], SceneConfig(), Robot(XARM7))


def test_an_emulator_that_has_ended_is_the_end_of_the_plant(
    served: threading.Event, twin: EmulatorTwin
) -> None:
    served.set()

    def refresh_for_long() -> None:
        for _ in range(1000):
            twin.refresh()

    with pytest.raises(PlantEndedError, match=r"emulator at 127\.0\.0\.43"):
        refresh_for_long()


def test_nothing_at_the_port_is_named() -> None:
    with pytest.raises(EnvironmentMissingError, match="does not show its world"):
        EmulatorTwin("127.0.0.98", SceneConfig(), DUAL_PANDA)


def test_messages_are_cut_out_of_a_stream_and_others_refused() -> None:
    reader = MessageReader()
    stream = packed(Kind.STATE, b"12345678") + packed(Kind.PLACE)
    assert reader.feed(stream[:7]) == []
    state, place = reader.feed(stream[7:])
    assert (state.kind, state.body) == (Kind.STATE, b"12345678")
    assert (place.kind, place.body) == (Kind.PLACE, b"")
    with pytest.raises(MessageError, match="no message of kind 9"):
        MessageReader().feed(b"\x09\x00\x00\x00\x00")
    with pytest.raises(MessageError, match="at most"):
        MessageReader().feed(b"\x01\xff\xff\xff\xff")
