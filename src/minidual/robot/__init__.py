"""The one description of two Pandas: names, limits, kinematics and dynamics."""
