"""Motion planning. Entry points: `api.Planner` and `held.planner.HeldPlanner`.

Nothing is imported here, to keep importing the package fast.
"""
