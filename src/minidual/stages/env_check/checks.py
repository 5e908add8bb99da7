"""Checks of `env-check`."""

from dataclasses import dataclass

import numpy as np

from minidual.config.control import EnvCheckConfig
from minidual.gate.check import Check, Number, Op
from minidual.robot.pair import Robot
from minidual.show.figures.film import FILM_FPS
from minidual.stages.env_check.installation import Library
from minidual.stages.env_check.pictures import CameraCheck
from minidual.stages.env_check.tracking import CommandLatency, JointResponse, StopResponse, Tracking

_Rows = dict[str, tuple[Number, Op | None, Number | None]]
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


_WHY = {
    "libraries.unfit": "every library must be there in a version that works",
    "joints.count": "two arms, each joint a hinge with a torque motor on it",
    "joints.mapped": "a torque on one command must accelerate its own joint as the inertia matrix predicts",
    "joints.reached": "each joint alone must reach a step and move no other",
    "tracking.step_error_rad": "error norm of all joints left by a step of joint 1 of both arms: gravity and friction are compensated",
    "tracking.sine_rms_rad": "RMS of the error norm of all joints while all swing",
    "contacts.sine": "nothing may touch while the arms swing",
    "joints.rise_max_s": "time from 10 % to 90 % of a joint's own step, slowest joint",
    "joints.overshoot_max_rad": "how far any joint goes beyond its own step",
    "control.stopped": "the arbiter must give the arms, and the supervisor must not stop arms that follow their commands",
    "contacts.home": "no link may touch anything at home, or every plan would start in collision",
    "model.agreement_max": "MuJoCo and Pinocchio must describe one robot, or controllers cancel the wrong dynamics",
    "control.step_median_us": "arbiter, control, supervisor and physics of one step must fit into 1 ms for 1 kHz in real time",
    "latency.late_steps": "a command must change the torque of the arbiter's next tick, whenever it comes",
    "latency.wall_median_us": "computing time from propose() to the end of the step that drives the motors by it",
    "stop.ticks": "an emergency stop must act in the next control step",
    "stop.rest_s": "swinging arms must come to rest after an emergency stop",
    "cameras.contrast_min": "a picture of one flat colour shows nothing (standard deviation of brightness, 0 to 255)",
    "cameras.object_share": "every object of the task must be in the picture that the policy sees",
    "cameras.fingers_min": "each wrist camera must see both its fingertips",
    "video.frames": "the film must show the whole swing",
}
"""What each limit protects."""
_REMEDY = {
    "libraries.unfit": "reinstall the locked: {unfit}",
    "joints.count": "a joint without a motor cannot be driven: see minidual.plant.model, _add_actuators",
    "joints.mapped": "commands {astray} move something else: check the actuators' transmissions",
    "joints.reached": "joints {late} do not arrive: check their limits, motors and inertia",
    "tracking.step_error_rad": "check the inverse dynamics (model.agreement_max) and the motors (joints.mapped) first",
    "tracking.sine_rms_rad": "check the inverse dynamics and whether anything touches (contacts.sine)",
    "contacts.sine": "reduce env_check.sine_amplitude_rad or clear the table",
    "joints.rise_max_s": "{slowest}: look at its inertia, its motor's limit and the bandwidth of the reference filter",
    "joints.overshoot_max_rad": "{farthest}: its inertia in the model is not the simulated one (model.agreement_max), or gains changed",
    "control.stopped": "{stops}: the joint, motor or contact it names comes first",
    "contacts.home": "{touching}: allow the pair if it is adjacent, else move the base or the obstacle",
    "model.agreement_max": "the URDF feeds both: look for an inertia, armature or frame that was changed on one side only",
    "control.step_median_us": "close other programs; OMP_NUM_THREADS=1 keeps the linear algebra from fighting over cores",
    "latency.late_steps": "look for a step of delay in arbiter.tick, ControlStack.arbitrate, controller or supervisor",
    "latency.wall_median_us": "close other programs; OMP_NUM_THREADS=1 keeps the linear algebra from fighting over cores",
    "stop.ticks": "look at Supervisor.guard and Supervisor.estop",
    "stop.rest_s": "raise supervisor.stop_deceleration_scale, or find out what keeps pushing the arms",
    "cameras.contrast_min": "try MUJOCO_GL=egl, then apt-get install libegl1 libgl1-mesa-dri",
    "cameras.object_share": "check the pose of camera 'high' and the object's start",
    "cameras.fingers_min": "check the pose of the cameras 'left' and 'right'",
    "video.frames": "see the messages of the encoder (PyAV)",
}
_UNITS = ("rad", "us", "s")


def _checks(rows: _Rows, names: dict[str, str]) -> list[Check]:
    """Return checks of {name: (observed, operator, limit)}; `names` fills text placeholders."""
    checks = []
    for name, (observed, op, limit) in rows.items():
        unit = next((unit for unit in _UNITS if name.endswith(f"_{unit}")), "")
        why, remedy = (texts.get(name, "").format(**names) for texts in (_WHY, _REMEDY))
        checks.append(Check(name, observed, op, limit, unit, why, remedy))
    return checks


def installation_checks(libraries: list[Library], joints_n: int, robot: Robot) -> list[Check]:
    """Return the checks of libraries and actuated joints."""
    unfit = [f"{lib.name} {lib.wanted} (found {lib.found or 'none'})" for lib in libraries if not lib.fits]
    rows: _Rows = {"libraries.unfit": (len(unfit), "==", 0), "joints.count": (joints_n, "==", robot.dof)}
    return _checks(rows, {"unfit": ", ".join(unfit)})


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
    rows: _Rows = {
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
    return _checks(rows, names)
