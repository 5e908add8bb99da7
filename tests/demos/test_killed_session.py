"""Kill -9 in the middle of a session by hand loses at most the running episode."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from minidual.demos import recording
from minidual.demos.episode import read_episode
from tests.support.hand_session import INPUTS, job_of, swaying

ROOT = Path(__file__).resolve().parents[2]


def killed_in_episode(folder: Path, index: int) -> None:
    """Lead episodes in a process that is killed in the middle of one."""
    command = [sys.executable, "-m", "tests.support.hand_session", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert process.stdout is not None
    ticks_n = 0
    for line in process.stdout:
        ticks_n += int(line) == index
        if ticks_n == 20:
            break
    process.kill()
    process.wait()
    process.stdout.close()
    assert ticks_n == 20


def test_a_killed_session_by_hand_loses_the_running_episode_and_the_next_one_goes_on(
    tmp_path: Path,
) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    killed_in_episode(folder, 2)
    names = sorted(path.name for path in (folder / "rejected").glob("[!.]*.hdf5"))
    assert names == ["episode_000000.hdf5", "episode_000001.hdf5"]
    assert len(list((folder / "rejected").glob(".*.partial"))) == 1
    before = {name: (folder / "rejected" / name).stat().st_mtime_ns for name in names}

    note = recording.claim(folder, INPUTS, "old")
    assert note.startswith("an interrupted recording is continued")
    assert "half-written" in note
    with swaying():
        attempts = list(recording.attempts_of(job_of(folder, 4), workers=1))
    assert [attempt.trial.index for attempt in attempts] == [0, 1, 2, 3]
    assert [attempt.adopted for attempt in attempts] == [True, True, False, False]
    assert before == {name: (folder / "rejected" / name).stat().st_mtime_ns for name in names}
    for attempt in attempts:
        assert attempt.path is not None
        assert len(read_episode(attempt.path)) > 50
    assert not list((folder / "rejected").glob(".*.partial"))
