"""Verdict of a stage, derived from its checks, and hashes of its artefacts."""

import hashlib
import json
import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal, cast

from pydantic import TypeAdapter
from pydantic_core import from_json

from minidual.durable import kind_of, regular_file
from minidual.errors import DataError
from minidual.gate.canonical import canonical, digest, file_sha256
from minidual.gate.check import Check
from minidual.gate.fingerprint import Fingerprint, changes

Status = Literal["pass", "fail", "error"]
SCHEMA = 2
_BYTES_MAX = 100_000_000
VERDICT_FILE = "verdict.json"
ATTEMPT_FILE = "attempt.json"
CONFIG_FILE = "config.yaml"


@dataclass(frozen=True)
class Artefact:
    """Hash and size of a file."""

    sha256: str
    size_bytes: int


@dataclass(frozen=True)
class Waiver:
    """A gate opened by hand; `blocking` is {required stage: state}."""

    stage: str
    reason: str
    blocking: dict[str, str]
    at: str


def derive_status(checks: Sequence[Check]) -> Status:
    """Return "pass", "fail", or "error" if no check has a limit."""
    results = [check.passed for check in checks if check.passed is not None]
    if not results:
        return "error"
    return "pass" if all(results) else "fail"


@dataclass(frozen=True)
class Verdict:
    """Result of a finished stage.

    Attributes:
        acceptance_profile: Whether its profile counts as acceptance.
        weakened: Values weaker than the shipped profile's, here and upstream.
    """

    stage: str
    run: str
    fingerprint: Fingerprint
    checks: tuple[Check, ...]
    artefacts: dict[str, Artefact]
    acceptance_profile: bool
    started_at: str
    finished_at: str
    duration_s: float
    options: dict[str, Any] = field(default_factory=dict)
    overrides: tuple[str, ...] = ()
    waivers: tuple[Waiver, ...] = ()
    weakened: tuple[str, ...] = ()
    data: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        counts = Counter(check.name for check in self.checks)
        repeated = sorted(name for name, count in counts.items() if count > 1)
        if repeated:
            raise ValueError(f"stage {self.stage} returned check '{repeated[0]}' twice")

    @property
    def status(self) -> Status:
        """Pass, fail or error."""
        return derive_status(self.checks)

    @property
    def acceptance(self) -> bool:
        """Whether it counts as acceptance.

        It does by its profile, if nothing is weakened or waived here or upstream.
        """
        return self.acceptance_profile and not self.waivers and not self.weakened

    def failed_checks(self) -> list[Check]:
        """Return the checks that failed."""
        return [check for check in self.checks if check.passed is False]

    def content(self) -> str:
        """Return a digest of the demands and the results.

        Times, texts, machine and code do not enter: the same work again has the same content.
        """
        fingerprint = self.fingerprint
        return digest(
            {
                "stage": self.stage,
                "seed": fingerprint.seed,
                "profile": fingerprint.profile,
                "parameters": fingerprint.parameters,
                "options": fingerprint.options,
                "checks": [check.content() for check in self.checks],
                "acceptance_profile": self.acceptance_profile,
                "waivers": [asdict(waiver) for waiver in self.waivers],
                "weakened": self.weakened,
            },
        )

    def to_json(self) -> dict[str, Any]:
        """Return JSON types, with derived values and a digest."""
        derived = {
            "schema": SCHEMA,
            "profile": self.fingerprint.profile,
            "seed": self.fingerprint.seed,
            "status": self.status,
            "acceptance": self.acceptance,
            "checks": [check.to_json() for check in self.checks],
        }
        body = canonical({**asdict(self), **derived})
        return {**body, "digest": digest(body)}


_adapter = cache(TypeAdapter[Verdict])  # made when it is needed: it takes milliseconds


def verdict_from_json(record: dict[str, Any]) -> Verdict:
    """Return the verdict; DataError if malformed, edited or inconsistent."""
    if record.get("schema") != SCHEMA:
        raise DataError(f"schema {record.get('schema')} is not {SCHEMA}")
    body = {key: value for key, value in record.items() if key != "digest"}
    if record.get("digest") != digest(body):
        raise DataError("its content does not match its digest: it was edited after it was written")
    try:
        verdict = _adapter(Verdict).validate_python(record)
    except (ValueError, TypeError) as error:
        raise DataError(f"malformed verdict ({type(error).__name__}: {error})") from error
    for key, written, derived in changes(_by_name(record), _by_name(verdict.to_json())):
        raise DataError(f"it says {key} {written!r}, its content says {derived!r}")
    return verdict


def _by_name(record: dict[str, Any]) -> dict[str, Any]:
    """Return a record with checks by name and without digest, for comparison."""
    checks = {check["name"]: check for check in record["checks"]}
    return {**record, "checks": checks, "digest": ""}


def _refuse_repeated_keys(pairs: list[tuple[str, Any]]) -> None:
    """Refuse keys that stand twice: readers disagree about which of the values holds."""
    for key, count in Counter(key for key, _ in pairs).items():
        if count > 1:
            raise DataError(f"the key {key!r} stands {count} times in one object")


def read_verdict(path: Path) -> tuple[Verdict, str]:
    """Return (verdict, sha256 of its file); DataError if absent or corrupt."""
    try:
        content = regular_file(path, _BYTES_MAX).read_bytes()
        # Unlike json, it refuses deep nesting and characters that cannot be printed.
        record: Any = from_json(content)
        if not isinstance(record, dict):
            raise DataError("not a JSON object")
        json.loads(content, object_pairs_hook=_refuse_repeated_keys)
        verdict = verdict_from_json(cast(dict[str, Any], record))
    except (DataError, OSError, ValueError) as error:
        raise DataError(f"{path} is corrupt: {getattr(error, 'message', error)}") from error
    return verdict, hashlib.sha256(content).hexdigest()


def build_manifest(folder: Path) -> dict[str, Artefact]:
    """Return {relative posix path: Artefact} of all files."""
    manifest: dict[str, Artefact] = {}
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and name not in (VERDICT_FILE, ATTEMPT_FILE):
            manifest[name] = Artefact(file_sha256(path), path.stat().st_size)
    return manifest


def manifest_changes(folder: Path, manifest: Mapping[str, Artefact]) -> list[str]:
    """Return a reason per missing or changed artefact."""
    reasons: list[str] = []
    for name, artefact in manifest.items():
        try:
            change = _artefact_change(folder / name, artefact)
        except (DataError, OSError, ValueError) as error:  # ValueError: no name of a file
            change = f"cannot be read: {error}"
        if change:
            reasons.append(f"artefact {name} {change}")
    return reasons


def _artefact_change(path: Path, artefact: Artefact) -> str:
    kind = kind_of(path)
    if not kind:
        return "is gone"
    if kind != "file":
        return f"is now a {kind}"
    size = path.stat().st_size
    if size != artefact.size_bytes:
        return f"changed (was {artefact.size_bytes} bytes, is {size})"
    if file_sha256(path) != artefact.sha256:
        return "changed (same size, other content)"
    return ""


def strays(folder: Path, manifest: Mapping[str, Artefact]) -> list[str]:
    """Return the relative paths of other files and links; a link to a folder counts as one."""
    names: set[str] = set()
    for path in folder.rglob("*"):
        if path.is_symlink() or not path.is_dir():
            names.add(path.relative_to(folder).as_posix())
    names -= {*manifest, VERDICT_FILE}
    return [os.fsencode(name).decode(errors="replace") for name in sorted(names)]
