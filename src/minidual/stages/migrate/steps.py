"""The five steps of the migration: driven arms, speed and rows of each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from minidual.config.root import Config
from minidual.control.reflexes import ReflexError
from minidual.durable import write_csv
from minidual.errors import MinidualError, UsageError
from minidual.gate.stage import StageContext, StageFunction, StageResult
from minidual.plant.connect import SIMULATOR, connection
from minidual.plant.lifecycle import Connection
from minidual.robot.pair import SIDES, Array, Robot, robot_from
from minidual.skills.plant_drive import Driven, PlantDrive, swing
from minidual.stages.migrate import rows
from minidual.stages.migrate.measured import StepMeasurements, Worst, checks_of
from minidual.stages.migrate.meshes import small_meshes

PERSONS_ROWS = ("estop-button", "mains", "cable")
"""Rows that only a person can try: the stop button, mains off and on, the network cable pulled."""
_POSTURES = ("ready", "carry")
_HISTOGRAM_S = 0.001


@dataclass(frozen=True)
class Step:
    """One step.

    Attributes:
        name: Stage of the migration's table.
        summary: What it does.
        speed: Share of full speed.
        arms: Driven arms.
        rows: Keys of `measured.checks_of`.
        source: Which source of the arbiter leads.
    """

    name: str
    summary: str
    speed: float
    arms: tuple[int, ...]
    rows: tuple[str, ...]
    source: str = "policy"


STEPS: tuple[Step, ...] = (
    Step(
        "one-arm-10",
        "One arm at 10 % speed: tracking, gravity, stop",
        0.1,
        (0,),
        (
            "stops",
            "interface",
            "controllers",
            "limits",
            "latency",
            "gravity",
            "gains",
            "meshes",
            "hands",
            "speed",
            "stop",
            "tracking",
            "resting",
        ),
    ),
    Step(
        "both-arms-10",
        "Both arms at 10 % speed: synchrony, no collision, controllers switch",
        0.1,
        (0, 1),
        (
            "stops",
            "interface",
            "controllers",
            "limits",
            "latency",
            "gravity",
            "hands",
            "speed",
            "stop",
            "tracking",
            "synchrony",
        ),
    ),
    Step(
        "both-arms-30",
        "Both arms at 30 % speed: tracking in motion, no saturated motor",
        0.3,
        (0, 1),
        ("stops", "interface", "latency", "speed", "stop", "tracking", "synchrony", "torque"),
    ),
    Step(
        "teleoperation",
        "A leader at 30 % speed: latency, workspace",
        0.3,
        (0, 1),
        ("stops", "interface", "latency", "speed", "stop", "leader", "workspace"),
        source="teleop",
    ),
    Step(
        "full-speed",
        "Full speed with recording: indicators beside the simulation's, cameras, statistics",
        1.0,
        (0, 1),
        (
            "stops",
            "interface",
            "latency",
            "cameras",
            "speed",
            "stop",
            "statistics",
            "torque",
            "indicators",
        ),
    ),
)


def stage_of(step: Step) -> StageFunction:
    """Return the stage of a step."""
    return partial(run_step, step)


def run_step(step: Step, context: StageContext) -> StageResult:
    """Drive the configured plant through a step; write timing.csv and motion.csv."""
    config = context.config
    robot = robot_from(config.robot)
    signed_by, unsigned = signatures(context.options)
    link = connection(config.plant, robot, config.scene)
    with context.progress.task(step.name, len(step.rows)) as task, link:
        place = link.place
        m, logs = measure_step(step, link, config, boards=context.options.get("boards"))
        task.advance(len(step.rows), note=place)
    m.unsigned = unsigned if place == "hardware" else ()
    _write(context, logs, robot)
    data = {
        "step": step.name,
        "plant": config.plant.address,
        "place": place,
        "speed": step.speed,
        "signed_by": signed_by,
        "confirmed": [name for name in PERSONS_ROWS if name not in unsigned],
    }
    notes = [f"driven: {place} at {config.plant.address}"]
    if place != "hardware":
        notes.append(f"rows for a person ({', '.join(PERSONS_ROWS)}) are asked on hardware only")
    return StageResult(checks=checks_of(m, step.rows), data=data, notes=notes)


def signatures(options: object) -> tuple[str, tuple[str, ...]]:
    """Return who signed, and the rows for a person that are not confirmed.

    Raises:
        UsageError: An unknown row, or rows without a name.
    """
    values = dict(options) if isinstance(options, dict) else {}
    text = str(values.get("confirm") or "")
    confirmed = [word.strip() for word in text.split(",") if word.strip()]
    for name in confirmed:
        if name not in PERSONS_ROWS:
            raise UsageError(
                f"--confirm: no row '{name}'; there are {', '.join(PERSONS_ROWS)}",
            )
    signed_by = str(values.get("signed-by") or "")
    if confirmed and not signed_by:
        raise UsageError("--confirm needs the name of who tried it", remedy="add --signed-by NAME")
    return signed_by, tuple(name for name in PERSONS_ROWS if name not in confirmed)


def measure_step(
    step: Step,
    link: Connection,
    config: Config,
    boards: object = None,
) -> tuple[StepMeasurements, list[Driven]]:
    """Drive an open plant; return the measurements and the logs."""
    m = StepMeasurements(faults=rows.faults_of(link))
    logs: list[Driven] = []
    if m.faults:
        return m, logs
    try:
        _examine(step, link, config, boards, m)
        drive = PlantDrive(link, config, step.speed, step.source)
        drive.begin()
        work = _Work(step, drive, drive.q.copy(), m, logs, config)
        for name in step.rows:
            measure = _DRIVEN.get(name)
            if measure is not None:
                measure(work)
        _stop(work)
        if "statistics" in step.rows:
            _statistics(work)
        m.jitter_s = rows.timing(logs, link.plant.dt)
        m.speed = rows.speeds(logs, drive.robot, step.speed)
    except (ReflexError, MinidualError) as error:
        m.stops.append(error.message)
    m.faults = rows.faults_of(link)
    return m, logs


def _examine(
    step: Step,
    link: Connection,
    config: Config,
    boards: object,
    m: StepMeasurements,
) -> None:
    """Measure the rows that need no arm, before the arms are taken: they take long.

    Arms that are driven need a command in every period.
    """
    if "meshes" in step.rows:
        m.meshes_small = small_meshes(link.plant.robot)
    if "cameras" in step.rows:
        _calibrate(link, config, boards, m)


def _calibrate(link: Connection, config: Config, boards: object, m: StepMeasurements) -> None:
    """Calibrate; hardware needs pictures that were taken."""
    if boards is None and link.place == "hardware":
        m.focal = Worst(where="no pictures: add --boards FOLDER")
        return
    rows.calibration(m, config, link.plant.robot, boards)


@dataclass(frozen=True)
class _Work:
    """Inputs and results of a driven row's measurement."""

    step: Step
    drive: PlantDrive
    home: Array
    m: StepMeasurements
    logs: list[Driven]
    config: Config


