"""A leader of minidual as a LeRobot teleoperator."""

from functools import cached_property
from typing import Any

from lerobot.lerobot_types import RobotAction
from lerobot.teleoperators import Teleoperator
from lerobot.utils.decorators import check_if_already_connected, check_if_not_connected

from minidual.plugin_parts.leading import Lead, LeadSettings

from .config_minidual_leader import MinidualLeaderConfig


class MinidualLeader(Teleoperator):
    """Gives targets of both arms by the names of the robot `bi_minidual`."""

    config_class = MinidualLeaderConfig
    name = "minidual_leader"

    def __init__(self, config: MinidualLeaderConfig) -> None:
        super().__init__(config)
        self.config = config
        self.lead = Lead(LeadSettings(config.leader, config.task, config.settings))

    @cached_property
    def action_features(self) -> dict[str, type]:
        """Joints [rad] and grippers (0 closed to 1 open)."""
        return dict.fromkeys(self.lead.names, float)

    @cached_property
    def feedback_features(self) -> dict[str, type]:
        """A leader reads the arms' state itself."""
        return {}

    @property
    def is_connected(self) -> bool:
        """Whether the device is."""
        return self.lead.is_connected

    @check_if_already_connected
    def connect(self, calibrate: bool = True) -> None:
        """Connect the device."""
        self.lead.connect()

    @property
    def is_calibrated(self) -> bool:
        """`minidual leader calibrate` does it."""
        return True

    def calibrate(self) -> None:
        """Do nothing."""

    def configure(self) -> None:
        """Do nothing."""

    @check_if_not_connected
    def get_action(self) -> RobotAction:
        """Return the newest targets."""
        return dict(self.lead.action())

    def send_feedback(self, feedback: dict[str, Any]) -> None:
        """Do nothing: see `feedback_features`."""

    @check_if_not_connected
    def disconnect(self) -> None:
        """Release the device."""
        self.lead.close()
