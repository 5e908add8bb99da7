"""The migration: steps pass on sound plants, each injected fault is found by its row, gates hold."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from minidual.cli.app import run_command_line
from minidual.config.loader import load_config
from minidual.config.plant import PlantConfig
from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.errors import GateClosedError, UsageError
from minidual.gate.runner import Runner, StageOutcome
from minidual.gate.store import RunStore
from minidual.plant.contact import GROUP_COLLISION
from minidual.plant.lifecycle import Connection
from minidual.plant.model import build_spec
from minidual.robot.pair import DUAL_PANDA
from minidual.skills.plant_drive import PlantDrive
from minidual.stages.migrate import cameras, rows, steps
from minidual.stages.migrate.measured import StepMeasurements, Worst, checks_of
from minidual.stages.migrate.meshes import small_meshes
from minidual.stages.migrate.steps import STEPS, measure_step, shift_s, signatures
from minidual.stages.migrate.table import MIGRATION, NAMES
from minidual.stages.registry import STAGES, TOOLS
from tests.support.position_plant import Follower

ADDRESS = "tests.support.position_plant:Follower"
HOME = DUAL_PANDA.home
SOUND = StepMeasurements(
    controllers_wrong=[],
    limits_off=Worst(0.0, ""),
    approach=Worst(0.001, ""),
    jitter_s=0.0005,
    latency=Worst(0.03, ""),
    gravity=Worst(0.01, ""),
    sag=Worst(0.0, ""),
    soft_overshoot=Worst(0.0, ""),
    soft_error=Worst(0.0, ""),
    meshes_small=[],
    focal=Worst(0.001, ""),
    reprojection=Worst(0.1, ""),
    open_share=Worst(1.0, ""),
    closed_m=Worst(0.0, ""),
    speed=Worst(0.9, ""),
    rest_s=0.2,
    statistics=Worst(0.001, ""),
    tracking_rad=0.01,
    resting_arm_rad=0.0,
    arms_apart=Worst(0.0, ""),
    torque=Worst(0.4, ""),
    leader_latency_s=0.05,
    workspace_missed=[],
    indicator=Worst(0.95, ""),
)
ALL_ROWS = sorted({row for step in STEPS for row in step.rows})


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small motions: the rows are the same."""
    monkeypatch.setattr(rows, "APPROACH_RAD", 0.03)
    monkeypatch.setattr(rows, "SWING_S", 1.0)
    monkeypatch.setattr(rows, "_HAND_S", 0.2)
    monkeypatch.setattr(rows, "_HOLD_S", 0.3)


def drive_of(plant: Follower, speed: float = 0.3) -> PlantDrive:
    one = PlantDrive(Connection(ADDRESS, plant).open(), Config(), speed)
    one.begin()
    return one


def failing(m: StepMeasurements) -> set[str]:
    return {check.name for check in checks_of(m, ALL_ROWS) if check.passed is False}


@pytest.mark.parametrize("step", STEPS, ids=[step.name for step in STEPS])
def test_each_step_passes_on_a_sound_plant(step) -> None:
    m, logs = measure_step(step, Connection(ADDRESS, Follower()).open(), Config())
    assert m.stops == []
    checks = checks_of(m, step.rows)
    assert [check.name for check in checks if check.passed is False] == []
    assert logs


def test_arms_that_are_driven_wait_for_no_computation(monkeypatch: pytest.MonkeyPatch) -> None:
    """The plant's clock runs on while meshes are compared, cameras calibrated or a twin simulated."""
    plant = Follower()
    run_on: list[str] = []

    def slow(name: str, function: Callable[..., object]) -> Callable[..., object]:
        def late(*args: object) -> object:
            run_on.append(name)
            plant._ticks += round(0.6 / plant.dt)
            return function(*args)

        return late

    monkeypatch.setattr(steps, "small_meshes", slow("meshes", steps.small_meshes))
    monkeypatch.setattr(rows, "calibration", slow("cameras", rows.calibration))
    monkeypatch.setattr(steps, "connection", slow("twin", steps.connection))
    for step in (STEPS[0], STEPS[-1]):
        m, _ = measure_step(step, Connection(ADDRESS, plant).open(), Config())
        assert m.stops == []
    assert run_on == ["meshes", "cameras", "twin"]


