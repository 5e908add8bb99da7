"""Every limit of the shipped profiles and every number of the success tests, from its source.

A row names where its number comes from: a column of the table in the project's mission
(`baseline`, `excellent` or `goal`), a section of it (`mission`), or `design`: a choice of this
project. A number may become stricter without a change here, never looser.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from typing import Any, Literal, NamedTuple

import pytest

from minidual.config.base import limits
from minidual.config.loader import load_config
from minidual.config.root import Config, changed
from minidual.robot.pair import SIDES
from minidual.tasks.catalogue import TASKS, make_task
from minidual.tasks.insertion import HAND_OF
from minidual.tasks.sort import side_of
from minidual.tasks.success import SuccessCondition
from minidual.trials.methods import METHODS

type Mark = Literal["at least", "at most"]
AT_LEAST: Mark = "at least"
AT_MOST: Mark = "at most"


class Limit(NamedTuple):
    """A number, on which side of it acceptance lies, and where it comes from."""

    name: str
    mark: Mark
    value: Any
    source: str


PROFILE_LIMITS = (
    Limit("env_check.step_rad", AT_LEAST, 0.3, "baseline"),
    Limit("env_check.step_duration_s", AT_MOST, 2.0, "design"),
    Limit("env_check.step_error_max_rad", AT_MOST, 0.005, "goal"),
    Limit("env_check.single_step_rad", AT_LEAST, 0.1, "design"),
    Limit("env_check.single_duration_s", AT_MOST, 0.6, "design"),
    Limit("env_check.sine_amplitude_rad", AT_LEAST, 0.3, "baseline"),
    Limit("env_check.sine_frequency_hz", AT_LEAST, 0.5, "baseline"),
    Limit("env_check.sine_duration_s", AT_LEAST, 10.0, "baseline"),
    Limit("env_check.sine_rms_max_rad", AT_MOST, 0.02, "goal"),
    Limit("env_check.rise_max_s", AT_MOST, 0.25, "design"),
    Limit("env_check.overshoot_max_rad", AT_MOST, 0.005, "design"),
    Limit("env_check.stop_rest_max_s", AT_MOST, 0.5, "design"),
    Limit("env_check.agreement_states_n", AT_LEAST, 20, "design"),
    Limit("env_check.agreement_max", AT_MOST, 1e-10, "design"),
    Limit("plan.queries_n", AT_LEAST, 100, "goal"),  # three groups, two seeds: 600 queries
    Limit("plan.second_queries_n", AT_LEAST, 100, "goal"),
    Limit("plan.obstacles_n", AT_LEAST, 5, "design"),
    Limit("plan.blocked_fraction", AT_LEAST, 1.0, "design"),
    Limit("plan.agreement_states_n", AT_LEAST, 2000, "design"),
    Limit("plan.success_rate_min", AT_LEAST, 1.0, "baseline"),
    Limit("plan.time_max_s", AT_MOST, 10.0, "baseline"),
    Limit("plan.time_median_max_s.left_arm", AT_MOST, 0.2, "excellent"),
    Limit("plan.time_median_max_s.right_arm", AT_MOST, 0.2, "excellent"),
    Limit("plan.time_median_max_s.both_arms", AT_MOST, 2.0, "excellent"),
    Limit("plan.agreement_min", AT_LEAST, 0.999, "design"),
    Limit("plan.held.moves_n", AT_LEAST, 100, "design"),
    Limit("plan.held.executed_n", AT_LEAST, 6, "design"),
    Limit("plan.held.cpu_time_median_max_s", AT_MOST, 2.0, "design"),
    Limit("plan.held.executed_error_max_m", AT_MOST, 0.002, "design"),
    Limit("plan.held.executed_error_max_rad", AT_MOST, 0.01745, "design"),  # 1 degree
    Limit("carry.trials_n", AT_LEAST, 200, "goal"),
    Limit("carry.sensing.pose_noise_m", AT_LEAST, 0.0005, "design"),
    Limit("carry.sensing.pose_noise_rad", AT_LEAST, 0.005236, "design"),  # 0.3 degrees
    Limit("carry.sensing.pose_bias_m", AT_LEAST, 0.0, "design"),
    Limit("carry.sensing.pose_bias_rad", AT_LEAST, 0.0, "design"),
    Limit("carry.sensing.force_noise_n", AT_LEAST, 1.0, "design"),
    Limit("carry.sensing.delay_s", AT_LEAST, 0.010, "design"),
    Limit("carry.limits.success_rate_min", AT_LEAST, 0.99, "goal"),
    Limit("carry.limits.tilt_max_rad", AT_MOST, 0.0349, "goal"),  # 2 degrees
    Limit("carry.limits.duration_max_s", AT_MOST, 8.0, "design"),  # baseline: 10 s
    Limit("carry.limits.saturation_max_s", AT_MOST, 0.02, "design"),
    Limit("teleop.episodes_n", AT_LEAST, 150, "design"),  # baseline: 50
    Limit("teleop.jerk_max_rad_s3", AT_MOST, 200.0, "baseline"),
    Limit("teleop.latency_max_s", AT_MOST, 0.1, "baseline"),
    Limit("teleop.episodes_per_min", AT_LEAST, 3.0, "baseline"),
    Limit("train.seeds_n", AT_LEAST, 1, "design"),
    Limit("train.loss_ratio_max", AT_MOST, 0.5, "design"),
    Limit("train.actions_in_limits_min", AT_LEAST, 0.999, "design"),
    Limit("deploy.trials", AT_LEAST, 100, "goal"),
    Limit("deploy.training_trials", AT_LEAST, 50, "design"),
    Limit("deploy.hidden_trials", AT_LEAST, 5, "design"),
    Limit("deploy.hidden_rate_max", AT_MOST, 0.2, "design"),
    Limit("deploy.condition_rate_min", AT_LEAST, {"room": 0.85}, "design"),
    Limit("deploy.success_rate_min", AT_LEAST, 0.949, "goal"),  # more than that: 95 of 100
    Limit("deploy.inference_hz_min", AT_LEAST, 30.0, "baseline"),
    Limit("benchmark.methods", AT_LEAST, ("moveit", "impedance", "act"), "baseline"),
    Limit(
        "benchmark.conditions",
        AT_LEAST,
        (
            "clean",
            "randomised",
            "friction 0.3",
            "mass +50 %",
            "push +y",
            "moved 20 mm",
            "pose noise x3",
            "delay 20 ms",
            "light -30 %",
        ),
        "design",
    ),
    Limit(
        "benchmark.condition_trials",
        AT_LEAST,
        {
            "randomised": {
                "rod_carry": 60,
                "pot_lift": 16,
                "handover": 16,
                "insertion": 50,
                "sort": 10,
            },
        },
        "design",
    ),
    # Undisturbed trials saturate: every method succeeds in nearly all. `randomised` has most trials.
    Limit("benchmark.trials_n", AT_LEAST, 30, "design"),
    Limit("benchmark.perturbed_trials_n", AT_LEAST, 10, "design"),
    Limit(
        "benchmark.success_rate_min",
        AT_LEAST,
        {"moveit": 0.8, "impedance": 0.8, "act": 0.5},
        "excellent",
    ),
    Limit(
        "benchmark.tasks",
        AT_LEAST,
        {"pot_lift": 6, "handover": 6, "insertion": 6, "sort": 6},
        "goal",
    ),
    Limit("benchmark.own_task", AT_LEAST, True, "goal"),
    Limit("benchmark.own_policies", AT_LEAST, True, "goal"),
    Limit("deploy.own_policy", AT_LEAST, True, "goal"),
    Limit("teleop.lag_max_s", AT_MOST, 0.1, "mission"),
    Limit("scene.task.goal_range_m", AT_LEAST, 0.05, "design"),
    Limit("scene.task.goal_range_rad", AT_LEAST, 0.2618, "design"),  # 15 degrees
    Limit("scene.task.yaw_tolerance_rad", AT_MOST, 0.08727, "design"),  # 5 degrees
    Limit("scene.task.start_range_m", AT_LEAST, 0.05, "design"),
    Limit("scene.task.start_range_rad", AT_LEAST, 0.2618, "design"),  # 15 degrees
    Limit("scene.task.clear_height_m", AT_LEAST, 0.04, "design"),
    Limit("scene.task.tilt_max_rad", AT_MOST, 0.08727, "baseline"),  # 5 degrees
    Limit("scene.task.goal_tolerance_m", AT_MOST, 0.02, "design"),
    Limit("scene.task.pinch_min_n", AT_LEAST, 20.0, "baseline"),
    Limit("scene.task.internal_force_min_n", AT_LEAST, 20.0, "baseline"),
    Limit("scene.task.rest_speed_m_per_s", AT_MOST, 0.02, "design"),
    Limit("scene.task.time_limit_s", AT_MOST, 15.0, "design"),
    Limit("scene.task.distance_m", AT_LEAST, 0.5, "baseline"),
    Limit("scene.task.turn_rad", AT_LEAST, 0.0, "design"),
)

# What `smoke` has instead: it proves wiring, and its verdicts never count as acceptance.
SMOKE_LIMITS: dict[str, Any] = {
    "teleop.episodes_per_min": None,  # four episodes tell the start of processes, not the rate
    "plan.queries_n": 4,
    "plan.second_queries_n": 1,
    "plan.held.moves_n": 4,
    "plan.held.executed_n": 1,
    "carry.trials_n": 2,
    "carry.limits.success_rate_min": 0.81,
    "carry.limits.tilt_max_rad": 0.08727,
    "carry.limits.duration_max_s": 10.0,
    "teleop.episodes_n": 4,
    "deploy.trials": 2,
    "deploy.training_trials": 1,
    "deploy.hidden_trials": 1,
    "deploy.hidden_rate_max": None,
    "deploy.condition_rate_min": {},
    "deploy.success_rate_min": None,
    "benchmark.conditions": ("clean", "push +x"),
    "benchmark.condition_trials": {},
    "benchmark.trials_n": 2,
    "benchmark.perturbed_trials_n": 1,
    "benchmark.success_rate_min": {"moveit": 0.8, "impedance": 0.8},
    "benchmark.tasks": {"pot_lift": 1},
}

CONSTANTS = (
    Limit("minidual.trials.benchmark.DISTURBED_RATE_MIN", AT_LEAST, 0.95, "goal"),
    Limit("minidual.trials.tuning.TRACKING_MAX_M", AT_MOST, 0.01, "mission"),
    Limit("minidual.trials.tuning.OSCILLATION_MAX_M", AT_MOST, 0.0003, "design"),
    Limit("minidual.demos.schema.MAX_SYNC_S", AT_MOST, 0.020, "mission"),
    Limit("minidual.tasks.judge.REST_S", AT_LEAST, 0.1, "design"),
    Limit("minidual.tasks.truth.AIRBORNE_M", AT_MOST, 0.003, "design"),
    Limit("minidual.tasks.truth.TOUCH_N", AT_MOST, 0.1, "design"),
    Limit("minidual.tasks.movement.HIGH_SHARE", AT_LEAST, 0.5, "design"),
    Limit("minidual.tasks.movement.SHIFT_M", AT_MOST, 0.03, "design"),
    Limit("minidual.tasks.movement.SETTLE_M", AT_MOST, 0.005, "design"),
    Limit("minidual.tasks.movement.SET_DOWN_M", AT_MOST, 0.001, "design"),
    Limit("minidual.tasks.movement.SPEED_M_PER_S", AT_MOST, 1.7, "design"),
    Limit("minidual.tasks.movement.ALONE_M", AT_LEAST, 0.1, "design"),
    Limit("minidual.tasks.movement.BOTH_S", AT_LEAST, 0.1, "design"),
    Limit("minidual.tasks.insertion.CLEARANCE_M", AT_MOST, 0.0015, "design"),
    Limit("minidual.tasks.insertion.DEPTH_M", AT_LEAST, 0.03, "design"),
    Limit("minidual.tasks.insertion.HOLD_S", AT_LEAST, 0.3, "design"),
)

_ROD: dict[str, dict[str, Any]] = {
    "level": {"limit_rad": 0.08727},
    "whole": {"pinch_max_n": None, "force_max_n": None},
    "held": {"limit_n": 20.0, "both": True, "hand": None},
    "slow": {"limit_m_per_s": 1.7},
    "carried": {"height_m": 0.02, "limit_m": 0.03},
    "squeezed": {"limit_n": 20.0},
    "rose": {"limit_m": 0.04},
    "arrived": {"limit_m": 0.02},
    "turned": {"limit_rad": 0.08727, "symmetry": 2},
    "released": {},
    "settled": {"height_m": 0.02, "limit_m": 0.005, "over_m": 0.001},
    "at_rest": {"limit_m_per_s": 0.02},
    "on_time": {"limit_s": 15.0},
}
# {task or variant: {condition: {field: value}}}: every number of every success test.
SUCCESS: dict[str, dict[str, dict[str, Any]]] = {
    "rod_carry": _ROD,
    "glass": {
        **_ROD,
        "whole": {"pinch_max_n": 40.0, "force_max_n": 20.0},
        "squeezed": {"limit_n": 10.0},
    },
    "over": {**_ROD, "clear": {}},
    "pot_lift": {
        **_ROD,
        "carried": {"height_m": 0.05, "limit_m": 0.03},
        "settled": {"height_m": 0.05, "limit_m": 0.005, "over_m": 0.001},
        "rose": {"limit_m": 0.10},
        "arrived": {"limit_m": 0.03},
        "turned": {"limit_rad": 0.2618, "symmetry": 2},
    },
    "handover": {
        "level": {"limit_rad": 0.20},
        "held": {"limit_n": 20.0, "both": False, "hand": None},
        "slow": {"limit_m_per_s": 1.7},
        "carried": {"height_m": 0.02, "limit_m": 0.03},
        "rose": {"limit_m": 0.04},
        "exchanged": {"limit_n": 20.0, "alone_m": 0.1, "both_s": 0.1},
        "arrived": {"limit_m": 0.02},
        "released": {},
        "settled": {"height_m": 0.02, "limit_m": 0.005, "over_m": 0.001},
        "at_rest": {"limit_m_per_s": 0.02},
        "on_time": {"limit_s": 25.0},
    },
    "insertion": {
        "level": {"limit_rad": 0.08727},
        "whole": {"pinch_max_n": None, "force_max_n": 40.0},
        "held": {"limit_n": 20.0, "both": True, "hand": "of the object"},
        "slow": {"limit_m_per_s": 1.7},
        "carried": {"height_m": 0.05, "limit_m": 0.03},
        "aloft": {"limit_m": 0.10},
        "mated": {"height_m": 0.10},
        "arrived": {"limit_m": 0.02},
        "turned": {"limit_rad": 0.2618, "symmetry": 1},
        "on_time": {"limit_s": 20.0},
    },
    "sort": {
        "level": {"limit_rad": 0.20},
        "held": {"limit_n": 20.0, "both": False, "hand": None},
        "slow": {"limit_m_per_s": 1.7},
        "carried": {"height_m": 0.02, "limit_m": 0.03},
        "rose": {"limit_m": 0.04},
        "brought": {"limit_n": 20.0, "hand": "of the object"},
        "inside": {"bin_m": (0.16, 0.18)},
        "released": {},
        "settled": {"height_m": 0.02, "limit_m": 0.005, "over_m": 0.001},
        "at_rest": {"limit_m_per_s": 0.02},
        "placed_1": {},
        "placed_2": {},
        "placed_3": {},
        "placed_4": {},
        "on_time": {"limit_s": 48.0},
    },
}
_VARIANTS: dict[str, dict[str, str]] = {
    "glass": {"carry.object": "glass"},
    "over": {"carry.motion": "over"},
}


@functools.cache
def profile(name: str) -> Config:
    return load_config(name, []).config


def is_looser(value: Any, limit: Any, mark: Mark) -> bool:
    """Return whether a value asks for less than a limit; None asks for nothing."""
    if value is None:
        return True
    if isinstance(limit, Mapping):
        return any(name not in value or is_looser(value[name], limit[name], mark) for name in limit)
    if isinstance(limit, tuple):
        return value != ("all",) and not set(limit) <= set(value)
    return value > limit if mark == AT_MOST else value < limit


def loosened(limit: Limit) -> Any:
    """Return a value that asks for a little less than a limit."""
    value = limit.value
    if isinstance(value, Mapping):
        return dict(list(value.items())[1:])
    if isinstance(value, tuple):
        return value[1:]
    if isinstance(value, bool):
        return not value
    step = 0.01 * abs(value) or 1e-6
    return value + step if limit.mark == AT_MOST else value - step


def by_name(limit: Limit) -> str:
    return limit.name


@pytest.mark.parametrize("name", ["standard", "gpu"])
@pytest.mark.parametrize("limit", PROFILE_LIMITS, ids=by_name)
def test_no_limit_of_an_acceptance_profile_is_looser_than_its_source(
    name: str,
    limit: Limit,
) -> None:
    values = {path: value for path, _, value in limits(profile(name))}
    value = values[limit.name]
    needed = f"{limit.source}: {limit.mark} {limit.value}"
    assert not is_looser(value, limit.value, limit.mark), f"{limit.name} is {value}; {needed}"


@pytest.mark.parametrize("limit", PROFILE_LIMITS, ids=by_name)
def test_smoke_is_looser_in_its_own_limits_alone(limit: Limit) -> None:
    values = {path: value for path, _, value in limits(profile("smoke"))}
    allowed = SMOKE_LIMITS.get(limit.name, limit.value)
    if allowed is None:
        assert values[limit.name] is None
    else:
        assert not is_looser(values[limit.name], allowed, limit.mark)


@pytest.mark.parametrize("name", ["standard", "gpu", "smoke"])
def test_every_limit_of_a_profile_has_a_row_here(name: str) -> None:
    marks = {path: mark for path, mark, _ in limits(profile(name))}
    assert marks == {limit.name: limit.mark for limit in PROFILE_LIMITS}


def test_smoke_alone_is_no_acceptance() -> None:
    accepted = {name: profile(name).acceptance for name in ("standard", "gpu", "smoke")}
    assert accepted == {"standard": True, "gpu": True, "smoke": False}


@pytest.mark.parametrize("limit", CONSTANTS, ids=by_name)
def test_no_limit_in_the_code_is_looser_than_its_source(limit: Limit) -> None:
    module, _, constant = limit.name.rpartition(".")
    value = getattr(importlib.import_module(module), constant)
    assert not is_looser(value, limit.value, limit.mark)


@pytest.mark.parametrize("limit", [*PROFILE_LIMITS, *CONSTANTS], ids=by_name)
def test_a_loosened_limit_is_noticed(limit: Limit) -> None:
    assert is_looser(loosened(limit), limit.value, limit.mark)
    assert is_looser(None, limit.value, limit.mark)
    assert not is_looser(limit.value, limit.value, limit.mark)


def conditions_of(variant: str, config: Config) -> tuple[SuccessCondition, ...]:
    task_name = variant if variant in TASKS else "rod_carry"
    settings = {"task": task_name, **_VARIANTS.get(variant, {})}
    task = make_task(changed(config, settings))
    return tuple(task.success(task, task.trial(config.seed, "limits", 0)))


def numbers_of(part: SuccessCondition) -> Iterator[tuple[str, Any]]:
    """Yield the fields of a condition that do not depend on the trial."""
    if not is_dataclass(part):
        return
    for field in fields(part):
        if field.name.startswith("_") or field.name in ("object", "geom", "start", "goal"):
            continue
        value = getattr(part, field.name)
        if field.name == "goal_rad":  # of the trial
            continue
        if field.name == "mark":
            yield "bin_m", value.size_m
        elif field.name == "hand" and value is not None:
            side = HAND_OF.get(part.object) or side_of(part.object)
            assert value == SIDES.index(side)
            yield "hand", "of the object"
        else:
            yield field.name, value


@pytest.mark.parametrize("name", ["standard", "gpu"])
@pytest.mark.parametrize("variant", SUCCESS)
def test_every_number_of_a_success_test_is_the_one_here(name: str, variant: str) -> None:
    """Each part of a condition on several objects has the same numbers."""
    table = SUCCESS[variant]
    conditions = conditions_of(variant, profile(name))
    assert {condition.name for condition in conditions} == set(table)
    for condition in conditions:
        for _, part in condition.each():
            assert dict(numbers_of(part)) == table[condition.name], condition.name


def test_every_task_has_its_success_test_here() -> None:
    assert set(TASKS) <= set(SUCCESS)


@pytest.mark.parametrize("variant", SUCCESS)
def test_the_squeeze_alone_is_optional_and_force_methods_demand_it(variant: str) -> None:
    conditions = conditions_of(variant, profile("standard"))
    optional = {condition.name for condition in conditions if condition.optional}
    assert optional == ({"squeezed"} & set(SUCCESS[variant]))
    demands = {name: tuple(row.demands) for name, row in METHODS.items()}
    force_methods = {"impedance", "impedance_open", "impedance_world"}
    assert {name for name, demanded in demands.items() if demanded} == force_methods
    assert all(demands[name] == ("squeezed",) for name in force_methods)
