"""Draw what happens in a task, for its page: moments of one trial by `moveit`.

python -m scripts.task_pictures handover docs/handover.webp
"""

import sys
from typing import Any, NamedTuple

import mujoco
import numpy as np
from PIL import Image

from minidual.config.loader import load_config
from minidual.plant.contact import GROUP_COLLISION
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import MethodInputs
from minidual.trials.runner import Bench

SIZE_PX = (480, 360)
QUALITY = 60
EVERY_S = 0.02


class View(NamedTuple):
    """A camera (lookat [m], distance [m], azimuth and elevation [deg]), and the share of the trial's time."""

    at: float
    lookat: tuple[float, float, float]
    distance: float
    azimuth: float
    elevation: float


WHOLE = (0.4, 0.0, 0.15), 1.8, 150.0, -30.0
NEAR = (0.4, 0.0, 0.22), 1.5, 150.0, -25.0
CLOSE = (0.45, 0.0, 0.2), 0.8, 172.0, -10.0
SHOWN = {
    "handover": [View(at, *WHOLE) for at in (0.25, 0.5, 0.7, 0.93)],
    "pot_lift": [View(at, *NEAR) for at in (0.3, 0.6, 0.9)],
    "insertion": [View(0.15, *NEAR), View(0.3, *NEAR), View(0.36, *CLOSE), View(0.99, *CLOSE)],
}
OTHERS = [View(at, *WHOLE) for at in (0.2, 0.3, 0.4, 0.6, 0.8, 0.97)]


def main(task: str, target: str) -> None:
    """Run trial 0 of `task` and write the sheet."""
    config = load_config("standard", [f"task={task}"]).config
    bench = Bench("moveit", MethodInputs(config, config.seed), visuals=True)
    seen: list[tuple[float, Any]] = []

    def watch(world: Any, _method: Any) -> None:
        if not seen or world.time > seen[-1][0] + EVERY_S:
            seen.append((world.time, world.data.qpos.copy()))

    result, _ = bench.run(make_task(config).trial(config.seed, "benchmark", 0), on_step=watch)
    print(f"{task}: {result.text}; {seen[-1][0]:.1f} s")
    model = bench.world.model
    data = mujoco.MjData(bench.world.model)
    renderer = mujoco.Renderer(model, SIZE_PX[1], SIZE_PX[0])
    option = mujoco.MjvOption()
    option.geomgroup[GROUP_COLLISION] = 0
    pictures = []
    for view in SHOWN.get(task, OTHERS):
        data.qpos[:] = min(seen, key=lambda pair: abs(pair[0] - view.at * seen[-1][0]))[1]
        mujoco.mj_forward(model, data)
        camera = mujoco.MjvCamera()
        camera.lookat, camera.distance, camera.azimuth, camera.elevation = view[1:]
        renderer.update_scene(data, camera, scene_option=option)
        pictures.append(renderer.render().copy())
    columns = 2 if len(pictures) == 4 else 3
    rows = [np.hstack(pictures[k : k + columns]) for k in range(0, len(pictures), columns)]
    Image.fromarray(np.vstack(rows)).save(target, quality=QUALITY, method=6)


if __name__ == "__main__":
    main(*sys.argv[1:])