@pytest.mark.parametrize(
    ("change", "check"),
    [
        ({"stops": ["a reflex"]}, "step.stops"),
        ({"faults": ["left: joint_reflex"]}, "row01.interface_faults"),
        ({"controllers_wrong": ["both_arms"]}, "row02.controllers_wrong"),
        ({"controllers_wrong": None}, "row02.controllers_wrong"),
        ({"limits_off": Worst(0.1, "left_panda_joint2")}, "row03.limits_off_rad"),
        ({"approach": Worst(0.05, "")}, "row03.approach_error_rad"),
        ({"jitter_s": 0.015}, "row04.jitter_p99_s"),
        ({"latency": Worst(math.nan, "")}, "row04.latency_s"),
        ({"gravity": Worst(0.2, "")}, "row05.gravity_share"),
        ({"sag": Worst(0.02, "")}, "row05.sag_rad"),
        ({"soft_overshoot": Worst(0.03, "")}, "row06.soft_overshoot_rad"),
        ({"soft_error": Worst(0.03, "")}, "row06.soft_error_rad"),
        ({"meshes_small": ["left_panda_link5"]}, "row07.meshes_small"),
        ({"focal": Worst(0.1, "camera high")}, "row08.focal_error_share"),
        ({"reprojection": Worst(3.0, "camera high")}, "row08.reprojection_px"),
        ({"open_share": Worst(0.5, "the left hand")}, "row09.open_share"),
        ({"closed_m": Worst(0.04, "the left hand")}, "row09.closed_m"),
        ({"speed": Worst(1.5, "")}, "row10.speed_share"),
        ({"rest_s": math.nan}, "row11.rest_s"),
        ({"unsigned": ("mains",)}, "row11.unsigned"),
        ({"statistics": Worst(0.3, "")}, "row12.statistics_off_rad"),
        ({"tracking_rad": 0.3}, "step.tracking_rms_rad"),
        ({"resting_arm_rad": 0.1}, "step.resting_arm_rad"),
        ({"arms_apart": Worst(0.06, "the left arm")}, "step.arms_apart_s"),
        ({"torque": Worst(0.99, "")}, "step.torque_share"),
        ({"leader_latency_s": 0.5}, "step.leader_latency_s"),
        ({"workspace_missed": ["ready"]}, "step.workspace_missed"),
        ({"indicator": Worst(0.7, "tracking")}, "step.indicator_share"),
    ],
)
def test_each_check_says_no(change: dict, check: str) -> None:
    assert failing(SOUND) == set()
    assert failing(replace(SOUND, **change)) == {check}


def test_nothing_measured_fails_every_measured_row() -> None:
    named = {check.name for check in checks_of(StepMeasurements(), ALL_ROWS)}
    counted = {"step.stops", "row01.interface_faults", "row11.unsigned"}
    assert failing(StepMeasurements()) == named - counted


