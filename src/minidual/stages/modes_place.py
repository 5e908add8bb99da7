"""Where the modes hand over the arms: in the simulator, or on another plant."""

from collections.abc import Generator
from contextlib import contextmanager
from dataclasses import dataclass

from minidual.control.supervisor import OnReflex, dumping
from minidual.errors import UsageError
from minidual.gate.stage import ToolContext
from minidual.motion.api import Planner
from minidual.plant.connect import SIMULATOR, connection
from minidual.plant.lifecycle import Connection, planned_robot
from minidual.plant.protocol import Plant
from minidual.plant.recorder import Recorder
from minidual.plant.senses import Senses
from minidual.plant.sensing import SimulatedSenses
from minidual.plant.world import World
from minidual.robot.pair import robot_from
from minidual.skills.plant_home import bring_home
from minidual.tasks.task import Trial, placement, pose_of
from minidual.trials.modes_turns import KnownObject


@dataclass(frozen=True)
class ModesPlace:
    """A place for the demonstration, with the object at a trial's goal.

    Attributes:
        plant: What is driven.
        kind: `simulator`, `emulator`, `hardware` or what the plant says.
        known_object: What the modes know of the object.
        world: What is judged and drawn; None where nothing is simulated.
        senses: Pictures for a policy; None without a world.
        on_reflex: Keeps the last second before a reflex, in the simulator.
        notes: What a person should know.
    """

    plant: Plant
    kind: str
    known_object: KnownObject
    world: World | None = None
    senses: Senses | None = None
    on_reflex: OnReflex | None = None
    notes: tuple[str, ...] = ()


@contextmanager
def modes_place(
    context: ToolContext, trial: Trial, modes: tuple[str, ...]
) -> Generator[ModesPlace]:
    """Yield the configured place.

    Raises:
        UsageError: A policy is to drive where no camera is.
    """
    config = context.config
    if config.plant.address == SIMULATOR:
        yield _simulated(context, trial)
        return
    with connection(config.plant, robot_from(config.robot), config.scene) as link:
        yield _on_plant(context, link, trial, modes)


def _simulated(context: ToolContext, trial: Trial) -> ModesPlace:
    scene = context.config.scene
    world = World(scene, robot_from(context.config.robot), visuals=True)
    world.reset(poses=trial.goal)  # as the last carry left it
    dumps = context.run_folder / "dumps"
    recorder = Recorder(world, window_s=1.0, seed=context.seed, folder=dumps)
    world.recorder = recorder
    return ModesPlace(
        world,
        "simulator",
        KnownObject(scene, world.object_pose),
        world,
        SimulatedSenses(world, world.dt),
        dumping(recorder),
    )


def _on_plant(
    context: ToolContext,
    link: Connection,
    trial: Trial,
    modes: tuple[str, ...],
) -> ModesPlace:
    config = context.config
    scene = config.scene
    plant = link.plant
    twin = link.twin()
    if twin is None and "policy" in modes:
        raise UsageError(
            f"mode 'policy' looks through cameras, and plant '{link.address}' ({link.place}) "
            "brings none",
            remedy="leave the policy out with --modes moveit,teleop,moveit",
        )
    planner = Planner(config=config.plan.planner, robot=planned_robot(plant))
    context.progress.note("the arms go home")
    bring_home(link, config, planner, context.seed)
    if twin is not None:
        twin.place(trial.goal)
        world = twin.world
        senses = SimulatedSenses(world, plant.dt)
        return ModesPlace(plant, link.place, KnownObject(scene, world.object_pose), world, senses)
    name = scene.object.name
    T_world_object = pose_of(scene.object, trial.goal[name])
    x, y, yaw = placement(T_world_object)
    note = (
        f"nothing senses the object on plant '{link.address}': a person has put the {name} at "
        f"x {x:.3f} m, y {y:.3f} m, yaw {yaw:.3f} rad, or the hands stay empty"
    )
    known_object = KnownObject(scene, T_world_object.copy)
    return ModesPlace(
        plant, link.place, known_object, notes=(note, "no camera: signals are drawn instead")
    )
