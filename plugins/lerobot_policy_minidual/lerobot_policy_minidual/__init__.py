"""The LeRobot policies `spatial_act` and `spatial_diffusion`. Importing a configuration registers it."""

from minidual.policies.spatial_act import SpatialActConfig
from minidual.policies.spatial_diffusion import SpatialDiffusionConfig

__all__ = ["SpatialActConfig", "SpatialDiffusionConfig"]
