"""Find the offsets of GELLO arms that are held in the posture of the arms."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from minidual.demos.leaders.dynamixel_bus import DynamixelBus
from minidual.demos.leaders.gello_file import GelloArm, read_gello_file, write_gello_file
from minidual.errors import EnvironmentMissingError
from minidual.robot.pair import SIDES, Array, Robot

HORN_STEP_RAD = np.pi / 2.0
"""Horns are screwed on in steps of a quarter turn: offsets are multiples of it."""
OFF_MAX_RAD = 0.35
"""Most a joint may be off its posture for its quarter turn to be certain."""
_READINGS_N = 20
_TRIES_N = 200


@dataclass(frozen=True)
class Calibration:
    """Offsets of an arm.

    Attributes:
        arm: With its new offsets.
        off_rad: How far each joint (k,) was from the posture, with these offsets.
    """

    arm: GelloArm
    off_rad: Array


def calibrated(arm: GelloArm, servos_rad: Array, q_rad: Array) -> Calibration:
    """Return an arm whose servos (k or k + 1,) show that its joints are at (k,) [rad]."""
    signs = np.array(arm.signs)
    angles = servos_rad[: len(arm.ids)]
    exact = angles - signs * q_rad
    offsets = HORN_STEP_RAD * np.round(exact / HORN_STEP_RAD)
    off = signs * (exact - offsets)
    update: dict[str, object] = {"offsets_rad": tuple(round(float(each), 6) for each in offsets)}
    if arm.gripper is not None:
        travel_rad = arm.gripper.closed_rad - arm.gripper.open_rad
        opened_rad = float(servos_rad[-1])
        update["gripper"] = arm.gripper.model_copy(
            update={
                "open_rad": round(opened_rad, 6),
                "closed_rad": round(opened_rad + travel_rad, 6),
            },
        )
    return Calibration(arm.model_copy(update=update), off)


def _steady_angles(bus: DynamixelBus) -> Array:
    """Return the median of some readings (k,)."""
    readings: list[Array] = []
    for _ in range(_TRIES_N):
        angles = bus.read()
        if angles is not None:
            readings.append(angles)
        if len(readings) == _READINGS_N:
            return np.median(readings, axis=0)
    raise EnvironmentMissingError(
        f"{len(readings)} of {_TRIES_N} readings of the servos came through",
        remedy="check the cables and the power",
    )


def calibrate(path: Path, robot: Robot) -> dict[str, Calibration]:
    """Write the offsets of arms that are held at the home posture with open grippers.

    Returns:
        {side: calibration}.

    Raises:
        ConfigError: The file does not fit.
        EnvironmentMissingError: A servo does not answer, or a joint is far from its posture.
    """
    gello = read_gello_file(path, robot)
    calibrations: dict[str, Calibration] = {}
    for number, (side, arm) in enumerate(zip(SIDES, gello.arms, strict=True)):
        bus = DynamixelBus(arm.port, gello.baud_rate, arm.servos)
        try:
            angles = _steady_angles(bus)
        finally:
            bus.close()
        calibrations[side] = calibrated(arm, angles, robot.home[robot.joints_of(number)])
        _check_posture(side, calibrations[side], robot)
    arms = {side: calibration.arm for side, calibration in calibrations.items()}
    write_gello_file(path, gello.model_copy(update=arms))
    return calibrations


def _check_posture(side: str, calibration: Calibration, robot: Robot) -> None:
    worst = int(np.argmax(np.abs(calibration.off_rad)))
    if abs(calibration.off_rad[worst]) > OFF_MAX_RAD:
        name = robot.arms[SIDES.index(side)].joints[worst]
        raise EnvironmentMissingError(
            f"{side}_{name} is {calibration.off_rad[worst]:+.2f} rad off the home posture "
            f"(limit {OFF_MAX_RAD} rad): its quarter turn is uncertain; nothing was written",
            remedy="hold both leader arms as minidual view shows the arms; check signs",
        )
