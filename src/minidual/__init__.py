"""minidual: two Franka Pandas, from an empty folder to a measured comparison of methods."""

import os

# mujoco picks its OpenGL platform at its first import.
os.environ.setdefault("MUJOCO_GL", "egl")

__version__ = "0.1.0"
