"""The cache of allowed collisions with rows added, broken bytes and strange files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from minidual.errors import ExitCode
from scripts.campaign.case import Case, Place, Result, command, judge
from scripts.campaign.tampering import BYTE_CHANGES, Change

_EDITS = (
    "rows added",
    "rows removed",
    "rows edited",
    "empty",
    "not JSON",
    "other robot",
    "digest of old",
)
_BUILT: dict[str, bytes] = {}
"""Content of the cache, by file name."""
_PAIRS: set[tuple[str, str]] = set()
"""Pairs that are allowed to touch."""


def cache_cases(source: Path) -> Iterator[Case]:
    """Each edit of the cache, and each break of its bytes."""
    for edit in _EDITS:
        yield Case(edit, partial(_edited, edit), limit_s=40.0)
    for change in BYTE_CHANGES:
        for number in range(3):
            yield Case(f"{change.__name__} {number}", partial(_changed, change), limit_s=40.0)


def warm(place: Place) -> None:
    """Build the cache once."""
    folder = _use_cache(place)
    _PAIRS.update(_allowed_pairs(place))
    for path in folder.glob("acm-*.json"):
        _BUILT[path.name] = path.read_bytes()


def _use_cache(place: Place) -> Path:
    """Make this process use a cache in the case's folder; return it."""
    folder = place.folder / "cache"
    os.environ["MINIDUAL_CACHE"] = str(folder)
    return folder


def _write_built(place: Place) -> Path:
    """Write the built cache; return its file."""
    folder = _use_cache(place)
    folder.mkdir()
    ((name, content),) = _BUILT.items()
    path = folder / name
    path.write_bytes(content)
    return path


def _allowed_pairs(place: Place, result: Result | None = None) -> set[tuple[str, str]]:
    """Return the pairs that the command allows; none if it fails."""
    from minidual.collision.acm import acm_report

    acm_report.cache_clear()
    ran = command(place, "plan", "--acm", "--json", "--runs-dir", str(place.no_runs))
    if result is not None:
        judge(result, "plan --acm", ran, [ExitCode.PASS])
    if ran.code != 0:
        return set()
    return {(row["first"], row["second"]) for row in ran.document()["allowed"]}


def _edited(edit: str, place: Place, result: Result) -> None:
    path = _write_built(place)
    digest, _, content = path.read_text(encoding="utf-8").partition("\n")
    path.write_text(_edited_text(edit, digest, content), encoding="utf-8")
    _compare(edit == "digest of old", place, result)


def _edited_text(edit: str, digest: str, content: str) -> str:
    record = json.loads(content)
    pairs = record["pairs"]
    links = sorted({link for row in pairs for link in row[:2]})
    match edit:
        case "empty":
            return ""
        case "not JSON":
            return f"{digest}\nhello"
        case "other robot":
            return f"{'0' * 64}\n{json.dumps(record)}"
        case "rows added":
            pairs += [[a, b, "never"] for a in links[:6] for b in links[-6:]]
        case "rows removed":
            del pairs[-5:]
        case "rows edited":
            pairs[0] = [links[0], links[-1], "adjacent"]
    return f"{digest}\n{json.dumps(record)}"


def _changed(change: Change, place: Place, result: Result) -> None:
    change(_write_built(place), place.rng)
    _compare(False, place, result)


def _compare(is_original: bool, place: Place, result: Result) -> None:
    if _allowed_pairs(place, result) != _PAIRS:
        result.forbidden.append("a silent pass: other pairs are allowed")
    result.saw("read" if is_original else "built again")
