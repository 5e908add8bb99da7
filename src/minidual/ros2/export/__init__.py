"""A colcon workspace for one pair of arms."""
