"""Distance between the two arms, for the supervisor: cheap enough to be asked a hundred times a second."""

from __future__ import annotations

from minidual.collision.mujoco_engine import MujocoEngine
from minidual.collision.scene import PlanningScene
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
        scene = PlanningScene() if scene is None else scene
        left, right = (f"{arm}_" for arm in ARMS)
        across = [
            (a, b)
            for a, b in (sorted(pair) for pair in scene.checked_pairs)
            if a.startswith(left) and b.startswith(right)
        ]
        self._engine = MujocoEngine.from_pairs(across, scene.solid_obstacles, scene.attached)
        self._engine.set_margin(_WITHIN_M)

    def __call__(self, q: Array) -> tuple[str, float]:
        """Return ("left part with right part", distance [m]) at q (14,); beyond 150 mm the pair is "none"."""
        if self._engine.contact_count(q) == 0:
            return "none", _WITHIN_M
        pair = self._engine.contacts()[0]  # nearest first
        return f"{pair.first} with {pair.second}", pair.distance_m
