"""Pictures and films, embedded if small, else copied."""

from __future__ import annotations

import base64
import io
import shutil
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice
from pathlib import Path, PurePosixPath

import av
from av.error import FFmpegError

from minidual.errors import DataError

_CAPTIONS: dict[tuple[str, str], str] = {
    ("env-check", "sine.mp4"): "All joints follow a sine",
    ("env-check", "cameras.png"): "What each camera sees at home",
    ("env-check", "tracking.png"): "Step, sine and single joints: target against measurement",
    ("plan", "paths.png"): "One query a group: paths of the hands among the obstacles",
    ("plan", "times.png"): "Planning times and their phases",
    ("carry", "carry.mp4"): "The median carry under object impedance control",
    ("carry", "median.png"): "The median trial",
    ("carry", "worst.png"): "The worst trial: the first failure, or the largest tilt",
    ("teleop-record", "demonstration.mp4"): "A recorded demonstration",
    ("teleop-record", "quality.png"): "Quality of every episode",
    ("train-act", "loss.png"): "Training and validation loss",
    ("deploy", "success.mp4"): "The policy succeeds on a start held out from training",
    ("deploy", "failure.mp4"): "The policy fails on a start held out from training",
}
_PICTURES = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg"}
_FILM = ".mp4"
EMBED_PICTURE_BYTES = 1_000_000
EMBED_FILM_BYTES = 1_500_000
MEDIA_FOLDER = "media"


@dataclass(frozen=True)
class Medium:
    """A picture or film.

    Attributes:
        name: File name.
        source: Data URI, or path relative to the page.
        poster: A film's still, as data URI.
    """

    stage: str
    name: str
    caption: str
    source: str
    poster: str = ""
    film: bool = False


def is_shown(name: str) -> bool:
    """Return whether an artefact is shown; subfolders hold data."""
    path = PurePosixPath(name)
    return path.suffix.lower() in (*_PICTURES, _FILM) and len(path.parts) == 1


def caption(stage: str, name: str) -> str:
    """Return the caption, by default from the file name."""
    path = PurePosixPath(name)
    words = path.stem.replace("_", " ").replace("-", " ").strip()
    return _CAPTIONS.get((stage, path.name), words[:1].upper() + words[1:])


def collect_media(
    stage: str, folder: Path, names: Iterable[str], captions: dict[str, str], page_folder: Path
) -> list[Medium]:
    """Return a stage's media, copying large ones into `page_folder`/media.

    Raises:
        DataError: A file is missing, or a film unreadable.
    """
    media: list[Medium] = []
    for name in sorted(name for name in names if is_shown(name)):
        path = folder / name
        if not path.is_file():
            raise DataError(f"artefact {name} of stage {stage} is gone: {path}")
        film = path.suffix.lower() == _FILM
        limit = EMBED_FILM_BYTES if film else EMBED_PICTURE_BYTES
        kind = "video/mp4" if film else _PICTURES[path.suffix.lower()]
        if path.stat().st_size <= limit:
            source = _data_uri(kind, path.read_bytes())
        else:
            target = page_folder / MEDIA_FOLDER / f"{stage}-{PurePosixPath(name).name}"
            target.parent.mkdir(exist_ok=True)
            shutil.copyfile(path, target)
            source = target.relative_to(page_folder).as_posix()
        media.append(
            Medium(stage, name, captions.get(name) or caption(stage, name), source, _poster(path) if film else "", film)
        )
    return media


def _data_uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode('ascii')}"


def _poster(path: Path) -> str:
    """Return the frame at 40 %; first frames seldom show anything."""
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            wanted = int(0.4 * (stream.frames or 0))
            frames = deque(islice(container.decode(stream), wanted + 1), maxlen=1)
            if not frames:
                raise DataError(f"{path} holds no picture")
            image = frames[0].to_image()
    except (FFmpegError, IndexError) as error:
        raise DataError(f"{path} is no readable film: {error}") from error
    image.thumbnail((960, 960))
    content = io.BytesIO()
    image.save(content, "JPEG", quality=80)
    return _data_uri("image/jpeg", content.getvalue())
