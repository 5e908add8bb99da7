"""Query sets of the planner and their evaluation."""
