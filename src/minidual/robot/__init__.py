"""Arm models, URDF, kinematics and trajectories."""
