"""Two-arm manipulation in MuJoCo: plan, carry, teleoperate, record, train, deploy, compare."""

import os

# mujoco picks its OpenGL platform at its first import.
os.environ.setdefault("MUJOCO_GL", "egl")

__version__ = "0.1.0"
