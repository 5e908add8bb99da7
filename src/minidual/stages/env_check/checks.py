"""Checks of `env-check` from its measurements."""

from dataclasses import dataclass

import numpy as np

from minidual.config.control import EnvCheckConfig
from minidual.gate.check import Check
from minidual.robot.pair import Robot
from minidual.show.figures.film import FILM_FPS
from minidual.stages.env_check import criteria
from minidual.stages.env_check.installation import Library
from minidual.stages.env_check.pictures import CameraCheck
from minidual.stages.env_check.responses import CommandLatency, JointResponse, StopResponse
from minidual.stages.env_check.shapes import ShapeComparison
from minidual.stages.env_check.tracking import Tracking

REAL_TIME_US = 1000.0
"""Wall time of a control step at 1 kHz."""
_REACHED_RAD = 0.005
"""Error norm of all joints below which a single step has settled."""
_CONTRAST_MIN = 5.0
_OBJECT_SHARE_MIN = 0.001
_FINGER_SHARE_MIN = 0.002
_SHAPES_APART_M = 1e-5
"""MuJoCo holds vertices as float32."""


@dataclass(frozen=True)
class Measurements:
    """All measurements of a robot whose joints all have motors.

    Attributes:
        moved: Joint that each torque command moves, -1 for none.
        contacts: Contacts (body, body, distance [m]) of arm links at home.
        steps: A step of each joint alone.
        responses: Responses of each joint.
        step: Step of joint 1 of both arms.
        sine: Swing of all joints.
        agreement: Largest differences between MuJoCo and Pinocchio, see `model_agreement`.
        latency: Latency of commands.
        stop: Response to an emergency stop.
        cameras: What the cameras see.
        frames: Frames of the film of the swing.
        shapes: What is drawn and what collides.
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
    shapes: ShapeComparison


def installation_checks(libraries: list[Library], joints_n: int, robot: Robot) -> list[Check]:
    """Return the checks of libraries and motors; `joints_n`: joints with a motor."""
    unfit = [
        f"{lib.name} {lib.wanted} (found {lib.installed or 'none'})"
        for lib in libraries
        if not lib.fits
    ]
    return [
        criteria.LIBRARIES.check(len(unfit), 0, unfit=", ".join(unfit)),
        criteria.JOINTS_COUNT.check(joints_n, robot.dof),
    ]


def measured_checks(m: Measurements, limits: EnvCheckConfig, robot: Robot) -> list[Check]:
    """Return the checks of joints, engines, commands and cameras."""
    agreement_max = float(np.max(list(m.agreement.values())))
    touching = ", ".join(f"{first} with {second}" for first, second, _ in m.contacts)
    return [
        *_joint_checks(m, robot),
        criteria.STEP_ERROR.check(m.step.settled, limits.step_error_max_rad),
        criteria.SINE_RMS.check(m.sine.rms, limits.sine_rms_max_rad),
        criteria.CONTACTS_SINE.check(m.sine.contacts, 0),
        *_response_checks(m, limits),
        _stopped_check(m),
        criteria.CONTACTS_HOME.check(len(m.contacts), 0, touching=touching),
        criteria.AGREEMENT_MAX.check(agreement_max, limits.agreement_max),
        criteria.SHAPES_UNLIKE.check(len(m.shapes.unlike), 0, links="; ".join(m.shapes.unlike)),
        criteria.SHAPES_ENGINES.check(m.shapes.engines_max_m, _SHAPES_APART_M),
        criteria.STEP_MEDIAN.check(m.sine.step_us, REAL_TIME_US),
        criteria.LATE_STEPS.check(m.latency.late_steps, 0),
        criteria.LATENCY_MEDIAN.report(m.latency.wall_us),
        criteria.STOP_TICKS.check(m.stop.ticks, 1),
        criteria.STOP_REST.check(m.stop.rest_s, limits.stop_rest_max_s),
        criteria.CONTRAST_MIN.check(m.cameras.contrast_min, _CONTRAST_MIN),
        criteria.OBJECT_SHARE.check(m.cameras.object_share, _OBJECT_SHARE_MIN),
        criteria.FINGERS_MIN.check(m.cameras.fingers_min, _FINGER_SHARE_MIN),
        criteria.VIDEO_FRAMES.check(m.frames, round(limits.sine_duration_s * FILM_FPS)),
    ]


def _joint_checks(m: Measurements, robot: Robot) -> list[Check]:
    """Return the checks of each joint alone; messages count joints from 1."""
    astray = [str(j + 1) for j, joint in enumerate(m.moved) if joint != j]
    late = [
        str(j + 1)
        for j, response in enumerate(m.responses)
        if not response.settled_rad < _REACHED_RAD
    ]
    mapped_n = robot.dof - len(astray)
    reached_n = len(m.responses) - len(late)
    return [
        criteria.JOINTS_MAPPED.check(mapped_n, robot.dof, astray=", ".join(astray)),
        criteria.JOINTS_REACHED.check(reached_n, robot.dof, late=", ".join(late)),
    ]


def _response_checks(m: Measurements, limits: EnvCheckConfig) -> list[Check]:
    rises_s = [response.rise_s for response in m.responses]
    overshoots_rad = [response.overshoot_rad for response in m.responses]
    slowest = m.responses[int(np.argmax(rises_s))].joint
    farthest = m.responses[int(np.argmax(overshoots_rad))].joint
    return [
        criteria.RISE_MAX.check(float(np.max(rises_s)), limits.rise_max_s, slowest=slowest),
        criteria.OVERSHOOT_MAX.check(
            float(np.max(overshoots_rad)),
            limits.overshoot_max_rad,
            farthest=farthest,
        ),
    ]


def _stopped_check(m: Measurements) -> Check:
    stops = [motion.stopped for motion in (*m.steps, m.step, m.sine) if motion.stopped]
    distinct = dict.fromkeys(stops)
    return criteria.STOPPED.check(len(stops), 0, stops="; ".join(distinct))
