"""Planning for an object held by both hands. Start at `planner`."""
