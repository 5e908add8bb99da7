"""Stage `env-check`: test all joints and cameras."""

from dataclasses import asdict
from typing import Any

import numpy as np

from minidual.config.seeds import stream
from minidual.durable import write_csv
from minidual.errors import UsageError
from minidual.gate.progress import ProgressTask
from minidual.gate.stage import StageContext, StageResult
from minidual.plant.connect import SIMULATOR
from minidual.plant.model import build_model
from minidual.plant.world import World
from minidual.robot.description import description_notes
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import Robot, robot_from
from minidual.show.figures.film import FILM_FPS, Postures, film_postures
from minidual.show.figures.film_model import film_model
from minidual.show.watch import StackNarrator, watched
from minidual.skills.supervised import SceneClearance
from minidual.stages.env_check import tracking
from minidual.stages.env_check.checks import Measurements, installation_checks, measured_checks
from minidual.stages.env_check.figure import save_tracking
from minidual.stages.env_check.installation import Library, required_libraries
from minidual.stages.env_check.model import (
    drivable_joints,
    model_agreement,
    torque_pulse_mapping,
)
from minidual.stages.env_check.on_plant import run_on_plant
from minidual.stages.env_check.pictures import check_cameras
from minidual.stages.env_check.responses import command_latency, emergency_stop, joint_responses
from minidual.stages.env_check.rig import TrackingRig
from minidual.stages.env_check.shapes import compare_shapes

_PARTS = 8
"""Parts of the progress."""
_GRAVITY_SHARE_MAX = 0.8
"""Of a motor's torque; the rest moves the arm."""


def run(context: StageContext) -> StageResult:
    """Measure; write joints.csv, sine.mp4, cameras.png and tracking.svg."""
    config = context.config
    if config.plant.address != SIMULATOR:
        return run_on_plant(context)
    robot = robot_from(config.robot)
    with context.progress.task("environment", _PARTS) as task:
        libraries = required_libraries()
        model = build_model(config.scene, robot, visuals=True)
        joints = drivable_joints(model, robot)
        installed = installation_checks(libraries, len(joints), robot)
        if len(joints) != robot.dof:  # no world can be built on it; this check says why
            return StageResult(checks=installed)
        world = World(config.scene, robot, model=model)
        measurements = _measure(context, world, task)
        write_csv(
            context.folder / "joints.csv",
            [asdict(response) for response in measurements.responses],
        )
        save_tracking(context.folder / "tracking.svg", measurements, config.env_check, robot)
        task.advance(note="film")
    notes = [
        f"pictures are drawn by {measurements.cameras.gl_renderer}",
        f"the step leaves {measurements.step.settled:.1e} rad",
        *description_notes(robot),
    ]
    return StageResult(
        checks=[*installed, *measured_checks(measurements, config.env_check, robot)],
        data={"arm": robot.name, **_data(libraries, measurements)},
        notes=notes,
    )


def _check_strength(kinematics: Kinematics) -> None:
    """Refuse arms that cannot hold themselves and their hands at home.

    Raises:
        UsageError: A motor has too little torque.
    """
    robot = kinematics.robot
    needed_nm = np.abs(kinematics.gravity(robot.home))
    worst = int(np.argmax(needed_nm / robot.tau_max))
    if needed_nm[worst] > _GRAVITY_SHARE_MAX * robot.tau_max[worst]:
        raise UsageError(
            f"{robot.joint_names[worst]} needs {needed_nm[worst]:.3g} Nm to hold the arm and its "
            f"hand '{robot.hand.name}' at home; tau_max is {robot.tau_max[worst]:g} Nm, of which "
            f"{_GRAVITY_SHARE_MAX:.0%} may go into that",
            remedy="choose a home with less reach, a lighter hand, or an arm that is stronger",
        )


def _check_clearance(robot: Robot) -> None:
    """Refuse arms with parts so near at home that the supervisor would let nothing move.

    Raises:
        UsageError: Two parts are nearer than where a stop may end.
    """
    pair, distance_m, bound_m = SceneClearance(robot)(robot.home)
    if distance_m < bound_m:
        raise UsageError(
            f"at home {pair} are {1e3 * distance_m:.1f} mm apart; the supervisor keeps "
            f"{1e3 * bound_m:.0f} mm",
            remedy="choose another home; where the hulls of two links of one arm meet although "
            "the links cannot, name the pair in never_touch",
        )


def _measure(context: StageContext, world: World, task: ProgressTask) -> Measurements:
    """Measure everything; write the pictures of the cameras and the film of the swing."""
    config = context.config.env_check
    robot = world.robot
    kinematics = Kinematics(robot)
    _check_strength(kinematics)
    _check_clearance(robot)
    contacts = tracking.arm_contacts(world)
    cameras = check_cameras(world, context.folder / "cameras.png")
    task.advance(note="cameras")
    rig = TrackingRig(world, kinematics, context.config)
    moved = torque_pulse_mapping(world, rig.supervisor, kinematics)
    task.advance(note="mapping")
    states = stream(context.seed, "env-check/states")
    agreement = model_agreement(world, kinematics, states, config.agreement_states_n)
    task.advance(note="two engines")
    postures = Postures(1.0 / FILM_FPS)
    with watched(context.view, world, StackNarrator(rig.stack, kinematics, "env-check")):
        steps = tracking.single_joint_steps(
            rig,
            config.single_step_rad,
            config.single_duration_s,
        )
        task.advance(note="each joint alone")
        outward = tracking.outward_step(robot, config.step_rad)
        step = tracking.step_response(rig, outward, config.step_duration_s)
        task.advance(note="a step")
        sine = tracking.sine_response(
            rig,
            config.sine_amplitude_rad,
            config.sine_frequency_hz,
            config.sine_duration_s,
            on_step=postures,
        )
        task.advance(note="all joints swing")
    latency = command_latency(rig)
    stop = emergency_stop(rig, config.sine_amplitude_rad, config.sine_frequency_hz)
    task.advance(note="latency")
    film = context.folder / "sine.mp4"
    model = film_model(world.scene, robot)
    frames = film_postures(model, postures.qpos, film, shadows=False)
    return Measurements(
        moved=moved,
        contacts=contacts,
        steps=steps,
        responses=joint_responses(robot, steps, sine),
        step=step,
        sine=sine,
        agreement=agreement,
        latency=latency,
        stop=stop,
        cameras=cameras,
        frames=frames,
        shapes=compare_shapes(world.model, robot),
    )


def _data(libraries: list[Library], m: Measurements) -> dict[str, Any]:
    versions = {lib.name: {"wanted": lib.wanted, "found": lib.installed} for lib in libraries}
    return {
        "libraries": versions,
        "latency": m.latency._asdict(),
        "emergency_stop": m.stop._asdict(),
        "agreement": m.agreement,
        "shapes": m.shapes.record(),
        "contacts_home": [list(contact) for contact in m.contacts],
        "cameras": m.cameras._asdict(),
    }
