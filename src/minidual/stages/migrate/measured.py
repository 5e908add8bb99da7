"""Measurements of a step of the migration, and their checks."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from minidual.gate.check import Check
from minidual.stages.migrate import criteria

JITTER_MAX_S = 0.005
LATENCY_MAX_S = 0.15
LEADER_LATENCY_MAX_S = 0.2
LIMITS_OFF_MAX_RAD = 0.02
APPROACH_MAX_RAD = 0.01
GRAVITY_SHARE_MAX = 0.08
SAG_MAX_RAD = 0.005
SOFT_OVERSHOOT_MAX_RAD = 0.01
SOFT_ERROR_MAX_RAD = 0.01
FOCAL_ERROR_MAX = 0.02
REPROJECTION_MAX_PX = 1.0
OPEN_SHARE_MIN = 0.95
CLOSED_MAX_M = 0.004
SPEED_SHARE_MAX = 1.1
REST_MAX_S = 0.5
STATISTICS_MAX_RAD = 0.05
TRACKING_MAX_RAD = 0.1
RESTING_MAX_RAD = 0.005
APART_MAX_S = 0.02
TORQUE_SHARE_MAX = 0.9
INDICATOR_MIN = 0.8


@dataclass
class Worst:
    """The worst of several values, and where it was.

    Attributes:
        value: NaN if nothing was measured.
        where: Joint, hand, camera or arm.
    """

    value: float = math.nan
    where: str = ""


@dataclass
class StepMeasurements:
    """Measurements of one step; NaN, or a value that fails, where it did not get that far.

    Attributes are named after the criteria that they are compared by.
    """

    faults: list[str] = field(default_factory=list[str])
    stops: list[str] = field(default_factory=list[str])
    controllers_wrong: list[str] | None = None
    limits_off: Worst | None = None
    """None if the plant declares no limits."""
    approach: Worst = field(default_factory=Worst)
    jitter_s: float = math.nan
    latency: Worst = field(default_factory=Worst)
    gravity: Worst = field(default_factory=Worst)
    sag: Worst = field(default_factory=Worst)
    soft_overshoot: Worst = field(default_factory=Worst)
    soft_error: Worst = field(default_factory=Worst)
    meshes_small: list[str] | None = None
    focal: Worst = field(default_factory=Worst)
    reprojection: Worst = field(default_factory=Worst)
    open_share: Worst = field(default_factory=Worst)
    closed_m: Worst = field(default_factory=Worst)
    speed: Worst = field(default_factory=Worst)
    rest_s: float = math.nan
    unsigned: Sequence[str] = ()
    statistics: Worst = field(default_factory=Worst)
    tracking_rad: float = math.nan
    resting_arm_rad: float = math.nan
    arms_apart: Worst = field(default_factory=Worst)
    torque: Worst = field(default_factory=Worst)
    leader_latency_s: float = math.nan
    workspace_missed: list[str] | None = None
    indicator: Worst = field(default_factory=Worst)


def _count(names: list[str] | None) -> float:
    """Return the count, NaN if it was not measured."""
    return math.nan if names is None else len(names)


def checks_of(m: StepMeasurements, names: Sequence[str]) -> list[Check]:
    """Return the checks of a step: `names` are keys of `ALL`, in their order."""
    every = _every(m)
    return [check for name in names for check in every[name]]


def _every(m: StepMeasurements) -> dict[str, list[Check]]:
    """Return {row or part of a step: its checks}."""
    return {**_plant_checks(m), **_motion_checks(m), **_equipment_checks(m)}


def _plant_checks(m: StepMeasurements) -> dict[str, list[Check]]:
    """Return the checks of the link to the plant: its interface, limits and times."""
    wrong = m.controllers_wrong
    return {
        "stops": [criteria.STOPPED.check(len(m.stops), 0, stops="; ".join(m.stops))],
        "interface": [criteria.INTERFACE.check(len(m.faults), 0, faults="; ".join(m.faults))],
        "controllers": [
            criteria.CONTROLLERS.check(_count(wrong), 0, wrong="; ".join(wrong or ["not tried"])),
        ],
        "limits": _limits_checks(m),
        "latency": [
            criteria.JITTER.check(m.jitter_s, JITTER_MAX_S),
            criteria.LATENCY.check(m.latency.value, LATENCY_MAX_S),
        ],
        "stop": [
            criteria.STOP.check(m.rest_s, REST_MAX_S),
            criteria.SIGNED.check(len(m.unsigned), 0, rows=",".join(m.unsigned)),
        ],
    }


def _limits_checks(m: StepMeasurements) -> list[Check]:
    approach = criteria.APPROACH.check(m.approach.value, APPROACH_MAX_RAD, joint=m.approach.where)
    limits = m.limits_off
    if limits is None:
        return [approach]
    declared = criteria.LIMITS.check(limits.value, LIMITS_OFF_MAX_RAD, joint=limits.where)
    return [declared, approach]


def _motion_checks(m: StepMeasurements) -> dict[str, list[Check]]:
    """Return the checks of how the arms move."""
    return {
        "gravity": [
            criteria.GRAVITY.check(m.gravity.value, GRAVITY_SHARE_MAX, joint=m.gravity.where),
            criteria.SAG.check(m.sag.value, SAG_MAX_RAD, joint=m.sag.where),
        ],
        "gains": [
            criteria.SOFT_OVERSHOOT.check(
                m.soft_overshoot.value,
                SOFT_OVERSHOOT_MAX_RAD,
                joint=m.soft_overshoot.where,
            ),
            criteria.SOFT_ERROR.check(
                m.soft_error.value,
                SOFT_ERROR_MAX_RAD,
                joint=m.soft_error.where,
            ),
        ],
        "speed": [criteria.SPEED.check(m.speed.value, SPEED_SHARE_MAX, joint=m.speed.where)],
        "statistics": [
            criteria.STATISTICS.check(
                m.statistics.value,
                STATISTICS_MAX_RAD,
                joint=m.statistics.where,
            ),
        ],
        "tracking": [criteria.TRACKING.check(m.tracking_rad, TRACKING_MAX_RAD)],
        "resting": [criteria.RESTING_ARM.check(m.resting_arm_rad, RESTING_MAX_RAD)],
        "synchrony": [
            criteria.SYNCHRONY.check(
                m.arms_apart.value,
                APART_MAX_S,
                later=m.arms_apart.where,
            ),
        ],
        "torque": [criteria.TORQUE.check(m.torque.value, TORQUE_SHARE_MAX, joint=m.torque.where)],
    }


def _equipment_checks(m: StepMeasurements) -> dict[str, list[Check]]:
    """Return the checks of cameras, hands, leader, models and indicators."""
    small = m.meshes_small
    missed = m.workspace_missed
    return {
        "meshes": [criteria.MESHES.check(_count(small), 0, links=", ".join(small or []))],
        "cameras": [
            criteria.FOCAL.check(m.focal.value, FOCAL_ERROR_MAX, camera=m.focal.where),
            criteria.REPROJECTION.check(
                m.reprojection.value,
                REPROJECTION_MAX_PX,
                camera=m.reprojection.where,
            ),
        ],
        "hands": [
            criteria.HAND_OPEN.check(m.open_share.value, OPEN_SHARE_MIN, hand=m.open_share.where),
            criteria.HAND_CLOSED.check(m.closed_m.value, CLOSED_MAX_M, hand=m.closed_m.where),
        ],
        "leader": [criteria.LEADER_LATENCY.check(m.leader_latency_s, LEADER_LATENCY_MAX_S)],
        "workspace": [
            criteria.WORKSPACE.check(_count(missed), 0, postures=", ".join(missed or [])),
        ],
        "indicators": [
            criteria.INDICATORS.check(
                m.indicator.value,
                INDICATOR_MIN,
                indicator=m.indicator.where,
            ),
        ],
    }
