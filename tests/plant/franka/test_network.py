"""The franka plant over a bad network: what ends a motion, and that both arms stop without a jump.

Needs the extra `minidual[franka]`; emulator and network are processes of their own.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from minidual.config.plant import PlantConfig
from minidual.config.root import Config
from minidual.control.reflexes import ReflexError
from minidual.plant.connect import connection
from minidual.plant.lifecycle import Connection
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.plant_drive import PlantDrive, swing
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import METHODS, MethodInputs
from minidual.trials.site import PlantSite
from tests.support.processes import running, started, told

pytest.importorskip("franky", reason="needs the extra minidual[franka] (franky-control)")
pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

SERVERS = "127.0.0.61,127.0.0.62"
PROXIES = "127.0.0.63,127.0.0.64"
PATIENCE_S = 0.02
"""The emulator waits so long for each of the 20 commands that a cut cable loses; after 1 s without a
state the client library takes the connection for lost."""
LOST = "communication_constraints_violation"
SWING_RAD = 0.1
IN_THE_AIR_M = 0.08
FASTEST_RAD_S = 0.4
"""Five times the largest speed of the swing: what moves faster has jumped."""

DRIVER = f"""
import numpy as np
from minidual.config.plant import PlantConfig
from minidual.config.root import Config
from minidual.plant.connect import connection
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.plant_drive import PlantDrive, swing
link = connection(PlantConfig(address="franka://{SERVERS}"), DUAL_PANDA, Config().scene).open()
drive = PlantDrive(link, Config())
drive.begin()
print("driving", flush=True)
times = np.arange(1, 3000) * 0.02
drive.follow(swing(drive.q.copy(), np.full(14, {SWING_RAD}) * [1, 1, 1, 1, 1, 0, 1] * 2, 0.25, times))
"""


@pytest.fixture
def emulator() -> Iterator[subprocess.Popen[str]]:
    with running("-m", "tests.support.served_emulator", SERVERS, str(PATIENCE_S)) as process:
        yield process


@pytest.fixture
def network(emulator: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    with running("-m", "tests.support.franka_proxy", PROXIES, SERVERS) as process:
        yield process


@pytest.fixture
def link(network: subprocess.Popen[str]) -> Iterator[Connection]:
    scene = make_task(Config()).scene
    opened = connection(PlantConfig(address=f"franka://{PROXIES}"), DUAL_PANDA, scene).open()
    yield opened
    opened.close()


def order(network: subprocess.Popen[str], line: str) -> None:
    assert network.stdin is not None
    network.stdin.write(line + "\n")
    network.stdin.flush()
    assert told(network) == "done"


class Swung:
    """Both arms swing while the network changes; keeps what was measured."""

    def __init__(self, link: Connection) -> None:
        self.drive = PlantDrive(link, Config())
        self.drive.begin()
        self.home = self.drive.q.copy()
        self.reflex: ReflexError | None = None
        self.rest_s = float("nan")
        self.fastest_rad_s = 0.0

    def run(self, seconds: float, change: Any, at_s: float = 0.5) -> None:
        """Swing; call `change` once; after a reflex wait for rest."""
        plant = self.drive.plant
        inward = np.where(self.home < 0.5 * (DUAL_PANDA.q_lower + DUAL_PANDA.q_upper), 1.0, -1.0)
        times = np.arange(1, round(seconds / plant.dt) + 1) * plant.dt
        last_s, last_q = plant.time, plant.q
        for k, target in enumerate(swing(self.home, SWING_RAD * inward, 0.25, times)):
            if k == round(at_s / plant.dt):
                change()
            with contextlib.suppress(ReflexError):
                self.drive.step(target)
            moved_s = plant.time - last_s
            if moved_s > 0.0:
                speed = float(np.abs(plant.q - last_q).max()) / moved_s
                self.fastest_rad_s = max(self.fastest_rad_s, speed)
                last_s, last_q = plant.time, plant.q
            reflex = self.drive.stack.reflex
            if reflex is not None and self.reflex is None:
                self.reflex = reflex
                self.stopped_s = plant.time
            still = float(np.abs(plant.v).max()) < 0.02
            if self.reflex is not None and still and np.isnan(self.rest_s):
                self.rest_s = plant.time - self.stopped_s


@pytest.mark.parametrize(("out_ms", "ends"), [(5, False), (20, True), (200, True)])
def test_the_cable_of_one_arm_is_out(
    network: subprocess.Popen[str], link: Connection, out_ms: int, ends: bool
) -> None:
    """Up to 19 lost states change nothing; 20 end the motion by name, and the other arm stops too."""
    swung = Swung(link)
    swung.run(2.5, lambda: order(network, f"cut 0 {out_ms}"))
    assert swung.fastest_rad_s < FASTEST_RAD_S, "something jumped"
    if not ends:
        assert swung.reflex is None
        assert link.plant.health == ""
        return
    assert swung.reflex is not None
    assert swung.reflex.reflex.name == "plant_failed"
    assert f"left arm: {LOST}" in swung.reflex.message
    assert link.healths[1].faults == (), "the right arm's cable was in"
    assert swung.rest_s < 1.0
    swung.drive.recover()
    swung.drive.move(swung.home)
    assert np.abs(link.plant.q - swung.home).max() < 0.01


def test_a_network_with_delay_and_commands_that_overtake_others(
    network: subprocess.Popen[str], link: Connection
) -> None:
    swung = Swung(link)

    def change() -> None:
        order(network, "delay 0 3")
        order(network, "swap 1 4")

    swung.run(1.5, change)
    assert swung.reflex is None
    assert swung.fastest_rad_s < FASTEST_RAD_S


def test_an_emulator_that_is_killed_is_a_named_stop(
    emulator: subprocess.Popen[str], link: Connection
) -> None:
    swung = Swung(link)
    swung.run(1.0, emulator.kill)
    assert swung.reflex is not None
    assert swung.reflex.reflex.name in ("plant_failed", "measurement")
    assert swung.fastest_rad_s < FASTEST_RAD_S


def test_a_client_that_is_killed_leaves_two_arms_at_rest_with_a_name(
    emulator: subprocess.Popen[str],
) -> None:
    driver = started("-c", DRIVER)
    driver.send_signal(signal.SIGKILL)
    driver.wait()
    scene = make_task(Config()).scene
    link = connection(PlantConfig(address=f"franka://{SERVERS}"), DUAL_PANDA, scene)
    link.plant.connect()
    for health in link.healths:
        assert LOST in "".join(health.faults)
    assert np.abs(link.plant.v).max() < 0.02
    link.plant.activate(link.kinds[0])
    assert link.plant.health == ""
    link.close()


def test_what_both_hands_hold_is_not_torn_when_one_arm_loses_its_cable(
    network: subprocess.Popen[str], link: Connection
) -> None:
    """The rod is in the air; the left cable is out for 200 ms: both arms stop and keep it."""
    task = make_task(Config())
    site = PlantSite(link, task.config, 1)
    trial = task.trial(1, "torn", 0)
    site.begin(task, trial, ())
    inputs = MethodInputs(task.config, 1, senses=site.senses, plant=link.plant)
    carry = METHODS["moveit"].factory(inputs)(link.plant, Kinematics(), trial)
    rod = site.world.truth()
    began_s = link.plant.time
    while rod.pose()[2, 3] < IN_THE_AIR_M and link.plant.time < began_s + 20.0:
        carry.step()
    assert carry.phase == "carry", carry.aborted
    order(network, "cut 0 200")
    least_n = np.inf
    for _ in range(100):
        carry.step()
        least_n = min(least_n, float(rod.pinch().min()))
    assert f"left arm: {LOST}" in str(carry.aborted)
    assert least_n > 5.0, "a hand let go"
    assert rod.pose()[2, 3] > IN_THE_AIR_M - 0.01
    assert float(np.abs(link.plant.v).max()) < 0.02
