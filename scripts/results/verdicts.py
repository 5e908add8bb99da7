"""Verdicts of a finished run, and the numbers that tables take from them."""

from pathlib import Path
from typing import Any, NamedTuple

import yaml

from minidual.durable import reading
from minidual.errors import DataError
from minidual.gate.verdict import CONFIG_FILE, VERDICT_FILE, Verdict, read_verdict
from scripts.results.markdown import Origin, origin


class Numbers(NamedTuple):
    """Numbers of one stage.

    Attributes:
        folder: Of the stage.
    """

    verdict: Verdict
    folder: Path

    def observed(self, name: str) -> Any:
        """Return what a check observed.

        Raises:
            DataError: The verdict has no such check.
        """
        for check in self.verdict.checks:
            if check.name == name:
                return check.observed
        raise DataError(f"the verdict of {self.verdict.stage} has no check '{name}'")

    def data(self, *keys: str) -> Any:
        """Return a value of the verdict's data.

        Raises:
            DataError: There is none.
        """
        value: Any = self.verdict.data
        for key in keys:
            if key not in value:
                place = ".".join(keys)
                raise DataError(f"the verdict of {self.verdict.stage} has no data '{place}'")
            value = value[key]
        return value

    def setting(self, section: str, name: str) -> Any:
        """Return a value of the configuration that the stage ran with.

        Raises:
            DataError: There is none.
        """
        path = self.folder / CONFIG_FILE
        with reading(path, "run the stage again"):
            return yaml.safe_load(path.read_text(encoding="utf-8"))[section][name]

    @property
    def made(self) -> Origin:
        """Commit, machine and date."""
        fingerprint = self.verdict.fingerprint
        return origin(fingerprint.commit, fingerprint.machine, self.verdict.finished_at)


def numbers_of(run: Path, stage: str) -> Numbers | None:
    """Return the numbers of a stage; None without a passing verdict."""
    path = run / stage / VERDICT_FILE
    if not path.exists():
        return None
    verdict, _ = read_verdict(path)
    return Numbers(verdict, path.parent) if verdict.status == "pass" else None
