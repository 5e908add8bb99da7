"""Both collision engines of a scene, the motion bound and the proof, built once a scene."""

from __future__ import annotations

from minidual.planning.coal_engine import CoalEngine
from minidual.planning.motion_bound import MotionBound
from minidual.planning.mujoco_engine import MujocoEngine
from minidual.planning.scene import PlanningScene
from minidual.planning.verify import STEP_RAD, Verifier


class SceneEngines:
    """What planning in one scene needs (about 40 ms to build)."""

    def __init__(self, scene: PlanningScene, verify_step_rad: float = STEP_RAD) -> None:
        self.scene = scene
        self.mujoco = MujocoEngine(scene)
        self.coal = CoalEngine(scene)
        self.verifier = Verifier(self.mujoco, self.coal, MotionBound(scene, self.coal), verify_step_rad)
