"""Draw what happens in a task, for its page: moments of one trial by `moveit`.

python -m scripts.task_pictures handover docs/handover.webp
"""

import sys
from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from PIL import Image

from minidual.config.loader import load_config
from minidual.plant.contact import GROUP_COLLISION
from minidual.plant.world import World
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench

SIZE_PX = (480, 360)
QUALITY = 60
EVERY_S = 0.02


class Camera(NamedTuple):
    """Where a camera looks: at a point [m], from a distance [m], by azimuth and elevation [deg]."""

    lookat: tuple[float, float, float]
    distance: float
    azimuth: float
    elevation: float


class View(NamedTuple):
    """A moment, as a share of the trial's time, and its camera."""

    share: float
    camera: Camera


class Moment(NamedTuple):
    """State of the world at one time."""

    time_s: float
    qpos: np.ndarray


WHOLE = Camera((0.4, 0.0, 0.15), 1.8, 150.0, -30.0)
NEAR = Camera((0.4, 0.0, 0.22), 1.5, 150.0, -25.0)
CLOSE = Camera((0.45, 0.0, 0.2), 0.8, 172.0, -10.0)
VIEWS = {
    "handover": [View(share, WHOLE) for share in (0.25, 0.5, 0.7, 0.93)],
    "pot_lift": [View(share, NEAR) for share in (0.3, 0.6, 0.9)],
    "insertion": [View(0.15, NEAR), View(0.3, NEAR), View(0.36, CLOSE), View(0.99, CLOSE)],
}
OTHER_VIEWS = [View(share, WHOLE) for share in (0.2, 0.3, 0.4, 0.6, 0.8, 0.97)]


def main(task: str, target: str) -> None:
    """Run trial 0 of `task` and write the sheet."""
    config = load_config("standard", [f"task={task}"]).config
    bench = Bench("moveit", MethodInputs(config, config.seed), visuals=True)
    moments: list[Moment] = []

    def watch(world: World, _method: object) -> None:
        if not moments or world.time > moments[-1].time_s + EVERY_S:
            moments.append(Moment(world.time, world.data.qpos.copy()))

    trial = make_task(config).trial(config.seed, "benchmark", 0)
    result, _ = bench.run(trial, on_step=watch)
    print(f"{task}: {result.text}; {moments[-1].time_s:.1f} s")
    views = VIEWS.get(task, OTHER_VIEWS)
    pictures = _pictures(bench.world.model, moments, views)
    columns = 2 if len(pictures) == 4 else 3
    rows = [np.hstack(pictures[k : k + columns]) for k in range(0, len(pictures), columns)]
    Image.fromarray(np.vstack(rows)).save(target, quality=QUALITY, method=6)


def _pictures(
    model: mujoco.MjModel,
    moments: Sequence[Moment],
    views: Sequence[View],
) -> list[np.ndarray]:
    """Return one picture (H, W, 3) per view."""
    width, height = SIZE_PX
    data = mujoco.MjData(model)
    renderer = mujoco.Renderer(model, height, width)
    option = mujoco.MjvOption()
    option.geomgroup[GROUP_COLLISION] = 0
    pictures = []
    for view in views:
        time_s = view.share * moments[-1].time_s
        data.qpos[:] = _nearest(moments, time_s).qpos
        mujoco.mj_forward(model, data)
        camera = mujoco.MjvCamera()
        camera.lookat = view.camera.lookat
        camera.distance = view.camera.distance
        camera.azimuth = view.camera.azimuth
        camera.elevation = view.camera.elevation
        renderer.update_scene(data, camera, scene_option=option)
        pictures.append(renderer.render().copy())
    return pictures


def _nearest(moments: Sequence[Moment], time_s: float) -> Moment:
    return min(moments, key=lambda moment: abs(moment.time_s - time_s))


if __name__ == "__main__":
    main(*sys.argv[1:])
