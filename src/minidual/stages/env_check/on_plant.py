"""`env-check --plant`: the same questions to a plant that is no simulator of ours.

No world is behind it: cameras, contacts and the engines' agreement are the simulator's.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from minidual.config.root import Config
from minidual.control.reflexes import ReflexError
from minidual.durable import write_csv
from minidual.errors import MinidualError
from minidual.gate.check import Check
from minidual.gate.stage import StageContext, StageResult
from minidual.plant.connect import connection
from minidual.plant.lifecycle import Connection
from minidual.robot.pair import SIDES, Array, Robot, robot_from
from minidual.skills.plant_drive import Driven, PlantDrive, swing
from minidual.stages.env_check import plant_criteria as criteria
from minidual.stages.env_check.checks import installation_checks
from minidual.stages.env_check.installation import required_libraries

STEP_RAD = 0.05
_STEP_S = 0.6
_REACHED_RAD = 0.01
"""Error of a joint, and motion of the others, that count as arrived."""
_SWING_RAD = 0.1
_SWING_HZ = 0.25
_SWING_S = 4.0
_APART_MAX_S = 0.02
_LATE_SHARE_MAX = 0.05
_RETURNED_RAD = 0.02
_PARTS = 4


@dataclass
class PlantMeasurements:
    """Measurements of `env-check` on a plant; NaN where it did not get that far.

    Attributes:
        faults: Of the arms, by name.
        reached: Whether each joint reached its step.
        swing_rms_rad: RMS of the error norm.
        stamp_age_s: Largest age of a measurement.
        arms_apart_s: Largest difference of the arms' stamps.
        later: The arm that lags.
        late_share: Share of late control steps.
        stops: Reflexes and refusals.
        rest_s: From the emergency stop to rest.
        recovery: Why the arms did not come back, or empty.
    """

    faults: list[str] = field(default_factory=list[str])
    reached: list[bool] = field(default_factory=list[bool])
    swing_rms_rad: float = math.nan
    stamp_age_s: float = math.nan
    arms_apart_s: float = math.nan
    later: str = ""
    late_share: float = math.nan
    stops: list[str] = field(default_factory=list[str])
    rest_s: float = math.nan
    recovery: str = "the emergency stop was not reached"


def run_on_plant(context: StageContext) -> StageResult:
    """Connect, measure, close; write joints.csv."""
    config = context.config
    robot = robot_from(config.robot)
    libraries = required_libraries()
    link = connection(config.plant, robot, config.scene)
    with context.progress.task("environment", _PARTS) as task, link:
        measured, rows = measure_plant(link, config, lambda note: task.advance(note=note))
        data = {
            "plant": link.address,
            "place": link.place,
            "kinds": [str(kind) for kind in link.kinds],
            "rate_hz": 1.0 / link.plant.dt,
            "arm": robot.name,
        }
    write_csv(context.folder / "joints.csv", rows)
    checks = [
        *installation_checks(libraries, robot.dof, robot),
        *plant_checks(measured, config, robot),
    ]
    notes = [f"driven: {link.place} at {link.address}"]
    return StageResult(checks=checks, data=data, notes=notes)


def measure_plant(
    link: Connection,
    config: Config,
    tell: object = None,
) -> tuple[PlantMeasurements, list[dict[str, object]]]:
    """Drive an open plant; return what it measured, and one row a joint."""
    note = tell if callable(tell) else (lambda text: None)
    m = PlantMeasurements(faults=_faults(link))
    rows: list[dict[str, object]] = []
    if m.faults:
        return m, rows
    try:
        drive = PlantDrive(link, config, speed=config.arbiter.speed_override)
        drive.begin()
        home = drive.q.copy()
        logs = _single_steps(drive, home, m, rows)
        note("each joint alone")
        steps = round(_SWING_S / link.plant.dt)
        times_s = np.arange(1, steps + 1) * link.plant.dt
        log = drive.follow(swing(home, _towards_middle(drive.robot, home), _SWING_HZ, times_s))
        m.swing_rms_rad = log.rms_rad
        logs.append(log)
        note("all joints swing")
        _time(m, logs, link.plant.dt)
        _stop_and_recover(drive, home, m)
        note("stop and recovery")
    except (ReflexError, MinidualError) as error:
        m.stops.append(error.message)
    m.faults = _faults(link)
    return m, rows


def _faults(link: Connection) -> list[str]:
    return [f"{health.arm}: {fault}" for health in link.healths for fault in health.faults]


def _towards_middle(robot: Robot, home: Array) -> Array:
    """Return signed amplitudes (n,) [rad] that lead away from the nearer limit."""
    middle = 0.5 * (robot.q_lower + robot.q_upper)
    return np.where(home <= middle, _SWING_RAD, -_SWING_RAD)


def _single_steps(
    drive: PlantDrive,
    home: Array,
    m: PlantMeasurements,
    rows: list[dict[str, object]],
) -> list[Driven]:
    """Step each joint alone and back; note which arrive."""
    robot = drive.robot
    signs = np.sign(_towards_middle(robot, home))
    logs: list[Driven] = []
    for joint, name in enumerate(robot.joint_names):
        goal = home.copy()
        goal[joint] += signs[joint] * STEP_RAD
        log = drive.move(goal, seconds=_STEP_S)
        error = np.abs(log.q[-1] - goal)
        m.reached.append(bool(error.max() < _REACHED_RAD))
        rows.append(
            {
                "joint": name,
                "step_rad": float(goal[joint] - home[joint]),
                "error_rad": float(error[joint]),
                "others_rad": float(np.delete(error, joint).max()),
            },
        )
        logs.append(log)
        logs.append(drive.move(home))
    return logs


def _time(m: PlantMeasurements, logs: list[Driven], dt_s: float) -> None:
    """Note ages and late steps of all logs."""
    ages = [float(np.max(log.t[:, None] - log.stamps_s)) for log in logs]
    apart = np.concatenate([log.stamps_s[:, 0] - log.stamps_s[:, 1] for log in logs])
    periods = np.concatenate([np.diff(log.t) for log in logs])
    m.stamp_age_s = float(np.max(ages))
    m.arms_apart_s = float(np.max(np.abs(apart)))
    m.later = SIDES[1] if apart[int(np.argmax(np.abs(apart)))] > 0.0 else SIDES[0]
    m.late_share = float(np.mean(periods > 1.5 * dt_s))


def _stop_and_recover(drive: PlantDrive, home: Array, m: PlantMeasurements) -> None:
    """Stop in a swing, recover, and go back to where the check began."""
    steps = round(0.5 / _SWING_HZ / drive.plant.dt / 2)
    times_s = np.arange(1, steps + 1) * drive.plant.dt
    drive.follow(swing(home, _towards_middle(drive.robot, home), _SWING_HZ, times_s))
    m.rest_s = drive.stop_and_rest("environment check")
    m.recovery = ""
    try:
        drive.recover()
        drive.move(home, seconds=_STEP_S)
    except (ReflexError, MinidualError) as error:
        m.recovery = error.message
        return
    away_rad = float(np.abs(drive.q - home).max())
    if not away_rad < _RETURNED_RAD:
        m.recovery = f"the arms stand {away_rad:.3f} rad from where they began"


def plant_checks(m: PlantMeasurements, config: Config, robot: Robot) -> list[Check]:
    """Return the checks of a plant's measurements."""
    names = [
        name for name, arrived in zip(robot.joint_names, m.reached, strict=False) if not arrived
    ]
    names += robot.joint_names[len(m.reached) :]
    limits = config.env_check
    age_max_s = config.supervisor.measurement_age_max_s
    return [
        criteria.FAULTS.check(len(m.faults), 0, faults="; ".join(m.faults)),
        criteria.STOPPED.check(len(m.stops), 0, stops="; ".join(m.stops)),
        criteria.STAMP_AGE.check(m.stamp_age_s, age_max_s),
        criteria.ARMS_APART.check(m.arms_apart_s, _APART_MAX_S, later=f"the {m.later} arm"),
        criteria.LATE_TICKS.check(m.late_share, _LATE_SHARE_MAX),
        criteria.REACHED.check(robot.dof - len(names), robot.dof, late=", ".join(names)),
        criteria.SWING_RMS.check(m.swing_rms_rad, limits.sine_rms_max_rad),
        criteria.STOP_REST.check(m.rest_s, limits.stop_rest_max_s),
        criteria.RECOVERED.check(int(not m.recovery), 1, reason=m.recovery),
    ]
