"""Processors of stock ACT."""

from lerobot.policies.act.processor_act import make_act_pre_post_processors

make_spatial_diffusion_pre_post_processors = make_act_pre_post_processors
