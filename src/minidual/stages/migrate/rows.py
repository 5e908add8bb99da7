"""Measurements of the rows of the migration's checklist; no row depends on another's numbers."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from minidual.config.root import Config
from minidual.control.controller_manager import ControllerSwitchError
from minidual.plant.lifecycle import CommandKind, Connection, kind_of
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import SIDES, Array, Robot
from minidual.skills.plant_drive import Driven, PlantDrive, swing
from minidual.stages.migrate import cameras
from minidual.stages.migrate.measured import StepMeasurements, Worst

APPROACH_RAD = 0.15
"""How far each joint is moved to both sides."""
STEP_RAD = 0.05
SOFT_SHARE = 0.75
SWING_RAD = 0.1
SWING_HZ = 0.25
SWING_S = 4.0
_HOLD_S = 1.0
_SETTLE_S = 0.5
_HAND_S = 2.0


def worst_of(values: Array, names: Sequence[str]) -> Worst:
    """Return the largest value and its name; NaN is larger than any."""
    index = int(np.argmax(np.where(np.isnan(values), np.inf, values)))
    return Worst(float(values[index]), names[index])


def faults_of(link: Connection) -> list[str]:
    """Return the faults of all arms."""
    return [f"{health.arm}: {fault}" for health in link.healths for fault in health.faults]


def driven_joints(robot: Robot, arms: Sequence[int]) -> list[int]:
    """Return the joints of some arms."""
    every = np.arange(robot.dof)
    return [int(joint) for arm in arms for joint in every[robot.joints_of(arm)]]


def inward(robot: Robot, home: Array) -> Array:
    """Return the direction (n,) of each joint away from its nearer limit."""
    middle = 0.5 * (robot.q_lower + robot.q_upper)
    return np.where(home <= middle, 1.0, -1.0)


def controllers(drive: PlantDrive) -> list[str]:
    """Row 2: return the sets of controllers that did not answer as they should."""
    wrong: list[str] = []
    stack = drive.stack
    for names in (("left_arm", "right_arm"), ("both_arms",)):
        try:
            stack.request("policy" if stack.source == "policy" else "hold", names)
            drive.hold(0.1)
        except ControllerSwitchError as error:
            wrong.append(f"{' and '.join(names)}: {error.message}")
    by_position = kind_of(drive.plant) is CommandKind.POSITION
    try:
        stack.manager.check(("object_impedance",))
        refused = ""
    except ControllerSwitchError as error:
        refused = error.name
    if by_position and refused != "wrong_plant":
        wrong.append("object_impedance is not refused on a plant that takes joint targets")
    if not by_position and refused == "wrong_plant":
        wrong.append("object_impedance is refused on a plant that takes torques")
    return wrong


def declared_limits(link: Connection, robot: Robot) -> Worst | None:
    """Row 3: return how far the plant's declared limits are from the arm model's."""
    declared = getattr(link.plant, "limits_rad", None)
    if declared is None:
        return None
    lower, upper = declared
    off = np.maximum(np.abs(lower - robot.q_lower), np.abs(upper - robot.q_upper))
    return worst_of(off, robot.joint_names)


def approach(drive: PlantDrive, home: Array, arms: Sequence[int]) -> tuple[Worst, Worst, Worst]:
    """Row 3 and 6: move each joint slowly to both sides.

    Returns:
        Largest error of a joint at its goal, latency [s], and largest motion of the other joints.
    """
    robot = drive.robot
    errors = np.zeros(robot.dof)
    lags: list[float] = []
    others_moved = np.zeros(robot.dof)
    joints = driven_joints(robot, arms)
    for joint in joints:
        for side in (1.0, -1.0):
            goal = home.copy()
            goal[joint] += side * APPROACH_RAD
            goal = np.clip(goal, robot.q_lower + 0.02, robot.q_upper - 0.02)
            log = drive.move(goal, seconds=0.1)
            deviation = np.abs(log.q[-1] - goal)
            errors[joint] = max(errors[joint], deviation[joint])
            others_moved[joint] = max(others_moved[joint], float(np.delete(deviation, joint).max()))
            lags.append(lag_s(log, joint))
            drive.move(home)
    names = [robot.joint_names[joint] for joint in joints]
    worst = worst_of(np.maximum(errors, others_moved)[joints], names)
    return worst, Worst(float(np.median(lags)), ""), worst_of(others_moved[joints], names)


def lag_s(log: Driven, joint: int) -> float:
    """Return how much later than its reference a joint is half way [s]; NaN if it never is."""
    reference = log.reference[:, joint]
    measured = log.q[:, joint]
    start = reference[0]
    end = reference[-1]
    if abs(end - start) < 1e-6:
        return float("nan")
    shares = [(path - start) / (end - start) >= 0.5 for path in (reference, measured)]
    if not all(share.any() for share in shares):
        return float("nan")
    reference_s, measured_s = (float(log.t[int(np.argmax(share))]) for share in shares)
    return measured_s - reference_s


def timing(logs: Sequence[Driven], dt_s: float) -> float:
    """Row 4: return the 99th percentile of the deviation of steps and stamps from the period."""
    periods = np.concatenate(
        [np.r_[np.diff(log.t), np.diff(log.stamps_s, axis=0).ravel()] for log in logs],
    )
    return float(np.percentile(np.abs(periods - dt_s), 99.0))


def gravity(drive: PlantDrive, home: Array, arms: Sequence[int]) -> tuple[Worst, Worst]:
    """Row 5: hold still; return the share of torque that gravity does not explain, and the sag."""
    drive.move(home, seconds=_SETTLE_S)
    drive.take_rows()
    drive.hold(_HOLD_S)
    log = drive.take()
    robot = drive.robot
    joints = driven_joints(robot, arms)
    needed = np.array(Kinematics(robot).gravity(log.q.mean(axis=0)))
    share = np.abs(log.tau.mean(axis=0) - needed) / robot.tau_max
    sag = np.abs(log.q[-1] - log.q[0])
    names = [robot.joint_names[joint] for joint in joints]
    return worst_of(share[joints], names), worst_of(sag[joints], names)


def soft_step(drive: PlantDrive, home: Array, arms: Sequence[int]) -> tuple[Worst, Worst]:
    """Row 6: a step of all driven joints with lower gains; return overshoot and remaining error."""
    robot = drive.robot
    joints = driven_joints(robot, arms)
    drive.soften(SOFT_SHARE)
    goal = home.copy()
    goal[joints] += STEP_RAD * inward(robot, home)[joints]
    drive.take_rows()
    for _ in range(round(1.5 / drive.plant.dt)):
        drive.step(goal)
    log = drive.take()
    drive.soften(1.0)
    drive.move(home)
    overshoot = ((log.q - goal) * np.sign(goal - home))[:, joints].max(axis=0)
    remaining = np.abs(log.q[-1] - goal)[joints]
    names = [robot.joint_names[joint] for joint in joints]
    return worst_of(np.maximum(overshoot, 0.0), names), worst_of(remaining, names)


def hands(drive: PlantDrive, arms: Sequence[int]) -> tuple[Worst, Worst]:
    """Row 9: close the empty hands, and open them; return the open share, and the gap when closed."""
    travel_m = drive.robot.hand.travel_m
    openings = drive.openings.copy()
    for arm in arms:
        openings[arm] = 0.0
    drive.openings = openings.copy()
    drive.hold(_HAND_S)
    closed_m = drive.plant.fingers
    for arm in arms:
        openings[arm] = 1.0
    drive.openings = openings.copy()
    drive.hold(_HAND_S)
    opened = drive.plant.fingers / travel_m
    names = [f"the {SIDES[arm]} hand" for arm in arms]
    driven_arms = list(arms)
    least_open = worst_of(-opened[driven_arms], names)
    return Worst(-least_open.value, least_open.where), worst_of(2.0 * closed_m[driven_arms], names)


def swings(drive: PlantDrive, home: Array, arms: Sequence[int], speed: float) -> Driven:
    """Swing the driven joints about home, faster in faster steps."""
    robot = drive.robot
    amplitudes = np.zeros(robot.dof)
    joints = driven_joints(robot, arms)
    amplitudes[joints] = SWING_RAD * inward(robot, home)[joints]
    frequency_hz = SWING_HZ * max(1.0, 4.0 * min(speed, 0.5))
    steps = round(SWING_S / drive.plant.dt)
    times_s = np.arange(1, steps + 1) * drive.plant.dt
    log = drive.follow(swing(home, amplitudes, frequency_hz, times_s))
    drive.move(home)
    return log


def speeds(logs: Sequence[Driven], robot: Robot, share: float) -> Worst:
    """Row 10: return the largest joint speed, relative to the bound of this step."""
    peak = np.max([np.abs(log.v).max(axis=0) for log in logs], axis=0)
    return worst_of(peak / (share * robot.v_max), robot.joint_names)


def statistics(log: Driven, reference: Array, robot: Robot) -> Worst:
    """Row 12: compare mean and spread (n,) of recorded joints with those of the simulation."""
    mean = np.abs(log.q.mean(axis=0) - reference.mean(axis=0))
    spread = np.abs(log.q.std(axis=0) - reference.std(axis=0))
    return worst_of(np.maximum(mean, spread), robot.joint_names)


def calibration(m: StepMeasurements, config: Config, robot: Robot, boards: object) -> None:
    """Row 8: calibrate each camera by pictures of a board.

    Args:
        m: Filled in.
        config: Of the scene.
        robot: The arms.
        boards: Folder of pictures, or None to render boards with known truth.
    """
    focals = cameras.expected_focals(config.scene, robot)
    errors: list[float] = []
    pixels: list[float] = []
    for name, focal_px in focals.items():
        if boards is None:
            pictures = cameras.rendered_boards(focal_px)
        else:
            pictures = cameras.taken_boards(Path(str(boards)), name)
        calibration = cameras.calibrate(pictures)
        errors.append(abs(calibration.focal_px / focal_px - 1.0))
        pixels.append(calibration.reprojection_px)
    names = [f"camera {name}" for name in focals]
    m.focal = worst_of(np.array(errors), names)
    m.reprojection = worst_of(np.array(pixels), names)