class TestInjectedFaults:
    def test_row_1_an_arm_that_reports_a_fault(self) -> None:
        plant = Follower()
        plant.faults = [("user_stopped",), ()]
        m, _ = measure_step(STEPS[0], Connection(ADDRESS, plant).open(), Config())
        assert m.faults == ["left: user_stopped"]

    def test_row_2_a_plant_that_is_given_an_impedance_law(self) -> None:
        one = drive_of(Follower())
        assert rows.controllers(one) == []
        one.stack.manager.forbidden = {}
        assert "object_impedance is not refused" in rows.controllers(one)[-1]

    def test_row_3_a_wrong_limit(self) -> None:
        plant = Follower()
        lower, upper = DUAL_PANDA.q_lower.copy(), DUAL_PANDA.q_upper.copy()
        upper[8] -= 0.2
        plant.limits_rad = (lower, upper)
        off = rows.declared_limits(Connection(ADDRESS, plant), DUAL_PANDA)
        assert off == Worst(pytest.approx(0.2), "right_panda_joint2")

    def test_row_3_a_joint_that_stays_behind(self) -> None:
        plant = Follower()
        plant.stuck[4] = True
        worst, *_ = rows.approach(drive_of(plant), HOME, (0,))
        assert worst.where == "left_panda_joint5"
        assert worst.value > 0.02

    def test_row_4_fifteen_milliseconds_of_jitter(self) -> None:
        plant = Follower()
        plant.jitter_s = 0.0075  # every other step is 15 ms longer than the one between
        one = drive_of(plant)
        log = one.move(HOME, seconds=0.5)
        assert rows.timing([log], plant.dt) == pytest.approx(0.0075, abs=1e-3)
        assert rows.timing([drive_of(Follower()).move(HOME)], 0.02) < 1e-6

    def test_row_4_a_late_arm(self) -> None:
        plant = Follower()
        plant.lag_ticks = [6, 6]
        one = drive_of(plant, 0.1)
        log = one.move(HOME + 0.02, seconds=0.3)
        assert rows.lag_s(log, 0) >= 0.12

    def test_row_5_a_load_that_nobody_told(self) -> None:
        plant = Follower()
        plant.tau_off[1] = 12.0
        share, _ = rows.gravity(drive_of(plant), HOME, (0,))
        assert share == Worst(pytest.approx(12.0 / 87.0, abs=1e-3), "left_panda_joint2")

    def test_row_5_a_brake_that_slips(self) -> None:
        plant = Follower()
        one = drive_of(plant)
        plant.sag_rad_s[10] = -0.05
        plant._target = plant._q.copy()
        follow = plant.follow
        plant.follow = lambda q, v, openings: follow(
            np.where(np.arange(14) == 10, plant._q, q), v, openings
        )
        _, sag = rows.gravity(one, HOME, (0, 1))
        assert sag.where == "right_panda_joint4"
        assert sag.value > 0.01

    def test_row_6_a_joint_that_does_not_arrive_with_soft_gains(self) -> None:
        plant = Follower()

        def soften(share: float) -> None:
            plant.stuck[2] |= share < 1.0

        plant.soften = soften
        overshoot, left = rows.soft_step(drive_of(plant, 0.1), HOME, (0,))
        assert left.where == "left_panda_joint3"
        assert left.value > 0.03
        assert overshoot.value < 0.01

    def test_row_7_a_mesh_that_is_too_small(self) -> None:
        assert small_meshes(DUAL_PANDA) == []
        spec = build_spec(SceneConfig(), DUAL_PANDA, visuals=True)
        body = spec.body("left_panda_link5")
        for geom in list(body.geoms):
            if geom.group == GROUP_COLLISION:
                spec.delete(geom)
        body.add_geom(type=2, size=[0.02, 0.0, 0.0], group=GROUP_COLLISION)
        assert small_meshes(DUAL_PANDA, spec.compile()) == ["left_panda_link5"]

    def test_row_8_swapped_cameras(self, tmp_path: Path) -> None:
        import cv2

        focals = cameras.expected_focals(SceneConfig(), DUAL_PANDA)
        swapped = {"high": focals["left"], "left": focals["high"], "right": focals["right"]}
        for folder, taken in (("right", focals), ("swapped", swapped)):
            for name, focal in taken.items():
                place = tmp_path / folder / name
                place.mkdir(parents=True)
                for k, picture in enumerate(cameras.rendered_boards(focal)):
                    cv2.imwrite(str(place / f"{k}.png"), picture)
        m = StepMeasurements()
        rows.calibration(m, Config(), DUAL_PANDA, tmp_path / "right")
        assert m.focal.value < 0.02
        assert m.reprojection.value < 1.0
        rows.calibration(m, Config(), DUAL_PANDA, tmp_path / "swapped")
        assert m.focal.value > 0.02
        with pytest.raises(UsageError, match="there are no pictures"):
            rows.calibration(m, Config(), DUAL_PANDA, tmp_path / "none")

    def test_row_9_a_gripper_that_closes_to_half(self) -> None:
        plant = Follower()
        plant.fingers_least_m = 0.02
        opened, closed = rows.hands(drive_of(plant), (0, 1))
        assert opened.value == pytest.approx(1.0)
        assert closed.value == pytest.approx(0.04)

    def test_row_10_a_plant_that_is_faster_than_told(self) -> None:
        log = drive_of(Follower(), 0.3).move(HOME + 0.05)
        assert rows.speeds([log], DUAL_PANDA, 0.3).value < 1.1
        assert rows.speeds([log], DUAL_PANDA, 0.03).value > 1.1

    def test_row_11_a_stop_that_does_not_stop(self) -> None:
        plant = Follower()
        one = drive_of(plant)
        one.follow(HOME + np.linspace(0.0, 0.05, 25)[:, None])
        plant.follow = lambda q, v, openings: None
        plant.step = lambda: setattr(plant, "_ticks", plant._ticks + 1)
        assert math.isnan(one.stop_and_rest("test"))

    def test_row_11_rows_for_a_person(self) -> None:
        assert signatures({})[1] == ("estop-button", "mains", "cable")
        signed = signatures({"confirm": "mains,cable", "signed-by": "A. Person"})
        assert signed == ("A. Person", ("estop-button",))
        with pytest.raises(UsageError, match="no row 'brake'"):
            signatures({"confirm": "brake", "signed-by": "A. Person"})
        with pytest.raises(UsageError, match="needs the name"):
            signatures({"confirm": "mains"})

    def test_row_12_statistics_of_another_robot(self) -> None:
        log = drive_of(Follower()).move(HOME + 0.05)
        assert rows.statistics(log, log.q, DUAL_PANDA).value == 0.0
        other = log.q + np.linspace(0.0, 0.3, 14)
        assert rows.statistics(log, other, DUAL_PANDA).where == "right_panda_joint7"

    def test_swapped_arms_are_found_by_the_arm_that_should_rest(self) -> None:
        plant = Follower()
        plant.swapped = True
        worst, *_ = rows.approach(drive_of(plant), HOME, (0,))
        assert worst.value > 0.02

    def test_an_arm_that_is_later_than_the_other(self) -> None:
        plant = Follower()
        plant.lag_ticks = [0, 4]
        m, _ = measure_step(
            replace(STEPS[1], rows=("synchrony",)),
            Connection(ADDRESS, plant).open(),
            Config(),
        )
        assert m.arms_apart.where == "the right arm"
        assert m.arms_apart.value == pytest.approx(0.08, abs=0.021)


