"""Hashes of a stage's artefacts."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from minidual.durable import kind_of
from minidual.errors import DataError
from minidual.gate.canonical import file_sha256

VERDICT_FILE = "verdict.json"
ATTEMPT_FILE = "attempt.json"
CONFIG_FILE = "config.yaml"


@dataclass(frozen=True)
class Artefact:
    """Hash and size of a file."""

    sha256: str
    size_bytes: int


def build_manifest(folder: Path) -> dict[str, Artefact]:
    """Return {relative posix path: Artefact} of all files."""
    manifest: dict[str, Artefact] = {}
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        name = path.relative_to(folder).as_posix()
        if name not in (VERDICT_FILE, ATTEMPT_FILE):
            manifest[name] = Artefact(file_sha256(path), path.stat().st_size)
    return manifest


def manifest_changes(folder: Path, manifest: Mapping[str, Artefact]) -> list[str]:
    """Return a reason per missing or changed artefact."""
    reasons: list[str] = []
    for name, artefact in manifest.items():
        path = folder / name
        try:
            if (kind := kind_of(path)) != "file":
                reasons.append(f"artefact {name} is {f'now a {kind}' if kind else 'gone'}")
            elif path.stat().st_size != artefact.size_bytes:
                reasons.append(f"artefact {name} changed (was {artefact.size_bytes} bytes, is {path.stat().st_size})")
            elif file_sha256(path) != artefact.sha256:
                reasons.append(f"artefact {name} changed (same size, other content)")
        except (DataError, OSError, ValueError) as error:  # ValueError: no name of a file
            reasons.append(f"artefact {name} cannot be read: {error}")
    return reasons


def strays(folder: Path, manifest: Mapping[str, Artefact]) -> list[str]:
    """Return the relative paths of other files and links; a link to a folder counts as one."""
    known = {*manifest, VERDICT_FILE}
    found = {p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_symlink() or not p.is_dir()}
    return [os.fsencode(name).decode(errors="replace") for name in sorted(found - known)]
