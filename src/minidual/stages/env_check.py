"""Stage `env-check`: do the simulated arms exist, answer and see?"""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

from minidual.gate.stage import StageContext, StageResult

if TYPE_CHECKING:
    from minidual.stages.bench_step import StepCost
    from minidual.stages.env_check_environment_pictures import CameraCheck
    from minidual.stages.env_check_joint_tracking import Tracking


def run(context: StageContext) -> StageResult:
    """Measure; write environment.json, joints.csv, sine.mp4, cameras.png, tracking.png and joints.png."""
    import numpy as np

    from minidual.config.seeds import stream
    from minidual.control.loop import JointLoop
    from minidual.plant.model import build_model
    from minidual.plant.world import World
    from minidual.robot.kinematics import Kinematics
    from minidual.show.view import Overlay
    from minidual.show.watch import watched
    from minidual.stages import env_check_checks as checks_of
    from minidual.stages import env_check_environment as measure
    from minidual.stages import env_check_environment_pictures as pictures
    from minidual.stages import env_check_joint_tracking as motion
    from minidual.stages.bench_step import control_step_cost
    from minidual.stages.env_check_command_latency import LatencyRig, command_latency, emergency_stop
    from minidual.stages.env_check_installation import machine, required_libraries, system_packages
    from minidual.stages.env_check_joint_response import joint_responses, write_joints

    config = context.config.env_check
    with context.progress.task("environment", 10) as task:
        libraries, packages = required_libraries(), system_packages()
        model = build_model(context.config.scene, visuals=True)
        joints = measure.drivable_joints(model)
        if len(joints) != checks_of.JOINTS:  # no world can be built on it; this check says why
            return StageResult(checks=[*checks_of.library_checks(libraries), checks_of.count_check(len(joints))])
        world, kinematics = World(context.config.scene, model=model), Kinematics()
        loop = JointLoop(world, kinematics)
        contacts = measure.arm_contacts(world)
        cameras = pictures.check_cameras(world)
        pictures.save_cameras(world, context.folder / "cameras.png")
        task.advance(note="cameras")
        mapping = measure.torque_pulse_mapping(world, kinematics, pulse_share=config.pulse_share)
        task.advance(note="mapping")
        doing = "each joint alone"

        def tell() -> Overlay:
            return Overlay(title="env-check", mode="joint", source="env-check", state=doing)

        with watched(context.view, world, tell):
            steps = motion.single_joint_steps(loop, config.single_step_rad, config.single_duration_s)
            task.advance(note="each joint alone")
            doing = "a step"
            step = motion.step_response(loop, motion.outward_step(config.step_rad), config.step_duration_s)
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
        rig = LatencyRig(
            world, kinematics, context.config.arbiter, context.config.supervisor, context.config.teleop.rate_hz
        )
        latency = command_latency(rig)
        stop = emergency_stop(world, kinematics, context.config.supervisor)
        task.advance(note="latency")
        responses = joint_responses(steps, sine)
        alone = np.array([row.settled_rad for row in responses])
        write_joints(context.folder / "joints.csv", responses)
        frames = pictures.film(
            world,
            sine,
            context.folder / "sine.mp4",
            fps=config.video_fps,
            width_px=config.video_width_px,
            height_px=config.video_height_px,
        )
        task.advance(note="film")
        pictures.save_tracking(
            context.folder / "tracking.png",
            step,
            sine,
            alone,
            step_limit_rad=config.step_error_max_rad,
            sine_limit_rad=config.sine_rms_max_rad,
        )
        pictures.save_joints(context.folder / "joints.png", steps, responses, rise_limit_s=config.rise_max_s)
        task.advance(note="figures")

    checks = [
        *checks_of.library_checks(libraries),
        *checks_of.package_checks(packages),
        checks_of.count_check(len(joints)),
        *checks_of.motion_checks(context.config, mapping, alone.tolist(), step, sine),
        *checks_of.joint_checks(responses, config),
        checks_of.contact_check(contacts),
        checks_of.agreement_check(agreement, config),
        checks_of.cost_check(cost),
        *checks_of.latency_checks(latency, stop, config),
        *checks_of.camera_checks(cameras),
        checks_of.film_check(frames, config),
    ]
    data = {
        "machine": {**machine(), "gl_renderer": cameras.gl_renderer},
        "libraries": {lib.name: {"wanted": lib.wanted, "found": lib.found} for lib in libraries},
        "packages": {package.name: package.version for package in packages},
        "joints": joints,
        "responses": [asdict(row) for row in responses],
        "latency": {
            "ticks": list(latency.ticks),
            "period_ticks": latency.period_ticks,
            "wall_median_us": float(np.median(latency.wall_us)),
            "wall_p99_us": float(np.percentile(latency.wall_us, 99)),
        },
        "emergency_stop": asdict(stop),
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


def _notes(cost: StepCost, cameras: CameraCheck, step: Tracking) -> list[str]:
    return [
        f"one control step takes {cost.ratio:.1f} times a bare physics step ({cost.bare_median_us:.0f} us)",
        f"pictures are drawn by {cameras.gl_renderer}",
        f"the step leaves {step.settled:.1e} rad",
    ]