def test_the_shift_between_two_paths_is_found() -> None:
    path = np.sin(np.arange(200) * 0.05)[:, None] * np.ones(14)
    assert shift_s(path[5:], path[:-5], 0.02) == pytest.approx(0.1)


class TestGates:
    def runner(self, folder: Path, address: str) -> Runner:
        return Runner(
            table=MIGRATION,
            store=RunStore(folder, "migration"),
            loaded=load_config("standard", [f"plant.address={address}"]),
            command=lambda words: f"minidual migrate {words}",
        )

    def test_the_names_are_the_steps(self) -> None:
        assert tuple(step.name for step in STEPS) == NAMES == tuple(MIGRATION)
        assert not set(NAMES) & set(STAGES)

    def test_a_step_refuses_before_the_one_below_has_passed(self, tmp_path: Path) -> None:
        with pytest.raises(GateClosedError, match="one-arm-10 has not run") as error:
            self.runner(tmp_path, ADDRESS).run("both-arms-10")
        assert "minidual migrate one-arm-10" in (error.value.remedy or "")

    def test_a_step_that_passed_on_another_plant_does_not_open_the_gate(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Nor does it count as done: without STEP the command goes on at what is open on the plant."""
        folder = tmp_path / "standard"
        first = self.runner(folder, ADDRESS).run("one-arm-10", {"signed-by": "A. Person"})
        assert first.exit_code == 0
        assert first.verdict.data["place"] == "test double"
        with pytest.raises(GateClosedError, match="one-arm-10 is stale"):
            self.runner(folder, "sim-position").run("both-arms-10")
        chosen: list[str] = []

        def run(_: Runner, step: str, *options: object, **others: object) -> StageOutcome:
            chosen.append(step)
            return first

        monkeypatch.setattr(Runner, "run", run)
        for address in (ADDRESS, "sim-position"):
            words = ["migrate", "--plant", address, "--runs-dir", str(tmp_path)]
            assert run_command_line(words, STAGES, TOOLS) == 0
        assert chosen == ["both-arms-10", "one-arm-10"]


def test_the_command_names_the_steps_that_there_are(capsys: pytest.CaptureFixture[str]) -> None:
    code = run_command_line(["migrate", "step-6"], STAGES, TOOLS)
    assert code == 2
    assert "no step 'step-6'; there are both-arms-10" in capsys.readouterr().err


def test_hardware_rows_are_asked_of_a_person() -> None:
    assert Config(plant=PlantConfig(address="franka://a,b")).plant.address == "franka://a,b"
    assert failing(replace(SOUND, unsigned=("estop-button", "mains", "cable"))) == {
        "row11.unsigned"
    }
