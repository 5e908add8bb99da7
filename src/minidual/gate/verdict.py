"""Verdict of a stage, derived from its checks, with fingerprint and digest."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

from minidual.errors import DataError
from minidual.gate.canonical import canonical, digest, dumps, parse_json
from minidual.gate.check import Check
from minidual.gate.fingerprint import Fingerprint
from minidual.gate.manifest import Artefact, manifest_from_json, manifest_to_json

Status = Literal["pass", "fail", "error"]
SCHEMA = 2


@dataclass(frozen=True)
class Waiver:
    """A gate opened by hand; `blocking` is {stage: state}."""

    stage: str
    reason: str
    blocking: dict[str, str]
    at: str


def derive_status(checks: Sequence[Check]) -> Status:
    """Return "pass", "fail", or "error" if no check has a limit."""
    limited = [check for check in checks if check.limited]
    if not limited:
        return "error"
    return "pass" if all(check.passed for check in limited) else "fail"


@dataclass(frozen=True)
class Verdict:
    """Result of a finished stage.

    Attributes:
        weakened: Counts and limits, here and upstream, that ask for less than the shipped profile.
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
        names = [check.name for check in self.checks]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"stage {self.stage} returned check '{twice[0]}' twice")

    @property
    def status(self) -> Status:
        """Pass, fail or error."""
        return derive_status(self.checks)

    @property
    def acceptance(self) -> bool:
        """Whether the profile counts as acceptance, with nothing weakened or waived here or upstream."""
        return self.acceptance_profile and not self.waivers and not self.weakened

    @property
    def profile(self) -> str:
        """Name of the profile."""
        return self.fingerprint.profile

    def failed_checks(self) -> list[Check]:
        """Return the checks that failed."""
        return [check for check in self.checks if check.passed is False]

    def check(self, name: str) -> Check:
        """Return the named check; DataError lists the existing ones."""
        for check in self.checks:
            if check.name == name:
                return check
        raise DataError(
            f"no check '{name}' in the verdict of {self.stage}; there are "
            + ", ".join(check.name for check in self.checks)
        )

    def to_json(self) -> dict[str, Any]:
        """Return JSON types, with derived status and digest."""
        body = canonical(
            {
                "schema": SCHEMA,
                "stage": self.stage,
                "run": self.run,
                "profile": self.profile,
                "status": self.status,
                "acceptance": self.acceptance,
                "acceptance_profile": self.acceptance_profile,
                "started_at": self.started_at,
                "finished_at": self.finished_at,
                "duration_s": self.duration_s,
                "seed": self.fingerprint.seed,
                "checks": [check.to_json() for check in self.checks],
                "waivers": [asdict(waiver) for waiver in self.waivers],
                "weakened": list(self.weakened),
                "options": self.options,
                "overrides": list(self.overrides),
                "notes": list(self.notes),
                "data": self.data,
                "artefacts": manifest_to_json(self.artefacts),
                "fingerprint": self.fingerprint.to_json(),
            }
        )
        body["digest"] = digest(body)
        return body

    def text(self) -> str:
        """Return the text of the verdict file."""
        return dumps(self.to_json())

    @classmethod
    def from_json(cls, record: Mapping[str, Any]) -> Verdict:
        """Rebuild a verdict; DataError if malformed, edited or inconsistent."""
        try:
            if record["schema"] != SCHEMA:
                raise DataError(f"schema {record['schema']} is not {SCHEMA}")
            if record["digest"] != digest({key: record[key] for key in record if key != "digest"}):
                raise DataError("its content does not match its digest: it was edited after it was written")
            verdict = cls(
                stage=record["stage"],
                run=record["run"],
                fingerprint=Fingerprint.from_json(record["fingerprint"]),
                checks=tuple(Check.from_json(check) for check in record["checks"]),
                artefacts=manifest_from_json(record["artefacts"]),
                acceptance_profile=record["acceptance_profile"],
                started_at=record["started_at"],
                finished_at=record["finished_at"],
                duration_s=record["duration_s"],
                options=record["options"],
                overrides=tuple(record["overrides"]),
                waivers=tuple(Waiver(**waiver) for waiver in record["waivers"]),
                weakened=tuple(record["weakened"]),
                data=record["data"],
                notes=tuple(record["notes"]),
            )
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise DataError(f"malformed verdict ({type(error).__name__}: {error})") from error
        for key in ("status", "acceptance", "profile"):
            if record.get(key) != getattr(verdict, key):
                raise DataError(f"it says {key} {record.get(key)!r}, its content says {getattr(verdict, key)!r}")
        return verdict


def read_verdict(path: Path) -> tuple[Verdict, str]:
    """Return the verdict in `path` and the file's sha256; DataError if corrupt."""
    content = path.read_bytes()
    record = parse_json(content, path)
    if not isinstance(record, dict):
        raise DataError(f"{path} is corrupt: not a JSON object")
    try:
        return Verdict.from_json(cast(dict[str, Any], record)), hashlib.sha256(content).hexdigest()
    except DataError as error:
        raise DataError(f"{path} is corrupt: {error.message}") from error
