"""Lessons of the package: tasks that can be learned by reinforcement."""
