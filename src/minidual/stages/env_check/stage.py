"""Stage `env-check`: test all joints and cameras."""

from dataclasses import asdict

from minidual.config.seeds import stream
from minidual.durable import write_csv
from minidual.gate.stage import StageContext, StageResult
from minidual.plant.model import build_model
from minidual.plant.world import World
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
from minidual.show.figures.film import FILM_FPS, Postures, film_postures
from minidual.show.watch import StackNarrator, watched
from minidual.stages.env_check import model as measure
from minidual.stages.env_check import pictures, tracking
from minidual.stages.env_check.checks import Measured, installation_checks, measured_checks
from minidual.stages.env_check.installation import required_libraries


def run(context: StageContext) -> StageResult:
    """Measure; write joints.csv, sine.mp4, cameras.png and tracking.png."""
    config, folder = context.config.env_check, context.folder
    robot = robot_from(context.config.robot)
    sine_wave = config.sine_amplitude_rad, config.sine_frequency_hz
    with context.progress.task("environment", 8) as task:
        libraries = required_libraries()
        model = build_model(context.config.scene, robot, visuals=True)
        joints = measure.drivable_joints(model, robot)
        installed = installation_checks(libraries, len(joints), robot)
        if len(joints) != robot.dof:  # no world can be built on it; this check says why
            return StageResult(checks=installed)
        world, kinematics = World(context.config.scene, robot, model=model), Kinematics(robot)
        contacts = tracking.arm_contacts(world)
        cameras = pictures.check_cameras(world, folder / "cameras.png")
        task.advance(note="cameras")
        rig, postures = tracking.Rig(world, kinematics, context.config), Postures(1.0 / FILM_FPS)
        moved = measure.torque_pulse_mapping(world, rig.supervisor, kinematics, pulse_share=config.pulse_share)
        task.advance(note="mapping")
        states = stream(context.seed, "env-check/states")
        agreement = measure.model_agreement(world, kinematics, states, config.agreement_states_n)
        task.advance(note="two engines")
        with watched(context.view, world, StackNarrator(rig.stack, kinematics, "env-check")):
            steps = tracking.single_joint_steps(rig, config.single_step_rad, config.single_duration_s)
            task.advance(note="each joint alone")
            step = tracking.step_response(rig, tracking.outward_step(robot, config.step_rad), config.step_duration_s)
            task.advance(note="a step")
            sine = tracking.sine_response(rig, *sine_wave, config.sine_duration_s, on_step=postures)
            task.advance(note="all joints swing")
        latency, stop = tracking.command_latency(rig), tracking.emergency_stop(rig, *sine_wave)
        task.advance(note="latency")
        frames = film_postures(model, postures.qpos, folder / "sine.mp4", shadows=False)
        responses = tracking.joint_responses(robot, steps, sine)
        write_csv(folder / "joints.csv", responses)
        pictures.save_tracking(folder / "tracking.png", robot, config, step, steps, sine, responses)
        task.advance(note="film")

    measured = Measured(moved, contacts, steps, responses, step, sine, agreement, latency, stop, cameras, frames)
    data = {
        "arm": robot.arm.name,
        "libraries": {lib.name: {"wanted": lib.wanted, "found": lib.found} for lib in libraries},
        "latency": asdict(latency),
        "emergency_stop": asdict(stop),
        "agreement": agreement,
        "contacts_home": [list(pair) for pair in contacts],
        "cameras": asdict(cameras),
    }
    notes = [f"pictures are drawn by {cameras.gl_renderer}", f"the step leaves {step.settled:.1e} rad"]
    return StageResult(checks=[*installed, *measured_checks(measured, config, robot)], data=data, notes=notes)
