"""The network `keyframe_act` as a LeRobot plug-in.

Importing it registers `spatial_act` with LeRobot's factories.
"""

from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig

__all__ = ["SpatialActConfig"]
