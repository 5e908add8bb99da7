"""Distance between the two arms, for the supervisor: cheap enough to be asked a hundred times a second."""

from __future__ import annotations

from minidual.collision.engine import Pairs
from minidual.collision.mujoco_engine import MujocoEngine
from minidual.collision.scene import PlanningScene
from minidual.robot.pair import SIDES, Array

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
        left, right = (f"{side}_" for side in SIDES)
        ordered = [(a, b) if a < b else (b, a) for a, b in scene.checked_pairs]
        across = tuple((a, b) for a, b in ordered if a.startswith(left) and b.startswith(right))
        self._engine = MujocoEngine(Pairs(scene.robot, across, scene.solid_obstacles, scene.attached))
        self._engine.set_margin(_WITHIN_M)

    def __call__(self, q: Array) -> tuple[str, float]:
        """Return ("left part with right part", distance [m]) at q (dof,); beyond 150 mm the pair is "none"."""
        if self._engine.contact_count(q) == 0:
            return "none", _WITHIN_M
        pair = self._engine.contacts()[0]  # nearest first
        return f"{pair.first} with {pair.second}", pair.distance_m
