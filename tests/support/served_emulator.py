"""The emulator in a process of its own, with a patience of its own.

python -m tests.support.served_emulator HOST,HOST PATIENCE_S
"""

from __future__ import annotations

import signal
import sys
import threading

from minidual.config.root import Config
from minidual.plant.franka.cell import EmulatedCell
from minidual.plant.franka.server import EmulatorServer, Pace
from minidual.robot.pair import DUAL_PANDA
from minidual.tasks.catalogue import make_task

if __name__ == "__main__":
    hosts, patience_s = sys.argv[1:3]
    cell = EmulatedCell(make_task(Config()).scene, DUAL_PANDA)
    server = EmulatorServer(cell, hosts.split(","), Pace.CLIENT, float(patience_s))
    ended = threading.Event()
    signal.signal(signal.SIGTERM, lambda number, frame: ended.set())
    print("ready", flush=True)
    server.run(ended)
