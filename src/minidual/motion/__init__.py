"""Motion planning; start at `api.Planner` or `held.planner.HeldPlanner`."""
