"""Draw what happens in a task, for its page: moments of one trial by `moveit`, as films show it.

python -m scripts.task_pictures handover docs/handover.webp
"""

import sys
from typing import NamedTuple

import numpy as np
from PIL import Image

from minidual.config.loader import load_config
from minidual.show.figures.film_camera import FilmCamera
from minidual.show.figures.side_by_side import take
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import MethodInputs

SIZE_PX = (480, 270)
QUALITY = 70


class View(NamedTuple):
    """A moment, as a share of the trial's time; from near: a camera before this place [m]."""

    share: float
    near_m: tuple[float, float, float] | None = None


VIEWS = {
    "handover": [View(share) for share in (0.25, 0.5, 0.7, 0.93)],
    "pot_lift": [View(share) for share in (0.1, 0.3, 0.6, 0.9)],
    "insertion": [
        View(0.1),
        View(0.3),
        View(0.36, (0.45, 0.0, 0.22)),
        View(0.99, (0.45, 0.0, 0.22)),
    ],
}
OTHER_VIEWS = [View(share) for share in (0.2, 0.3, 0.4, 0.6, 0.8, 0.97)]


def main(task: str, target: str) -> None:
    """Run trial 0 of `task` and write the sheet."""
    config = load_config("standard", [f"task={task}"]).config
    trial = make_task(config).trial(config.seed, "benchmark", 0)
    shown = take("moveit", MethodInputs(config, config.seed), trial, fine=True)
    print(f"{task}: {shown.result.text}; {shown.end_s:.1f} s")
    pictures: list[np.ndarray] = []
    with FilmCamera(shown.model, SIZE_PX) as camera:
        for view in VIEWS.get(task, OTHER_VIEWS):
            moment = shown.at(view.share * shown.end_s)
            if view.near_m is None:
                pictures.append(camera.picture(moment.qpos, moment.arrows))
            else:
                pictures.append(camera.close_up(moment.qpos, view.near_m).copy())
    columns = 3 if len(pictures) % 3 == 0 else 2
    rows = [np.hstack(pictures[k : k + columns]) for k in range(0, len(pictures), columns)]
    Image.fromarray(np.vstack(rows)).save(target, quality=QUALITY, method=6)


if __name__ == "__main__":
    main(*sys.argv[1:])
