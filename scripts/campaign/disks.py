"""Real stages on a small disk that fills up: exit 4 with one message, and the finished result stays."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from minidual.errors import ExitCode
from scripts.campaign.case import Case, Place, Result, judge
from scripts.campaign.kills import STAGES_S
from scripts.campaign.processes import ended, orphans, said

_ROOM_KIB = (0, 64, 1024, 4096)
"""Free space when the stage begins."""
_NO_MOUNT = 99
_SCRIPT = f"""
mkdir disk && mount -t tmpfs -o size=256m none disk || exit {_NO_MOUNT}
cp -r {{runs}}/. disk
head -c $(($(df --output=avail -k disk | tail -n 1) - {{room}}))k /dev/zero > disk/filler
{{stage}}; code=$?
rm disk/filler
{{status}} > status.json
exit $code
"""


def disk_cases(source: Path) -> Iterator[Case]:
    """Each stage with no room, little, more, and perhaps enough."""
    for name in STAGES_S:
        for room in _ROOM_KIB:
            yield Case(f"{name} with {room} KiB", partial(_full, name, room), limit_s=90.0)


def _full(name: str, room: int, place: Place, result: Result) -> None:
    """Run a stage on a disk with `room` KiB of free space."""
    _, options = STAGES_S[name]
    script = _SCRIPT.format(
        runs=shlex.quote(str(place.runs)),
        room=room,
        stage=_typed(name, "--force", "--yes", *options),
        status=_typed("status", "--json"),
    )
    with (place.folder / ".stdout").open("wb") as out, (place.folder / ".stderr").open("wb") as err:
        process = subprocess.Popen(
            ["unshare", "--map-root-user", "--mount", "bash", "-c", script],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,
            cwd=place.folder,
        )
    code = ended(process)
    left = orphans(process.pid, 2.0)
    if code is None:
        result.forbidden.append("a hang")
        return
    status_file = place.folder / "status.json"
    if code in (1, _NO_MOUNT) and not status_file.exists():
        result.saw("not tried: this machine lets no user mount")
        return
    if left:
        result.forbidden.append(f"orphans: {left}")
    allowed: list[int] = [ExitCode.ENVIRONMENT]
    if room > 0:
        allowed += [ExitCode.PASS, ExitCode.ACCEPTANCE_FAILED]  # perhaps it was enough
    judge(result, name, said(place, code), allowed)
    result.saw(f"exit {code}")
    stages = json.loads(status_file.read_bytes())["stages"]
    row = next(row for row in stages if row["name"] == name)
    if code == ExitCode.ENVIRONMENT and row["state"] != "pass":
        result.forbidden.append(
            f"a lost finished result: {name} is {row['state']} {row['reasons']}",
        )


def _typed(*words: str) -> str:
    """Return a command on the run of the small disk, as one types it."""
    selecting = ("--profile", "smoke", "--run", "smoke", "--runs-dir", "disk")
    return shlex.join([sys.executable, "-m", "minidual.cli", *words, *selecting])
