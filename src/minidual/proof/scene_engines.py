"""What planning in one scene needs: its solids, its proof, and the collision engines where they are asked for."""

from __future__ import annotations

import numpy as np

from minidual.collision.engine import PairDistance
from minidual.collision.scene import PlanningScene
from minidual.proof.solids import Solids
from minidual.proof.verify import STEP_RAD, Verifier
from minidual.robot.pair import Array


class SceneEngines:
    """Geometry and proof of one scene (a few ms to build). Planes answer; the engines are built when they are needed.

    Attributes:
        scene: The scene.
        solids: Its geometry.
        verifier: Its proof.
        min_distance_m: Distance that the scene keeps from obstacles.
    """

    def __init__(self, scene: PlanningScene, verify_step_rad: float = STEP_RAD) -> None:
        self.scene = scene
        self.solids = Solids(scene)
        self.verifier = Verifier(scene, self.solids, verify_step_rad)
        self.min_distance_m = scene.min_distance_m

    def in_collision(self, q: Array) -> bool:
        """Return whether anything touches at q (dof,), or is not seen apart."""
        return not self.solids.free(q)

    def closest(self, q: Array, within_m: float) -> list[PairDistance]:
        """Return every checked pair nearer than `within_m` at q (dof,), nearest first; names and depths from MuJoCo."""
        if self.solids.free(np.asarray(q), within_m):
            return []
        return self.verifier.engine("mujoco").closest(q, within_m)
