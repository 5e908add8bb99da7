"""The bench: what it times, what it says of limits, and that a slow controller shows. No test here judges a time."""

from __future__ import annotations

import time

import numpy as np
import pytest

from minidual.config.control import ImpedanceConfig
from minidual.config.root import Config
from minidual.config.scene import SceneConfig
from minidual.errors import UsageError
from minidual.registry import Registry
from minidual.tasks.task import tilt_rad
from scripts.bench import __main__ as bench
from scripts.bench import carry, control, planning
from scripts.bench.control import CASES, COLUMNS, Case, measure_case, trajectory_14
from scripts.bench.scenes import BenchScene, free_scene, held_scene
from scripts.bench.step import step_cost
from scripts.bench.tables import BenchInputs, BenchRow, BenchTable


@pytest.fixture(scope="module")
def held() -> BenchScene:
    return held_scene(SceneConfig(), ImpedanceConfig())


@pytest.fixture(scope="module")
def free() -> BenchScene:
    return free_scene(SceneConfig(), ImpedanceConfig())


class TestScenes:
    def test_held_means_held(self, held: BenchScene) -> None:
        held.restore()
        assert held.world.truth().pinch().min() > 50.0
        assert held.world.truth().internal_force() == pytest.approx(40.0, abs=2.0)
        assert held.world.object_pose()[2, 3] > 0.09
        assert not held.world.on_table()

    def test_free_means_free(self, free: BenchScene) -> None:
        free.restore()
        assert free.world.truth().pinch().tolist() == [0.0, 0.0]

    def test_a_restored_scene_is_the_same_to_the_byte(self, held: BenchScene) -> None:
        held.restore()
        before = held.world.data.qpos.tobytes() + held.world.data.sensordata.tobytes()
        for _ in range(5):
            held.world.step()
        assert held.world.data.qpos.tobytes() + held.world.data.sensordata.tobytes() != before
        held.restore()
        assert held.world.data.qpos.tobytes() + held.world.data.sensordata.tobytes() == before

    @pytest.mark.parametrize("make", CASES)
    def test_every_case_keeps_its_situation(self, make: control.MakeCase, held: BenchScene) -> None:
        held.restore()
        case = make(held)
        for _ in range(300):
            case.before()
            case.step()
        assert held.world.truth().pinch().min() > 40.0
        assert tilt_rad(held.world.object_pose(), held.world.scene.object) < 0.02
        assert held.world.object_pose()[2, 3] > 0.09

    def test_samples_agree_with_their_rates(self, free: BenchScene) -> None:
        samples = free.joint_samples()
        (q0, _, _), (q1, v1, a1), (q2, _, _) = (next(samples) for _ in range(3))
        dt = free.world.dt
        assert q0 == pytest.approx(free.q_rest, abs=1e-12)
        assert (q2 - q0) / (2 * dt) == pytest.approx(v1, abs=1e-5)
        assert (q2 - 2 * q1 + q0) / dt**2 == pytest.approx(a1, abs=1e-3)
        states = free.object_samples()
        s0, s1, s2 = (next(states) for _ in range(3))
        x0, x1, x2 = (s.T_world_object[:3, 3] for s in (s0, s1, s2))
        assert (x2 - x0) / (2 * dt) == pytest.approx(s1.twist[:3], abs=1e-6)
        assert (x2 - 2 * x1 + x0) / dt**2 == pytest.approx(s1.acceleration[:3], abs=1e-4)


class TestStepCost:
    def test_every_step_is_taken_once_and_bare_physics_leaves_the_world_alone(
        self,
        free: BenchScene,
    ) -> None:
        free.restore()
        began = free.world.time
        taken = []
        cost = step_cost(
            free.world,
            free.world.step,
            130,
            parts={"look": lambda: free.world.q},
            before=lambda: taken.append(1),
        )
        assert len(taken) == 130
        assert free.world.time - began == pytest.approx(0.130)
        assert set(cost.parts_us) == {"look"}
        assert len(cost.turn_ratios) == 3
        assert cost.ratio == sorted(cost.turn_ratios)[1]
        assert cost.real_time_factor == pytest.approx(1e3 / cost.median_us)

    def test_a_controller_slowed_on_purpose_shows(self, held: BenchScene) -> None:
        """Two milliseconds beside some tens of microseconds: no load on the machine hides that."""

        def slowed(scene: BenchScene) -> Case:
            case = trajectory_14(scene)

            def step() -> None:
                time.sleep(2e-3)
                case.step()

            return Case("slowed", step, case.before, case.parts, case.ratio_max)

        row = measure_case(held, slowed, 60)
        assert row.exceeded == ("ratio",)
        assert row.numbers["ratio"] > 5.0
        assert row.numbers["algebra_us"] > 1000.0

    def test_rows_have_every_column_and_parts_are_parts(self, held: BenchScene) -> None:
        for make in CASES:
            row = measure_case(held, make, 100)
            assert set(row.numbers) == set(COLUMNS)
            assert all(np.isfinite(value) for value in row.numbers.values())
            # The rest is a difference of medians that are not of the same moments: negative on a busy machine.
            rest = row.numbers.pop("algebra_us")
            assert all(value > 0.0 for value in row.numbers.values())
            parts = ("bare_us", "read_us", "dynamics_us")
            assert rest == pytest.approx(
                row.numbers["step_us"] - sum(row.numbers[name] for name in parts),
            )
            assert set(row.limits) == {"ratio"}

    def test_an_imagined_object_has_no_limit_to_keep(self, free: BenchScene) -> None:
        assert measure_case(free, control.object_impedance, 50).limits == {}


