"""The MuJoCo world: model, contacts, cameras."""

import os

# mujoco picks its OpenGL platform when it is first imported, so the choice must stand before that.
os.environ.setdefault("MUJOCO_GL", "egl")
