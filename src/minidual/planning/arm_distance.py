"""Distance between the two arms, for the supervisor: cheap enough to be asked a hundred times a second."""

from __future__ import annotations

from minidual.planning.mujoco_engine import MujocoEngine
from minidual.planning.scene import PlanningScene
from minidual.robot.constants import ARMS, Array

_WITHIN_M = 0.15


class ArmDistance:
    """Returns the nearest pair of parts of different arms.

    Parts of one arm are left out: neighbours in a wrist are 22 mm apart in every posture, and the joint limits keep
    the others from each other.

    Args:
        scene: Parts and allowed pairs; the bare robot on its table by default.
    """

    def __init__(self, scene: PlanningScene | None = None) -> None:
        self._engine = MujocoEngine(PlanningScene() if scene is None else scene)

    def __call__(self, q: Array) -> tuple[str, float]:
        """Return ("left part with right part", distance [m]) at q (14,); beyond 150 mm the pair is "none"."""
        left, right = ARMS
        for pair in self._engine.closest(q, _WITHIN_M):  # nearest first
            first, second = sorted((pair.first, pair.second))
            if first.startswith(f"{left}_") and second.startswith(f"{right}_"):
                return f"{first} with {second}", pair.distance_m
        return "none", _WITHIN_M
