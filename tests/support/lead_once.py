"""Run as a script: record one trial with a leader, as `teleop-record` does, without its gate.

    python tests/support/lead_once.py LEADER FOLDER [teleop.PATH=VALUE ...]

It prints what a person is told, and at the end the reason of the attempt.
"""

import sys
from pathlib import Path

from minidual.config.root import Config, changed
from minidual.demos.rig import Job, Rig
from minidual.demos.terminal_station import LineStation
from minidual.tasks.catalogue import make_task

if __name__ == "__main__":
    leader, folder, *words = sys.argv[1:]
    changes: dict[str, object] = {"teleop.leader": leader}
    for word in words:
        path, _, value = word.partition("=")
        changes[path] = int(value)
    config = changed(Config(), changes)
    teleop = config.teleop.model_copy(update={"cameras": ()})
    rig = Rig(Job(Path(folder), make_task(config), teleop, config.arbiter, 1), cameras=())
    rig.station = LineStation(lambda line: print(line, flush=True))
    attempt = rig.record(0)
    rig.close()
    print(f"attempt: {attempt.reason}; file {attempt.path}", flush=True)
