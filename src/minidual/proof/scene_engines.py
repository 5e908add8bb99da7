"""Geometry and engines of one scene."""

from __future__ import annotations

import numpy as np

from minidual.collision.engine import PairDistance
from minidual.collision.scene import PlanningScene
from minidual.proof.solids import Solids
from minidual.proof.verify import STEP_RAD, Verifier
from minidual.robot.pair import Array


class SceneEngines:
    """Planning geometry of one scene, built in a few ms."""

    def __init__(self, scene: PlanningScene, verify_step_rad: float = STEP_RAD) -> None:
        self.scene = scene
        self.solids = Solids(scene)
        self.verifier = Verifier(scene, self.solids, verify_step_rad)
        self.min_distance_m = scene.min_distance_m

    def in_collision(self, q: Array) -> bool:
        """Return whether parts touch or cannot be proven apart."""
        return not self.solids.free(q)

    def closest(self, q: Array, within_m: float) -> list[PairDistance]:
        """Return checked pairs nearer than `within_m`, nearest first, from MuJoCo."""
        if self.solids.free(np.asarray(q), within_m):
            return []
        return self.verifier.engine("mujoco").closest(q, within_m)
