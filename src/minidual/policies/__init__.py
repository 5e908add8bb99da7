"""Learned policies: kinds, training and runtime.

Kinds, which import torch and LeRobot, load lazily.
"""
