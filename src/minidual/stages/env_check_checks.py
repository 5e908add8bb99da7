"""The checks of `env-check`: what was measured against its limits, with the remedy for each."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from minidual.gate.check import Check

if TYPE_CHECKING:
    from minidual.config.control import EnvCheckConfig
    from minidual.config.root import Config
    from minidual.stages.bench_step import StepCost
    from minidual.stages.env_check_command_latency import CommandLatency, StopResponse
    from minidual.stages.env_check_environment import Mapping
    from minidual.stages.env_check_environment_pictures import CameraCheck
    from minidual.stages.env_check_installation import Library, Package
    from minidual.stages.env_check_joint_response import JointResponse
    from minidual.stages.env_check_joint_tracking import Tracking

JOINTS = 14
_REACHED_RAD = 0.005
"""A joint driven alone has reached its target when the 14-D error left is below this."""
_REAL_TIME_US = 1000.0
_CONTRAST_MIN, _ROD_SHARE_MIN, _FINGER_SHARE_MIN = 5.0, 0.001, 0.002


def library_checks(libraries: list[Library]) -> list[Check]:
    """Judge libraries that are missing or of another version."""
    unfit = [library for library in libraries if not library.fits]
    names = ", ".join(f"{lib.name} {lib.wanted} (found {lib.found or 'none'})" for lib in unfit)
    return [
        Check(
            "libraries.unfit",
            len(unfit),
            "==",
            0,
            "",
            "every library must be there in a version that works",
            f"reinstall the locked dependencies: {names}" if unfit else "",
        ),
        Check("libraries.count", len(libraries)),
    ]


def count_check(count: int) -> Check:
    """Judge joints with a motor."""
    return Check(
        "joints.count",
        count,
        "==",
        JOINTS,
        "",
        "two arms of seven joints, each a hinge with a torque motor on it",
        "a joint without a motor cannot be driven: see minidual.plant.model, _add_actuators",
    )


def motion_checks(config: Config, mapping: Mapping, alone: list[float], step: Tracking, sine: Tracking) -> list[Check]:
    """Judge what the joints do."""
    limits = config.env_check
    astray = [str(j + 1) for j, joint in enumerate(mapping.moved) if joint != j]
    late = [str(j + 1) for j, error in enumerate(alone) if not error < _REACHED_RAD]
    return [
        Check(
            "joints.mapped",
            mapping.mapped,
            "==",
            JOINTS,
            "",
            "a torque on one command must accelerate its own joint as the inertia matrix predicts",
            f"commands {', '.join(astray)} move something else: check the actuators' transmissions" if astray else "",
        ),
        Check(
            "joints.reached",
            len(alone) - len(late),
            "==",
            JOINTS,
            "",
            f"each joint alone must reach a step of {limits.single_step_rad:g} rad and move no other",
            f"joints {', '.join(late)} do not arrive: check their limits, motors and inertia" if late else "",
        ),
        Check(
            "tracking.step_error_rad",
            step.settled,
            "<",
            limits.step_error_max_rad,
            "rad",
            "14-D error norm left by a step of joint 1 of both arms: gravity and friction are compensated",
            "check the inverse dynamics (model.agreement_max) and the motors (joints.mapped) first",
        ),
        Check("tracking.step_overshoot_rad", step.overshoot, None, None, "rad", "beyond the target of the step"),
        Check(
            "tracking.sine_rms_rad",
            sine.rms,
            "<",
            limits.sine_rms_max_rad,
            "rad",
            f"RMS of the 14-D error norm, all joints swinging {limits.sine_amplitude_rad:g} rad at "
            f"{limits.sine_frequency_hz:g} Hz",
            "check the inverse dynamics and whether anything touches (contacts.sine)",
        ),
        Check(
            "contacts.sine",
            sine.contacts,
            "==",
            0,
            "",
            "nothing may touch while the arms swing",
            "reduce env_check.sine_amplitude_rad or clear the table",
        ),
    ]


def contact_check(contacts: list[tuple[str, str, float]]) -> Check:
    """Judge what touches at home."""
    pairs = ", ".join(f"{a} with {b}" for a, b, _ in contacts)
    return Check(
        "contacts.home",
        len(contacts),
        "==",
        0,
        "",
        "no link may touch anything at home, or every plan would start in collision",
        f"{pairs}: allow the pair if it is adjacent, else move the base or the obstacle" if contacts else "",
    )


def agreement_check(agreement: dict[str, float], limits: EnvCheckConfig) -> Check:
    """Judge whether the two engines describe one robot."""
    return Check(
        "model.agreement_max",
        float(np.max(list(agreement.values()))),
        "<=",
        limits.agreement_max,
        "",
        "MuJoCo and Pinocchio must describe one robot, or controllers cancel the wrong dynamics",
        "the URDF feeds both: look for an inertia, armature or frame that was changed on one side only",
    )


def film_check(frames: int, limits: EnvCheckConfig) -> Check:
    """Judge whether the film is whole."""
    return Check(
        "video.frames",
        frames,
        "==",
        round(limits.sine_duration_s * limits.video_fps),
        "",
        "the film must show the whole swing",
        "see the messages of the encoder (PyAV)",
    )


def cost_check(cost: StepCost) -> Check:
    """Judge the wall time of one step."""
    return Check(
        "control.step_median_us",
        cost.median_us,
        "<",
        _REAL_TIME_US,
        "us",
        "control and physics of one step must fit into 1 ms for 1 kHz in real time",
        "close other programs; OMP_NUM_THREADS=1 keeps the linear algebra from fighting over cores",
    )


def camera_checks(cameras: CameraCheck) -> list[Check]:
    """Judge what the pictures show."""
    return [
        Check(
            "cameras.contrast_min",
            cameras.contrast_min,
            ">",
            _CONTRAST_MIN,
            "",
            "a picture of one flat colour shows nothing (standard deviation of brightness, 0 to 255)",
            "try MUJOCO_GL=egl, then apt-get install libegl1 libgl1-mesa-dri",
        ),
        Check(
            "cameras.rod_share",
            cameras.rod_share,
            ">",
            _ROD_SHARE_MIN,
            "",
            "the rod's orange must be in the picture that the policy sees",
            "check the pose of camera 'high' and the rod's start",
        ),
        Check(
            "cameras.fingers_min",
            cameras.fingers_min,
            ">",
            _FINGER_SHARE_MIN,
            "",
            "each wrist camera must see both its fingertips",
            "check the pose of the cameras 'left' and 'right'",
        ),
    ]


def joint_checks(rows: list[JointResponse], limits: EnvCheckConfig) -> list[Check]:
    """Judge each joint's own step; the worst joint decides."""
    rise = np.array([row.rise_s for row in rows])
    overshoot = np.array([row.overshoot_rad for row in rows])
    slowest, farthest = rows[int(np.argmax(rise))].joint, rows[int(np.argmax(overshoot))].joint
    return [
        Check(
            "joints.rise_max_s",
            float(np.max(rise)),
            "<",
            limits.rise_max_s,
            "s",
            f"time from 10 % to 90 % of a step of {limits.single_step_rad:g} rad, slowest joint",
            f"{slowest}: look at its inertia, its motor's limit and the bandwidth of the reference filter",
        ),
        Check(
            "joints.overshoot_max_rad",
            float(np.max(overshoot)),
            "<",
            limits.overshoot_max_rad,
            "rad",
            "how far any joint goes beyond its own step",
            f"{farthest}: its inertia in the model is not the simulated one (model.agreement_max), or gains changed",
        ),
    ]


