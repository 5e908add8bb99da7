"""The emulator behind its sockets, driven by a plain client in this process; time passes by ticks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from minidual import emergency
from minidual.config.scene import SceneConfig
from minidual.errors import EnvironmentMissingError, UsageError
from minidual.plant.franka import wire
from minidual.plant.franka.cell import EmulatedCell
from minidual.plant.franka.description import model_urdf
from minidual.plant.franka.errors import names_of
from minidual.plant.franka.server import EmulatorServer, Pace
from minidual.plant.franka.wire import ArmCommand, MoveStatus, RobotMode
from minidual.robot.models import PANDA, UR5
from minidual.robot.pair import DUAL_PANDA, Robot
from tests.support.franka_client import RawClient

HOSTS = ("127.0.0.41", "127.0.0.42")


@pytest.fixture(scope="module")
def cell() -> EmulatedCell:
    return EmulatedCell(SceneConfig(), DUAL_PANDA)


@pytest.fixture
def server(cell: EmulatedCell) -> Iterator[EmulatorServer]:
    serving = EmulatorServer(cell, HOSTS, Pace.CLIENT, patience_s=0.02)
    yield serving
    serving.close()
    for arm in cell.arms:
        arm.disconnected()
        arm.user_stop(pressed=False)
        for _ in range(200):
            arm.command(None)
        arm.recover()


@pytest.fixture
def client(server: EmulatorServer) -> Iterator[RawClient]:
    speaking = RawClient(server)
    yield speaking
    speaking.close()


def hold(client: RawClient, ticks: int, q: np.ndarray) -> np.void:
    state = client.state()
    for _ in range(ticks):
        client.command(state, q_c=q)
        client.server.tick()
        state = client.state()
    return state


def test_a_client_of_another_version_is_told_ours(server: EmulatorServer) -> None:
    old = RawClient(server, version=5)
    answer = np.frombuffer(old.connected, wire.ARM_CONNECTED)[0]
    assert answer["status"] == wire.ConnectStatus.INCOMPATIBLE_VERSION
    assert answer["version"] == wire.ARM_VERSION
    old.close()


def test_states_come_every_millisecond_with_the_arms_posture(client: RawClient) -> None:
    first = int(client.state()["message_id"])
    for _ in range(10):
        client.server.tick()
    state = client.state()
    assert int(state["message_id"]) == first + 10
    assert np.allclose(state["q"], PANDA.home, atol=1e-3)
    assert state["robot_mode"] == RobotMode.IDLE
    T_base_hand = state["O_T_EE"].reshape(4, 4).T
    assert T_base_hand[0, 3] == pytest.approx(0.307, abs=0.01)


def test_a_motion_moves_the_simulated_arm(client: RawClient, cell: EmulatedCell) -> None:
    assert client.move(0, 0) == MoveStatus.MOTION_STARTED
    state = client.state()
    start = state["q_d"].astype(float)
    start = cell.arms[0].desired.q.copy()
    for k in range(1, 301):
        s = k / 300
        q = start + 0.05 * (35 * s**4 - 84 * s**5 + 70 * s**6 - 20 * s**7) * np.eye(7)[3]
        client.command(state, q_c=q)
        client.server.tick()
        state = client.state()
    assert names_of(state["errors"]) == ()
    assert state["q"][3] - start[3] == pytest.approx(0.05, abs=1e-3)
    client.command(state, q_c=q, motion_generation_finished=True)
    client.server.tick()
    client.server.tick()
    client.collect()
    assert client.answers[-1][2] == bytes([MoveStatus.SUCCESS])


def test_a_jump_is_answered_and_flagged_by_name(client: RawClient, cell: EmulatedCell) -> None:
    client.move(0, 0)
    q = cell.arms[0].desired.q + 0.01 * np.eye(7)[0]
    client.command(client.state(), q_c=q)
    client.server.tick()
    client.server.tick()
    state = client.state()
    assert state["robot_mode"] == RobotMode.REFLEX
    assert "joint_motion_generator_velocity_discontinuity" in names_of(state["errors"])
    assert names_of(state["reflex_reason"]) == names_of(state["errors"])
    client.collect()
    assert client.answers[-1][2] == bytes([MoveStatus.REFLEX_ABORTED])
    assert client.request(ArmCommand.AUTOMATIC_ERROR_RECOVERY) == bytes([0])
    assert names_of(client.state()["errors"]) == ()


def test_recovery_and_a_motion_wait_until_the_arm_rests(
    client: RawClient, cell: EmulatedCell
) -> None:
    client.move(0, 0)
    arm = cell.arms[0]
    start = arm.desired.q.copy()
    state = client.state()
    for k in range(1, 200):
        client.command(state, q_c=start + 0.5 * (k / 1000.0) ** 3 * np.eye(7)[3])
        client.server.tick()
        state = client.state()
    client.command(state, q_c=start)
    while arm.mode is RobotMode.MOVE:
        client.server.tick()
    assert arm.mode is RobotMode.REFLEX
    assert arm.is_braking
    client.send(ArmCommand.AUTOMATIC_ERROR_RECOVERY)
    client.server.tick()
    client.collect()
    assert client.answers[-1][:1] == (ArmCommand.MOVE,), "the recovery was answered in motion"
    assert client.move(0, 0) == MoveStatus.MOTION_STARTED
    assert (ArmCommand.AUTOMATIC_ERROR_RECOVERY, bytes([0])) in [
        (answer[0], answer[2]) for answer in client.answers
    ]
    assert client.state()["robot_mode"] == RobotMode.MOVE


def test_commands_that_answer_an_old_state_are_lost(client: RawClient, cell: EmulatedCell) -> None:
    cell_patience = 25
    client.move(0, 0)
    q = cell.arms[0].desired.q.copy()
    state = hold(client, 3, q)
    for _ in range(cell_patience):
        client.command(state, q_c=q)  # always the same, old number
        client.server.tick()
    state = client.state()
    assert names_of(state["errors"]) == ("communication_constraints_violation",)


def test_one_arm_in_a_reflex_leaves_the_other_one_to_its_client(
    server: EmulatorServer, cell: EmulatedCell
) -> None:
    clients = [RawClient(server, index) for index in (0, 1)]
    for each in clients:
        assert each.move(0, 0) == MoveStatus.MOTION_STARTED
        each.command(each.state(), q_c=cell.arms[each is clients[1]].desired.q)
    clients[0].close()
    for _ in range(3):
        server.tick()
    assert cell.arms[0].errors == ("communication_constraints_violation",)
    assert cell.arms[1].mode is RobotMode.MOVE
    clients[1].close()


@pytest.mark.parametrize(("out_ms", "ends"), [(5, False), (20, True), (200, True)])
def test_a_cable_that_is_out_on_one_arm(
    server: EmulatorServer, cell: EmulatedCell, out_ms: int, ends: bool
) -> None:
    """From 20 lost commands on, that arm stops by name; nothing jumps, the other goes on."""
    server._patience_s = 0.001
    clients = [RawClient(server, index) for index in (0, 1)]
    homes = [arm.desired.q.copy() for arm in cell.arms]
    for each in clients:
        assert each.move(0, 0) == MoveStatus.MOTION_STARTED
    steps_rad: list[float] = []
    for k in range(out_ms + 20):
        for index, each in enumerate(clients):
            cable_out = index == 0 and 10 <= k < 10 + out_ms
            if not cable_out:
                each.command(each.state(), q_c=homes[index])
        before = [arm.desired.q.copy() for arm in cell.arms]
        server.tick()
        moved = [
            np.abs(arm.desired.q - old).max() for arm, old in zip(cell.arms, before, strict=True)
        ]
        steps_rad.append(float(max(moved)))
    named = cell.arms[0].last_errors if ends else ()
    assert named == (("communication_constraints_violation",) if ends else ())
    assert (cell.arms[0].mode is RobotMode.MOVE) is not ends
    assert cell.arms[1].mode is RobotMode.MOVE
    assert max(steps_rad) < 1e-4
    for each in clients:
        each.close()


def test_commands_out_of_order_count_once(client: RawClient, cell: EmulatedCell) -> None:
    client.move(0, 0)
    q = cell.arms[0].desired.q.copy()
    old = client.state()
    state = hold(client, 5, q)
    client.command(state, q_c=q)
    client.command(old, q_c=q + 0.5)  # overtaken on the way: it would be a jump
    client.server.tick()
    assert cell.arms[0].mode is RobotMode.MOVE


def test_pressing_the_stop_button_of_the_process_stops_both(
    client: RawClient, cell: EmulatedCell
) -> None:
    client.move(0, 0)
    hold(client, 2, cell.arms[0].desired.q.copy())
    emergency.press("test")
    try:
        client.server.tick()
    finally:
        emergency.release()
    assert [arm.mode for arm in cell.arms] == [RobotMode.USER_STOPPED] * 2
    client.server.tick()
    client.collect()
    assert client.answers[-1][2] == bytes([MoveStatus.EMERGENCY_ABORTED])


def test_settings_are_refused_in_a_motion(client: RawClient, cell: EmulatedCell) -> None:
    stiffness = {"stiffness": np.full(7, 1000.0)}
    answer = client.request(ArmCommand.SET_JOINT_IMPEDANCE, wire.JOINT_IMPEDANCE, **stiffness)
    assert answer == bytes([wire.SetterStatus.SUCCESS])
    client.move(0, 0)
    answer = client.request(ArmCommand.SET_JOINT_IMPEDANCE, wire.JOINT_IMPEDANCE, **stiffness)
    assert answer == bytes([wire.SetterStatus.NOT_POSSIBLE])


def test_a_hand_that_is_pulled_is_a_collision(client: RawClient, cell: EmulatedCell) -> None:
    client.move(0, 0)
    q = cell.arms[0].desired.q.copy()
    assert names_of(hold(client, 5, q)["errors"]) == ()
    hand = cell.world.model.body(DUAL_PANDA.tcp_names[0]).id
    cell.world.data.xfrc_applied[hand, 2] = -60.0
    try:
        state = hold(client, 60, q)
    finally:
        cell.world.data.xfrc_applied[hand, 2] = 0.0
    assert "cartesian_reflex" in names_of(state["errors"])
    assert state["O_F_ext_hat_K"][2] < -20.0


def test_the_description_has_the_links_that_a_client_looks_for() -> None:
    urdf = model_urdf(PANDA)
    assert all(f'name="joint{index}"' in urdf for index in range(1, 8))
    assert 'name="link8"' in urdf
    assert urdf.count("position_based_velocity_limits") == 7
    assert "finger" not in urdf
    assert "mesh" not in urdf


def test_addresses_must_differ_and_be_free(server: EmulatorServer, cell: EmulatedCell) -> None:
    with pytest.raises(UsageError, match="two different addresses"):
        EmulatorServer(cell, ("127.0.0.41", "127.0.0.41"))
    with pytest.raises(EnvironmentMissingError, match=r"cannot listen on 127\.0\.0\.41:1337"):
        EmulatorServer(cell, HOSTS)


def test_arms_with_six_joints_have_no_emulator() -> None:
    with pytest.raises(ValueError, match="6 joints"):
        EmulatedCell(SceneConfig(), Robot(UR5))
