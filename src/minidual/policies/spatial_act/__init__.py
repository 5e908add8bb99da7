"""ACT with a spatial-softmax image encoder, laid out as a LeRobot policy plug-in.

Importing this package registers the policy type `spatial_act` with LeRobot, so that LeRobot's own
`PreTrainedConfig.from_pretrained`, `get_policy_class` and `make_pre_post_processors` understand a checkpoint
whose config.json says `"type": "spatial_act"`.
"""

from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig

__all__ = ["SpatialActConfig"]