def _controllers(work: _Work) -> None:
    work.m.controllers_wrong = rows.controllers(work.drive)


def _limits(work: _Work) -> None:
    work.m.limits_off = rows.declared_limits(work.drive.connection, work.drive.robot)
    work.m.approach, latency, _ = rows.approach(work.drive, work.home, work.step.arms)
    work.m.latency = latency


def _latency(work: _Work) -> None:
    """Measure latency where no approach has."""
    if not np.isnan(work.m.latency.value):
        return
    goal = work.home + rows.STEP_RAD * rows.inward(work.drive.robot, work.home)
    log = work.drive.move(goal, seconds=0.2)
    lags = [rows.lag_s(log, joint) for joint in range(work.drive.robot.dof)]
    work.m.latency = Worst(float(np.max(lags)), "")
    work.logs.append(log)
    work.logs.append(work.drive.move(work.home))


def _gravity(work: _Work) -> None:
    work.m.gravity, work.m.sag = rows.gravity(work.drive, work.home, work.step.arms)


def _gains(work: _Work) -> None:
    work.m.soft_overshoot, work.m.soft_error = rows.soft_step(
        work.drive,
        work.home,
        work.step.arms,
    )


def _hands(work: _Work) -> None:
    work.m.open_share, work.m.closed_m = rows.hands(work.drive, work.step.arms)


