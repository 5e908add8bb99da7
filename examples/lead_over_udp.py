"""Lead both arms from another program: sway the hands, close them, report success.

    python examples/lead_over_udp.py 8765        # in a second terminal, during
    minidual teleop-record --set teleop.leader=network

Standard library only. docs/teleoperation.md describes the messages.
"""

import json
import math
import socket
import sys
import time

ADDRESS = ("127.0.0.1", int(sys.argv[1]) if len(sys.argv) > 1 else 8765)
RATE_HZ = 50
LASTS_S = float(sys.argv[2]) if len(sys.argv) > 2 else 4.0

link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
link.settimeout(0.5)
sender = f"sway-{time.time_ns()}"
home = None
sequence = 0
elapsed_s = 0.0
while elapsed_s < LASTS_S:
    message = {"version": 1, "sender": sender, "sequence": sequence, "stamp_s": time.monotonic()}
    if home is not None:
        angle = 0.1 * (1 - math.cos(math.pi * elapsed_s))
        message["q"] = [q + (angle if joint % 7 == 1 else 0.0) for joint, q in enumerate(home)]
        message["openings"] = [1.0, 1.0] if elapsed_s < LASTS_S / 2 else [0.0, 0.0]
        message["pressed"] = ["start"] if elapsed_s < 0.1 else []
    link.sendto(json.dumps(message).encode(), ADDRESS)
    sequence += 1
    try:
        state = json.loads(link.recv(65535))
    except (TimeoutError, ConnectionRefusedError):
        time.sleep(0.2)
        continue
    home = home or state["q"]
    elapsed_s = state["stamp_s"]  # simulated time of the episode: it waits for the start button
    time.sleep(1 / RATE_HZ)
message |= {"sequence": sequence, "pressed": ["success"]}
link.sendto(json.dumps(message).encode(), ADDRESS)
print(f"sent {sequence + 1} messages; the first joint ended at {state['q'][0]:.3f} rad")
