"""The LeRobot policy `spatial_act`. Importing its configuration registers it."""

from minidual.policies.spatial_act import SpatialActConfig

__all__ = ["SpatialActConfig"]
