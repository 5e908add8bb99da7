"""State of a stage."""

from pathlib import Path
from typing import Literal, NamedTuple

from minidual.errors import shortened
from minidual.gate.verdict import Verdict

State = Literal["pass", "fail", "error", "stale", "missing", "incomplete", "blocked"]


class StageState(NamedTuple):
    """State of a stage.

    Attributes:
        reasons: Why it is not pass or fail.
        warnings: Changes that do not make it stale.
    """

    name: str
    state: State
    reasons: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    verdict: Verdict | None = None
    verdict_sha256: str | None = None
    folder: Path | None = None

    def because(self) -> list[str]:
        """Return failed checks with why and remedy, or the reasons."""
        if self.state != "fail" or self.verdict is None:
            return [f"{self.name} is {self.state}", *(f"  {reason}" for reason in self.reasons)]
        lines: list[str] = []
        for check in self.verdict.failed_checks():
            lines.append(f"{self.name}: {check.sentence()}")
            for label, text in (("why", check.why), ("remedy", check.remedy)):
                if text:
                    lines.append(f"  {label}: {text}")
        return lines

    def why(self) -> str:
        """Return the first failed check, or the first two reasons."""
        if self.state == "fail" and self.verdict is not None:
            return shortened([check.sentence() for check in self.verdict.failed_checks()], 1)
        return shortened(self.reasons, 2, "; ")
