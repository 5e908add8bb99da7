"""The LeRobot teleoperator `minidual_leader`."""

from .config_minidual_leader import MinidualLeaderConfig
from .minidual_leader import MinidualLeader

__all__ = ["MinidualLeader", "MinidualLeaderConfig"]