def latency_checks(latency: CommandLatency, stop: StopResponse, limits: EnvCheckConfig) -> list[Check]:
    """Judge how soon commands and emergency stops reach the motors."""
    return [
        Check(
            "latency.ticks_max",
            latency.ticks_max,
            "<=",
            latency.period_ticks,
            "",
            "control steps from propose() to a changed torque, at the worst instant of the arbiter's period",
            "somebody holds commands back: look at arbiter.tick and the controllers' switch",
        ),
        Check(
            "latency.ticks_min",
            latency.ticks_min,
            "==",
            1,
            "",
            "a command that comes just before the arbiter's tick must change the torque of that very step",
            "look for a step of delay in ControlStack.arbitrate, the controller or the supervisor",
        ),
        Check(
            "latency.wall_median_us",
            float(np.median(latency.wall_us)),
            "<",
            limits.latency_max_us,
            "us",
            "computing time from propose() to the motors' torques, without waiting for the arbiter",
            "close other programs; OMP_NUM_THREADS=1 keeps the linear algebra from fighting over cores",
        ),
        Check("latency.wall_p99_us", float(np.percentile(latency.wall_us, 99)), None, None, "us", "of the same"),
        Check(
            "stop.ticks",
            stop.ticks,
            "==",
            1,
            "",
            "an emergency stop must act in the next control step",
            "look at Supervisor.guard and Supervisor.estop",
        ),
        Check(
            "stop.rest_s",
            stop.rest_s,
            "<",
            limits.stop_rest_max_s,
            "s",
            "swinging arms must come to rest after an emergency stop",
            "raise supervisor.stop_deceleration_scale, or find out what keeps pushing the arms",
        ),
    ]


def package_checks(packages: list[Package]) -> list[Check]:
    """Report system packages; where the cameras drew their pictures, what they need was there."""
    missing = [package.name for package in packages if package.version is None]
    return (
        [
            Check(
                "packages.missing",
                len(missing),
                None,
                None,
                "",
                f"of {', '.join(p.name for p in packages)}; a GPU's own driver may stand in for them"
                + (f"; not there: {', '.join(missing)}" if missing else ""),
            )
        ]
        if packages
        else []
    )
