"""Hashes of a stage's artefacts, which detect changes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from minidual.errors import DataError
from minidual.gate.canonical import file_sha256

VERDICT_FILE = "verdict.json"
ATTEMPT_FILE = "attempt.json"
CONFIG_FILE = "config.yaml"
_NOT_ARTEFACTS = (VERDICT_FILE, ATTEMPT_FILE)


@dataclass(frozen=True)
class Artefact:
    """Hash and size of a file."""

    sha256: str
    size_bytes: int


def _files_under(folder: Path) -> Iterable[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def build_manifest(folder: Path, listed: Sequence[str] | None) -> dict[str, Artefact]:
    """Return {relative posix path: Artefact} of `listed` paths (None: all files).

    DataError if a path is missing or outside the folder.
    """
    if listed is None:
        files: set[Path] = set(_files_under(folder))
    else:
        files = {folder / CONFIG_FILE} if (folder / CONFIG_FILE).is_file() else set()
        for name in listed:
            path = folder / name
            if PurePosixPath(name).is_absolute() or not path.resolve().is_relative_to(folder.resolve()):
                raise DataError(f"artefact '{name}' lies outside the stage's folder")
            if not path.exists():
                raise DataError(f"artefact '{name}' was announced but not written to {folder}")
            files.update(_files_under(path) if path.is_dir() else [path])
    manifest: dict[str, Artefact] = {}
    for path in sorted(files):
        name = path.relative_to(folder).as_posix()
        if name not in _NOT_ARTEFACTS:
            manifest[name] = Artefact(file_sha256(path), path.stat().st_size)
    return manifest


def manifest_changes(folder: Path, manifest: Mapping[str, Artefact]) -> list[str]:
    """Return one reason per missing or changed artefact."""
    reasons: list[str] = []
    for name, artefact in manifest.items():
        path = folder / name
        if not path.is_file():
            reasons.append(f"artefact {name} is gone")
        elif path.stat().st_size != artefact.size_bytes:
            reasons.append(f"artefact {name} changed (was {artefact.size_bytes} bytes, is {path.stat().st_size})")
        elif file_sha256(path) != artefact.sha256:
            reasons.append(f"artefact {name} changed (same size, other content)")
    return reasons
