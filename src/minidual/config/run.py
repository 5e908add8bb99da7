"""Location and name of a run."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

RUNS_VARIABLE = "MINIDUAL_RUNS"


@dataclass(frozen=True)
class RunLocation:
    """The folder of all runs and the name of one."""

    root: Path
    name: str

    @property
    def folder(self) -> Path:
        """Folder of the run."""
        return self.root / self.name


def locate_run(
    profile: str, run: str | None = None, runs_folder: Path | None = None, environment: Mapping[str, str] | None = None
) -> RunLocation:
    """Locate a run in `runs_folder`, $MINIDUAL_RUNS or ./runs; its name is `run` or `profile`."""
    variable = (os.environ if environment is None else environment).get(RUNS_VARIABLE)
    root = runs_folder or (Path(variable).expanduser() if variable else Path("runs"))
    return RunLocation(root, profile if run is None else run)
