"""Pictures and films, embedded if small, else copied."""

import base64
import shutil
from dataclasses import dataclass
from pathlib import Path

from minidual.errors import DataError
from minidual.gate.verdict import Verdict
from minidual.show.report.wording import WORDS

_KINDS = {".png": "image/png", ".jpg": "image/jpeg", ".jpeg": "image/jpeg", ".mp4": "video/mp4"}
EMBED_BYTES = 1_500_000


@dataclass(frozen=True)
class Medium:
    """A picture or film.

    Attributes:
        source: Data URI, or path relative to the page.
    """

    stage: str
    name: str
    caption: str
    source: str
    film: bool = False


def collect_media(verdict: Verdict, folder: Path, page_folder: Path) -> list[Medium]:
    """Return the pictures and films in a stage's folder, without subfolders; copy large ones into `page_folder`/media.

    Raises:
        DataError: A file is missing.
    """
    media: list[Medium] = []
    stage, captions = verdict.stage, WORDS["captions"].get(verdict.stage, {}) | verdict.data.get("captions", {})
    for name in sorted(name for name in verdict.artefacts if Path(name).suffix in _KINDS and "/" not in name):
        path = folder / name
        if not path.is_file():
            raise DataError(f"artefact {name} of stage {stage} is gone: {path}")
        kind = _KINDS[path.suffix]
        if path.stat().st_size <= EMBED_BYTES:
            source = f"data:{kind};base64,{base64.b64encode(path.read_bytes()).decode('ascii')}"
        else:
            source = f"media/{stage}-{name}"
            (page_folder / "media").mkdir(exist_ok=True)
            shutil.copyfile(path, page_folder / source)
        caption = captions.get(name) or path.stem.replace("_", " ").capitalize()
        media.append(Medium(stage, name, caption, source, path.suffix == ".mp4"))
    return media
