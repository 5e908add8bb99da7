"""Two-arm manipulation in MuJoCo: plan, carry, teleoperate, record, train, deploy, compare."""

import os

# mujoco picks its OpenGL platform at its first import.
os.environ["MUJOCO_GL"] = "egl"  # whatever is set: with another one the import may fail

__version__ = "0.1.0"
