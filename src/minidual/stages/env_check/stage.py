"""Stage `env-check`: test all joints and cameras."""

from __future__ import annotations

import csv
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from minidual.config.seeds import stream
from minidual.control.loop import JointLoop
from minidual.gate.stage import StageContext, StageResult
from minidual.plant.model import build_model
from minidual.plant.world import World
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
from minidual.show.view import Overlay
from minidual.show.watch import watched
from minidual.stages.env_check import model as measure
from minidual.stages.env_check import pictures, tracking
from minidual.stages.env_check.checks import Measured, installation_checks, measured_checks
from minidual.stages.env_check.installation import machine, required_libraries, system_packages
from minidual.stages.env_check.latency import LatencyRig, command_latency, emergency_stop


def run(context: StageContext) -> StageResult:
    """Measure; write environment.json, joints.csv, sine.mp4, cameras.png and tracking.png."""
    config, folder, supervisor = context.config.env_check, context.folder, context.config.supervisor
    robot = robot_from(context.config.robot)
    with context.progress.task("environment", 9) as task:
        libraries, packages = required_libraries(), system_packages()
        model = build_model(context.config.scene, robot, visuals=True)
        joints = measure.drivable_joints(model, robot)
        installed = installation_checks(libraries, packages, len(joints), robot)
        if len(joints) != robot.dof:  # no world can be built on it; this check says why
            return StageResult(checks=installed)
        world, kinematics = World(context.config.scene, robot, model=model), Kinematics(robot)
        loop = JointLoop(world, kinematics)
        contacts, cameras = tracking.arm_contacts(world), pictures.check_cameras(world)
        pictures.save_cameras(world, folder / "cameras.png")
        task.advance(note="cameras")
        mapping = measure.torque_pulse_mapping(world, kinematics, pulse_share=config.pulse_share)
        task.advance(note="mapping")
        doing = "each joint alone"

        def tell() -> Overlay:
            return Overlay(title="env-check", mode="joint", source="env-check", state=doing)

        with watched(context.view, world, tell):
            steps = tracking.single_joint_steps(loop, config.single_step_rad, config.single_duration_s)
            task.advance(note=doing)
            doing = "a step"
            step = tracking.step_response(loop, tracking.outward_step(robot, config.step_rad), config.step_duration_s)
            task.advance(note=doing)
            doing = "all joints swing"
            sine = tracking.sine_response(
                loop, config.sine_amplitude_rad, config.sine_frequency_hz, config.sine_duration_s
            )
            task.advance(note=doing)
        states = stream(context.seed, "env-check/states")
        agreement = measure.model_agreement(world, kinematics, states, config.agreement_states_n)
        task.advance(note="two engines")
        cost = measure.control_step_cost(loop, config.cost_steps_n)
        task.advance(note="step cost")
        rig = LatencyRig(world, kinematics, context.config.arbiter, supervisor, context.config.teleop.rate_hz)
        latency = command_latency(rig)
        stop = emergency_stop(rig)
        task.advance(note="latency")
        size = {"width_px": config.video_width_px, "height_px": config.video_height_px}
        frames = pictures.film(world, sine, folder / "sine.mp4", fps=config.video_fps, **size)
        responses = tracking.joint_responses(robot, steps, sine)
        _write_joints(folder / "joints.csv", responses)
        pictures.save_tracking(
            folder / "tracking.png",
            robot,
            step,
            steps,
            sine,
            responses,
            step_limit_rad=config.step_error_max_rad,
            sine_limit_rad=config.sine_rms_max_rad,
            rise_limit_s=config.rise_max_s,
        )
        task.advance(note="film")

    measured = Measured(mapping, contacts, responses, step, sine, agreement, cost, latency, stop, cameras, frames)
    data = {
        "arm": robot.arm.name,
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
        "step": {"settled_rad": step.settled, "overshoot_rad": step.overshoot},
        "sine": {"rms_rad": sine.rms, "joint_rms_rad": sine.joint_rms.tolist(), "frames": frames},
        "agreement": agreement,
        "contacts_home": [list(pair) for pair in contacts],
        "control_step": {**asdict(cost), "ratio": cost.ratio},
        "cameras": asdict(cameras),
    }
    text = json.dumps(data, indent=2, sort_keys=True, allow_nan=False)
    (folder / "environment.json").write_text(text + "\n", encoding="utf-8")
    notes = [
        f"one control step takes {cost.ratio:.1f} times a bare physics step ({cost.bare_median_us:.0f} us)",
        f"pictures are drawn by {cameras.gl_renderer}",
        f"the step leaves {step.settled:.1e} rad",
    ]
    return StageResult(checks=[*installed, *measured_checks(measured, config, robot)], data=data, notes=notes)


def _write_joints(path: Path, rows: Sequence[tracking.JointResponse]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=list(asdict(rows[0])), lineterminator="\n")
        writer.writeheader()
        writer.writerows({k: f"{v:.6g}" if isinstance(v, float) else v for k, v in asdict(row).items()} for row in rows)
