"""Turn a film into an animated WebP for a page that shows no video.

minidual carry
python scripts/moving_picture.py runs/standard/carry/carry.mp4 docs/carry.webp
"""

import itertools
import sys

import av

WIDTH_PX = 480
EVERY = 3
QUALITY = 55


def main(film: str, target: str) -> None:
    """Write every third frame of `film` at its own speed."""
    with av.open(film) as container:
        stream = container.streams.video[0]
        period_ms = round(1000.0 * EVERY / float(stream.average_rate or 0))
        decoded = itertools.islice(container.decode(stream), 0, None, EVERY)
        frames = [frame.to_image() for frame in decoded]
    for frame in frames:
        frame.thumbnail((WIDTH_PX, WIDTH_PX))
    frames[0].save(
        target,
        save_all=True,
        append_images=frames[1:],
        duration=period_ms,
        loop=0,
        quality=QUALITY,
        method=6,
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
