"""Film a trial: the same trial again, in a world with visual meshes, seen by the overview camera."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from minidual.plant.model import build_model
from minidual.plant.render import Camera, Image, write_video
from minidual.plant.world import World
from minidual.robot.arms import robot_from
from minidual.robot.kinematics import Kinematics
from minidual.tasks.task import Trial, make_task
from minidual.trials.methods import Factory, Method, MethodInputs, load_factory
from minidual.trials.trials import TrialResult, run_trial

FILM_FPS = 25
FILM_SIZE = (640, 480)


def film_trial(
    method: str, inputs: MethodInputs, trial: Trial, path: Path, *, factory: Factory | None = None
) -> TrialResult:
    """Run `trial` once more, write it to `path` (mp4) and return its result.

    The result is that of the filmed run, so a film never shows another trial than the one it names.
    """
    robot = robot_from(inputs.config.robot)
    model = build_model(inputs.config.scene, robot, visuals=True)
    world = World(inputs.config.scene, robot, model=model)
    make = load_factory(method, inputs) if factory is None else factory
    frames: list[Image] = []
    with Camera(model, *FILM_SIZE, shadows=True) as camera:
        result, _ = run_trial(
            method, make, world, Kinematics(robot), make_task(inputs.config), trial, on_step=film_hook(camera, frames)
        )
    write_video(path, frames, fps=FILM_FPS)
    return result


def film_hook(camera: Camera, frames: list[Image], *, view: str = "overview") -> Callable[[World, Method], None]:
    """Return a step hook that appends one picture every 1 / FILM_FPS seconds of simulated time."""

    def hook(world: World, method: Method) -> None:
        if world.time * FILM_FPS >= len(frames):
            frames.append(camera.picture(world.data, view))

    return hook