class TestTable:
    TABLE = BenchTable(
        "title",
        ("a_us", "ratio"),
        (
            BenchRow("good", {"a_us": 3.0, "ratio": 1.0}, {"ratio": 1.5}),
            BenchRow("bad", {"ratio": 2.0}, {"ratio": 1.5}),
            BenchRow("broken", {"ratio": float("nan")}, {"ratio": 1.5}),
        ),
        ("a note",),
    )

    def test_over_the_limit_is_marked_and_nan_is_over(self) -> None:
        assert [row.exceeded for row in self.TABLE.rows] == [(), ("ratio",), ("ratio",)]
        lines = self.TABLE.lines()
        assert lines[0] == "title"
        assert "!2.00 (<= 1.5)" in next(line for line in lines if line.startswith("bad"))
        assert "!" not in next(line for line in lines if line.startswith("good"))
        assert "  -  " in next(line for line in lines if line.startswith("bad"))
        assert len(self.TABLE.exceeded) == 2


def toy(inputs: BenchInputs) -> BenchTable:
    inputs.advance("toy")
    return BenchTable(
        "toy",
        ("n",),
        (BenchRow("row", {"n": float(inputs.repeats_n)}, {"n": 10.0}),),
    )


class TestCommand:
    @pytest.fixture
    def call(self, capsys, monkeypatch):
        monkeypatch.setattr(bench, "BENCHES", Registry("bench", {"toy": toy}))

        def run(*words: str) -> tuple[int, str, str]:
            code = bench.main(list(words))
            out = capsys.readouterr()
            return code, out.out, out.err

        return run

    def test_within_limits(self, call) -> None:
        code, out, _ = call("--check", "--repeats", "3")
        assert code == 0
        assert "row" in out

    def test_over_a_limit_is_said_and_with_check_fails(self, call) -> None:
        code, out, err = call("toy", "--repeats", "11")
        assert code == 0
        assert "!" in out
        assert "row: n 11.00, limit 10" in err
        assert call("--repeats", "11", "--check")[0] == 1

    def test_usage(self, call) -> None:
        with pytest.raises(UsageError, match="toy"):
            call("nonsense")
        with pytest.raises(SystemExit):
            call("--repeats", "0")


def test_every_bench_can_be_loaded() -> None:
    assert set(bench.BENCHES) == set(bench.REPEATS_N)
    assert all(callable(bench.BENCHES[name]) for name in bench.BENCHES)


def test_the_first_plan_of_a_process_can_be_timed(capsys) -> None:
    exec(planning._COLD, {})
    assert 0.0 < float(capsys.readouterr().out) < 1e6


def test_planning_is_measured_with_its_goals_beside(monkeypatch) -> None:
    monkeypatch.setattr(planning, "_cold_start_s", lambda folder: 1.0)
    table = planning.measure(BenchInputs(Config(), 20261, 1))
    rows = {row.name: row for row in table.rows}
    assert len(rows) == 8
    assert all(
        np.isfinite(value) and value > 0.0 for row in table.rows for value in row.numbers.values()
    )
    for group, goal_ms in planning.GOALS_MS.items():
        row = rows[f"{group}: rrtconnect, proven"]
        assert row.limits == {"median_ms": goal_ms}
        assert row.numbers["solved_pct"] == row.numbers["free_pct"] == 100.0
    assert rows["cold start"].limits == {"median_ms": planning.COLD_START_MAX_MS}


@pytest.mark.slow
def test_a_trial_of_each_task_is_timed_beside_physics(monkeypatch) -> None:
    said: list[str] = []
    monkeypatch.setattr(carry, "TASKS", ("rod_carry", "insertion"))
    table = carry.measure(BenchInputs(Config(), 20261, 2 * carry.BLOCK, said.append))
    rows = {row.name: row for row in table.rows}
    timed = [f"{task}, {method}" for task in carry.TASKS for method in ("impedance", "moveit")]
    assert [f"{name}: success" for name in timed] == said[-len(timed) :]
    assert [name for name in rows if "held" not in name][2:] == timed
    assert all(
        np.isfinite(value) and value > 0.0 for row in table.rows for value in row.numbers.values()
    )
    for name in timed:
        assert rows[name].limits == {"ratio": carry.STEP_RATIO_MAX}
        assert rows[name].numbers["median_us"] > rows[name].numbers["bare_us"]
