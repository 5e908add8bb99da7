"""Stage `env-check`: do the simulated arms exist, answer and see?"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from minidual.pipeline.check import Check
from minidual.pipeline.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.config.root import Config
    from minidual.evaluation.environment import Mapping
    from minidual.evaluation.environment_pictures import CameraCheck
    from minidual.evaluation.installation import Library
    from minidual.evaluation.joint_tracking import Tracking
    from minidual.evaluation.step_cost import StepCost

_JOINTS = 14
_REACHED_RAD = 0.005
"""A joint driven alone has reached its target when the 14-D error left is below this."""
_REAL_TIME_US = 1000.0
_CONTRAST_MIN, _ROD_SHARE_MIN, _FINGER_SHARE_MIN = 5.0, 0.001, 0.002


class EnvCheckStage:
    """Drives every joint and looks through every camera before anything is built on them."""

    name = "env-check"
    requires = ()
    summary = "Check the simulation, the motors, the cameras and the libraries"

    def parameters(self, config: Config) -> dict[str, Any]:
        """Return what the measurements depend on."""
        return {"env_check": config.env_check, "scene": config.scene}

    def run(self, context: StageContext) -> StageResult:
        """Measure; write environment.json, sine.mp4, cameras.png and tracking.png."""
        from minidual.config.seeds import stream
        from minidual.control.loop import JointLoop
        from minidual.evaluation import environment as measure
        from minidual.evaluation import environment_pictures as pictures
        from minidual.evaluation import joint_tracking as motion
        from minidual.evaluation.installation import machine, required_libraries
        from minidual.evaluation.step_cost import control_step_cost
        from minidual.robot.kinematics import Kinematics
        from minidual.sim.model import build_model
        from minidual.sim.watch import Narration, watched
        from minidual.sim.world import World

        config = context.config.env_check
        with context.progress.task("environment", 9) as task:
            libraries = required_libraries()
            model = build_model(context.config.scene, visuals=True)
            joints = measure.drivable_joints(model)
            if len(joints) != _JOINTS:  # no world can be built on it; this check says why
                return StageResult(checks=[*_library_checks(libraries), _count_check(len(joints))])
            world, kinematics = World(context.config.scene, model=model), Kinematics()
            loop = JointLoop(world, kinematics)
            contacts = measure.arm_contacts(world)
            cameras = pictures.check_cameras(world)
            pictures.save_cameras(world, context.folder / "cameras.png")
            task.advance(note="cameras")
            mapping = measure.torque_pulse_mapping(world, kinematics, pulse_share=config.pulse_share)
            task.advance(note="mapping")
            doing = "each joint alone"

            def tell() -> Narration:
                return Narration("env-check", "joint", "env-check", doing)

            with watched(context.view, world, tell, speed_max=context.config.view.speed_max):
                alone = motion.single_joint_errors(loop, config.single_step_rad, config.single_duration_s)
                task.advance(note="each joint alone")
                doing = "a step"
                step = motion.step_response(
                    loop, motion.outward_step(config.step_rad), config.step_duration_s
                )
                task.advance(note="step")
                doing = "all joints swing"
                sine = motion.sine_response(
                    loop, config.sine_amplitude_rad, config.sine_frequency_hz, config.sine_duration_s
                )
                task.advance(note="swing")
            agreement = measure.model_agreement(
                world, kinematics, stream(context.seed, "env-check/states"), config.agreement_states_n
            )
            task.advance(note="two engines")
            cost = control_step_cost(loop, config.cost_steps_n)
            task.advance(note="step cost")
            frames = pictures.film(
                world, sine, context.folder / "sine.mp4", fps=config.video_fps,
                width_px=config.video_width_px, height_px=config.video_height_px,
            )  # fmt: skip
            task.advance(note="film")
            pictures.save_tracking(
                context.folder / "tracking.png", step, sine, alone,
                step_limit_rad=config.step_error_max_rad, sine_limit_rad=config.sine_rms_max_rad,
            )  # fmt: skip
            task.advance(note="figures")

        checks = [
            *_library_checks(libraries),
            _count_check(len(joints)),
            *_motion_checks(context.config, mapping, alone.tolist(), step, sine),
            _contact_check(contacts),
            Check(
                "model.agreement_max", max(agreement.values()), "<=", config.agreement_max, "",
                "MuJoCo and Pinocchio must describe one robot, or controllers cancel the wrong dynamics",
                "the URDF feeds both: look for an inertia, armature or frame that was changed on one side only",
            ),
            _cost_check(cost),
            *_camera_checks(cameras),
            Check(
                "video.frames", frames, "==", round(config.sine_duration_s * config.video_fps), "",
                "the film must show the whole swing", "see the messages of the encoder (PyAV)",
            ),
        ]  # fmt: skip
        data = {
            "machine": {**machine(), "gl_renderer": cameras.gl_renderer},
            "libraries": {lib.name: {"wanted": lib.wanted, "found": lib.found} for lib in libraries},
            "joints": joints,
            "mapping_error": mapping.error.tolist(),
            "alone_error_rad": alone.tolist(),
            "step": {"settled_rad": step.settled, "overshoot_rad": step.overshoot},
            "sine": {"rms_rad": sine.rms, "joint_rms_rad": sine.joint_rms.tolist(), "frames": frames},
            "agreement": agreement,
            "contacts_home": [list(pair) for pair in contacts],
            "control_step": {**asdict(cost), "ratio": cost.ratio},
            "cameras": asdict(cameras),
        }
        text = json.dumps(data, indent=2, sort_keys=True, allow_nan=False)
        (context.folder / "environment.json").write_text(text + "\n", encoding="utf-8")
        return StageResult(checks=checks, data=data, notes=_notes(cost, cameras, step))


def _library_checks(libraries: list[Library]) -> list[Check]:
    unfit = [library for library in libraries if not library.fits]
    names = ", ".join(f"{lib.name} {lib.wanted} (found {lib.found or 'none'})" for lib in unfit)
    return [
        Check(
            "libraries.unfit", len(unfit), "==", 0, "", "every library must be there in a version that works",
            f"reinstall the locked dependencies: {names}" if unfit else "",
        ),
        Check("libraries.count", len(libraries)),
    ]  # fmt: skip


def _count_check(count: int) -> Check:
    return Check(
        "joints.count", count, "==", _JOINTS, "",
        "two arms of seven joints, each a hinge with a torque motor on it",
        "a joint without a motor cannot be driven: see minidual.sim.model, _add_actuators",
    )  # fmt: skip


def _motion_checks(
    config: Config, mapping: Mapping, alone: list[float], step: Tracking, sine: Tracking
) -> list[Check]:
    limits = config.env_check
    astray = [str(j + 1) for j, joint in enumerate(mapping.moved) if joint != j]
    late = [str(j + 1) for j, error in enumerate(alone) if not error < _REACHED_RAD]
    return [
        Check(
            "joints.mapped", mapping.mapped, "==", _JOINTS, "",
            "a torque on one command must accelerate its own joint as the inertia matrix predicts",
            f"commands {', '.join(astray)} move something else: check the actuators' transmissions" if astray else "",
        ),
        Check(
            "joints.reached", len(alone) - len(late), "==", _JOINTS, "",
            f"each joint alone must reach a step of {limits.single_step_rad:g} rad and move no other",
            f"joints {', '.join(late)} do not arrive: check their limits, motors and inertia" if late else "",
        ),
        Check(
            "tracking.step_error_rad", step.settled, "<", limits.step_error_max_rad, "rad",
            "14-D error norm left by a step of joint 1 of both arms: gravity and friction are compensated",
            "check the inverse dynamics (model.agreement_max) and the motors (joints.mapped) first",
        ),
        Check("tracking.step_overshoot_rad", step.overshoot, None, None, "rad", "beyond the target of the step"),
        Check(
            "tracking.sine_rms_rad", sine.rms, "<", limits.sine_rms_max_rad, "rad",
            f"RMS of the 14-D error norm, all joints swinging {limits.sine_amplitude_rad:g} rad at "
            f"{limits.sine_frequency_hz:g} Hz",
            "check the inverse dynamics and whether anything touches (contacts.sine)",
        ),
        Check(
            "contacts.sine", sine.contacts, "==", 0, "",
            "nothing may touch while the arms swing", "reduce env_check.sine_amplitude_rad or clear the table",
        ),
    ]  # fmt: skip


def _contact_check(contacts: list[tuple[str, str, float]]) -> Check:
    pairs = ", ".join(f"{a} with {b}" for a, b, _ in contacts)
    return Check(
        "contacts.home", len(contacts), "==", 0, "",
        "no link may touch anything at home, or every plan would start in collision",
        f"{pairs}: allow the pair if it is adjacent, else move the base or the obstacle" if contacts else "",
    )  # fmt: skip


def _cost_check(cost: StepCost) -> Check:
    return Check(
        "control.step_median_us", cost.median_us, "<", _REAL_TIME_US, "us",
        "control and physics of one step must fit into 1 ms for 1 kHz in real time",
        "close other programs; OMP_NUM_THREADS=1 keeps the linear algebra from fighting over cores",
    )  # fmt: skip


def _camera_checks(cameras: CameraCheck) -> list[Check]:
    return [
        Check(
            "cameras.contrast_min", cameras.contrast_min, ">", _CONTRAST_MIN, "",
            "a picture of one flat colour shows nothing (standard deviation of brightness, 0 to 255)",
            "try MUJOCO_GL=egl, then apt-get install libegl1 libgl1-mesa-dri",
        ),
        Check(
            "cameras.rod_share", cameras.rod_share, ">", _ROD_SHARE_MIN, "",
            "the rod's orange must be in the picture that the policy sees",
            "check the pose of camera 'high' and the rod's start",
        ),
        Check(
            "cameras.fingers_min", cameras.fingers_min, ">", _FINGER_SHARE_MIN, "",
            "each wrist camera must see both its fingertips", "check the pose of the cameras 'left' and 'right'",
        ),
    ]  # fmt: skip


def _notes(cost: StepCost, cameras: CameraCheck, step: Tracking) -> list[str]:
    return [
        f"one control step takes {cost.ratio:.1f} times a bare physics step ({cost.bare_median_us:.0f} us)",
        f"pictures are drawn by {cameras.gl_renderer}",
        f"the step leaves {step.settled:.1e} rad",
    ]


STAGE = EnvCheckStage()
