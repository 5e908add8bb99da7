"""Stage `env-check`: test all joints and cameras."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from minidual.config.control import EnvCheckConfig
from minidual.config.seeds import stream
from minidual.durable import write_csv
from minidual.gate.check import Check, Rows
from minidual.gate.stage import StageContext, StageResult
from minidual.plant.model import build_model
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Robot, robot_from
from minidual.show.figures.canvas import BLUE, INK, ORANGE, limit_line, new_figure
from minidual.show.figures.film import FILM_FPS, Postures, film_postures
from minidual.show.watch import StackNarrator, watched
from minidual.stages.env_check import model as measure
from minidual.stages.env_check import pictures, tracking
from minidual.stages.env_check.installation import Library, required_libraries
from minidual.stages.words import worded

_REACHED_RAD = 0.005
"""Error norm of all joints below which a single step has settled."""
_REAL_TIME_US = 1000.0
_CONTRAST_MIN = 5.0
_OBJECT_SHARE_MIN = 0.001
_FINGER_SHARE_MIN = 0.002


class Measured(NamedTuple):
    """All measurements of a fully actuated robot.

    Attributes:
        moved: Joint moved by each torque command.
    """

    moved: tuple[int, ...]
    contacts: list[tuple[str, str, float]]
    steps: list[tracking.Tracking]
    responses: list[tracking.JointResponse]
    step: tracking.Tracking
    sine: tracking.Tracking
    agreement: dict[str, float]
    latency: tracking.CommandLatency
    stop: tracking.StopResponse
    cameras: pictures.CameraCheck
    frames: int


def installation_checks(libraries: list[Library], joints_n: int, robot: Robot) -> list[Check]:
    """Return the checks of libraries and actuated joints."""
    unfit = [
        f"{lib.name} {lib.wanted} (found {lib.found or 'none'})"
        for lib in libraries
        if not lib.fits
    ]
    rows: Rows = {
        "libraries.unfit": (len(unfit), "==", 0),
        "joints.count": (joints_n, "==", robot.dof),
    }
    return worded("env-check", rows, unfit=", ".join(unfit))


def measured_checks(m: Measured, limits: EnvCheckConfig, robot: Robot) -> list[Check]:
    """Return the checks of joints, engines, commands and cameras."""
    astray = [str(j + 1) for j, joint in enumerate(m.moved) if joint != j]
    late = [
        str(j + 1) for j, row in enumerate(m.responses) if not row["settled_rad"] < _REACHED_RAD
    ]
    rise, overshoot = ([row[name] for row in m.responses] for name in ("rise_s", "overshoot_rad"))
    stops = [t.stopped for t in (*m.steps, m.step, m.sine) if t.stopped]
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
        "model.agreement_max": (
            float(np.max(list(m.agreement.values()))),
            "<=",
            limits.agreement_max,
        ),
        "control.step_median_us": (m.sine.step_us, "<", _REAL_TIME_US),
        "latency.late_steps": (m.latency.late_steps, "==", 0),
        "latency.wall_median_us": m.latency.wall_us,
        "stop.ticks": (m.stop.ticks, "==", 1),
        "stop.rest_s": (m.stop.rest_s, "<", limits.stop_rest_max_s),
        "cameras.contrast_min": (m.cameras.contrast_min, ">", _CONTRAST_MIN),
        "cameras.object_share": (m.cameras.object_share, ">", _OBJECT_SHARE_MIN),
        "cameras.fingers_min": (m.cameras.fingers_min, ">", _FINGER_SHARE_MIN),
        "video.frames": (m.frames, "==", round(limits.sine_duration_s * FILM_FPS)),
    }
    return worded("env-check", rows, **names)


def save_tracking(path: Path, m: Measured, limits: EnvCheckConfig, robot: Robot) -> None:
    """Save a figure of the steps, the swing, their errors and the rise times."""
    figure, ((norm, alone), (swing, rise)) = new_figure(2, 2, 11.0, 7.2)
    step = m.step
    sine = m.sine
    rows = m.responses
    n = robot.dof_per_arm
    x = np.arange(robot.dof)
    every = max(1, len(sine.t) // 2000)
    colours = np.repeat([BLUE, ORANGE], n)
    for j in range(robot.dof):
        label = f"{robot.sides[j // n]} arm" if j % n == 0 else None
        style: dict[str, Any] = {"color": colours[j], "lw": 1.0, "label": label}
        alone.plot(
            m.steps[j].t,
            m.steps[j].share(j),
            ls=("-", (0, (4, 4)))[j // n],
            **style,
        )  # the arms answer alike
        swing.plot(
            sine.t[::every],
            1e3 * (sine.measured - sine.reference)[::every, j],
            alpha=0.55,
            **style,
        )
    norm.semilogy(step.t, np.maximum(step.error_norm, 1e-16), color=INK)
    limit_line(norm, limits.step_error_max_rad, f"limit {limits.step_error_max_rad:g} rad")
    rise.bar(x, [1e3 * row["rise_s"] for row in rows], width=0.7, color=colours, alpha=0.85)
    limit_line(rise, 1e3 * limits.rise_max_s, f"limit {1e3 * limits.rise_max_s:g} ms")
    rise.set_xticks(x, [f"{'LR'[j // n]}{j % n + 1}" for j in x], fontsize=8)
    texts = {
        norm: (
            f"Step of joint 1 of both arms leaves {step.settled:.1e} rad",
            "time [s]",
            "error of all joints [rad]",
        ),
        alone: (
            f"A step of {abs(rows[0]['step_rad']):g} rad, each joint alone",
            "time [s]",
            "share of the step",
        ),
        swing: (
            f"All {robot.dof} joints swinging: RMS {1e3 * sine.rms:.2g} mrad",
            "time [s]",
            "error [mrad]",
        ),
        rise: ("Rise time of each joint's own step, 10 % to 90 %", "joint", "time [ms]"),
    }
    for axes, (title, across, up) in texts.items():
        axes.set(title=title, xlabel=across, ylabel=up)
        axes.legend(frameon=False, fontsize=8)
    figure.savefig(
        path,
        metadata={"Software": None},
    )  # no date inside: the same run writes the same bytes


def run(context: StageContext) -> StageResult:
    """Measure; write joints.csv, sine.mp4, cameras.png and tracking.png."""
    config = context.config.env_check
    folder = context.folder
    robot = robot_from(context.config.robot)
    sine_wave = config.sine_amplitude_rad, config.sine_frequency_hz
    with context.progress.task("environment", 8) as task:
        libraries = required_libraries()
        model = build_model(context.config.scene, robot, visuals=True)
        joints = measure.drivable_joints(model, robot)
        installed = installation_checks(libraries, len(joints), robot)
        if len(joints) != robot.dof:  # no world can be built on it; this check says why
            return StageResult(checks=installed)
        world = World(context.config.scene, robot, model=model)
        kinematics = Kinematics(robot)
        contacts = tracking.arm_contacts(world)
        cameras = pictures.check_cameras(world, folder / "cameras.png")
        task.advance(note="cameras")
        rig = tracking.TrackingRig(world, kinematics, context.config)
        postures = Postures(1.0 / FILM_FPS)
        moved = measure.torque_pulse_mapping(world, rig.supervisor, kinematics)
        task.advance(note="mapping")
        states = stream(context.seed, "env-check/states")
        agreement = measure.model_agreement(world, kinematics, states, config.agreement_states_n)
        task.advance(note="two engines")
        with watched(context.view, world, StackNarrator(rig.stack, kinematics, "env-check")):
            steps = tracking.single_joint_steps(
                rig,
                config.single_step_rad,
                config.single_duration_s,
            )
            task.advance(note="each joint alone")
            step = tracking.step_response(
                rig,
                tracking.outward_step(robot, config.step_rad),
                config.step_duration_s,
            )
            task.advance(note="a step")
            sine = tracking.sine_response(rig, *sine_wave, config.sine_duration_s, on_step=postures)
            task.advance(note="all joints swing")
        latency = tracking.command_latency(rig)
        stop = tracking.emergency_stop(rig, *sine_wave)
        task.advance(note="latency")
        frames = film_postures(model, postures.qpos, folder / "sine.mp4", shadows=False)
        responses = tracking.joint_responses(robot, steps, sine)
        write_csv(folder / "joints.csv", responses)
        measured = Measured(
            moved,
            contacts,
            steps,
            responses,
            step,
            sine,
            agreement,
            latency,
            stop,
            cameras,
            frames,
        )
        save_tracking(folder / "tracking.png", measured, config, robot)
        task.advance(note="film")

    versions = {lib.name: {"wanted": lib.wanted, "found": lib.found} for lib in libraries}
    data: dict[str, Any] = {"arm": robot.arm.name, "libraries": versions}
    data |= {"latency": latency._asdict(), "emergency_stop": stop._asdict()}
    data |= {
        "agreement": agreement,
        "contacts_home": [list(pair) for pair in contacts],
        "cameras": cameras._asdict(),
    }
    notes = [
        f"pictures are drawn by {cameras.gl_renderer}",
        f"the step leaves {step.settled:.1e} rad",
    ]
    return StageResult(
        checks=[*installed, *measured_checks(measured, config, robot)],
        data=data,
        notes=notes,
    )
