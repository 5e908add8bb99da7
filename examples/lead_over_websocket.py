"""Lead both arms from another program over a WebSocket: sway the hands, close them, report success.

    python examples/lead_over_websocket.py 8765        # in a second terminal, during
    minidual teleop-record --set teleop.leader=network --set teleop.network.transport=websocket

Needs the library `websockets`. docs/teleoperation.md describes the messages.
"""

import json
import math
import sys
import time

from websockets.sync.client import connect

ADDRESS = f"ws://127.0.0.1:{sys.argv[1] if len(sys.argv) > 1 else 8765}"
RATE_HZ = 50
LASTS_S = float(sys.argv[2]) if len(sys.argv) > 2 else 4.0

sender = f"sway-{time.time_ns()}"
sequence = 0
home = None
target = {}
elapsed_s = 0.0
with connect(ADDRESS) as link:
    while elapsed_s < LASTS_S:
        head = {"version": 1, "sender": sender, "sequence": sequence, "stamp_s": time.monotonic()}
        link.send(json.dumps({**head, **target}))
        sequence += 1
        state = json.loads(link.recv())
        home = home or state["q"]
        elapsed_s = state["stamp_s"]  # simulated time of the episode: it waits for the start button
        angle = 0.1 * (1 - math.cos(math.pi * elapsed_s))
        target = {
            "q": [value + (angle if joint % 7 == 1 else 0.0) for joint, value in enumerate(home)],
            "openings": [1.0, 1.0] if elapsed_s < LASTS_S / 2 else [0.0, 0.0],
            "pressed": ["start"] if elapsed_s < 0.1 else [],
        }
        time.sleep(1 / RATE_HZ)
    head |= {"sequence": sequence, "stamp_s": time.monotonic()}
    link.send(json.dumps({**head, **target, "pressed": ["success"]}))
print(f"sent {sequence} messages; the first joint ended at {state['q'][0]:.3f} rad")
