"""Arm models, kinematics and trajectories."""
