"""Run folders on disk.

runs/<run>/config.yaml      configuration of the latest stage run
runs/<run>/remembered.json  settings that later commands need not repeat
runs/<run>/<stage>/         finished stage: artefacts, config.yaml, verdict.json; may be a link to a
                            folder elsewhere
runs/<run>/.<stage>.tmp/    unfinished stage
runs/<run>/.<stage>.old/    previous result during replacement; both beside the target of a link
runs/<run>/set-aside/       replaced recordings and tool outputs
runs/<run>/crash-*.txt      tracebacks
"""

from __future__ import annotations

import os
import re
import shutil
import traceback
from collections.abc import Generator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter

from minidual.durable import (
    now_text,
    read_json,
    remove,
    replacing,
    require,
    set_aside,
    sync,
    write_text,
)
from minidual.errors import DataError, UsageError
from minidual.gate.canonical import dumps
from minidual.gate.lock import LOCK_FILE, held_by, run_lock
from minidual.gate.place import ResultPlace
from minidual.gate.verdict import ATTEMPT_FILE, CONFIG_FILE, VERDICT_FILE, Verdict, read_verdict

_RUN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
_ATTEMPT_BYTES_MAX = 1_000_000


@dataclass(frozen=True)
class StageAttempt:
    """An unfinished stage.

    Attributes:
        options: As typed.
    """

    stage: str
    state: Literal["running", "interrupted", "error"]
    pid: int
    started_at: str
    message: str = ""
    options: str = ""


class RunStore:
    """One run folder.

    Args:
        root: Folder of all runs; need not exist.
        run: Name; UsageError if unfit for a folder.
    """

    def __init__(self, root: Path, run: str) -> None:
        if not _RUN_NAME.fullmatch(run):
            raise UsageError(
                f"'{run}' cannot be a run's name: letters, digits, '.', '_' and '-', up to 100",
            )
        self.run = run
        self.folder = root / run
        for path in (root, self.folder):
            require(path, "folder")

    def _place(self, stage: str) -> ResultPlace:
        return ResultPlace(self.folder / stage)

    def stage_folder(self, stage: str) -> Path:
        """Return the folder of a finished stage; it need not exist."""
        place = self._place(stage)
        for folder in (place.name, place.old):
            if os.path.lexists(folder / VERDICT_FILE):
                return folder
        return place.name

    def verdict_path(self, stage: str) -> Path:
        """Return the path of a verdict; it need not exist."""
        return self.stage_folder(stage) / VERDICT_FILE

    def verdict(self, stage: str) -> tuple[Verdict, str] | None:
        """Return (verdict, sha256 of its file), or None.

        Raises:
            DataError: It is corrupt, or its folder is none.
        """
        self._place(stage).check(replacing=False)
        path = self.verdict_path(stage)
        if not os.path.lexists(path):
            return None
        verdict, sha256 = read_verdict(path)
        if verdict.stage != stage:
            raise DataError(
                f"{path} is corrupt: it is the verdict of stage {verdict.stage}, not of {stage}",
            )
        return verdict, sha256

    def attempt(self, stage: str) -> StageAttempt | None:
        """Return the unfinished attempt at `stage`, or None."""
        folder = self._place(stage).temporary
        if not folder.is_dir():
            return None
        try:
            record = read_json(folder / ATTEMPT_FILE, _ATTEMPT_BYTES_MAX)
            attempt = TypeAdapter(StageAttempt).validate_python(record)
        except (ValueError, DataError):
            return StageAttempt(stage, "interrupted", 0, "", "killed as it began")
        if attempt.state != "running":
            return attempt
        # Another command may hold the lock since. A holder with id 0 is just writing its id down.
        holder = held_by(self.folder / LOCK_FILE)
        if holder is None or holder.pid not in (0, attempt.pid):
            return replace(attempt, state="interrupted", message="the process was killed")
        return attempt

    @contextmanager
    def writing(self, command: str, stages: Sequence[str]) -> Generator[None]:
        """Hold the run's lock and repair interrupted replacements of `stages`.

        Raises:
            UsageError: Another process holds the lock.
            DataError: Something else than a folder is in the place of a stage.
        """
        with run_lock(self.folder, command):
            require(self.folder / CONFIG_FILE, "file")
            for stage in stages:
                self._repair(stage)
            yield

    def _repair(self, stage: str) -> None:
        """Undo a replacement that was interrupted before the new result was in place."""
        place = self._place(stage)
        place.check()
        if not place.old.is_dir():
            return
        replaced = (place.folder / VERDICT_FILE).is_file()
        if replaced or not (place.old / VERDICT_FILE).is_file():
            set_aside(place.old, stage)
        else:
            remove(place.folder)
            place.old.rename(place.folder)

    def begin(
        self,
        stage: str,
        config_text: str,
        keeps: Sequence[str] = (),
        options: str = "",
    ) -> Path:
        """Clear the temporary folder except `keeps`, mark it as running and return it."""
        folder = self._place(stage).temporary
        folder.mkdir(parents=True, exist_ok=True)
        for path in folder.iterdir():
            if path.name not in keeps:
                remove(path)
        self._mark(StageAttempt(stage, "running", os.getpid(), now_text(), "", options))
        write_text(folder / CONFIG_FILE, config_text)
        write_text(self.folder / CONFIG_FILE, config_text)
        return folder

    def _mark(self, attempt: StageAttempt) -> None:
        path = self._place(attempt.stage).temporary / ATTEMPT_FILE
        write_text(path, dumps(asdict(attempt)))

    def abandon(self, stage: str, state: Literal["interrupted", "error"], message: str) -> None:
        """Mark the attempt as ended without verdict; its files stay until the next one."""
        begun = self.attempt(stage)
        options = "" if begun is None else begun.options
        ended = StageAttempt(stage, state, os.getpid(), now_text(), message, options)
        # On a full disk the old mark stays: "running" without a lock reads as killed.
        with suppress(OSError):
            self._mark(ended)

    def publish(self, stage: str, verdict: Verdict, *, keep_old: bool = False) -> Path | None:
        """Write the verdict and replace the previous folder; return where that is kept, or None."""
        place = self._place(stage)
        temporary = place.temporary
        folder = place.folder
        old = place.old
        (temporary / ATTEMPT_FILE).unlink(missing_ok=True)
        write_text(temporary / VERDICT_FILE, dumps(verdict.to_json()))
        if folder.exists():
            if old.exists():
                set_aside(old, stage)
            folder.rename(old)
        temporary.rename(folder)
        sync(folder.parent)
        if not old.exists():
            return None
        if not keep_old:
            with suppress(OSError):  # no permission inside it
                remove(old)
        return set_aside(old, stage) if old.exists() else None

    def link(self, stage: str, other: RunStore) -> None:
        """Hard-link a finished stage of another run, unless this one has it."""
        folder = self.folder / stage
        with self.writing(f"run {self.run}", [stage]):
            if folder.exists():
                return
            with replacing(folder) as partial:
                shutil.copytree(other.stage_folder(stage), partial, copy_function=_link_or_copy)

    def write_crash(self, name: str, error: BaseException) -> Path:
        """Write the traceback; return its path."""
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / f"crash-{name}-{now_text('%Y%m%d-%H%M%S')}-{os.getpid()}.txt"
        path.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
        return path


def _link_or_copy(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # a file system without hard links
        shutil.copy2(source, target)
