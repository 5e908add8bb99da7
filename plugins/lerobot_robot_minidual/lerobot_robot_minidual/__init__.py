"""The LeRobot robot `bi_minidual`."""

from .bi_minidual import BiMinidual
from .config_bi_minidual import BiMinidualConfig

__all__ = ["BiMinidual", "BiMinidualConfig"]
