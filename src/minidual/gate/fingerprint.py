"""The fingerprint of a verdict, and its differences from the present."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, cast

from minidual.errors import shortened
from minidual.gate.canonical import canonical
from minidual.gate.code import Code

UNSEEN = "(absent)"
_FULL_HASH = re.compile(r"^([0-9a-f]{10})[0-9a-f]+")
_TEXT_LENGTH_MAX = 60


@dataclass(frozen=True)
class Fingerprint:
    """Everything that a verdict depends on.

    A difference in the last five fields, the circumstances, only warns.

    Attributes:
        inputs: sha256 by "stage/path" of the upstream artefacts that the stage reads.
        upstream: Digest of what every upstream stage found, or sha256 of its verdict; None if it
            has none. See `minidual.gate.footing`.
    """

    parameters: dict[str, Any]
    options: dict[str, Any]
    inputs: dict[str, str]
    upstream: dict[str, str | None]
    seed: int
    profile: str
    version: str
    commit: str | None
    machine: dict[str, Any]
    libraries: dict[str, str]
    code: Code = field(default_factory=Code)

    def choices(self, now: Fingerprint) -> list[str]:
        """Return differences of parameters, options, seed and profile."""
        before = {"parameter": self.parameters, "option": self.options}
        after = {"parameter": canonical(now.parameters), "option": canonical(now.options)}
        reasons = [
            f"{_spaced(name)} was {_short(then)}, is {_short(current)}"
            for name, then, current in changes(before, after)
        ]
        if self.seed != now.seed:
            reasons.append(f"the seed was {self.seed!r}, is {now.seed!r}")
        if self.profile != now.profile:
            reasons.append(f"the profile was {self.profile!r}, is {now.profile!r}")
        return reasons

    def differences(self, now: Fingerprint) -> list[str]:
        """Return why a verdict with this fingerprint is stale."""
        reasons = self.choices(now)
        for name, then, _ in changes(self.inputs, now.inputs):
            change = "is new" if then == UNSEEN else "changed or is gone"
            reasons.append(f"input {name} {change}")
        for name, then, current in changes(self.upstream, now.upstream):
            if current is None:
                reasons.append(f"the verdict of upstream stage {name} is gone")
            elif then is None:
                reasons.append(f"upstream stage {name} has run since")
            else:
                reasons.append(f"upstream stage {name} ran again since")
        return reasons

    def circumstances(self, now: Fingerprint) -> list[str]:
        """Return a warning per changed circumstance."""
        warnings: list[str] = []
        if self.version != now.version:
            warnings.append(f"made by minidual {self.version}, this is {now.version}")
        if self.commit != now.commit:
            then = _short_commit(self.commit)
            current = _short_commit(now.commit)
            warnings.append(f"made at commit {then}, this is {current}")
        before = {"machine": self.machine, "library": self.libraries}
        after = {"machine": now.machine, "library": now.libraries}
        for name, then, current in changes(before, after):
            warnings.append(f"{_spaced(name)}: was {_short(then)}, is {_short(current)}")
        modules = self.code.changes(now.code)
        if modules:
            warnings.append(f"made by other code: {shortened(modules, 3)} changed since")
        return warnings


def changes(
    before: Mapping[str, Any],
    after: Mapping[str, Any],
    prefix: str = "",
) -> Iterable[tuple[str, Any, Any]]:
    """Yield (dotted name, before, after) for each differing leaf; `UNSEEN` for an absent one."""
    for key in dict.fromkeys([*before, *after]):
        then = before.get(key, UNSEEN)
        current = after.get(key, UNSEEN)
        if isinstance(then, dict) and isinstance(current, dict):
            inner_before = cast(dict[str, Any], then)
            inner_after = cast(dict[str, Any], current)
            yield from changes(inner_before, inner_after, f"{prefix}{key}.")
        elif then != current or isinstance(then, bool) is not isinstance(current, bool):
            yield f"{prefix}{key}", then, current


def _spaced(name: str) -> str:
    """Return "parameter plan.queries_n" for "parameter.plan.queries_n"."""
    return name.replace(".", " ", 1)


def _short(value: Any) -> str:
    text = str(value)
    if len(text) <= _TEXT_LENGTH_MAX:
        return text
    return f"{text[: _TEXT_LENGTH_MAX - 3]}..."


def _short_commit(commit: str | None) -> str:
    return _FULL_HASH.sub(r"\1", commit or "none")
