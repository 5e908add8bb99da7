"""The bench of control: its situations, what a step costs, and that a slow controller shows.

No test here judges a time.
"""

from __future__ import annotations

import time

import numpy as np
import pytest

from minidual.config.control import ImpedanceConfig
from minidual.config.scene import SceneConfig
from minidual.tasks.task import tilt_rad
from scripts.bench import control, step
from scripts.bench.control import CASES, COLUMNS, Case, measure_case, trajectory_14
from scripts.bench.scenes import BenchScene, free_scene, held_scene
from scripts.bench.step import Spread, StepCost, step_cost


@pytest.fixture(scope="module")
def held() -> BenchScene:
    return held_scene(SceneConfig(), ImpedanceConfig())


@pytest.fixture(scope="module")
def free() -> BenchScene:
    return free_scene(SceneConfig(), ImpedanceConfig())


class TestScenes:
    def test_both_hands_hold_the_rod_in_the_air(self, held: BenchScene) -> None:
        held.restore()
        assert held.world.truth().pinch().min() > 50.0
        assert held.world.truth().internal_force() == pytest.approx(40.0, abs=2.0)
        assert held.world.object_pose()[2, 3] > 0.09
        assert not held.world.on_table()

    def test_free_hands_touch_nothing(self, free: BenchScene) -> None:
        free.restore()
        assert free.world.truth().pinch().tolist() == [0.0, 0.0]

    def test_a_restored_scene_is_the_same_to_the_byte(self, held: BenchScene) -> None:
        def state() -> bytes:
            data = held.world.data
            return data.qpos.tobytes() + data.sensordata.tobytes()

        held.restore()
        start = state()
        for _ in range(5):
            held.world.step()
        assert state() != start
        held.restore()
        assert state() == start

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

    def test_joint_samples_are_derivatives_of_each_other(self, free: BenchScene) -> None:
        samples = free.joint_samples()
        q0, _, _ = next(samples)
        q1, v1, a1 = next(samples)
        q2, _, _ = next(samples)
        dt = free.world.dt
        assert q0 == pytest.approx(free.q_rest, abs=1e-12)
        assert (q2 - q0) / (2 * dt) == pytest.approx(v1, abs=1e-5)
        assert (q2 - 2 * q1 + q0) / dt**2 == pytest.approx(a1, abs=1e-3)

    def test_object_samples_are_derivatives_of_each_other(self, free: BenchScene) -> None:
        samples = free.object_samples()
        first = next(samples)
        second = next(samples)
        third = next(samples)
        x0 = first.T_world_object[:3, 3]
        x1 = second.T_world_object[:3, 3]
        x2 = third.T_world_object[:3, 3]
        dt = free.world.dt
        assert (x2 - x0) / (2 * dt) == pytest.approx(second.twist[:3], abs=1e-6)
        assert (x2 - 2 * x1 + x0) / dt**2 == pytest.approx(second.acceleration[:3], abs=1e-4)


class TestStepCost:
    def test_every_step_is_taken_once_and_bare_physics_leaves_the_world_alone(
        self,
        free: BenchScene,
    ) -> None:
        free.restore()
        began = free.world.time
        samples_taken: list[int] = []
        cost = step_cost(
            free.world,
            free.world.step,
            130,
            parts={"look": lambda: free.world.q},
            before=lambda: samples_taken.append(1),
        )
        assert len(samples_taken) == 130
        assert free.world.time - began == pytest.approx(0.130)
        assert set(cost.parts_us) == {"look"}
        assert cost.real_time_factor == pytest.approx(1e3 / cost.whole.mean_us)

    def test_the_mean_takes_all_steps_and_ratios_compare_like_with_like(self) -> None:
        """One step of a hundred looks at distances: it is in the mean and the 99th percentile."""
        steps_ns = ([30_000] * 99 + [3_000_000]) * 10
        whole = Spread.of(steps_ns)
        assert whole.mean_us == pytest.approx(59.7)
        assert whole.median_us == 30.0
        assert whole.p99_us > 30.0
        bare = Spread.of([10_000] * 98 + [20_000] * 2)
        assert bare == pytest.approx((10.2, 10.0, 20.0))
        numbers = StepCost(Spread(40.8, 25.0, 60.0), bare).numbers()
        assert numbers["mean_ratio"] == pytest.approx(4.0)
        assert numbers["median_ratio"] == pytest.approx(2.5)
        assert numbers["p99_ratio"] == pytest.approx(3.0)
        assert numbers["bare_us"] == pytest.approx(10.2)

    def test_a_look_at_the_clock_is_no_part_of_a_step(
        self,
        monkeypatch: pytest.MonkeyPatch,
    ) -> None:
        monkeypatch.setattr(step.time, "process_time_ns", lambda: 5_600)
        monkeypatch.setattr(step, "_look_ns", lambda: 600)
        assert step.elapsed_ns(1_000) == 4_000

    def test_a_controller_slowed_on_purpose_shows(self, held: BenchScene) -> None:
        """Two milliseconds of work beside some tens of microseconds."""

        def slowed(scene: BenchScene) -> Case:
            case = trajectory_14(scene)

            def slow_step() -> None:
                until_s = time.process_time() + 2e-3
                while time.process_time() < until_s:
                    pass
                case.step()

            return Case("slowed", slow_step, case.before, case.parts, case.ratio_max)

        row = measure_case(held, slowed, 60)
        assert row.exceeded == ("mean_ratio",)
        assert row.numbers["mean_ratio"] > 5.0
        assert row.numbers["algebra_us"] > 1000.0

    @pytest.mark.parametrize("make", CASES)
    def test_rows_have_every_column_and_the_rest_is_the_algebra(
        self,
        make: control.MakeCase,
        held: BenchScene,
    ) -> None:
        row = measure_case(held, make, 100)
        numbers = dict(row.numbers)
        assert set(numbers) == set(COLUMNS)
        assert set(row.limits) == {"mean_ratio"}
        assert all(np.isfinite(value) for value in numbers.values())
        # A difference of means of different moments: negative on a busy machine.
        algebra_us = numbers.pop("algebra_us")
        assert all(value > 0.0 for value in numbers.values())
        parts_us = numbers["bare_us"] + numbers["read_us"] + numbers["dynamics_us"]
        assert algebra_us == pytest.approx(numbers["mean_us"] - parts_us)

    def test_an_imagined_object_has_no_limit_to_keep(self, free: BenchScene) -> None:
        assert measure_case(free, control.object_impedance, 50).limits == {}
