"""Make the moving picture of README.md: force control carries the rod, with the hands' forces.

python -m scripts.moving_picture docs/demo.webp
"""

import sys

from PIL import Image

from minidual.config.loader import load_config
from minidual.show.figures.side_by_side import FPS, frames_of, take
from minidual.tasks.catalogue import make_task
from minidual.trials.methods import MethodInputs

METHOD = "impedance"
TASK = "rod_carry"
SIZE_PX = (640, 360)
QUALITY = 60


def main(target: str, task: str = TASK) -> None:
    """Run trial 0 of the task and write it as an animated WebP, as fast as it happened."""
    config = load_config("standard", [f"task={task}"]).config
    trial = make_task(config).trial(config.seed, "film", 0)
    shown = take(METHOD, MethodInputs(config, config.seed), trial)
    print(f"{task}, {METHOD}: {shown.result.text}")
    frames = [Image.fromarray(frame) for frame in frames_of([shown], size_px=SIZE_PX)]
    frames[0].save(
        target,
        save_all=True,
        append_images=frames[1:],
        duration=round(1000 / FPS),
        loop=0,
        quality=QUALITY,
        method=4,
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
