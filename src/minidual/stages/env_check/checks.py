"""Checks of `env-check`."""

from dataclasses import dataclass

import numpy as np

from minidual.config.control import EnvCheckConfig
from minidual.gate.check import Check
from minidual.robot.pair import Robot
from minidual.show.figures.film import FILM_FPS
from minidual.stages.env_check.installation import Library
from minidual.stages.env_check.pictures import CameraCheck
from minidual.stages.env_check.tracking import CommandLatency, JointResponse, StopResponse, Tracking
from minidual.stages.words import Rows, worded

_REACHED_RAD = 0.005
"""Error norm of all joints below which a single step has settled."""
_REAL_TIME_US = 1000.0
_CONTRAST_MIN, _OBJECT_SHARE_MIN, _FINGER_SHARE_MIN = 5.0, 0.001, 0.002


@dataclass(frozen=True)
class Measured:
    """All measurements of a fully actuated robot.

    Attributes:
        moved: Joint moved by each torque command.
    """

    moved: tuple[int, ...]
    contacts: list[tuple[str, str, float]]
    steps: list[Tracking]
    responses: list[JointResponse]
    step: Tracking
    sine: Tracking
    agreement: dict[str, float]
    latency: CommandLatency
    stop: StopResponse
    cameras: CameraCheck
    frames: int


def installation_checks(libraries: list[Library], joints_n: int, robot: Robot) -> list[Check]:
    """Return the checks of libraries and actuated joints."""
    unfit = [f"{lib.name} {lib.wanted} (found {lib.found or 'none'})" for lib in libraries if not lib.fits]
    rows: Rows = {"libraries.unfit": (len(unfit), "==", 0), "joints.count": (joints_n, "==", robot.dof)}
    return worded("env-check", rows, unfit=", ".join(unfit))


def measured_checks(m: Measured, limits: EnvCheckConfig, robot: Robot) -> list[Check]:
    """Return the checks of joints, engines, commands and cameras."""
    astray = [str(j + 1) for j, joint in enumerate(m.moved) if joint != j]
    late = [str(j + 1) for j, row in enumerate(m.responses) if not row["settled_rad"] < _REACHED_RAD]
    rise, overshoot = ([row[name] for row in m.responses] for name in ("rise_s", "overshoot_rad"))
    stops = [tracking.stopped for tracking in (*m.steps, m.step, m.sine) if tracking.stopped]
    names = {
        "astray": ", ".join(astray),
        "late": ", ".join(late),
        "slowest": m.responses[int(np.argmax(rise))]["joint"],
        "farthest": m.responses[int(np.argmax(overshoot))]["joint"],
        "touching": ", ".join(f"{a} with {b}" for a, b, _ in m.contacts),
        "stops": "; ".join(dict.fromkeys(stops)),
    }
    rows: Rows = {
        "joints.mapped": (robot.dof - len(astray), "==", robot.dof),
        "joints.reached": (len(m.responses) - len(late), "==", robot.dof),
        "tracking.step_error_rad": (m.step.settled, "<", limits.step_error_max_rad),
        "tracking.sine_rms_rad": (m.sine.rms, "<", limits.sine_rms_max_rad),
        "contacts.sine": (m.sine.contacts, "==", 0),
        "joints.rise_max_s": (float(np.max(rise)), "<", limits.rise_max_s),
        "joints.overshoot_max_rad": (float(np.max(overshoot)), "<", limits.overshoot_max_rad),
        "control.stopped": (len(stops), "==", 0),
        "contacts.home": (len(m.contacts), "==", 0),
        "model.agreement_max": (float(np.max(list(m.agreement.values()))), "<=", limits.agreement_max),
        "control.step_median_us": (m.sine.step_us, "<", _REAL_TIME_US),
        "latency.late_steps": (m.latency.late_steps, "==", 0),
        "latency.wall_median_us": (m.latency.wall_us, "<", limits.latency_max_us),
        "stop.ticks": (m.stop.ticks, "==", 1),
        "stop.rest_s": (m.stop.rest_s, "<", limits.stop_rest_max_s),
        "cameras.contrast_min": (m.cameras.contrast_min, ">", _CONTRAST_MIN),
        "cameras.object_share": (m.cameras.object_share, ">", _OBJECT_SHARE_MIN),
        "cameras.fingers_min": (m.cameras.fingers_min, ">", _FINGER_SHARE_MIN),
        "video.frames": (m.frames, "==", round(limits.sine_duration_s * FILM_FPS)),
    }
    return worded("env-check", rows, **names)
