"""Both collision engines of a scene, its solids and the proof, built once a scene."""

from __future__ import annotations

from minidual.collision.coal_engine import CoalEngine
from minidual.collision.mujoco_engine import MujocoEngine
from minidual.collision.scene import PlanningScene
from minidual.proof.solids import Solids
from minidual.proof.verify import STEP_RAD, Verifier


class SceneEngines:
    """What planning in one scene needs (about 40 ms to build)."""

    def __init__(self, scene: PlanningScene, verify_step_rad: float = STEP_RAD) -> None:
        self.scene = scene
        self.mujoco = MujocoEngine(scene)
        self.coal = CoalEngine(scene)
        self.solids = Solids(scene, self.coal)
        self.verifier = Verifier(self.mujoco, self.coal, self.solids, verify_step_rad)
