"""`minidual bridge`: the simulated arms on ROS 2 topics."""

import math
import time

from minidual.config.root import Config
from minidual.control.stack import ControlStack
from minidual.control.supervisor import dumping
from minidual.errors import UsageError
from minidual.gate.stage import ToolContext, ToolResult
from minidual.plant.cameras import CAMERAS
from minidual.plant.recorder import Recorder
from minidual.plant.world import World
from minidual.robot.kinematics import Kinematics
from minidual.robot.pair import robot_from
from minidual.ros2.bridge.bridge import RATE_HZ, Bridge, come_to_rest
from minidual.ros2.bridge.cameras import CameraProcess
from minidual.ros2.bridge.topics import Topics, domain_id
from minidual.ros2.names import JOINT_STATES, image_topic
from minidual.skills.supervised import trial_supervisor
from minidual.stages.scene_view import interruptions
from minidual.tasks.catalogue import task_config


def bridge(context: ToolContext) -> ToolResult:
    """Run until Ctrl-C or --for-s.

    Raises:
        EnvironmentMissingError: cyclonedds is not installed.
        UsageError: A wrong domain or time.
    """
    options = context.options
    for_s = float(options.get("for-s", math.inf))
    if not for_s > 0.0:
        raise UsageError(f"--for-s is {for_s:g}; it must be above 0")
    domain = domain_id(options.get("domain"))
    config = task_config(context.config)
    cameras = () if options.get("no-cameras") else CAMERAS
    topics = Topics(domain)
    stack = _simulated_stack(context, config)
    world = stack.plant
    eyes = CameraProcess(config.scene, world.robot, cameras, domain) if cameras else None

    def show() -> None:
        if eyes is not None:
            eyes.offer(world.data.qpos)

    running = Bridge(topics, stack, show, context.progress.note)
    context.progress.note(f"on DDS domain {domain}: Ctrl-C ends it")
    with interruptions() as stop:
        began_s = time.monotonic()
        running.run(stop.is_set, for_s)
        wall_s = time.monotonic() - began_s
        come_to_rest(stack)
    counts = running.counts
    rates = {JOINT_STATES: counts.ticks_n / wall_s}
    if eyes is not None:
        eyes.close()
        for camera, rate_hz in eyes.rates_hz().items():
            rates[image_topic(camera)] = rate_hz
    topics.close()
    lines = [f"{topic} {rate_hz:.1f} Hz" for topic, rate_hz in rates.items()]
    notes: list[str] = []
    if counts.behind_s > 0.0:
        notes.append(f"the machine was too slow: {counts.behind_s:.1f} of {wall_s:.1f} s given up")
    data = {
        "domain": domain,
        "wall_s": wall_s,
        "rates_hz": rates,
        "complaints": counts.complaints_n,
        "behind_s": counts.behind_s,
        "reflexes": counts.reflexes,
    }
    return ToolResult(lines, notes, data)


def _simulated_stack(context: ToolContext, config: Config) -> ControlStack[World]:
    """Return the control stack of the task's simulated world, whose last second can be dumped."""
    world = World(config.scene, robot_from(config.robot))
    recorder = Recorder(
        world,
        window_s=1.0,
        seed=context.seed,
        folder=context.run_folder / "dumps",
    )
    world.recorder = recorder
    supervisor = trial_supervisor(config.supervisor, world.dt, world.robot, dumping(recorder))
    return ControlStack(
        world,
        Kinematics(world.robot),
        config.arbiter,
        rate_hz=RATE_HZ,
        supervisor=supervisor,
    )
