"""The network `keyframe_diffusion` as a LeRobot plug-in.

Importing it registers `spatial_diffusion` with LeRobot's factories.
"""

from minidual.policies.spatial_diffusion.configuration_spatial_diffusion import (
    SpatialDiffusionConfig,
)

__all__ = ["SpatialDiffusionConfig"]