def _tracking(work: _Work) -> None:
    """Swing; measure tracking, the resting arm, synchrony and torques."""
    robot = work.drive.robot
    log = rows.swings(work.drive, work.home, work.step.arms, work.step.speed)
    work.logs.append(log)
    joints = rows.driven_joints(robot, work.step.arms)
    errors = log.errors[:, joints]
    work.m.tracking_rad = float(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
    resting = [joint for joint in range(robot.dof) if joint not in joints]
    if resting:
        work.m.resting_arm_rad = float(np.abs(log.q[:, resting] - work.home[resting]).max())
    _torques(work, log)


def _torques(work: _Work, log: Driven) -> None:
    share = np.abs(log.tau).max(axis=0) / work.drive.robot.tau_max
    work.m.torque = rows.worst_of(share, work.drive.robot.joint_names)


def _synchrony(work: _Work) -> None:
    """Move both arms alike; compare when they are half way."""
    robot = work.drive.robot
    goal = work.home + rows.STEP_RAD * rows.inward(robot, work.home)
    log = work.drive.move(goal, seconds=0.2)
    work.logs.append(log)
    lags = np.array([rows.lag_s(log, joint) for joint in range(robot.dof)])
    by_arm = [float(np.median(lags[robot.joints_of(arm)])) for arm in range(len(SIDES))]
    later = SIDES[int(np.argmax(by_arm))]
    work.m.arms_apart = Worst(abs(by_arm[0] - by_arm[1]), f"the {later} arm")
    work.logs.append(work.drive.move(work.home))


def _leader(work: _Work) -> None:
    """Lead by the hand of a scripted operator; measure how much later the arms are."""
    drive = work.drive
    dt_s = drive.plant.dt
    times_s = np.arange(1, round(rows.SWING_S / dt_s) + 1) * dt_s
    amplitudes = rows.SWING_RAD * rows.inward(drive.robot, work.home)
    targets = swing(work.home, amplitudes, rows.SWING_HZ, times_s)
    log = drive.follow(targets)
    work.logs.append(log)
    work.m.leader_latency_s = shift_s(targets, log.q, dt_s)
    drive.move(work.home)


def shift_s(targets: Array, measured: Array, dt_s: float) -> float:
    """Return by how much a measured path (T, n) is later than its targets [s], best fit."""
    most = min(len(targets) // 2, round(0.6 / dt_s))
    errors = [
        float(np.mean((measured[k:] - targets[: len(targets) - k]) ** 2)) for k in range(most)
    ]
    return float(np.argmin(errors)) * dt_s


def _workspace(work: _Work) -> None:
    """Lead the arms to the postures in which tasks are done."""
    missed: list[str] = []
    for name in _POSTURES:
        posture = work.drive.robot.arm.postures.get(name)
        if posture is None:
            continue
        goal = np.concatenate(posture)
        log = work.drive.move(goal, seconds=0.3)
        work.logs.append(log)
        if float(np.abs(log.q[-1] - goal).max()) > 0.02:
            missed.append(name)
    work.m.workspace_missed = missed
    work.logs.append(work.drive.move(work.home))


def _statistics(work: _Work) -> None:
    """Record a motion; compare its statistics with the simulation's.

    Nothing may drive the arms afterwards: they stand without commands while the simulation runs.
    """
    log, simulated = _beside_simulation(work)
    work.m.statistics = rows.statistics(log, simulated.q, work.drive.robot)
    _torques(work, log)
    peak = [float(np.abs(one.v).max()) for one in (log, simulated)]
    went = [float(np.abs(one.q - work.home).max()) for one in (log, simulated)]
    followed = [1.0 / (0.05 + one.rms_rad) for one in (log, simulated)]
    shares = {
        "peak speed": peak[0] / peak[1],
        "way": went[0] / went[1],
        "tracking": followed[0] / followed[1],
        "recorded samples": len(log.t) / max(1.0, (log.t[-1] - log.t[0]) / work.drive.plant.dt),
    }
    least = min(shares, key=lambda name: shares[name])
    work.m.indicator = Worst(shares[least], least)


def _beside_simulation(work: _Work) -> tuple[Driven, Driven]:
    """Drive the same motion on the plant and in the simulator."""
    drive = work.drive
    goal = _posture(drive.robot, work.home)
    log = drive.move(goal, seconds=0.2)
    work.logs.append(log)
    work.logs.append(drive.move(work.home))
    twin = connection(work.config.plant, drive.robot, work.config.scene, SIMULATOR)
    twin.plant.reset(np.clip(work.home, drive.robot.q_lower, drive.robot.q_upper))
    with twin:
        beside = PlantDrive(twin, work.config, work.step.speed)
        beside.begin()
        return log, beside.move(goal, seconds=0.2)


def _posture(robot: Robot, home: Array) -> Array:
    posture = robot.arm.postures.get("ready")
    return home + 0.2 * rows.inward(robot, home) if posture is None else np.concatenate(posture)


def _stop(work: _Work) -> None:
    """Row 11: stop in a swing, recover, go back."""
    drive = work.drive
    amplitudes = np.zeros(drive.robot.dof)
    joints = rows.driven_joints(drive.robot, work.step.arms)
    amplitudes[joints] = rows.SWING_RAD * rows.inward(drive.robot, work.home)[joints]
    times_s = np.arange(1, round(1.0 / drive.plant.dt) + 1) * drive.plant.dt
    drive.follow(swing(work.home, amplitudes, rows.SWING_HZ, times_s))
    work.m.rest_s = drive.stop_and_rest("migration")
    drive.recover()
    drive.move(work.home)


_DRIVEN: dict[str, Callable[[_Work], None]] = {
    "controllers": _controllers,
    "limits": _limits,
    "latency": _latency,
    "gravity": _gravity,
    "gains": _gains,
    "hands": _hands,
    "tracking": _tracking,
    "synchrony": _synchrony,
    "leader": _leader,
    "workspace": _workspace,
}
"""Measurement of each row that drives; the others follow from the log of the drive."""


def _write(context: StageContext, logs: Sequence[Driven], robot: Robot) -> None:
    """Write the histogram of periods, and the log of the drive."""
    periods = np.concatenate([np.diff(log.t) for log in logs]) if logs else np.zeros(0)
    edges, counts = np.unique(np.round(periods / _HISTOGRAM_S), return_counts=True)
    histogram = [
        {"period_ms": int(edge), "count": int(count)}
        for edge, count in zip(edges, counts, strict=True)
    ]
    write_csv(context.folder / "timing.csv", histogram)
    motion: list[dict[str, object]] = []
    for log in logs:
        for k in range(0, len(log.t), max(1, len(log.t) // 500)):
            row: dict[str, object] = {"time_s": f"{log.t[k]:.4f}"}
            row |= {
                name: f"{value:.5f}"
                for name, value in zip(robot.joint_names, log.q[k], strict=True)
            }
            motion.append(row)
    write_csv(context.folder / "motion.csv", motion)
