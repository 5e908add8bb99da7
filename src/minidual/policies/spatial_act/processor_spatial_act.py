"""Processors of stock ACT."""

from __future__ import annotations

from typing import Any

from lerobot.policies.act.processor_act import make_act_pre_post_processors
from torch import Tensor

from minidual.policies.spatial_act.configuration_spatial_act import SpatialActConfig


def make_spatial_act_pre_post_processors(
    config: SpatialActConfig, dataset_stats: dict[str, dict[str, Tensor]] | None = None
) -> tuple[Any, Any]:
    """Return normalising pre-processor and un-normalising post-processor."""
    act: Any = config  # has the ACTConfig entries read there
    return make_act_pre_post_processors(act, dataset_stats)
