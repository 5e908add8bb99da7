"""Two simulated arms of minidual as one LeRobot robot."""

from functools import cached_property
from typing import Any

from lerobot.lerobot_types import RobotAction, RobotObservation
from lerobot.robots import Robot
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from minidual.plugin_parts.arms import ArmsSettings, SimulatedArms

from .config_bi_minidual import BiMinidualConfig


class BiMinidual(Robot):
    """Both arms, their grippers and the cameras of a task.

    Keys are `left_<joint>.pos` [rad], `left_gripper.pos` (0 closed to 1 open), the same of the right
    arm, and `cam_high`, `cam_left`, `cam_right`.
    """

    config_class = BiMinidualConfig
    name = "bi_minidual"

    def __init__(self, config: BiMinidualConfig) -> None:
        super().__init__(config)
        self.config = config
        settings = ArmsSettings(
            task=config.task,
            views=tuple(config.views),
            rate_hz=config.fps,
            start=config.start,
            seed=config.seed,
            episode_time_s=config.episode_time_s,
        )
        self.arms = SimulatedArms(settings)
        self.cameras = self.arms.cameras  # LeRobot counts them

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """Joints and grippers, then the sizes of pictures."""
        return {**self.action_features, **self.arms.cameras}

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Joints and grippers."""
        return dict.fromkeys(self.arms.names, float)

    @property
    def is_connected(self) -> bool:
        """Whether the simulation runs."""
        return self.arms.is_connected

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Build the simulation."""
        self.arms.connect()

    @property
    def is_calibrated(self) -> bool:
        """Simulated joints need no calibration."""
        return True

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    @check_if_not_connected
    def get_observation(self) -> RobotObservation:
        """Return what joints and cameras measure."""
        return dict(self.arms.observe())

    @check_if_not_connected
    def send_action(self, action: RobotAction) -> RobotAction:
        """Drive for one period; return the targets within the limits."""
        return dict(self.arms.act(action))

    @check_if_not_connected
    def disconnect(self) -> None:
        """Log how the last start ended, and free the simulation."""
        self.arms.close()
