"""ACT with a spatial-softmax encoder, as a LeRobot plug-in.

Importing it registers the type `spatial_act` with LeRobot's `PreTrainedConfig.from_pretrained`, `get_policy_class` and
`make_pre_post_processors`.
"""

from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig

__all__ = ["SpatialActConfig"]
