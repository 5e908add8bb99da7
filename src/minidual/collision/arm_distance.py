"""Distance between the arms, cheap enough for 100 Hz."""

from __future__ import annotations

from minidual.collision.engine import Pairs
from minidual.collision.mujoco_engine import MujocoEngine
from minidual.collision.scene import PlanningScene
from minidual.robot.pair import SIDES, Array

_WITHIN_M = 0.15


class ArmDistance:
    """Nearest pair of parts of different arms.

    Not within one arm: wrist neighbours are always 22 mm apart.
    """

    def __init__(self, scene: PlanningScene | None = None) -> None:
        scene = PlanningScene() if scene is None else scene
        left, right = (f"{side}_" for side in SIDES)
        ordered = [(a, b) if a < b else (b, a) for a, b in scene.checked_pairs]
        across = tuple((a, b) for a, b in ordered if a.startswith(left) and b.startswith(right))
        self._engine = MujocoEngine(Pairs(scene.robot, across, scene.solid_obstacles, scene.attached))

    def __call__(self, q: Array) -> tuple[str, float]:
        """Return ("left part with right part", [m]); ("none", 0.15) beyond 150 mm."""
        pairs = self._engine.closest(q, _WITHIN_M)
        return (f"{pairs[0].first} with {pairs[0].second}", pairs[0].distance_m) if pairs else ("none", _WITHIN_M)
