"""Plants whose torques act a control period late: what the contact observer takes for a contact, and what not."""

from __future__ import annotations

import numpy as np
import pytest

from minidual.config.control import SupervisorConfig
from minidual.config.scene import SceneConfig
from minidual.control.supervisor import Supervisor
from minidual.robot.kinematics import Kinematics
from tests.support.panda import HOME
from tests.support.stacks import Arms, hand_over, move, run, stack_on, trajectory

WAY = np.tile([0.5, 0.3, 0.0, 0.4, 0.0, 0.4, 0.5], 2)


class Behind(Arms):
    """Arms controlled at 50 Hz; each torque acts from the next period on."""

    def __init__(self, scene: SceneConfig) -> None:
        self._acts: np.ndarray | None = None
        super().__init__(scene)
        self.dt = 0.02
        self._ticks = 0

    @property
    def time(self) -> float:
        return self.__dict__.get("_ticks", 0) * 0.02

    @time.setter
    def time(self, value: float) -> None: ...

    def step(self) -> None:
        told = self.tau
        self.tau = told if self._acts is None else self._acts
        self.dt = 1e-3
        for _ in range(20):
            super().step()
        self.tau = told
        self._acts = told
        self.dt = 0.02
        self._ticks += 1


def swing(scene: SceneConfig, told_s: float, push: np.ndarray | None = None) -> list[str]:
    """Move both arms there and back at 50 Hz, pushed on the way back; return the reflexes."""
    plant = Behind(scene)
    stack = stack_on(
        plant,
        supervisor=Supervisor(SupervisorConfig(torque_delay_s=told_s), dt_s=plant.dt),
    )
    hand_over(stack, "moveit")
    found = list[str]()
    for sequence, ends in enumerate(((HOME, HOME + WAY), (HOME + WAY, HOME)), start=1):
        if not found:
            assert stack.propose("moveit", trajectory(stack, move(*ends, 0.5), sequence)) is None
            plant.pushed = np.zeros(14) if push is None or sequence == 1 else push
            found += run(stack, 60)
    assert found or np.abs(plant.q - HOME).max() < 0.02
    return found


def test_torques_that_act_late_are_no_contact_once_told(scene: SceneConfig) -> None:
    assert swing(scene, 0.0)[:1] in (["contact.hand"], ["contact.joint"])
    assert swing(scene, 0.02) == []


@pytest.mark.parametrize("arm", [0, 1])
def test_a_push_is_still_named(scene: SceneConfig, kinematics: Kinematics, arm: int) -> None:
    push = 60.0 * kinematics.tcp_jacobians(HOME)[arm][1]
    assert swing(scene, 0.02, push)[:1] in (["contact.hand"], ["contact.joint"])
