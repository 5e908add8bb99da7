"""The LeRobot environment `minidual`."""

from .configuration_minidual import MinidualEnv

__all__ = ["MinidualEnv"]
