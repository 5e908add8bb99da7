"""Run folders on disk.

runs/<run>/config.yaml      configuration of the latest stage run
runs/<run>/<stage>/         finished stage: artefacts, config.yaml, verdict.json; may be a link to a folder elsewhere
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
from functools import cached_property
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
from minidual.gate.verdict import ATTEMPT_FILE, CONFIG_FILE, VERDICT_FILE, Verdict, read_verdict

ASIDE = "set-aside"
_RUN_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")


@dataclass(frozen=True)
class StageAttempt:
    """An unfinished stage."""

    stage: str
    state: Literal["running", "interrupted", "error"]
    pid: int
    started_at: str
    message: str = ""
    options: str = ""
    """As typed."""


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:  # a file system without hard links
        shutil.copy2(source, target)


@dataclass(frozen=True)
class ResultPlace:
    """The place of one result.

    Attributes:
        name: `runs/<run>/<stage>`. If it is a link to a folder elsewhere, the result lies and is replaced there.
    """

    name: Path

    @cached_property
    def folder(self) -> Path:
        """Folder of the finished result; need not exist."""
        return Path(os.path.realpath(self.name)) if self.name.is_symlink() else self.name

    @property
    def temporary(self) -> Path:
        """Folder of the unfinished result."""
        return self.folder.with_name(f".{self.folder.name}.tmp")

    @property
    def old(self) -> Path:
        """Folder of the previous result during replacement."""
        return self.folder.with_name(f".{self.folder.name}.old")

    def check(self, *, replacing: bool = True) -> None:
        """Raise DataError if links, files, mount points or permissions are in the way of reading, or `replacing`, it."""
        aside = (self.folder.with_name(ASIDE),) if replacing else ()
        for path in (self.folder, self.temporary, self.old, *aside):
            require(self.name if path == self.folder and self.name.exists() else path, "folder")
            if path.is_symlink():
                raise DataError(
                    f"{path} is a link; minidual keeps a folder there",
                    remedy="remove the link",
                )
            if replacing and path.exists() and not os.access(path, os.W_OK):
                raise DataError(
                    f"no permission to write in {path}",
                    remedy="change its permissions",
                )
        if self.folder != self.name and (why := self._unfit_target()):
            remedy = "make it a link to an empty folder elsewhere"
            raise DataError(f"{self.name} is a link to {self.folder}, {why}", remedy=remedy)
        if replacing and self.folder.is_mount():
            remedy = "mount that disk elsewhere and make a link to a folder on it"
            raise DataError(
                f"{self.folder} is a mount point, which cannot be replaced",
                remedy=remedy,
            )

    def _unfit_target(self) -> str:
        run = self.name.parent.resolve()
        others = (
            path for path in self.name.parent.glob("*") if path.is_symlink() and path != self.name
        )
        if same := [path.name for path in others if _overlap(path.resolve(), self.folder)]:
            return f"where the link {same[0]} leads, too"
        if _overlap(self.folder, run):
            return "in or above its own run"
        if not self.folder.parent.is_dir():
            return f"but {self.folder.parent} is no folder (is its disk mounted?)"
        if (
            self.folder.is_dir()
            and any(self.folder.iterdir())
            and not (self.folder / VERDICT_FILE).exists()
        ):
            return "whose files are no result of minidual"
        return ""


def _overlap(one: Path, other: Path) -> bool:
    return one.is_relative_to(other) or other.is_relative_to(one)


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

    def stage_folder(self, stage: str) -> Path:
        """Return the folder of a finished stage; it need not exist."""
        place = ResultPlace(self.folder / stage)
        for folder in (place.name, place.old):
            if os.path.lexists(folder / VERDICT_FILE):
                return folder
        return place.name

    def verdict_path(self, stage: str) -> Path:
        """Return the path of a verdict; it need not exist."""
        return self.stage_folder(stage) / VERDICT_FILE

    def verdict(self, stage: str) -> tuple[Verdict, str] | None:
        """Return (verdict, sha256 of its file), or None; DataError if corrupt, or if its folder is none."""
        ResultPlace(self.folder / stage).check(replacing=False)
        path = self.verdict_path(stage)
        if not os.path.lexists(path):
            return None
        found = read_verdict(path)
        if found[0].stage != stage:
            raise DataError(
                f"{path} is corrupt: it is the verdict of stage {found[0].stage}, not of {stage}",
            )
        return found

    def attempt(self, stage: str) -> StageAttempt | None:
        """Return the unfinished attempt at `stage`, or None."""
        folder = ResultPlace(self.folder / stage).temporary
        if not folder.is_dir():
            return None
        try:
            attempt = TypeAdapter(StageAttempt).validate_python(
                read_json(folder / ATTEMPT_FILE, 1_000_000),
            )
        except (ValueError, DataError):
            return StageAttempt(stage, "interrupted", 0, "", "killed as it began")
        # Another command may hold the lock since; 0 is a holder that is just writing down its process id.
        holder = held_by(self.folder / LOCK_FILE)
        if attempt.state == "running" and (holder is None or holder[0] not in (0, attempt.pid)):
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
                place = ResultPlace(self.folder / stage)
                place.check()
                old = place.old
                folder = place.folder
                if old.is_dir() and (
                    (folder / VERDICT_FILE).is_file() or not (old / VERDICT_FILE).is_file()
                ):
                    set_aside(old, stage)
                elif old.is_dir():
                    remove(folder)
                    old.rename(folder)
            yield

    def begin(
        self,
        stage: str,
        config_text: str,
        keeps: Sequence[str] = (),
        options: str = "",
    ) -> Path:
        """Clear the temporary folder except `keeps`, mark it as running and return it."""
        folder = ResultPlace(self.folder / stage).temporary
        folder.mkdir(parents=True, exist_ok=True)
        for left in folder.iterdir():
            if left.name not in keeps:
                remove(left)
        self._mark(StageAttempt(stage, "running", os.getpid(), now_text(), "", options))
        write_text(folder / CONFIG_FILE, config_text)
        write_text(self.folder / CONFIG_FILE, config_text)
        return folder

    def _mark(self, attempt: StageAttempt) -> None:
        write_text(
            ResultPlace(self.folder / attempt.stage).temporary / ATTEMPT_FILE,
            dumps(asdict(attempt)),
        )

    def abandon(self, stage: str, state: Literal["interrupted", "error"], message: str) -> None:
        """Mark the attempt as ended without verdict; its files stay until the next one."""
        # On a full disk the old mark stays: "running" without a lock reads as killed, so still unfinished.
        began = self.attempt(stage)
        with suppress(OSError):
            self._mark(
                StageAttempt(
                    stage,
                    state,
                    os.getpid(),
                    now_text(),
                    message,
                    began.options if began else "",
                ),
            )

    def publish(self, stage: str, verdict: Verdict, *, keep_old: bool = False) -> Path | None:
        """Write the verdict and replace the previous folder; return where that is kept, or None."""
        place = ResultPlace(self.folder / stage)
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
        if old.exists() and not keep_old:
            with suppress(OSError):  # no permission inside it
                remove(old)
        return set_aside(old, stage) if old.exists() else None

    def link(self, stage: str, other: RunStore) -> None:
        """Hard-link a finished stage of another run, unless this one has it."""
        folder = self.folder / stage
        with self.writing(f"run {self.run}", [stage]):
            if not folder.exists():
                with replacing(folder) as partial:
                    shutil.copytree(other.stage_folder(stage), partial, copy_function=_link)

    def write_crash(self, name: str, error: BaseException) -> Path:
        """Write the traceback; return its path."""
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / f"crash-{name}-{now_text('%Y%m%d-%H%M%S')}-{os.getpid()}.txt"
        path.write_text("".join(traceback.format_exception(error)), encoding="utf-8")
        return path
