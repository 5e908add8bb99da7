"""Pictures and films of the stages, embedded in the page or copied beside it."""

import base64
import shutil
from pathlib import Path
from typing import NamedTuple

from minidual.errors import DataError
from minidual.gate.verdict import Verdict
from minidual.show.report.wording import CAPTIONS
from minidual.show.report.words import Words

EMBED_BYTES = 1_500_000
"""Largest file that is embedded in the page."""

_MIME_TYPES = {
    ".png": "image/png",
    ".jpg": "image/jpeg",
    ".jpeg": "image/jpeg",
    ".svg": "image/svg+xml",
    ".mp4": "video/mp4",
}


class Medium(NamedTuple):
    """A picture or film.

    Attributes:
        stage: Stage that made it.
        name: File name.
        caption: Text below it.
        source: Data URI, or path relative to the page.
        film: Whether it is a film.
    """

    stage: str
    name: str
    caption: str
    source: str
    film: bool = False


def collect_media(
    verdict: Verdict,
    folder: Path,
    page_folder: Path,
    words: Words,
) -> list[Medium]:
    """Return the pictures and films of a stage, without those in subfolders.

    Large files are copied into `page_folder`/media.

    Args:
        verdict: Verdict of the stage; names the files.
        folder: Folder of the stage.
        page_folder: Folder of the page.
        words: Of the page's language.

    Raises:
        DataError: A file is missing.
    """
    captions = {**CAPTIONS.get(verdict.stage, {}), **verdict.data.get("captions", {})}
    media: list[Medium] = []
    for name in sorted(verdict.artefacts):
        path = folder / name
        if "/" in name or path.suffix not in _MIME_TYPES:
            continue
        if not path.is_file():
            raise DataError(f"artefact {name} of stage {verdict.stage} is gone: {path}")
        if path.stat().st_size <= EMBED_BYTES:
            source = _data_uri(path)
        else:
            source = f"media/{verdict.stage}-{name}"
            (page_folder / "media").mkdir(exist_ok=True)
            shutil.copyfile(path, page_folder / source)
        caption = captions.get(name) or path.stem.replace("_", " ").capitalize()
        shown = words.caption(name, caption)
        media.append(Medium(verdict.stage, name, shown, source, film=path.suffix == ".mp4"))
    return media


def _data_uri(path: Path) -> str:
    content = base64.b64encode(path.read_bytes()).decode("ascii")
    return f"data:{_MIME_TYPES[path.suffix]};base64,{content}"
