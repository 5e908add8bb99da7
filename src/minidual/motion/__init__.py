"""Motion planning; start at `api.Planner` or `held.planner.HeldPlanner`. Importing the package imports no module."""
